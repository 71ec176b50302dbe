"""Compares a recorded motion with the model of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
import math

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..columns import friction_columns, STATES_AT_ONCE
from ..recordings.resampling import pieces, smooth_like_efforts
from ..recordings.signals import derive, Motion, Recording, rms, without_turns
from .fault import Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import fit_friction, fit_shape, FrictionFit, is_moving, obstacle
from .loads import loaded_links
from .regression import Fit
from .rows import Rows, Signals
from .search import Search
from .simple_faults import constant_fault, not_measured, positions_fault
from .statements import faults_of

SAMPLES = 600  # approximate number of samples that the search uses
MIN_DURATION = 4.0  # [s]; in shorter recordings, a fit may be good by chance
WIDTH = 0.03  # [rad/s or m/s]; speed over which the search smooths Coulomb friction
LEAST_MOVING = 0.05  # fraction of the samples in which a joint moves, if it moves
DELAY_ROUNDS = 2  # of linear estimates of a delay
INERTIAS = 50  # approximate number of mass matrices for the estimate of noise
CONSTANT = 1e-9  # variations below this fraction of the largest effort are rounding errors


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


def unexplained_fraction(
    remaining: Sequence[float], squares: Sequence[float], is_prismatic: Sequence[bool]
) -> float:
    """Return the unexplained fraction of the squared efforts, averaged over both joint types."""
    left, whole = {False: 0.0, True: 0.0}, {False: 0.0, True: 0.0}
    for part, square, kind in zip(remaining, squares, is_prismatic, strict=True):
        left[kind] += part
        whole[kind] += square
    fractions = [left[kind] / whole[kind] for kind in whole if whole[kind]]
    return float(np.mean(fractions)) if fractions else math.nan


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
    return _Comparison(dynamics, motion, index, link, convention).result()


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


class _Comparison:
    """
    Measured and modelled efforts at K times, with one column for each of c compared joints.

    `index` contains the indices of the m joints of the motion in ``robot.joint_names``.
    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        motion: Motion,
        index: list[int],
        link: str | None,
        convention: GravityConvention,
    ) -> None:
        self.dynamics, self.motion, self.robot = dynamics, motion, dynamics.robot
        self.link, self.convention = link, convention
        q, qd, qdd = np.zeros((3, len(motion.times), len(self.robot.joint_names)))
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        self.states = q, qd, qdd
        self.compared = np.flatnonzero(np.isfinite(motion.efforts).all(axis=0)).tolist()
        self.index = [index[j] for j in self.compared]
        self.names = [motion.joint_names[j] for j in self.compared]
        self.measured = motion.efforts[:, self.compared]
        self.qd = motion.qd[:, self.compared]
        self.direction = smooth_like_efforts(motion, np.tanh(self.qd / FRICTION_WIDTH))
        terms = dynamics.effort_terms(*self.states)
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        if not convention.in_measured:
            self.modelled = self.modelled - terms.gravity[:, self.index]
        # Friction is fitted again, so these efforts exclude the friction of the dynamics.
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        self.moves = [not obstacle(x, motion.period, FRICTION_WIDTH) for x in self.qd.T]
        largest = max(float(np.max(np.abs(self.measured))), float(np.max(np.abs(self.rigid))))
        variation = np.ptp(self.measured, axis=0)
        self.varying = np.flatnonzero(variation > CONSTANT * largest).tolist()

    @property
    def is_too_short(self) -> bool:
        """Whether a fit may be good by chance."""
        return len(self.motion.times) * self.motion.period < MIN_DURATION

    def result(self) -> ComparisonResult:
        """Diagnose the differences, fit friction, and compare all joints."""
        least = 0.01 * float(np.max(np.abs(self.rigid)))
        constant = np.flatnonzero(not_measured(self.measured, self.rigid, least)).tolist()
        silent = constant_fault({self.names[c]: float(self.measured[0, c]) for c in constant})
        reasons = dict.fromkeys(constant, 'the effort of this joint was not measured')
        faults = positions_fault(self.robot, self.motion.q, self.motion.joint_names)
        measured, efforts = self.measured, self.rigid.copy()
        recorded: Callable[[Floats], Floats] = np.copy
        load, used = np.abs(self.rigid), np.ones(len(efforts), dtype=bool)
        if not faults and self.varying and not self.is_too_short:
            signals = self._signals()
            rows = Rows(self.dynamics, signals, self._links(), self.convention)
            search = Search(rows, can_be_late=math.isinf(self.motion.cut_off))
            fit = self._with_exact_delay(search, search.best())
            faults = faults_of(search, fit, [self.names[c] for c in self.varying])
            reasons |= self._obscured(search, fit, faults)
            measured, efforts, recorded = self._corrected(search, fit)
            load = np.abs(efforts)
            for c, rotor in self._rotors(faults).items():
                efforts[:, c] += rotor * self.states[2][:, self.index[c]]
            window = fit.hypothesis.window
            if window is not None and window.kind == 'push':
                used = ~window.inside(self.motion.times)
        fits = self._friction(measured - efforts, reasons, used)
        if used.all():
            fits = self._shapes(fits, measured - efforts, load)
        for c, friction in enumerate(fits):
            efforts[:, c] += self._friction_efforts(c, friction, load[:, c])
        corrected = recorded(efforts)
        plain = self._friction(self.measured - self.rigid, {}, np.ones_like(used))
        moving = [c for c in self.varying if self.moves[c]]
        return ComparisonResult(
            motion=self.motion,
            compared=tuple(self.compared),
            joints=tuple(
                self._residual(c, fits[c], plain[c], corrected[:, c], used)
                for c in range(len(fits))
            ),
            measured=self.measured,
            modelled=self.modelled,
            corrected=corrected,
            faults=(*silent, *faults),
            width=FRICTION_WIDTH,
            is_too_short=self.is_too_short,
            moving=tuple(moving or self.varying),
        )

    # ---- Rows ----------------------------------------------------------------------------

    def _links(self) -> tuple[str, ...]:
        return loaded_links(self.robot, self.states[0], self.link)

    def _with_exact_delay(self, search: Search, fit: Fit) -> Fit:
        """Return the fit with a delay that is accurate even if the efforts vary quickly."""
        if not fit.hypothesis.is_late:
            return fit
        delay = float(fit.shared['delay'][0])
        for _ in range(DELAY_ROUNDS):
            rows = search.rows.at(self._signals(delay=delay))
            delay += float(Search(rows).fit(fit.hypothesis).shared['delay'][0])
        return fit._replace(shared={**fit.shared, 'delay': np.array([delay])})

    def _signals(self, every: bool = False, delay: float = 0.0) -> Signals:
        """Return the samples for the search, or all samples, with efforts of a later time."""
        motion, count = self.motion, len(self.motion.times)
        some = slice(None, None, 1 if every else max(1, count // SAMPLES))
        measured = self._later(self.measured[:, self.varying], delay)
        qd = self.qd[:, self.varying]
        rates = [
            np.gradient(measured[a:b], motion.times[a:b], axis=0) for a, b in pieces(motion.times)
        ]
        fast = is_moving(qd, WIDTH)[some]
        moves = fast.mean(axis=0) > LEAST_MOVING
        q, qd_all, qdd = (x[some] for x in self.states)
        return Signals(
            joints=tuple(self.index[c] for c in self.varying),
            times=motion.times[some],
            q=q,
            qd=qd_all,
            qdd=qdd,
            measured=measured[some],
            added=np.zeros_like(measured[some]),
            direction=smooth_like_efforts(motion, np.tanh(qd / WIDTH))[some],
            rate=np.concatenate(rates)[some],
            used=fast | ~moves,
            moves=moves,
            independent=min(count / motion.window, 2.0 * motion.cut_off * motion.period * count),
            noise=self._noise[self.varying],
            dry=np.zeros(len(self.varying)),
        )

    def _obscured(self, search: Search, fit: Fit, faults: list[Fault]) -> dict[int, str]:
        """Return reasons why the friction of joints is unknown, keyed by joint index."""
        reasons = {}
        has_scale = any(fault.kind is FaultKind.SCALE for fault in faults)
        left, shown = search.unexplained(fit), search.shows_scale(fit)
        for j, c in enumerate(self.varying):
            if left[j] and search.rows.signals.moves[j]:
                reasons[c] = 'the model does not explain the effort of this joint'
            elif has_scale and not shown[j]:
                reasons[c] = 'the effort of this joint is in an unknown unit'
        return reasons

    def _rotors(self, faults: list[Fault]) -> dict[int, float]:
        """Return the rotor inertias of the faults, by joint index."""
        return {
            self.names.index(name): value
            for fault in faults
            if fault.kind is FaultKind.ROTOR_INERTIA
            for name, value in zip(fault.joints, fault.values, strict=True)
        }

    # ---- Corrected efforts ---------------------------------------------------------------

    def _corrected(
        self, search: Search, fit: Fit
    ) -> tuple[Floats, Floats, Callable[[Floats], Floats]]:
        """
        Return corrected measured efforts, and the efforts that explain them without friction.

        Both have the shape (K, c). The function in the result applies signs, units, order and
        delay of the recording to efforts.
        """
        h, varying = fit.hypothesis, np.array(self.varying)
        signs = np.ones(len(varying))
        signs[list(h.axes)] = -1.0
        factor, source = signs * h.factor(len(varying)), varying[h.order(len(varying))]
        delay = float(fit.shared['delay'][0]) if h.is_late else 0.0
        measured, efforts = self.measured.copy(), self.rigid.copy()
        measured[:, varying] = self._later(self.measured[:, source], delay) / factor
        signals = self._signals(every=True)
        for k in range(0, len(efforts), STATES_AT_ONCE):
            some = slice(k, k + STATES_AT_ONCE)
            efforts[some, varying] = search.explained(fit, signals.part(some))

        def recorded(efforts: Floats) -> Floats:
            found: Floats = efforts.copy()
            found[:, source] = self._later(factor * efforts[:, varying], -delay)
            return found

        return measured, efforts, recorded

    def _later(self, efforts: Floats, delay: float) -> Floats:
        """Interpolate the efforts at the sample times plus a delay [s]."""
        if not delay:
            return efforts
        parts = []
        for begin, end in pieces(self.motion.times):
            times = self.motion.times[begin:end]
            columns = [np.interp(times + delay, times, column) for column in efforts[begin:end].T]
            parts.append(np.stack(columns, axis=1))
        return np.concatenate(parts)

    # ---- Friction ------------------------------------------------------------------------

    def _friction(
        self, residual: Floats, reasons: dict[int, str], used: Booleans
    ) -> list[FrictionFit]:
        """Fit the friction of each joint to the residuals of the used samples."""
        fits = []
        for c in range(len(self.names)):
            fit = fit_friction(
                self.qd[used, c],
                self.direction[used, c],
                residual[used, c],
                self.motion.period,
                self.motion.window,
                FRICTION_WIDTH,
            )
            if c in reasons:
                fit = FrictionFit.unknown(reasons[c], fit.offset if fit.unknown_because else 0.0)
            fits.append(fit)
        return fits

    def _shapes(
        self, fits: list[FrictionFit], residual: Floats, load: Floats
    ) -> list[FrictionFit]:
        """Fit smoothing widths and load-dependent friction, given gear loads of shape (K, c)."""
        smooth = partial(smooth_like_efforts, self.motion)
        return [
            fit_shape(
                fit,
                self.qd[:, c],
                residual[:, c],
                load[:, c],
                smooth,
                FRICTION_WIDTH,
                self.motion.window,
            )
            for c, fit in enumerate(fits)
        ]

    def _friction_efforts(self, c: int, fit: FrictionFit, load: Floats) -> Floats:
        """Return friction plus offset of one joint, given the load on the gear."""
        qd = self.qd[:, c]
        if not fit.has_shape:
            return fit.friction(qd, self.direction[:, c]) + fit.offset
        smooth = partial(smooth_like_efforts, self.motion)
        factors = np.array([fit.damping, fit.coulomb, fit.load_friction, fit.offset])
        return np.asarray(friction_columns(qd, fit.width, load, smooth) @ factors)

    def _residual(
        self, c: int, fit: FrictionFit, plain: FrictionFit, corrected: Floats, used: Booleans
    ) -> JointResidual:
        """
        Compare the efforts of one joint in the used samples.

        `plain` is the friction that was fitted without a correction of faults.
        """
        # If the friction of a joint is unknown, all samples are compared.
        when = used if fit.unknown_because else used & is_moving(self.qd[:, c], FRICTION_WIDTH)
        measured, modelled = self.measured[when, c], self.modelled[when, c]
        rubbing = plain.friction(self.qd[when, c], self.direction[when, c])
        is_varying = c in self.varying
        has_line = is_varying and np.ptp(modelled) > CONSTANT * np.max(np.abs(modelled))
        scale, offset = np.polyfit(modelled, measured, 1) if has_line else (math.nan, math.nan)
        is_filtered = math.isfinite(self.motion.cut_off)
        noise = math.nan if is_filtered else float(self._noise[c])
        return JointResidual(
            name=self.names[c],
            is_prismatic=bool(self.robot.is_prismatic_joint[self.index[c]]),
            rms_measured=float(rms(measured)),
            rms_modelled=float(rms(modelled)),
            rms_residual=float(rms(measured - modelled)),
            rms_friction=float(rms(measured - self.rigid[when, c] - rubbing)),
            rms_corrected=float(rms(measured - corrected[when])),
            noise=noise,
            scale=float(scale),
            offset=float(offset),
            friction=fit,
            is_varying=is_varying,
        )

    @cached_property
    def _noise(self) -> Floats:
        """Standard deviation of the noise in each residual, shape (c,) [N m or N]."""
        some = slice(None, None, max(1, len(self.motion.times) // INERTIAS))
        inertia = self.dynamics.mass_matrix(self.states[0][some])
        moved = [self.robot.joint_names.index(name) for name in self.motion.joint_names]
        modelled: Floats = inertia[:, :, moved] * self.motion.qdd_noise
        squares: Floats = np.mean(np.sum(modelled**2, axis=-1), axis=0)
        noise = self.motion.effort_noise[self.compared]
        return np.asarray(np.hypot(np.sqrt(squares[self.index]), noise))
