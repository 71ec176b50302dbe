"""Names the value that makes efforts infinite or too large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

import numpy as np

from ..robot.model import Floats

_PLAUSIBLE = 1e9  # in SI units; a larger input is the cause of efforts that are not finite


def describe_overflow(
    joint_names: Sequence[str], inputs: Mapping[str, Floats], efforts: Floats
) -> str:
    """
    Name the joint and the value that are the cause of efforts that are not finite.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints.
    inputs : mapping of str to ndarray, shape (n,)
        Inputs of the computation, by name.
    efforts : ndarray, shape (n,)
        Computed efforts [N m or N], for the case that the inputs are plausible.

    """
    name, joint = _largest(inputs)
    value = inputs[name][joint]
    if abs(value) <= _PLAUSIBLE:
        name, joint = _largest({'computed effort': efforts})
        value = efforts[joint]
    return f"the {name} of joint '{joint_names[joint]}' is {value:.4g}"


def _largest(arrays: Mapping[str, Floats]) -> tuple[str, int]:
    """Return the name and the index of the value with the largest magnitude; NaN is largest."""
    sizes = np.nan_to_num(np.abs(list(arrays.values())), nan=math.inf, posinf=math.inf)
    row, joint = np.unravel_index(np.argmax(sizes), sizes.shape)
    return list(arrays)[int(row)], int(joint)
