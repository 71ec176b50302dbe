"""Identifies a robot from recordings: prepare them, fit, and evaluate the fit on unseen data."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from ...dynamics.inverse_dynamics import STANDARD_GRAVITY
from ...errors import RecordingError
from ...robot.model import Floats, RobotModel
from ..recordings.recording import Recording
from .estimator import Estimator, GOOD_RECORDINGS
from .evaluation import evaluate
from .identified_bodies import identified_bodies
from .preparation import measured_joints, prepare_all
from .regression import IdentificationProblem
from .result import IdentificationResult


def identify_parameters(
    robot: RobotModel,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    gravity: Floats | tuple[float, ...] = STANDARD_GRAVITY,
    payload: tuple[str, float, Sequence[float]] | None = None,
    fixed: Collection[str] = (),
    currents: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> IdentificationResult:
    """
    Identify inertial parameters, friction and armature of a robot.

    Parameters
    ----------
    robot : RobotModel
        The robot description, which the result stays close to where the recordings say little.
    recordings : sequence of Recording
        Recordings to fit.
    validation : sequence of Recording
        Recordings to evaluate the result with; by default, blocks of the others that were left
        out of the fit in turn.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].
    payload : tuple of link, mass and centre of mass, optional
        Known payload in all recordings.
    fixed : collection of str
        Links that do not change.
    currents : bool
        Whether efforts were recorded as motor currents: one gain per joint is estimated.
    progress : callable
        Called now and then with the fraction that is done, 0 to 1.

    Returns
    -------
    result : IdentificationResult

    Raises
    ------
    RecordingError
        If a recording is not usable, or the recordings are too short or too uniform.
    ConfigurationError
        If a link does not exist, or nothing is left to identify.

    """
    joints = measured_joints(robot, [*recordings, *validation])
    identified = identified_bodies(robot, fixed)
    problem = IdentificationProblem(
        identified, joints, np.array(gravity, dtype=float), payload, currents
    )
    every = prepare_all(robot, [*recordings, *validation], joints)
    prepared, unseen = every[: len(recordings)], every[len(recordings) :]
    progress(0.1)
    try:
        found = Estimator(problem, prepared, progress)
        return evaluate(found, unseen)
    except np.linalg.LinAlgError as error:
        raise RecordingError(
            f'the recordings determine too little: the fit has no solution ({error}); '
            f'{GOOD_RECORDINGS}'
        ) from None
