"""
Converts recordings to motions of the whole robot, and to rows of a regression.

The friction width is the speed over which Coulomb friction is smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import derive, Motion, Recording, without_turns
from .corrections import EffortCorrection
from .regression import IdentificationProblem, Regression, regression_of

HIGHEST_RATE = 100.0
"""Highest sampling rate of prepared recordings [Hz]; smoothed signals do not need more."""
SMOOTHING = 0.2
"""
Smoothing window of the fit [s].

For an industrial arm, all windows from 0.1 s to 0.4 s led to the same errors on unseen data,
within 1 %. A window of 0.6 s increased the errors by 3 %, and a window of 0.8 s by 8 %.
"""
NOISES_IN_WIDTH = 3.0
"""
Smallest exported friction width, in standard deviations of the velocity noise.

With this width, one standard deviation of velocity noise changes the commanded friction effort at
rest by a third of Coulomb friction.
"""
BLOCKS = 8
LEAST_DURATION = 3.0
"""Least total duration of the smoothed recordings [s]."""
LEAST_TRAVEL = {False: 0.02, True: 0.002}
"""Least travel in each direction for identifying friction [rad or m]; True: prismatic."""
LEAST_RETURN = 0.1
"""Least travel in each direction for identifying friction, as a fraction of the total travel."""
GOOD_RECORDINGS = (
    'record slow and fast motions of all joints for at least 30 s; `inverse_dynamics excite` '
    'plans a suitable motion'
)


def measured_joints(robot: RobotModel, recordings: Sequence[Recording]) -> list[int]:
    """
    Return the joints whose efforts vary in every recording.

    Raises RecordingError if there are no such joints.

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
        raise RecordingError('no joint of this robot has efforts that vary in every recording')
    return sorted(common)


def prepare_all(
    robot: RobotModel, recordings: Sequence[Recording], joints: Sequence[int]
) -> list[Motion]:
    """
    Smooth all recordings, and return motions of all joints of the robot.

    The motions contain the efforts, and the noise, of `joints`. Joints without recorded positions
    are assumed to stay at zero. Raises RecordingError if a recording is too short, or if one of
    the joints has no measured effort.

    """
    return [_prepare(robot, without_turns(robot, each), joints) for each in recordings]


def _prepare(robot: RobotModel, recording: Recording, joints: Sequence[int]) -> Motion:
    derived = derive(recording, HIGHEST_RATE)
    names = [robot.joint_names[joint] for joint in joints]
    is_measured = np.isfinite(derived.efforts).any(axis=0)
    measured = [derived.joint_names[j] for j in np.flatnonzero(is_measured)]
    if missing := [name for name in names if name not in measured]:
        raise RecordingError(
            f'a validation recording has efforts of {", ".join(measured)}, but not of '
            f'{", ".join(missing)}; expected efforts of the same joints as in the fitted '
            'recordings'
        )
    q, qd, qdd = np.zeros((3, len(derived.times), len(robot.joint_names)))
    index = [robot.joint_names.index(name) for name in derived.joint_names]
    q[:, index], qd[:, index], qdd[:, index] = derived.q, derived.qd, derived.qdd
    columns = [derived.joint_names.index(name) for name in names]
    return derived._replace(
        q=q,
        qd=qd,
        qdd=qdd,
        efforts=derived.efforts[:, columns],
        joint_names=robot.joint_names,
        effort_noise=derived.effort_noise[columns],
        qdd_noise=derived.qdd_noise[columns],
        qd_noise=derived.qd_noise[columns],
    )


# ---- Rows of a regression ------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TrainingData:
    """The recordings to fit, and their regression."""

    problem: IdentificationProblem
    motions: Sequence[Motion]
    duration: float
    """Total duration of the recordings [s]."""
    moving: Booleans
    """Whether each joint moved enough to identify its friction, shape (joints,)."""
    least_widths: Floats
    """Smallest friction widths to export, shape (joints,) [rad/s or m/s]."""
    correction: EffortCorrection
    regression: Regression
    """The smoothed rows with corrected efforts."""

    def corrected(self, correction: EffortCorrection) -> TrainingData:
        """Return the data with another correction of the efforts."""
        regression = self.regression.with_efforts(correction.apply(self.motions))
        return replace(self, correction=correction, regression=regression)


def training_data(problem: IdentificationProblem, motions: Sequence[Motion]) -> TrainingData:
    """Build the regression; raise RecordingError if the recordings are too short."""
    moving = _moving_joints(problem, motions)
    duration = sum(float(np.ptp(motion.times)) for motion in motions)
    regression = regression_of(problem, motions, SMOOTHING, BLOCKS)
    if duration < LEAST_DURATION or not len(regression.efforts):
        raise RecordingError(
            f'after smoothing, the recordings last {duration:.2g} s, expected at least '
            f'{LEAST_DURATION:g} s without gaps; {GOOD_RECORDINGS}'
        )
    m = len(problem.joints)
    return TrainingData(
        problem,
        motions,
        duration,
        moving,
        NOISES_IN_WIDTH * np.max([motion.qd_noise for motion in motions], axis=0),
        EffortCorrection(0.0, np.ones(m), np.zeros(m, dtype=bool)),
        regression,
    )


def _moving_joints(problem: IdentificationProblem, motions: Sequence[Motion]) -> Booleans:
    """Return whether each joint moved enough to identify its friction."""
    forth = np.zeros(len(problem.joints))
    back = np.zeros(len(problem.joints))
    for motion in motions:
        steps = np.diff(motion.q[:, problem.joints], axis=0)
        forth += np.maximum(steps, 0.0).sum(axis=0)
        back -= np.minimum(steps, 0.0).sum(axis=0)
    slides = problem.identified.robot.is_prismatic_joint[problem.joints]
    least = np.where(slides, LEAST_TRAVEL[True], LEAST_TRAVEL[False])
    return np.asarray(np.minimum(forth, back) > np.maximum(least, LEAST_RETURN * (forth + back)))
