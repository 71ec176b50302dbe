"""Compares a recorded motion with the model of the robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import derive, Motion, Recording, rms, without_turns
from .bodies import CERTAIN, fit_bodies
from .compared_efforts import (
    added_efforts,
    as_recorded,
    ComparedEfforts,
    CONSTANT,
    corrected_efforts,
    fit_joints,
    friction_efforts,
    obscured,
    with_shapes,
)
from .diagnoses import (
    Axes,
    decreases,
    diagnose,
    diagnose_axes,
    diagnose_constant,
    diagnose_interval,
    diagnose_positions,
    search_axes,
)
from .fault import Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import FrictionFit, is_moving
from .intervals import best_interval, FaultInterval, find_fault_interval, MUCH_LOUDER
from .joint_samples import unexplained_fraction
from .regression_data import RegressionData, RobotFit

REVERSED = 0.7  # with fitted links, reversed axes leave at most this fraction of the squares
MIN_DELAY, MAX_DELAY = 0.01, 0.3  # [s]; delays between these limits are reported
SMALL_STEP = 0.001  # [s]; the search for a delay ends at a smaller change
DELAY_ROUNDS = 5  # largest number of linear estimates of a delay


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Comparison of measured and modelled efforts of one joint, in N m or N."""

    name: str
    is_prismatic: bool
    rms_measured: float
    rms_modelled: float
    rms_residual: float
    """RMS of measured minus modelled effort."""
    rms_friction: float
    """RMS residual if only friction is fitted."""
    rms_corrected: float
    """RMS residual with fitted friction, a fitted offset and all corrections of faults."""
    noise: float
    """
    Standard deviation of the noise after smoothing, or NaN if the efforts were filtered before the
    recording. Residuals below the noise need no explanation.
    """
    scale: float
    """Slope of the line ``measured = scale * modelled + offset``, fitted by least squares."""
    offset: float
    friction: FrictionFit
    is_varying: bool
    """Whether the measured effort varies."""

    @property
    def explained(self) -> float:
        """Fraction of the squared effort that the model explains, or NaN for constant efforts."""
        return self._explained(self.rms_residual)

    @property
    def explained_corrected(self) -> float:
        """Fraction of the squared effort that the model, friction, offset and faults explain."""
        return self._explained(self.rms_corrected)

    def _explained(self, residual: float) -> float:
        return 1.0 - (residual / self.rms_measured) ** 2 if self.is_varying else math.nan


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """The comparison of a recording of K samples with the model."""

    motion: Motion
    """The motion of all recorded joints."""
    compared: tuple[int, ...]
    """Indices in ``motion.joint_names`` of the c joints with measured efforts."""
    joints: tuple[JointResidual, ...]
    """Residuals of the compared joints."""
    measured: Floats
    """Measured efforts, shape (K, c) [N m or N]."""
    modelled: Floats
    """Efforts of the uncorrected model, including its friction, shape (K, c) [N m or N]."""
    corrected: Floats
    """Modelled efforts with fitted friction and effects of all faults, shape (K, c) [N m or N]."""
    faults: tuple[Fault, ...]
    """Faults that explain the difference, most important first."""
    width: float
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""
    is_too_short: bool
    """Whether the recording is too short to diagnose a difference."""
    moving: tuple[int, ...]
    """
    Indices in ``joints`` of the joints that moved. If no joint moved, all joints with varying
    efforts are listed.
    """

    @property
    def explained(self) -> float:
        """Explained fraction of the squared efforts, averaged over both joint types."""
        return self._mean([joint.rms_residual for joint in self.joints])

    @property
    def explained_corrected(self) -> float:
        """Fraction of the squared efforts that the model, friction, offset and faults explain."""
        return self._mean([joint.rms_corrected for joint in self.joints])

    def _mean(self, residuals: list[float]) -> float:
        return 1.0 - unexplained_fraction(
            [residuals[c] ** 2 for c in self.moving],
            [self.joints[c].rms_measured ** 2 for c in self.moving],
            [self.joints[c].is_prismatic for c in self.moving],
        )


def diagnose_recording(
    dynamics: InverseDynamics,
    recording: Recording,
    link: str | None = None,
    convention: GravityConvention = WITH_GRAVITY,
) -> ComparisonResult:
    """
    Compare a recording with the robot model.

    The recording may contain any joints of the robot, in any order. Joints that were not recorded
    are assumed to rest at zero. `dynamics` must include all known loads. An unknown load is
    searched for on `link`, or on the links from `tip_links()` if `link` is None. The `convention`
    says whether measured efforts should contain gravity.

    Raise RecordingError if the robot lacks a recorded joint or the recording is not usable. Raise
    ConfigurationError if the link does not exist.
    """
    robot = dynamics.robot
    if link is not None:
        robot.link_index(link)  # raises if the link does not exist
    index = _indices(recording.joint_names, robot)
    motion = derive(without_turns(robot, recording))
    return _result(ComparedEfforts(dynamics, motion, index, link, FRICTION_WIDTH, convention))


def _indices(names: tuple[str, ...], robot: RobotModel) -> list[int]:
    unknown = [name for name in names if name not in robot.joint_names]
    if unknown:
        raise RecordingError(
            f"the recording has joint '{unknown[0]}', which robot '{robot.name}' does not have; "
            f'expected only {", ".join(robot.joint_names)}'
        )
    if len(set(names)) != len(names):
        raise RecordingError(f'the recording lists a joint twice: {", ".join(names)}')
    return [robot.joint_names.index(name) for name in names]


def _result(recorded: ComparedEfforts) -> ComparisonResult:
    found = _search(recorded)
    compared, robot_fit, fault = found.compared, found.robot_fit, found.interval
    measured, efforts = corrected_efforts(compared, robot_fit, fault)
    used = np.ones(len(efforts), dtype=bool)
    if fault is not None and fault.kind is FaultKind.EXTERNAL_FORCE:
        used = ~compared.inside(fault)
    unknown = obscured(compared, robot_fit)
    fits = fit_joints(compared, measured[used] - efforts[used], unknown, used)
    load = np.abs(compared.rigid + added_efforts(compared, robot_fit))
    if fault is None:
        fits = with_shapes(compared, fits, measured - efforts, load)
    for c, fit in enumerate(fits):
        efforts[:, c] += friction_efforts(compared, c, fit, load[:, c])
    corrected = as_recorded(compared, efforts, robot_fit)
    corrected = compared.distorted(corrected, found.signs, found.delay)
    # If the friction of a joint is unknown, all samples are compared.
    when = [
        used if fit.unknown_because else used & is_moving(recorded.qd[:, c], recorded.width)
        for c, fit in enumerate(fits)
    ]
    plain = fit_joints(recorded, recorded.measured - recorded.rigid, {})
    moving = [c for c in recorded.varying if recorded.moves(c)]
    return ComparisonResult(
        motion=recorded.motion,
        compared=tuple(recorded.compared),
        joints=tuple(
            _joint_residual(recorded, c, fits[c], plain[c], corrected[:, c], when[c])
            for c in range(len(fits))
        ),
        measured=recorded.measured,
        modelled=recorded.modelled,
        corrected=corrected,
        faults=found.faults,
        width=recorded.width,
        is_too_short=found.data.is_too_short,
        moving=tuple(moving or recorded.varying),
    )


class _Found(NamedTuple):
    """The explanation of a recording."""

    compared: ComparedEfforts
    """Efforts after reversed axes and the delay were corrected."""
    data: RegressionData
    robot_fit: RobotFit
    faults: tuple[Fault, ...]
    signs: Floats
    """Signs of the joint axes, shape (m,): -1 for reversed axes, and 1 for other axes."""
    delay: float = 0.0
    """Delay of the efforts [s]."""
    interval: FaultInterval | None = None


def _search(recorded: ComparedEfforts) -> _Found:
    """Find faults that explain the recorded efforts."""
    motion, names = recorded.motion, [recorded.names[c] for c in recorded.varying]
    constant = {recorded.names[c]: float(recorded.measured[0, c]) for c in recorded.constant}
    silent = diagnose_constant(constant)
    data = recorded.regression_data()
    every = np.ones(len(motion.joint_names))
    positions = diagnose_positions(recorded.robot, motion.q, motion.joint_names)
    if positions:  # wrong positions would make all other results wrong
        return _Found(recorded, data, data.friction_only(), (*positions, *silent), every)

    def undistorted(signs: Floats, delay: float = 0.0) -> ComparedEfforts:
        return recorded.undistorted(_of_motion(recorded, signs), delay)

    def with_signs(signs: Floats) -> RegressionData | None:
        other = undistorted(signs)
        return other.regression_data() if other.varying == recorded.varying else None

    axes = search_axes(data, with_signs)
    if (axes.signs < 0.0).any():
        axes = _confirmed(undistorted, axes, Axes(np.ones(len(names)), data, data.explain()))
    compared, delay = undistorted(axes.signs), _delay(partial(undistorted, axes.signs), axes)
    faults, robot_fit, late = diagnose_axes(data, axes, names), axes.robot_fit, axes.data
    if delay:
        compared = undistorted(axes.signs, delay)
        late = compared.regression_data()
        robot_fit = late.explain()
        faults.append(Fault(FaultKind.DELAY, values=(delay,)))
    late, robot_fit, others, interval = _beside_links(compared, late, robot_fit)
    faults = [*silent, *faults, *others]
    signs = _of_motion(recorded, axes.signs)
    return _Found(compared, late, robot_fit, tuple(faults), signs, delay, interval)


def _confirmed(
    undistorted: Callable[[Floats], ComparedEfforts], reversed_: Axes, recorded: Axes
) -> Axes:
    """Return `reversed_` if it clearly improves a fit of inertial parameters, else `recorded`."""
    left = []
    for each in (reversed_, recorded):
        bodies = fit_bodies(undistorted(each.signs), each.data, each.robot_fit)
        left.append(math.inf if bodies is None else bodies.unexplained_anywhere)
    return recorded if left[0] > REVERSED * left[1] else reversed_


def _delay(undistorted: Callable[[float], ComparedEfforts], axes: Axes) -> float:
    """Return the delay of the efforts [s], or 0 if the delay is small or uncertain."""
    data, robot_fit, delay = axes.data, axes.robot_fit, 0.0
    for _ in range(DELAY_ROUNDS):
        compared = undistorted(delay)
        if delay:
            data = compared.regression_data()
            robot_fit = data.refit(robot_fit)
        bodies = fit_bodies(compared, data, robot_fit)
        if bodies is None or abs(delay) > MAX_DELAY:
            return 0.0
        delay += bodies.delay
        if abs(delay) < max(0.5 * MIN_DELAY, CERTAIN * bodies.delay_error):
            return 0.0
        if abs(bodies.delay) < SMALL_STEP:
            break
    return delay if abs(delay) > MIN_DELAY else 0.0


def _of_motion(compared: ComparedEfforts, signs: Floats) -> Floats:
    """Return signs for all joints of the motion, with 1 for joints without varying efforts."""
    every = np.ones(len(compared.motion.joint_names))
    every[[compared.compared[c] for c in compared.varying]] = signs
    return every


def _beside_links(
    compared: ComparedEfforts, data: RegressionData, robot_fit: RobotFit
) -> tuple[RegressionData, RobotFit, list[Fault], FaultInterval | None]:
    """Explain the efforts, if necessary by wrong inertial parameters or a temporary cause."""
    names = [compared.names[c] for c in compared.varying]
    fault = find_fault_interval(data, robot_fit)
    bodies = fit_bodies(compared, data, robot_fit)
    nearer, faults = compared, []
    if bodies is not None and bodies.explain_more(data, robot_fit, fault):
        nearer = compared.with_bodies(bodies.change, bodies.has_own_gravity)
        data = nearer.regression_data()
        robot_fit = data.refit(bodies.robot_fit)
        fault = bodies.confirmed(find_fault_interval(data, robot_fit))
        if bodies.are_wrong:
            changes = decreases(data, names, bodies.before, bodies.after)
            faults = [Fault(FaultKind.BODIES, changes=changes)]
    if fault is not None:
        fault = _refined(nearer, fault)
        data, robot_fit = fault.data, fault.outside
    if compared.varying and (fault is None or fault.kind is FaultKind.EXTERNAL_FORCE):
        faults = diagnose(data, robot_fit, names) + faults
    if fault is not None:
        faults.insert(0, diagnose_interval(fault, names))
    return data, robot_fit, faults, fault


def _refined(compared: ComparedEfforts, fault: FaultInterval) -> FaultInterval:
    """Return the fault with an interval that is accurate to a single sample."""
    if fault.kind is FaultKind.MOUNTING:
        return fault
    is_force = fault.kind is FaultKind.EXTERNAL_FORCE
    measured, efforts = corrected_efforts(
        compared, fault.outside._replace(candidate=fault.data.nominal)
    )
    load = np.zeros_like(efforts) if is_force else added_efforts(compared, fault.outside)
    gain = np.zeros(len(efforts))
    for j, c in enumerate(compared.varying):
        fit = fault.outside.fits[j]
        if not fit.moves or (is_force and j not in fault.joints):
            continue
        left = measured[:, c] - efforts[:, c] - fit.offset
        left -= fit.friction(compared.qd[:, c], compared.direction[:, c])
        variance = max((fit.rms / fault.outside.factor(j)) ** 2, 1e-12)
        after = MUCH_LOUDER * variance if is_force else (left - load[:, c]) ** 2
        gain += (left**2 - after) / variance
    return fault._replace(interval=best_interval(compared.motion.times, gain, fault.interval))


def _joint_residual(
    compared: ComparedEfforts,
    c: int,
    friction: FrictionFit,
    plain: FrictionFit,
    corrected: Floats,
    when: Booleans,
) -> JointResidual:
    """
    Compare the efforts of one joint in the samples that the mask `when` selects.

    `plain` is the friction that was fitted without a correction of faults.
    """
    measured, modelled = compared.measured[when, c], compared.modelled[when, c]
    rubbing = plain.friction(compared.qd[when, c], compared.direction[when, c])
    is_varying = c in compared.varying
    has_line = is_varying and np.ptp(modelled) > CONSTANT * np.max(np.abs(modelled))
    scale, offset = np.polyfit(modelled, measured, 1) if has_line else (math.nan, math.nan)
    return JointResidual(
        name=compared.names[c],
        is_prismatic=bool(compared.robot.is_prismatic_joint[compared.index[c]]),
        rms_measured=float(rms(measured)),
        rms_modelled=float(rms(modelled)),
        rms_residual=float(rms(measured - modelled)),
        rms_friction=float(rms(measured - compared.rigid[when, c] - rubbing)),
        rms_corrected=float(rms(measured - corrected[when])),
        noise=math.nan if math.isfinite(compared.motion.cut_off) else float(compared.noise[c]),
        scale=float(scale),
        offset=float(offset),
        friction=friction,
        is_varying=is_varying,
    )
