"""Selection of the commanded joints among those of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import ConfigurationError
from ..robot.model import RobotModel


def compact_index(index: list[int]) -> Any:
    """Return consecutive indices as a slice, with which numpy takes a third of the time."""
    first = index[0]
    if index == list(range(first, first + len(index))):
        return slice(first, first + len(index))
    return np.array(index)


def joint_index(joints: Sequence[str], robot: RobotModel) -> list[int]:
    """Return the indices of the commanded joints among those of the robot."""
    if not joints:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joints")
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f'joints lists a joint twice: {", ".join(joints)}')
    unknown = [name for name in joints if name not in robot.joint_names]
    if unknown:
        raise ConfigurationError(
            f"joints names '{unknown[0]}', which robot '{robot.name}' does not have or cannot be "
            f'commanded (fixed, or mimicking another); it has {", ".join(robot.joint_names)}'
        )
    return robot.joint_indices(joints)
