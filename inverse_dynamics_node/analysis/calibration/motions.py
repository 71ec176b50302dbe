"""Recordings as uniform motions of the whole robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import RecordingError
from ...robot.model import Floats, RobotModel
from ..identification.signals import derive, Recording
from .rows import Motion, pieces

HIGHEST_RATE = 250.0
"""Samples per second that are kept; the smoothed motions contain nothing faster."""
CONSTANT = 1e-6
"""Fraction of the largest effort up to which an effort that varies is constant."""


class Run(NamedTuple):
    """One recording, prepared for the regression."""

    motion: Motion
    noise: Floats
    """Noise that is left in the smoothed efforts, shape (m,) [N m or N]."""
    notes: tuple[str, ...]
    method: str


def measured_joints(robot: RobotModel, recordings: Sequence[Recording]) -> list[int]:
    """
    Return the joints whose efforts were measured in every recording.

    Raises
    ------
    RecordingError
        If there is none.

    """
    common = set(range(len(robot.joint_names)))
    for recording in recordings:
        found = set()
        for j, name in enumerate(recording.joint_names):
            efforts = recording.efforts[:, j]
            efforts = efforts[np.isfinite(efforts)]
            if name in robot.joint_names and len(efforts) and np.ptp(efforts) > 0.0:
                found.add(robot.joint_names.index(name))
        common &= found
    if not common:
        raise RecordingError('no joint of this robot has a measured effort that varies')
    return sorted(common)


def prepare(robot: RobotModel, recording: Recording, joints: Sequence[int]) -> Run:
    """
    Smooth a recording and derive velocities and accelerations.

    Parameters
    ----------
    robot : RobotModel
        Robot with n joints; those that were not recorded are assumed to rest at zero.
    recording : Recording
        The recording.
    joints : sequence of int
        Joints whose efforts are used, m of them.

    """
    recording = _without_turns(robot, recording)
    derived = derive(recording)
    n, K = len(robot.joint_names), len(derived.times)
    q, qd, qdd, efforts = np.zeros((4, K, n))
    index = [robot.joint_names.index(name) for name in derived.joint_names]
    q[:, index], qd[:, index], qdd[:, index] = derived.q, derived.qd, derived.qdd
    efforts[:, index] = derived.efforts
    period = float(np.median(np.diff(derived.times)))
    step = max(1, int(1.0 / (period * HIGHEST_RATE) + 1e-9))
    kept = np.concatenate([np.arange(a, b, step) for a, b in pieces(derived.times)])
    motion = Motion(
        derived.times[kept],
        q[kept],
        qd[kept],
        qdd[kept],
        efforts[kept][:, list(joints)],
        2 * (derived.window // (2 * step)) + 1,
        derived.degree,
    )
    columns = [derived.joint_names.index(robot.joint_names[i]) for i in joints]
    noise = np.array([_noise(recording.efforts[:, c]) for c in columns])
    return Run(motion, noise * _passed(derived.window, derived.degree), derived.notes,
               derived.method)  # fmt: skip


def _without_turns(robot: RobotModel, recording: Recording) -> Recording:
    """Remove jumps by a whole turn from the positions of continuous joints."""
    positions = recording.positions.copy()
    for j, name in enumerate(recording.joint_names):
        if robot.is_continuous[robot.joint_names.index(name)]:
            is_known = np.isfinite(positions[:, j])
            positions[is_known, j] = np.unwrap(positions[is_known, j])
    return recording._replace(positions=positions)


def _noise(values: Floats) -> float:
    """Return the standard deviation of white noise, from differences of the third order."""
    known = values[np.isfinite(values)]
    if len(known) < 8:
        return 0.0
    return float(np.sqrt(np.mean(np.diff(known, 3) ** 2) / 20.0))


def _passed(window: int, degree: int) -> float:
    """Return the factor by which smoothing reduces white noise."""
    from scipy.signal import savgol_coeffs

    return float(np.linalg.norm(savgol_coeffs(window, degree)))
