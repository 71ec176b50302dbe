"""Compares a recorded motion with the model of the robot."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.resampling import pieces, smooth_like_efforts
from ..recordings.signals import derive, Motion, Recording, rms, without_turns
from .fault import Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import Friction, frictions, is_moving
from .loads import loaded_links
from .regression import Fit
from .rows import COULOMB, DAMPING, LOAD_FRICTION, OFFSET, ROTOR, Rows, Signals
from .search import Search
from .simple_faults import constant_fault, not_measured, positions_fault
from .statements import faults_of, is_considerable

SAMPLES = 1200  # approximate number of samples that the search uses
MIN_DURATION = 4.0  # [s]; in shorter recordings, a fit may be good by chance
WIDTH = 0.03  # [rad/s or m/s]; speed over which Coulomb friction is smoothed
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
    """RMS residual if only friction and an offset are fitted."""
    rms_corrected: float
    """RMS residual with fitted friction, a fitted offset and all corrections of faults."""
    noise: float
    """
    Standard deviation of the noise after smoothing, or NaN if the efforts were filtered before the
    recording. Residuals below the noise need no explanation.
    """
    friction: Friction
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
    joints: tuple[JointResidual, ...]
    """Residuals of the c joints with measured efforts."""
    measured: Floats
    """Measured efforts, shape (K, c) [N m or N]."""
    modelled: Floats
    """Efforts of the uncorrected model, including its friction, shape (K, c) [N m or N]."""
    corrected: Floats
    """Modelled efforts with fitted friction and effects of all faults, shape (K, c) [N m or N]."""
    faults: tuple[Fault, ...]
    """Faults that explain the difference, most important first."""
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
        fractions = []
        for kind in (False, True):
            same = [c for c in self.moving if self.joints[c].is_prismatic is kind]
            whole = sum(self.joints[c].rms_measured ** 2 for c in same)
            if whole:
                fractions.append(1.0 - sum(residuals[c] ** 2 for c in same) / whole)
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
        self.moved = index
        q, qd, qdd = np.zeros((3, len(motion.times), len(self.robot.joint_names)))
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        self.states = q, qd, qdd
        compared = np.flatnonzero(np.isfinite(motion.efforts).all(axis=0)).tolist()
        self.index = [index[j] for j in compared]
        self.names = [motion.joint_names[j] for j in compared]
        self.measured = motion.efforts[:, compared]
        terms = dynamics.effort_terms(*self.states)
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        if not convention.in_measured:
            self.modelled = self.modelled - terms.gravity[:, self.index]
        # Friction is fitted again, so these efforts exclude the friction of the dynamics.
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        largest = max(float(np.max(np.abs(self.measured))), float(np.max(np.abs(self.rigid))))
        is_varying = np.ptp(self.measured, axis=0) > CONSTANT * largest
        self.varying = np.flatnonzero(is_varying).tolist()
        self.noise = self._noise(motion.effort_noise[compared])

    def result(self) -> ComparisonResult:
        """Diagnose the differences, fit friction, and compare all joints."""
        least = 0.01 * float(np.max(np.abs(self.rigid)))
        constant = np.flatnonzero(not_measured(self.measured, self.rigid, least)).tolist()
        faults = constant_fault({self.names[c]: float(self.measured[0, c]) for c in constant})
        far = positions_fault(self.robot, self.motion.q, self.motion.joint_names)
        faults += far
        reason = (
            'the positions are wrong' if far else 'the measured effort of this joint never changes'
        )
        found = [Friction(unknown_because=reason) for _ in self.names]
        plain, corrected = self.rigid.copy(), self.rigid.copy()
        used = np.ones(len(plain), dtype=bool)
        moving: list[int] = []
        is_too_short = len(self.motion.times) * self.motion.period < MIN_DURATION
        if not far and self.varying:
            signals = self._signals()
            links = loaded_links(self.robot, self.states[0], self.link)
            rows = Rows(self.dynamics, signals, links, self.convention)
            search = Search(rows, can_be_late=math.isinf(self.motion.cut_off))
            every = self._signals(every=True)
            fit = search.without_faults()
            plain[:, self.varying] += _friction_efforts(
                search.with_friction(fit, False), every, self.rigid[:, self.varying]
            )
            if not is_too_short:
                fit = self._with_exact_delay(search, search.best(fit))
                faults += faults_of(search, fit, [self.names[c] for c in self.varying])
            has_bodies = any(fault.kind is FaultKind.BODIES for fault in faults)
            rubbing = search.with_friction(fit, has_bodies)
            for c, friction in zip(self.varying, self._known(search, rubbing), strict=True):
                found[c] = friction
            rotors = is_considerable(search, fit, ROTOR)
            corrected = self._recorded(rubbing, search.explained(rubbing, every, rotors))
            moving = [c for c, moves in zip(self.varying, signals.moves, strict=True) if moves]
            window = fit.hypothesis.window
            if window is not None and window.kind == 'push':
                used = ~window.inside(self.motion.times)
        return ComparisonResult(
            motion=self.motion,
            joints=tuple(
                self._residual(c, found[c], plain[:, c], corrected[:, c], used)
                for c in range(len(found))
            ),
            measured=self.measured,
            modelled=self.modelled,
            corrected=corrected,
            faults=tuple(faults),
            is_too_short=is_too_short,
            moving=tuple(moving or self.varying),
        )

    # ---- Rows ----------------------------------------------------------------------------

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
        index = [self.index[c] for c in self.varying]
        qd = self.states[1][:, index]
        rates = [
            np.gradient(measured[a:b], motion.times[a:b], axis=0) for a, b in pieces(motion.times)
        ]
        fast = is_moving(qd, WIDTH)[some]
        moves = fast.mean(axis=0) > LEAST_MOVING
        return Signals(
            joints=tuple(index),
            times=motion.times[some],
            q=self.states[0][some],
            qd=self.states[1][some],
            qdd=self.states[2][some],
            measured=measured[some],
            added=np.zeros_like(measured[some]),
            direction=smooth_like_efforts(motion, np.tanh(qd / WIDTH))[some],
            rate=np.concatenate(rates)[some],
            used=fast | ~moves,
            moves=moves,
            independent=min(count / motion.window, 2.0 * motion.cut_off * motion.period * count),
            noise=self.noise[self.varying],
            dry=np.zeros(len(self.varying)),
        )

    def _noise(self, effort_noise: Floats) -> Floats:
        """Return the standard deviation of the noise in each residual, shape (c,) [N m or N]."""
        some = slice(None, None, max(1, len(self.motion.times) // INERTIAS))
        inertia = self.dynamics.mass_matrix(self.states[0][some])
        modelled: Floats = inertia[:, :, self.moved] * self.motion.qdd_noise
        squares: Floats = np.mean(np.sum(modelled**2, axis=-1), axis=0)
        return np.asarray(np.hypot(np.sqrt(squares[self.index]), effort_noise))

    # ---- Efforts -------------------------------------------------------------------------

    def _known(self, search: Search, fit: Fit) -> list[Friction]:
        """Return the friction of each varying joint, if the model explains its effort."""
        found = frictions(fit, search.rows.signals.moves)
        unexplained, shown = search.unexplained(fit), search.shows_scale(fit)
        has_scale = any(factor != -1.0 for _, factor in fit.hypothesis.factors)
        for j in range(len(found)):
            reason = ''
            if unexplained[j]:
                reason = 'the model does not explain the effort of this joint'
            elif has_scale and not shown[j]:
                reason = 'the effort of this joint is in an unknown unit'
            found[j] = Friction(unknown_because=reason) if reason else found[j]
        return found

    def _recorded(self, fit: Fit, explained: Floats) -> Floats:
        """
        Return the efforts that a fit expects in the recording, shape (K, c) [N m or N].

        The explained efforts of the varying joints have the units and the order of the model.
        """
        h, varying = fit.hypothesis, np.array(self.varying)
        factor, source = h.factor(len(varying)), varying[h.order(len(varying))]
        factor[list(h.axes)] *= -1.0
        delay = float(fit.shared['delay'][0]) if h.is_late else 0.0
        efforts: Floats = self.rigid.copy()
        efforts[:, source] = self._later(factor * explained, -delay)
        return efforts

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

    def _residual(
        self, c: int, friction: Friction, plain: Floats, corrected: Floats, used: Booleans
    ) -> JointResidual:
        """
        Compare the efforts of one joint in the used samples.

        `plain` are the modelled efforts with friction, but without a correction of faults.
        """
        # If the friction of a joint is unknown, all samples are compared.
        fast = is_moving(self.states[1][:, self.index[c]], WIDTH)
        when = used if friction.unknown_because else used & fast
        measured = self.measured[when, c]
        is_filtered = math.isfinite(self.motion.cut_off)
        return JointResidual(
            name=self.names[c],
            is_prismatic=bool(self.robot.is_prismatic_joint[self.index[c]]),
            rms_measured=float(rms(measured)),
            rms_modelled=float(rms(self.modelled[when, c])),
            rms_residual=float(rms(measured - self.modelled[when, c])),
            rms_friction=float(rms(measured - plain[when])),
            rms_corrected=float(rms(measured - corrected[when])),
            noise=math.nan if is_filtered else float(self.noise[c]),
            friction=friction,
            is_varying=c in self.varying,
        )


def _friction_efforts(fit: Fit, signals: Signals, model: Floats) -> Floats:
    """Return the friction and offsets of a fit, given modelled efforts, shape (K, c)."""
    drives, qd = fit.drives, signals.qd[:, signals.joints]
    dry = drives[:, COULOMB] + drives[:, LOAD_FRICTION] * np.abs(model)
    return np.asarray(drives[:, DAMPING] * qd + dry * signals.direction + drives[:, OFFSET])
