"""Measured and modelled efforts of a recorded motion, with corrections and friction."""

from __future__ import annotations

from copy import copy
from functools import partial

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats
from ..columns import friction_columns, gravity_columns, payload_columns, STATES_AT_ONCE
from ..recordings.resampling import pieces, smooth_like_efforts
from ..recordings.signals import Motion
from .fault import FaultKind, GravityConvention
from .friction import fit_friction, fit_shape, FrictionFit, is_moving, obstacle
from .intervals import FaultInterval
from .joint_samples import CREDIBLE, sample_joints
from .loads import loaded_links, PARAMETERS, point_mass_parameters
from .regression_data import RegressionData, RobotFit

SAMPLES_PER_WINDOW = 8  # fits use this number of samples of each smoothing window
INERTIAS = 50  # approximate number of mass matrices for the estimate of noise
CONSTANT = 1e-9  # variations below this fraction of the largest effort are rounding errors
ALL = slice(None)


class ComparedEfforts:
    """
    Measured and modelled efforts at K times, with one column for each of c compared joints.

    The motion contains m joints, and `index` contains the indices of these joints in
    ``robot.joint_names``. Joints that were not recorded are assumed to rest at zero. The dynamics
    include all known loads. An unknown load may act on `link`, or on the tips of the kinematic
    tree if `link` is None. `width` is the speed over which Coulomb friction is smoothed [rad/s or
    m/s]. The `convention` says whether measured and modelled efforts should contain gravity.
    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        motion: Motion,
        index: list[int],
        link: str | None,
        width: float,
        convention: GravityConvention,
    ) -> None:
        self.dynamics, self.motion = dynamics, motion
        self.width, self.convention = width, convention
        self._arguments = index, link, width, convention
        robot = self.robot = dynamics.robot
        K, n = len(motion.times), len(robot.joint_names)
        q, qd, qdd = np.zeros((3, K, n))
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        self.states = q, qd, qdd
        some = self.fit_samples = slice(None, None, max(1, motion.window // SAMPLES_PER_WINDOW))
        self.fit_states = q[some], qd[some], qdd[some]
        self.all_index = index
        self.links = loaded_links(robot, q, link)
        self.compared = [j for j in range(len(index)) if np.isfinite(motion.efforts[:, j]).all()]
        self.index = [index[j] for j in self.compared]
        self.names = [motion.joint_names[j] for j in self.compared]
        self.measured = motion.efforts[:, self.compared]
        self.qd, self.qdd = motion.qd[:, self.compared], motion.qdd[:, self.compared]
        self.direction = smooth_like_efforts(motion, np.tanh(self.qd / width))
        self.period = motion.period
        terms = dynamics.effort_terms(*self.states)
        self.gravity: Floats = terms.gravity[:, self.index]
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        if not convention.in_measured:
            self.modelled = self.modelled - self.gravity
        # Friction is fitted again, so these efforts exclude the friction of the dynamics.
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        self.noise = self._noise()
        self.varying = self._varying()
        least = 0.01 * float(np.max(np.abs(self.rigid)))
        self.constant = np.flatnonzero(not_measured(self.measured, self.rigid, least)).tolist()

    def undistorted(self, signs: Floats, delay: float) -> ComparedEfforts:
        """
        Return a comparison in which reversed axes and the delay of the efforts are corrected.

        The signs, shape (m,), are -1 for reversed axes and 1 for other axes. The delay is in
        seconds.
        """
        motion = self.motion
        efforts = signs * _later(motion, motion.efforts, delay)
        q, qd, qdd = (signs * each for each in (motion.q, motion.qd, motion.qdd))
        motion = motion._replace(q=q, qd=qd, qdd=qdd, efforts=efforts)
        return ComparedEfforts(self.dynamics, motion, *self._arguments)

    def distorted(self, efforts: Floats, signs: Floats, delay: float) -> Floats:
        """Apply reversed axes and a delay [s] to efforts of shape (K, c)."""
        return signs[self.compared] * _later(self.motion, efforts, -delay)

    def with_bodies(self, change: Floats, has_own_gravity: bool) -> ComparedEfforts:
        """
        Return a copy in which the inertial parameters of b links are changed.

        `change` has the shape (10 b,). `has_own_gravity` says whether wrong links also cause
        residuals in the gravity efforts.
        """
        other = copy(self)
        other.rigid, other.gravity = self.rigid.copy(), self.gravity.copy()
        for k in range(0, len(self.rigid), STATES_AT_ONCE):
            some = slice(k, k + STATES_AT_ONCE)
            q, qd, qdd = (np.ascontiguousarray(x[some]) for x in self.states)
            other.rigid[some] += self.dynamics.regressor(q, qd, qdd)[:, self.index] @ change
            at_rest = self.dynamics.regressor(q, *np.zeros((2, *q.shape)))[:, self.index] @ change
            if not has_own_gravity and self.convention.in_measured:
                other.gravity[some] += at_rest
            elif not has_own_gravity:
                other.rigid[some] -= at_rest
        return other

    def rates(self, robot_fit: RobotFit) -> Floats:
        """Return the time derivatives of the explained efforts [N m/s or N/s]."""
        efforts = corrected_efforts(self, robot_fit)[1][:, self.varying]
        for j, (c, fit) in enumerate(zip(self.varying, robot_fit.fits, strict=True)):
            efforts[:, j] += fit.friction(self.qd[:, c], self.direction[:, c])
        times = self.motion.times
        return np.concatenate(
            [np.gradient(efforts[a:b], times[a:b], axis=0) for a, b in pieces(times)]
        )

    def inside(self, fault: FaultInterval) -> Booleans:
        """Return a mask of the samples in the interval of a fault."""
        begin, end = fault.interval
        return np.asarray((self.motion.times >= begin) & (self.motion.times <= end))

    def moves(self, c: int) -> bool:
        """Return whether a joint moves enough to identify its friction."""
        return not obstacle(self.qd[:, c], self.period, self.width)

    def used(self, c: int) -> Booleans:
        """Return a mask of the samples in motion, or of all samples if `moves` is false."""
        if not self.moves(c):
            return np.ones(len(self.qd), dtype=bool)
        return is_moving(self.qd[:, c], self.width)

    def regression_data(self) -> RegressionData:
        """Return the regression data of all joints whose measured efforts vary."""
        robot, some, varying = self.robot, self.fit_samples, self.varying
        joints = sample_joints(
            self.dynamics,
            self.motion.times[some],
            self.fit_states,
            self.links,
            [self.index[c] for c in varying],
            measured=self.measured[some][:, varying],
            modelled=self.rigid[some][:, varying],
            gravity=self.gravity[some][:, varying],
            direction=self.direction[some][:, varying],
            used=[self.used(c)[some] for c in varying],
            moves=[self.moves(c) for c in varying],
            noise=self.noise[varying],
        )
        duration = len(self.motion.times) * self.period
        sample_count = len(self.motion.times) / self.motion.window
        own_masses = self.dynamics.inertial_parameters()[::PARAMETERS]
        mass_with_loads = np.append(robot.mass[0], own_masses)
        masses = {
            link: float(mass_with_loads[robot.link_body[robot.link_index(link)]])
            for link in self.links
        }
        return RegressionData(
            joints,
            masses,
            float(np.sum(robot.mass)),
            self.dynamics.gravity,
            sample_count,
            duration,
            convention=self.convention,
        )

    def _noise(self) -> Floats:
        """Return the standard deviation of the noise in each residual, shape (c,) [N m or N]."""
        some = slice(None, None, max(1, len(self.motion.times) // INERTIAS))
        inertia = self.dynamics.mass_matrix(self.states[0][some])
        modelled: Floats = inertia[:, :, self.all_index] * self.motion.qdd_noise
        squares: Floats = np.mean(np.sum(modelled**2, axis=-1), axis=0)
        return np.hypot(np.sqrt(squares[self.index]), self.motion.effort_noise[self.compared])

    def _varying(self) -> list[int]:
        """Return the indices of joints whose measured efforts vary."""
        # Compare with the largest effort of all joints, because an unloaded joint may have only
        # rounding errors.
        largest = max(float(np.max(np.abs(self.measured))), float(np.max(np.abs(self.rigid))))
        variation = np.ptp(self.measured, axis=0)
        return [c for c in range(len(self.names)) if variation[c] > CONSTANT * largest]


def not_measured(measured: Floats, modelled: Floats, least: Floats | float) -> Booleans:
    """
    Return a mask of joints with a constant measured effort that contradicts the model.

    Efforts have the shape (K, c). A constant measured effort contradicts a modelled effort that
    varies by more than `least` [N m or N]. A measured effort of zero contradicts a modelled effort
    above `least`.
    """
    largest = np.max(np.abs([measured, modelled]))
    is_constant = np.ptp(measured, axis=0) <= CONSTANT * largest
    is_zero = np.max(np.abs(measured), axis=0) <= CONSTANT * largest
    expected = np.where(is_zero, np.max(np.abs(modelled), axis=0), np.ptp(modelled, axis=0))
    return np.asarray(is_constant & (expected > least))


def _later(motion: Motion, efforts: Floats, delay: float) -> Floats:
    """Interpolate the efforts at the sample times plus a delay [s]."""
    if not delay:
        return efforts
    parts = []
    for begin, end in pieces(motion.times):
        times = motion.times[begin:end]
        columns = [np.interp(times + delay, times, column) for column in efforts[begin:end].T]
        parts.append(np.stack(columns, axis=1))
    return np.concatenate(parts)


# ---- Corrected efforts ---------------------------------------------------------------------


def corrected_efforts(
    compared: ComparedEfforts, robot_fit: RobotFit, fault: FaultInterval | None = None
) -> tuple[Floats, Floats]:
    """Return the corrected measured efforts, and the efforts of the candidate model."""
    measured = compared.measured / robot_fit.unit
    correction = added_efforts(compared, robot_fit)
    if fault is not None and fault.kind is FaultKind.PAYLOAD:
        correction = correction * compared.inside(fault)[:, None]
    if fault is not None and fault.kind is FaultKind.MOUNTING:
        columns = gravity_columns(compared.robot, compared.states[0])[:, compared.index]
        times, knots = compared.motion.times, fault.knots
        gravity = np.stack([np.interp(times, knots, axis) for axis in fault.gravity.T], axis=-1)
        correction = np.einsum('kcx,kx->kc', columns, gravity) - compared.gravity
    efforts = compared.rigid + correction
    for j, (c, fit) in enumerate(zip(compared.varying, robot_fit.fits, strict=True)):
        source = compared.measured[:, compared.varying[robot_fit.source[j]]]
        measured[:, c] = fit.sensor_fault.sign * source / robot_fit.factor(j)
        efforts[:, c] += fit.rotor * compared.qdd[:, c]
    return measured, efforts


def added_efforts(compared: ComparedEfforts, robot_fit: RobotFit) -> Floats:
    """Return the efforts that the candidate model adds to those of the robot model."""
    candidate = robot_fit.candidate
    if candidate.kind is FaultKind.MOUNTING:
        turned = gravity_columns(compared.robot, compared.states[0]) @ np.array(candidate.solution)
        return np.asarray(turned[:, compared.index] - compared.gravity)
    correction: Floats = np.zeros_like(compared.rigid)
    if candidate.has_gravity is not compared.convention.in_measured:
        correction += compared.gravity if candidate.has_gravity else -compared.gravity
    if candidate.kind is FaultKind.PAYLOAD:
        mass, *com = candidate.solution
        columns = payload_columns(
            compared.robot, compared.dynamics.gravity, candidate.link, compared.states
        )
        efforts = columns @ point_mass_parameters(mass, np.array(com))
        correction += efforts[:, compared.index]
    return correction


def as_recorded(compared: ComparedEfforts, efforts: Floats, robot_fit: RobotFit) -> Floats:
    """Apply the wrong signs, units and order of the measured efforts to `efforts`."""
    recorded: Floats = robot_fit.unit * efforts
    for j, (c, fit) in enumerate(zip(compared.varying, robot_fit.fits, strict=True)):
        source = compared.varying[robot_fit.source[j]]
        recorded[:, source] = fit.sensor_fault.sign * robot_fit.factor(j) * efforts[:, c]
    return recorded


# ---- Friction ------------------------------------------------------------------------------


def fit_joints(
    compared: ComparedEfforts,
    residual: Floats,
    obscured: dict[int, str],
    used: Booleans | slice = ALL,
) -> list[FrictionFit]:
    """Fit the friction of each joint to the residuals of the used samples."""
    fits = []
    for c in range(len(compared.names)):
        fit = fit_friction(
            compared.qd[used, c],
            compared.direction[used, c],
            residual[:, c],
            compared.period,
            compared.motion.window,
            compared.width,
        )
        if c in obscured:
            fit = FrictionFit.unknown(obscured[c], fit.offset if fit.unknown_because else 0.0)
        fits.append(fit)
    return fits


def obscured(compared: ComparedEfforts, robot_fit: RobotFit) -> dict[int, str]:
    """Return reasons why the friction of joints is unknown, keyed by joint index."""
    reasons = dict.fromkeys(compared.constant, 'the effort of this joint was not measured')
    is_scaled = any(fit.sensor_fault.is_scaled for fit in robot_fit.fits)
    for c, fit in zip(compared.varying, robot_fit.fits, strict=True):
        if fit.moves and fit.remaining > CREDIBLE:
            reasons[c] = 'the model does not explain the effort of this joint'
        elif is_scaled and fit.is_friction_only:
            reasons[c] = 'the effort of this joint is in an unknown unit'
    return reasons


def with_shapes(
    compared: ComparedEfforts, fits: list[FrictionFit], residual: Floats, load: Floats
) -> list[FrictionFit]:
    """Fit smoothing widths and load-dependent friction, given gear loads of shape (K, c)."""
    return [
        fit_shape(
            fit,
            compared.qd[:, c],
            residual[:, c],
            load[:, c],
            partial(smooth_like_efforts, compared.motion),
            compared.width,
            compared.motion.window,
        )
        for c, fit in enumerate(fits)
    ]


def friction_efforts(compared: ComparedEfforts, c: int, fit: FrictionFit, load: Floats) -> Floats:
    """Return friction plus offset of one joint, given the load on the gear."""
    qd = compared.qd[:, c]
    if not fit.has_shape:
        return fit.friction(qd, compared.direction[:, c]) + fit.offset
    smooth = partial(smooth_like_efforts, compared.motion)
    factors = np.array([fit.damping, fit.coulomb, fit.load_friction, fit.offset])
    return np.asarray(friction_columns(qd, fit.width, load, smooth) @ factors)
