"""
Runs the steps of the identification in order.

Joint terms are the effects of a drive, such as friction and armature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np

from ...dynamics.inverse_dynamics import STANDARD_GRAVITY
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import Recording
from .corrections import estimate_delay, first_gains, link_factors
from .evaluation import evaluate
from .fit import Equations, RobotFit, solve, weights_of, with_best_urdf_weight
from .preparation import (
    GOOD_RECORDINGS,
    measured_joints,
    prepare_all,
    training_data,
    TrainingData,
)
from .regression import (
    ARMATURE,
    COULOMB,
    DAMPING,
    IdentificationProblem,
    IdentifiedBodies,
    LOAD,
    Model,
    OFFSET,
    TERMS,
)
from .result import IdentificationResult
from .terms import with_best_widths, with_extra, without_useless_terms

ROUNDS = 3
DELAY_ROUNDS = 3
GAIN_ROUNDS = 10
LEAST_DELAY = 1e-3
"""Smaller delays of the efforts are not removed [s]."""
CERTAIN = 3.0
"""A delay is removed only if it exceeds this many standard errors."""
FIRST_URDF_WEIGHT = 1.0
HELD = 1e9
"""Weight of the robot description with which its bodies are kept."""
FRICTION = [DAMPING, COULOMB, OFFSET]


def identify_parameters(
    robot: RobotModel,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    gravity: Floats | tuple[float, ...] = STANDARD_GRAVITY,
    payload: tuple[str, float, Sequence[float]] | None = None,
    currents: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> IdentificationResult:
    """
    Identify inertial parameters, friction and armature of a robot.

    If the recordings contain little information, the result stays close to the robot description.
    The result is evaluated on the `validation` recordings. Without `validation`, each block of
    `recordings` is predicted by a fit to the other blocks.

    `gravity` is the free-fall acceleration in the base frame [m/s^2]. `payload` contains the link,
    mass [kg] and centre of mass [m] of a known payload. If `currents` is
    true, motor currents were recorded instead of efforts, and one gain per joint is estimated.
    `progress` is called with the completed fraction, 0 to 1.

    Raises RecordingError if the recordings are unusable or too short, or contain too little
    information. Raises ConfigurationError if a link does not exist, or if nothing is left to
    identify.

    """
    joints = measured_joints(robot, recordings)
    gravity = np.array(gravity, dtype=float)
    problem = IdentificationProblem(IdentifiedBodies(robot), joints, gravity, payload, currents)
    training = prepare_all(robot, recordings, joints)
    unseen = prepare_all(robot, validation, joints)
    progress(0.2)
    try:
        data = training_data(problem, training)
        every = [ARMATURE, DAMPING, COULOMB, LOAD, OFFSET]
        if currents:
            data = with_first_gains(data)
        fit = fitted(data, nominal(data), terms_of(data, every), FIRST_URDF_WEIGHT)
        progress(0.4)
        while (better := with_extra(fit, data.moving)) is not None:
            fit = refitted(data, better)
        data, fit, delay = remove_delay(data, fit)
        if currents:
            data, fit = fit_gains(data, fit)
        progress(0.7)
        fit = refitted(data, with_best_urdf_weight(fit))
        while (needed := without_useless_terms(fit)) is not fit:
            fit = refitted(data, with_best_urdf_weight(needed))
        friction = fitted(data, nominal(data), terms_of(data, FRICTION), HELD)
        return evaluate(data, fit, friction, delay, unseen)
    except np.linalg.LinAlgError as error:
        raise RecordingError(
            f'the recordings contain too little information: the fit has no solution ({error}); '
            f'{GOOD_RECORDINGS}'
        ) from None


def nominal(data: TrainingData) -> Model:
    """Return the bodies of the robot description without joint terms."""
    m = len(data.problem.joints)
    return Model(
        data.problem.identified.reference, np.zeros((m, TERMS)), np.full(m, 0.05), np.zeros(m)
    )


def terms_of(data: TrainingData, chosen: Sequence[int]) -> Booleans:
    """Return a mask of the chosen terms, shape (joints, 6); joints at rest have only offsets."""
    used = np.zeros((len(data.problem.joints), TERMS), dtype=bool)
    used[:, list(chosen)] = data.moving[:, None]
    used[:, OFFSET] = True
    return used


def fitted(
    data: TrainingData, model: Model, used: Booleans, urdf_weight: float, rounds: int = ROUNDS
) -> RobotFit:
    """Alternate between choosing friction widths and fitting all other unknowns together."""
    regression = data.regression
    for _ in range(rounds):
        model = with_best_widths(regression, model, used)
        weights = weights_of(regression.residual(model))
        fit = solve(Equations(regression, model), weights, urdf_weight, used, model)
        model = fit.model
    return fit._replace(weights=weights_of(regression.residual(model)))


def refitted(data: TrainingData, fit: RobotFit) -> RobotFit:
    """Repeat a fit with new friction widths."""
    return fitted(data, fit.model, fit.used, fit.urdf_weight, 2)


def remove_delay(
    data: TrainingData, fit: RobotFit
) -> tuple[TrainingData, RobotFit, tuple[float, float]]:
    """
    Estimate the delay of the efforts, and remove a delay that is certain.

    A filter of the efforts looks like a delay, so nothing is removed from filtered efforts.
    Returns the corrected data, the fit, and the delay with its standard error [s].

    """
    is_filtered = any(math.isfinite(motion.cut_off) for motion in data.motions)
    for _ in range(DELAY_ROUNDS):
        removed = data.correction.delay
        more, error = estimate_delay(fit)
        if is_filtered or abs(more) < max(CERTAIN * error, LEAST_DELAY):
            break
        data = data.corrected(data.correction._replace(delay=removed + more))
        fit, more = refitted(data, fit), 0.0
    return data, fit, (data.correction.delay + more, error)


# ---- Currents ------------------------------------------------------------------------------


def with_first_gains(data: TrainingData) -> TrainingData:
    """Estimate gains from the masses of the robot description, and convert currents to efforts."""
    used = terms_of(data, [ARMATURE, DAMPING, COULOMB, OFFSET])
    gains, known = first_gains(data.regression, nominal(data), used)
    return data.corrected(data.correction._replace(gains=gains, is_gain_known=known))


def fit_gains(data: TrainingData, fit: RobotFit) -> tuple[TrainingData, RobotFit]:
    """Alternate between fitting the gains and all other unknowns."""
    known = data.correction.is_gain_known
    for _ in range(GAIN_ROUNDS):
        factors, _ = link_factors(data.regression, fit.model, fit.used)
        change = np.where(known, 1.0 / np.clip(factors, 0.7, 1.4), 1.0)
        if data.problem.payload is None and known.any():  # restores the mean of the gains
            change *= np.exp(-np.mean(np.log(change[known])))
        gains = data.correction.gains * change
        data = data.corrected(data.correction._replace(gains=gains))
        fit = refitted(data, fit)
    return data, fit
