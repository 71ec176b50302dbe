"""Writes numbers, units, kinds of joints, and notes about recorded data as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..errors import significant
from ..robot.model import Floats, RobotModel

if TYPE_CHECKING:
    from ..analysis.recordings.signals import Motion


def kind_of(robot: RobotModel, body: int) -> str:
    """Return the kind of the joint that moves a body."""
    if robot.is_prismatic[body]:
        return 'prismatic'
    return 'continuous' if robot.is_continuous[robot.joint_index[body]] else 'revolute'


def effort_unit(robot: RobotModel, joint: int) -> str:
    """Return the unit of a joint's effort, padded to a common length."""
    return 'N  ' if robot.is_prismatic_joint[joint] else 'N m'


def number(value: float) -> str:
    """Write a limit; an infinite limit becomes a dash."""
    if not math.isfinite(value):
        return '-'
    return f'{value:.0f}' if 1e4 <= abs(value) < 1e7 else f'{value:.4g}'


def fraction(effort: float, limit: float) -> str:
    """Write the ratio of an effort to its limit as a percentage, or a dash if it has no limit."""
    return f'{abs(effort) / limit:.0%}' if math.isfinite(limit) else '-'


def decimals(values: Floats, digits: int = 4) -> int:
    """Return the number of decimals, 1 to 6, that shows `digits` digits of the largest value."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not 0.0 < largest < math.inf:
        return 1
    return min(6, max(1, digits - 1 - math.floor(math.log10(largest))))


def with_error(value: float, error: float) -> str:
    """Write a value with as many digits as its standard error justifies."""
    if not error > 0.0 or not math.isfinite(error):
        return significant(value, 4)
    places = min(6, max(0, 1 - math.floor(math.log10(error))))
    return f'{value:.{places}f} ± {error:.{places}f}'


def motion_notes(motion: Motion) -> list[str]:
    """Return notes about ignored, repaired and doubtful data, without full stops."""
    notes = list(motion.notes)
    if motion.lags:
        late = ', '.join(f'{name} {1e3 * value:.0f} ms' for name, value in motion.lags.items())
        notes.append(
            f'recorded velocities lag behind the positions ({late}); velocities were derived from '
            'the positions instead'
        )
    if math.isfinite(motion.cut_off):
        notes.append(
            f'the efforts contain no signal and no noise above about {motion.cut_off:.0f} Hz: '
            'they passed a low-pass filter before they were recorded (or the efforts were '
            'computed without noise). This filter distorts the friction at reversals; record the '
            'efforts of the driver without a filter'
        )
    return notes
