"""Compares a recorded motion with the model of the robot."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import derive, Motion, Recording
from .bodies import Bodies, wrong_bodies
from .compared_efforts import (
    added_efforts,
    as_recorded,
    ComparedEfforts,
    CONSTANT,
    corrected_efforts,
    fit_joints,
    friction_efforts,
    load_on_gears,
    obscured,
    when_comparable,
    with_friction_only,
    with_shapes,
)
from .diagnoses import diagnose, diagnose_bodies, diagnose_constant, diagnose_interval
from .fault import Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import FrictionFit
from .intervals import best_interval, FaultInterval, find_fault_interval, MUCH_LOUDER
from .regression_data import RegressionData, RobotFit


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Measured and modelled effort of one joint, in N m or N."""

    name: str
    is_prismatic: bool
    rms_measured: float
    rms_modelled: float
    rms_residual: float
    """RMS of measured minus modelled effort."""
    rms_friction: float
    """The same with fitted friction, but without faults and offset."""
    rms_corrected: float
    """The same with fitted friction, offset and the faults."""
    noise: float
    """Standard deviation of the noise that smoothing leaves; a smaller residual is explained.

    NaN if the recording was filtered before.
    """
    scale: float
    """Measured effort is about ``scale * modelled + offset``, by least squares."""
    offset: float
    friction: FrictionFit
    is_varying: bool
    """Whether the measured effort varies."""

    @property
    def explained(self) -> float:
        """Fraction of the squares of the effort that the model explains; NaN if constant."""
        return self._explained(self.rms_residual)

    @property
    def explained_corrected(self) -> float:
        """The same with fitted friction and offset, and the faults."""
        return self._explained(self.rms_corrected)

    def _explained(self, residual: float) -> float:
        return 1.0 - (residual / self.rms_measured) ** 2 if self.is_varying else math.nan


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """The comparison of the K samples of a recording with the model."""

    motion: Motion
    """The derived motion of all recorded joints."""
    compared: tuple[int, ...]
    """Indices of the joints of the motion that have a measured effort; c of them."""
    joints: tuple[JointResidual, ...]
    """Residuals of these joints."""
    measured: Floats
    """Measured efforts, shape (K, c) [N m or N]."""
    modelled: Floats
    """Modelled efforts, shape (K, c) [N m or N]; with friction if the dynamics have friction."""
    corrected: Floats
    """
    Efforts of the corrected model, as they would be recorded, shape (K, c) [N m or N].

    The corrections are the fitted friction and the faults.
    """
    faults: tuple[Fault, ...]
    """Explanations of the difference, most important first; empty if none is needed."""
    width: float
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""
    is_too_short: bool
    """Whether there are too few samples to diagnose a difference."""
    moving: tuple[int, ...]
    """Indices in ``joints`` of those that the sums below contain: those that moved, if any."""

    @property
    def explained(self) -> float:
        """Explained fraction of the squares: mean of revolute and of prismatic joints."""
        return self._mean([joint.rms_residual for joint in self.joints])

    @property
    def explained_corrected(self) -> float:
        """The same with fitted friction and offset, and the faults."""
        return self._mean([joint.rms_corrected for joint in self.joints])

    def _mean(self, residuals: list[float]) -> float:
        measured, remaining = {False: 0.0, True: 0.0}, {False: 0.0, True: 0.0}
        for c in self.moving:
            joint = self.joints[c]
            measured[joint.is_prismatic] += joint.rms_measured**2
            remaining[joint.is_prismatic] += residuals[c] ** 2
        fractions = [1.0 - remaining[kind] / measured[kind] for kind in measured if measured[kind]]
        return float(np.mean(fractions)) if fractions else math.nan


def diagnose_recording(
    dynamics: InverseDynamics,
    recording: Recording,
    others: ArrayLike | None = None,
    link: str | None = None,
    width: float | None = None,
    convention: GravityConvention = WITH_GRAVITY,
) -> ComparisonResult:
    """
    Compare a recording with the model.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot with n joints, and all known loads on it.
    recording : Recording
        Recording of any m of its joints, in any order.
    others : array_like, shape (n,), optional
        Positions of the joints that were not recorded [rad or m]; default: zero.
    link : str, optional
        Link that may carry an unknown load; default: the tips of the tree.
    width : float, optional
        Speed over which Coulomb friction is smoothed [rad/s or m/s]; default: fitted for each
        joint where the recording shows it.
    convention : GravityConvention
        Whether the recorded efforts contain gravity, as the driver is said to measure them.

    Returns
    -------
    result : ComparisonResult

    Raises
    ------
    RecordingError
        If the robot does not have a recorded joint, or the recording is not usable.
    ConfigurationError
        If the link does not exist.

    """
    robot = dynamics.robot
    if link is not None:
        robot.link_index(link)  # raises if it does not exist
    index = _indices(recording.joint_names, robot)
    continuous = [j for j, i in enumerate(index) if robot.is_continuous[i]]
    if continuous:
        positions = recording.positions.copy()
        for j in continuous:
            is_known = np.isfinite(positions[:, j])
            positions[is_known, j] = np.unwrap(positions[is_known, j])
        recording = recording._replace(positions=positions)
    motion = derive(recording)
    common_width = FRICTION_WIDTH if width is None else width
    compared = ComparedEfforts(dynamics, motion, index, others, link, common_width, convention)
    return _result(compared, fits_shape=width is None)


def _indices(names: tuple[str, ...], robot: RobotModel) -> list[int]:
    unknown = [name for name in names if name not in robot.joint_names]
    if unknown:
        raise RecordingError(
            f"the recording has joint '{unknown[0]}', which robot '{robot.name}' does not have; "
            f'it has {", ".join(robot.joint_names)}'
        )
    if len(set(names)) != len(names):
        raise RecordingError(f'a joint is recorded twice: {", ".join(names)}')
    return [robot.joint_names.index(name) for name in names]


def _result(compared: ComparedEfforts, *, fits_shape: bool) -> ComparisonResult:
    data = compared.regression_data()
    robot_fit = data.explain()
    fault = find_fault_interval(data, robot_fit)
    bodies = None
    if fault is not None:
        fault = _refined(compared, fault)
        data, robot_fit = fault.data, fault.outside
    else:
        bodies = _wrong_bodies(compared, data, robot_fit)
        if bodies is not None:
            robot_fit = bodies.robot_fit
    measured, efforts = corrected_efforts(compared, robot_fit, fault)
    used = np.ones(len(efforts), dtype=bool)
    if fault is not None and fault.kind is FaultKind.EXTERNAL_FORCE:
        used = ~compared.inside(fault)
    unknown = obscured(compared, robot_fit)
    fits = fit_joints(compared, measured[used] - efforts[used], unknown, used)
    load = load_on_gears(compared, robot_fit)
    if fits_shape and fault is None:
        fits = with_shapes(compared, fits, measured - efforts, load)
    for c, fit in enumerate(fits):
        efforts[:, c] += friction_efforts(compared, c, fit, load[:, c])
    recorded = as_recorded(compared, efforts, robot_fit)
    when = [used & each for each in when_comparable(compared, fits)]
    rubbing = with_friction_only(compared)
    return ComparisonResult(
        motion=compared.motion,
        compared=tuple(compared.compared),
        joints=tuple(
            _joint_residual(compared, c, fits[c], rubbing[:, c], recorded[:, c], when[c])
            for c in range(len(fits))
        ),
        measured=compared.measured,
        modelled=compared.modelled,
        corrected=recorded,
        faults=_faults(compared, data, robot_fit, fault, bodies),
        width=compared.width,
        is_too_short=data.is_too_short,
        moving=tuple(_moving(compared)),
    )


def _refined(compared: ComparedEfforts, fault: FaultInterval) -> FaultInterval:
    """Return a part whose begin and end are accurate to a sample."""
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
        left -= fit.damping * compared.qd[:, c] + fit.coulomb * compared.direction[:, c]
        variance = max((fit.rms / fault.outside.factor(j)) ** 2, 1e-12)
        after = MUCH_LOUDER * variance if is_force else (left - load[:, c]) ** 2
        gain += (left**2 - after) / variance
    return fault._replace(interval=best_interval(compared.motion.times, gain, fault.interval))


def _wrong_bodies(
    compared: ComparedEfforts, data: RegressionData, robot_fit: RobotFit
) -> Bodies | None:
    """Return the residuals with fitted links if several links are wrong."""
    if not compared.varying:
        return None
    rows = [compared.used(c)[compared.fit_samples] for c in compared.varying]
    index = [compared.index[c] for c in compared.varying]
    return wrong_bodies(data, robot_fit, compared.dynamics, compared.fit_states, rows, index)


def _moving(compared: ComparedEfforts) -> list[int]:
    """Leave out joints that friction may have held all the time, unless it may hold all."""
    moving = [c for c in compared.varying if compared.moves(c)]
    return moving or compared.varying


def _joint_residual(
    compared: ComparedEfforts,
    c: int,
    friction: FrictionFit,
    rubbing: Floats,
    corrected: Floats,
    when: Booleans,
) -> JointResidual:
    measured, modelled = compared.measured[when, c], compared.modelled[when, c]
    is_varying = c in compared.varying
    has_line = is_varying and np.ptp(modelled) > CONSTANT * np.max(np.abs(modelled))
    scale, offset = np.polyfit(modelled, measured, 1) if has_line else (math.nan, math.nan)
    return JointResidual(
        name=compared.names[c],
        is_prismatic=compared.is_prismatic(c),
        rms_measured=_rms(measured),
        rms_modelled=_rms(modelled),
        rms_residual=_rms(measured - modelled),
        rms_friction=_rms(measured - rubbing[when]),
        rms_corrected=_rms(measured - corrected[when]),
        noise=math.nan if math.isfinite(compared.motion.cut_off) else float(compared.noise[c]),
        scale=float(scale),
        offset=float(offset),
        friction=friction,
        is_varying=is_varying,
    )


def _faults(
    compared: ComparedEfforts,
    data: RegressionData,
    robot_fit: RobotFit,
    fault: FaultInterval | None,
    bodies: Bodies | None,
) -> tuple[Fault, ...]:
    constant = {compared.names[c]: float(compared.measured[0, c]) for c in compared.constant}
    names = [compared.names[c] for c in compared.varying]
    found = [] if fault is None else diagnose_interval(fault, names)
    if compared.varying and (fault is None or fault.kind is FaultKind.EXTERNAL_FORCE):
        found += diagnose(data, robot_fit, names)
    if bodies is not None:
        found = [each for each in found if each.kind is not FaultKind.UNEXPLAINED]
        found.append(diagnose_bodies(bodies, data, names))
    return (*diagnose_constant(constant), *found)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
