"""
Runs the steps of the identification in order.

Joint terms are the effects of a drive, such as friction and armature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...dynamics.inverse_dynamics import STANDARD_GRAVITY
from ...errors import RecordingError
from ...robot.model import Floats, RobotModel
from ..recordings.signals import Recording
from .drives import choose_terms, estimate_delay, first_gains, JointFit
from .evaluation import evaluate
from .extras import with_extra, without_useless_extras
from .fit import choose_urdf_weight, Equations, RobotFit, solve, solve_within_reason, weights_of
from .preparation import (
    GOOD_RECORDINGS,
    measured_joints,
    prepare_all,
    training_data,
    TrainingData,
)
from .regression import GAIN, IdentificationProblem, identified_bodies, Model, RATIO, TERMS, WIDTH
from .result import IdentificationResult

ROUNDS = 3
WIDTH_ROUNDS = 4
DELAY_ROUNDS = 3
GAIN_ROUNDS = 5
LEAST_DELAY = 2e-4
"""Smaller delays of the efforts are not removed [s]."""
FIRST_URDF_WEIGHT = 1.0


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
    bodies = identified_bodies(robot)
    gravity = np.array(gravity, dtype=float)
    problem = IdentificationProblem(bodies, joints, gravity, payload, currents)
    training, stretch = prepare_all(robot, recordings, joints)
    unseen, _ = prepare_all(robot, validation, joints, stretch)
    progress(0.1)
    try:
        data = training_data(problem, training)
        if currents:
            data = with_first_gains(data)
        progress(0.2)
        start = without_terms(data, bodies.reference)
        fit = fit_in_turn(data, start, np.full(len(bodies.bodies), FIRST_URDF_WEIGHT))
        fit = fit_with_extras(data, fit)
        data, fit, delay = remove_delay(data, fit)
        if currents:
            data, fit = fit_gains(data, fit)
        progress(0.6)
        fit = fit._replace(weights=weights_of(data.regression.residual(fit.model)))
        urdf_weight, trials = choose_urdf_weight(fit)
        progress(0.9)
        fit = fit_with_widths(data, fit, urdf_weight)
        if (needed := without_useless_extras(data.regression, fit)) is not fit:
            fit = fit_with_widths(data, needed, urdf_weight)
        friction = fit_friction(data)
        return evaluate(data, fit, friction, delay, urdf_weight, trials, unseen)
    except np.linalg.LinAlgError as error:
        raise RecordingError(
            f'the recordings contain too little information: the fit has no solution ({error}); '
            f'{GOOD_RECORDINGS}'
        ) from None


def with_first_gains(data: TrainingData) -> TrainingData:
    """Estimate gains from the masses of the robot description, and convert currents to efforts."""
    before = data.problem.identified.before
    gains, known = first_gains(data.regression, before, data.widths[3], data.moving)
    return data.corrected(data.correction._replace(gains=gains, is_gain_known=known))


def without_terms(data: TrainingData, bodies: Floats) -> JointFit:
    """Return a model with the given bodies and no joint terms."""
    m = len(data.problem.joints)
    model = Model(bodies, np.zeros((m, TERMS)), np.ones(m), np.zeros(m))
    return JointFit(model, np.zeros((m, TERMS), dtype=bool))


def fit_friction(data: TrainingData) -> JointFit:
    """Fit only friction and offsets, and keep the bodies of the robot description."""
    start = without_terms(data, data.problem.identified.before)
    return choose_terms(data.regression, start, data.moving, data.widths, optional=False)


def fit_in_turn(
    data: TrainingData, fit: JointFit | RobotFit, urdf_weights: Floats, rounds: int = ROUNDS
) -> RobotFit:
    """Alternate between choosing joint terms and fitting all unknowns together."""
    for _ in range(rounds):
        start, used = choose_terms(data.regression, fit, data.moving, data.widths)
        weights = weights_of(data.regression.residual(start))
        fit = solve(Equations(data.regression, start), weights, urdf_weights, used, start)
    assert isinstance(fit, RobotFit)
    return fit


def fit_with_extras(data: TrainingData, fit: RobotFit) -> RobotFit:
    """Add springs and couplings as long as the prediction improves."""
    while (better := with_extra(data.regression, data.moving, fit)) is not None:
        fit = fit_in_turn(data, better, fit.prior.weights, 2)
    return fit


def remove_delay(
    data: TrainingData, fit: RobotFit
) -> tuple[TrainingData, RobotFit, tuple[float, float]]:
    """
    Estimate the delay of the efforts, and remove the delay if this improves the fit.

    Returns the corrected data, the fit, and the delay with its standard error [s].

    """
    delay = error = 0.0
    for _ in range(DELAY_ROUNDS):
        removed = data.correction.delay
        more, error = estimate_delay(data.regression, fit)
        delay = removed + more
        if abs(more) < max(2.0 * error, LEAST_DELAY):
            break
        weights, before = fit.weights, _loss(data, fit, fit.weights)
        data, fit = _shift(data, fit, delay)
        if _loss(data, fit, weights) > before:
            data, fit = _shift(data, fit, removed)
            delay = removed
            break
    return data, fit, (delay, error)


def _shift(data: TrainingData, fit: RobotFit, delay: float) -> tuple[TrainingData, RobotFit]:
    data = data.corrected(data.correction._replace(delay=delay))
    return data, fit_in_turn(data, fit, fit.prior.weights, 2)


def _loss(data: TrainingData, fit: RobotFit, weights: Floats) -> float:
    return float((weights * data.regression.residual(fit.model) ** 2).sum())


def fit_gains(data: TrainingData, fit: RobotFit) -> tuple[TrainingData, RobotFit]:
    """Fit the gains together with all other unknowns."""
    known, used = data.correction.is_gain_known, fit.used
    with_gains = used.copy()
    with_gains[:, GAIN] = known
    for _ in range(GAIN_ROUNDS):
        equations = Equations(data.regression, fit.model)
        fit = fit.again(equations, with_gains, fit.model)
        change = 1.0 + np.clip(fit.model.joints[:, GAIN], -0.3, 0.3)
        common = _common_factor(data, change)
        gains = data.correction.gains * (np.where(known, change, 1.0) * common)
        data = data.corrected(data.correction._replace(gains=gains))
        fit = fit._replace(model=fit.model.scaled(common), weights=fit.weights / common**2)
    return data, fit._replace(used=used)


def _common_factor(data: TrainingData, change: Floats) -> float:
    """Return a factor that restores the geometric mean of the gains, or 1 if a mass is known."""
    known = data.correction.is_gain_known
    if data.problem.has_known_mass or not known.any():
        return 1.0
    return float(np.exp(-np.mean(np.log(change[known]))))


def fit_with_widths(data: TrainingData, fit: RobotFit, urdf_weight: float) -> RobotFit:
    """Fit all unknowns, including friction widths and couplings."""
    fit = fit_in_turn(data, fit, np.full(len(fit.model.bodies), urdf_weight), 2)
    # The efforts are not linear in widths and couplings, so the fit takes several steps.
    used = fit.used.copy()
    used[:, WIDTH] = data.moving
    used[:, RATIO] = fit.model.couplings != 0.0
    for _ in range(WIDTH_ROUNDS):
        equations = Equations(data.regression, fit.model)
        fit = solve_within_reason(equations, fit.weights, urdf_weight, used, fit.model)
        fit = fit._replace(model=fit.model.with_fitted_shapes())
    return fit
