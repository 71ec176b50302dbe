"""
Compares measured and modelled efforts of the last few seconds, for the command `watch`.

The regression is that of recordings, but temporary faults, delays and wrong links are not
considered, because they look like friction in a few seconds of filtered samples. The modelled
efforts come from the running node, and include payloads and friction.

A joint is *checked* if another sign of its effort would be noticed, and if its velocity was
compared with its position. Both need a motion: a joint without weight shows the sign of its effort
by friction and inertia only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import enum
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import rms
from .fault import Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import is_moving
from .loads import loaded_links
from .regression import Fit, NOISE_FLOOR
from .rows import OFFSET, ROTOR, Rows, Signals
from .search import Search
from .simple_faults import constant_fault, not_measured, positions_fault
from .statements import faults_of
from .velocities import check_velocities

DURATION = 10.0  # [s], length of the window

MIN_SAMPLES = 50  # one second at 50 Hz
LEAST_MOVING = 0.05  # smallest fraction of the window in which a joint moves
MOVING = 0.02  # [rad/s or m/s]; RMS speed above which a joint moves
AGREEMENT = 0.3  # largest RMS residual of a good model, as a fraction of the effort
SUSPICIOUS = 0.15  # residuals above this fraction of the effort start the search for faults
FLOOR_OF_LIMIT, FLOOR_OF_LARGEST = 0.02, 0.05
"""
Residuals are ignored below these fractions of the effort limit and of the largest modelled effort.
The smaller of the two thresholds applies, because effort limits in URDFs are often placeholders.
"""
LEAST_FLOOR = 0.005  # accuracy of effort sensors, as a fraction of the limit
REST_FACTOR = 2.5  # multiple of the floor for joints at rest, because dry friction may hold joints
FRICTION_AT_REST = 0.1  # largest dry friction, as a fraction of the limit

MOST_STATES = 80
"""
Largest number of states that the search uses, because the search repeats while the robot runs.
"""
INDEPENDENT = 0.2  # [s]; filtered samples at this distance have independent noise

DEFAULT_LEAST_RATE = 80.0  # [Hz]; the default rate of ros2_control is 100 Hz
OF_GIVEN_RATE = 0.8  # smallest fraction of the rate that the user gave
OF_UPDATE_RATE = 0.5  # smallest fraction of update_rate, because many drivers are slow

GRAVE = (
    FaultKind.POSITIONS,
    FaultKind.VELOCITY,
    FaultKind.VELOCITY_LAG,
    FaultKind.REVERSED_AXIS,
    FaultKind.SIGN,
    FaultKind.SCALE,
    FaultKind.UNIT,
    FaultKind.ORDER,
    FaultKind.GRAVITY_COMPENSATED,
    FaultKind.GRAVITY_MEASURED,
    FaultKind.PAYLOAD,
    FaultKind.MOUNTING,
)
"""
Faults that are reported even if residuals are small or the rate of joint states is low. All other
faults are harmless if residuals are below `AGREEMENT`. A low rate can cause residuals that look
like one of the other faults.
"""


# ---- The result ----------------------------------------------------------------------------


class Outcome(enum.Enum):
    """Outcome of the comparison of model and robot."""

    AGREE = 'agree'
    DIFFER = 'differ'
    UNDECIDED = 'undecided'
    SATURATED = 'saturated'
    """Commanded efforts reach the effort limits, and no difference was found."""
    NOT_CHECKED = 'not_checked'
    """Model and robot agree, but some commanded joints were not checked."""


class Check(enum.Enum):
    """What is known about the sign of the effort and the velocity of a joint."""

    DONE = 'done'
    NO_WEIGHT = 'no_weight'
    """The joint rested, and carries too little weight to show the sign of its effort."""
    NOT_MOVED = 'not_moved'
    """The joint rested, so that its velocity was not compared with its position."""
    FAINT = 'faint'
    """The joint moved, but its effort is too small to show its sign."""
    NOT_MEASURED = 'not_measured'


class Obstacle(enum.Enum):
    """A reason, apart from faults, to keep ``dry_run`` set to true."""

    SLOW_STATES = 'slow_states'
    SATURATED = 'saturated'
    NOT_CHECKED = 'not_checked'
    NO_DIAGNOSTICS = 'no_diagnostics'
    NODE_STATE = 'node_state'
    NO_EFFORTS = 'no_efforts'
    ZERO_EFFORTS = 'zero_efforts'
    TOO_FEW_SAMPLES = 'too_few_samples'
    SMALL_EFFORTS = 'small_efforts'
    AT_REST = 'at_rest'


_OUTCOMES = {
    Obstacle.SLOW_STATES: Outcome.DIFFER,
    Obstacle.SATURATED: Outcome.SATURATED,
    Obstacle.NOT_CHECKED: Outcome.NOT_CHECKED,
}
"""Outcomes of obstacles; the other obstacles leave the outcome undecided."""


@dataclass(frozen=True)
class Size:
    """RMS efforts of all compared joints of one type [N m or N]."""

    residual: float
    """RMS of measured minus modelled efforts."""
    measured: float
    is_prismatic: bool = False


@dataclass(frozen=True)
class Agreement:
    """Whether model and robot agree, and possible causes of a difference."""

    obstacle: Obstacle | None = None
    """Reason, apart from faults, to keep ``dry_run`` set to true."""
    faults: tuple[Fault, ...] = ()
    """Faults, most important first. If the obstacle is `AT_REST`, the cause may be friction."""
    numbers: tuple[float, ...] = ()
    """
    For `SLOW_STATES`, the measured rate and the lowest sufficient rate [Hz].
    """
    reason: str = ''
    """Message of the node, for `NODE_STATE`."""
    sizes: tuple[Size, ...] = ()
    """RMS efforts of revolute joints, then of prismatic joints."""
    checks: Mapping[str, Check] = field(default_factory=dict)
    """What is known about each compared or commanded joint."""
    saturated: tuple[str, ...] = ()
    """Commanded joints with efforts at the effort limits."""
    is_past: bool = False
    """Whether the difference was found earlier, and not in the latest samples."""
    is_moving: bool = True
    """Whether any compared joint moved in the window."""

    @property
    def outcome(self) -> Outcome:
        """The outcome that follows from obstacle and faults."""
        if self.obstacle is None:
            return Outcome.DIFFER if self.faults else Outcome.AGREE
        return _OUTCOMES.get(self.obstacle, Outcome.UNDECIDED)

    @property
    def cause(self) -> FaultKind | Obstacle | None:
        """Obstacle or fault that decides the outcome, or None if model and robot agree."""
        return self.obstacle or (self.faults[0].kind if self.faults else None)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Joints that were not checked."""
        return tuple(name for name, check in self.checks.items() if check is not Check.DONE)


# ---- Samples -------------------------------------------------------------------------------


class LiveSamples(NamedTuple):
    """Low-pass filtered samples of m joints at k times, with NaN for unknown values."""

    joint_names: tuple[str, ...]
    times: Floats
    """Times of the samples, shape (k,) [s]."""
    q: Floats
    """Positions, shape (k, m) [rad or m]."""
    qd: Floats
    """Velocities, shape (k, m) [rad/s or m/s]."""
    measured: Floats
    """Measured efforts, shape (k, m) [N m or N]."""
    modelled: Floats
    """Modelled efforts for the measured motion, shape (k, m) [N m or N]."""


class LiveWindow:
    """Keeps the samples of the last `duration` seconds."""

    def __init__(self, joint_names: Sequence[str], duration: float = DURATION) -> None:
        self.joint_names, self.duration = tuple(joint_names), duration
        self._rows: deque[tuple[float, Floats]] = deque()

    def add(self, time: float, *signals: Floats) -> None:
        """Add the newest sample, with the signals of `LiveSamples`, and drop old samples."""
        self._rows.append((time, np.array(signals)))
        while self._rows[0][0] < time - self.duration:
            self._rows.popleft()

    def samples(self) -> LiveSamples:
        """Return the samples in the window."""
        times = np.array([time for time, _ in self._rows])
        rows = np.array([row for _, row in self._rows]).reshape(-1, 4, len(self.joint_names))
        return LiveSamples(self.joint_names, times, *rows.transpose(1, 0, 2))


class StateRate(NamedTuple):
    """Measured rate of joint states, and values that determine the lowest sufficient rate."""

    measured: float | None
    """Measured rate [Hz], or None if unknown."""
    given: float | None = None
    """Rate that the user expects [Hz], or None if not given."""
    update_rate: float | None = None
    """Requested rate of commands [Hz], or None if each joint state leads to one command."""
    is_simulated: bool = False
    """Whether the node uses simulated time, which may be slower than real time."""

    @property
    def least(self) -> float:
        """Lowest sufficient rate [Hz]."""
        if self.given is not None:
            return OF_GIVEN_RATE * self.given
        if self.update_rate is not None:
            return OF_UPDATE_RATE * self.update_rate
        return 0.0 if self.is_simulated else DEFAULT_LEAST_RATE

    @property
    def is_slow(self) -> bool:
        """Whether the measured rate is too low."""
        return self.measured is not None and self.measured < self.least


# ---- The comparison ------------------------------------------------------------------------


def check_agreement(
    samples: LiveSamples,
    robot: RobotModel,
    gravity: Floats,
    limits: Floats | None = None,
    convention: GravityConvention = WITH_GRAVITY,
    payloads: Sequence[tuple[str, float, Sequence[float]]] = (),
    commanded: Sequence[str] = (),
    saturated: Sequence[str] = (),
    rate: StateRate | None = None,
) -> Agreement:
    """
    Check whether model and robot agreed in the last few seconds.

    The samples contain all joints, in the order of `robot`. Joints whose positions were never
    reported are assumed to rest at zero, as in recordings. `gravity`, in the frame of the base
    link [m/s^2], is required even if the modelled efforts exclude gravity. By default, `limits`
    are the effort limits of the robot. A payload consists of a link, a mass [kg], and the centre
    of mass in the frame of the link [m]. Constant efforts of joints other than the `commanded`
    ones are ignored. `saturated` contains the commanded joints with efforts that reached the
    effort limits. `rate` is that of the joint states.
    """
    if commanded:
        is_commanded = np.isin(samples.joint_names, commanded)
        is_constant = (samples.measured == samples.measured[:1]).all(axis=0)
        measured = np.where(is_constant & ~is_commanded, np.nan, samples.measured)
        samples = samples._replace(measured=measured)
    dynamics = InverseDynamics(robot, gravity)
    for link, mass, com in payloads:
        if link in robot.link_names:
            dynamics.set_payload(link, mass, com)
    limits = robot.effort_limits if limits is None else limits
    agreement = _compare(samples, dynamics, limits, convention)
    checks = agreement.checks
    if checks and commanded:
        checks = {joint: checks.get(joint, Check.NOT_MEASURED) for joint in commanded}
    agreement = replace(agreement, saturated=tuple(saturated), checks=checks)
    is_grave = any(fault.kind in GRAVE for fault in agreement.faults)
    if rate is not None and rate.is_slow and not is_grave:
        numbers = rate.measured or 0.0, rate.least
        agreement = replace(agreement, obstacle=Obstacle.SLOW_STATES, faults=(), numbers=numbers)
    if saturated and (agreement.outcome is not Outcome.DIFFER or agreement.obstacle):
        return replace(agreement, obstacle=Obstacle.SATURATED, faults=(), numbers=())
    return agreement


def _compare(
    samples: LiveSamples, dynamics: InverseDynamics, limits: Floats, convention: GravityConvention
) -> Agreement:
    """Compare the joints whose efforts are known in most samples."""
    is_known = np.isfinite(samples.measured) & np.isfinite(samples.modelled)
    # Efforts are unknown until all topics are connected and the filters have settled.
    known_rows = is_known.any(axis=1).sum()
    columns = np.flatnonzero(2 * is_known.sum(axis=0) > known_rows).tolist()
    if len(samples.times) >= MIN_SAMPLES and not np.isfinite(samples.measured).any():
        return Agreement(Obstacle.NO_EFFORTS)
    is_reported = np.isfinite(samples.q).any(axis=0)
    samples = samples._replace(q=np.where(is_reported, samples.q, 0.0))
    rows = is_known[:, columns].all(axis=1) & np.isfinite(samples.q).all(axis=1)
    if not columns or rows.sum() < MIN_SAMPLES:
        return Agreement(Obstacle.TOO_FEW_SAMPLES)
    whole = LiveSamples(samples.joint_names, *(signal[rows] for signal in samples[1:]))
    return _Comparison(whole, columns, dynamics, limits, convention).agreement()


class _Comparison:
    """Comparison of complete samples, with one column for each of the c compared joints."""

    def __init__(
        self,
        whole: LiveSamples,
        columns: list[int],
        dynamics: InverseDynamics,
        limits: Floats,
        convention: GravityConvention,
    ) -> None:
        self.whole, self.dynamics, self.convention = whole, dynamics, convention
        self.some = slice(None, None, -(-len(whole.times) // MOST_STATES))
        self.index = np.array(columns)
        self.names = [whole.joint_names[i] for i in columns]
        self.measured, self.modelled = whole.measured[:, columns], whole.modelled[:, columns]
        self.is_prismatic = dynamics.robot.is_prismatic_joint[columns]
        self.limits = limits[columns]
        # Velocities that the driver does not measure are derived.
        has_velocity = np.isfinite(whole.qd).all(axis=0)
        self.qd = np.where(has_velocity, whole.qd, np.gradient(whole.q, whole.times, axis=0))
        self.moves: Booleans = rms(self.qd[:, columns]) > MOVING
        self.effort = np.maximum(rms(self.measured), rms(self.modelled))
        self.floor = self._floor()
        self.is_large = rms(self.modelled) > self.floor
        self.silent = not_measured(self.measured, self.modelled, self.floor) & self.is_large
        # A measured effort of zero needs no explanation if the modelled effort is also small.
        self.searched = np.flatnonzero(self.measured.any(axis=0) & ~self.silent)

    def agreement(self) -> Agreement:
        """Return whether model and robot agree."""
        common = Agreement(sizes=self._sizes(), is_moving=bool(self.moves.any()))
        is_zero = ~self.measured[:, self.silent].any()
        if self.silent.any() and is_zero and np.array_equal(self.silent, self.is_large):
            return replace(common, obstacle=Obstacle.ZERO_EFFORTS)
        robot, whole = self.dynamics.robot, self.whole
        if positions := positions_fault(robot, whole.q, whole.joint_names):
            return replace(common, faults=tuple(positions))
        velocities = check_velocities(
            self.names, whole.times, whole.q[:, self.index], whole.qd[:, self.index]
        )
        known, left, is_signed = self._search()
        checks = {
            name: _check(bool(is_signed[c]), bool(velocities.compared[c]), bool(self.moves[c]))
            for c, name in enumerate(self.names)
        }
        common = replace(common, checks=checks)
        known = [*velocities.faults, *known]
        unexplained = Fault(FaultKind.UNEXPLAINED, tuple(self.names[c] for c in left))
        faults = (*known, *([unexplained] if left else []))
        if not known and self._may_be_friction(left):
            return replace(common, obstacle=Obstacle.AT_REST, faults=faults)
        if not faults and not self.is_large.any() and not is_signed.any():
            return replace(common, obstacle=Obstacle.SMALL_EFFORTS)
        return replace(common, faults=faults)

    def _search(self) -> tuple[list[Fault], dict[int, float], Booleans]:
        """
        Return the faults, the residuals that are still large, and joints that show their sign.

        The residuals are by joint index. The mask of the joints has the shape (c,).
        """
        constant = np.flatnonzero(self.silent).tolist()
        faults = constant_fault({self.names[c]: float(self.measured[0, c]) for c in constant})
        is_signed = np.zeros(len(self.names), dtype=bool)
        if not len(self.searched):
            return faults, {}, is_signed
        search = Search(self._rows(), is_brief=True)
        fit = search.without_faults()
        left = self._exceeding(fit, AGREEMENT)
        if self._exceeding(fit, SUSPICIOUS):
            fit = search.best(fit)
            names = [self.names[c] for c in self.searched]
            found = [
                fault
                for fault in faults_of(search, fit, names)
                if fault.kind not in (FaultKind.UNEXPLAINED, FaultKind.BODIES)
                and (left or fault.kind in GRAVE)
            ]
            faults += found
            left = self._exceeding(fit, AGREEMENT, True) if found else left
        is_signed[self.searched] = [search.shows_sign(fit, j) for j in range(len(self.searched))]
        return faults, left, is_signed

    def _floor(self) -> Floats:
        """Return the thresholds below which residuals are ignored, shape (c,) [N m or N]."""
        modelled, largest = rms(self.modelled), np.zeros(len(self.names))
        if not self.convention.in_measured:
            # If the driver removes gravity, the errors of the driver's gravity model remain.
            gravity = self.dynamics.gravity_efforts(self.whole.q[self.some])
            modelled = np.maximum(modelled, rms(gravity[:, self.index]))
        for kind in (False, True):
            same = self.is_prismatic == kind
            largest[same] = np.max(modelled[same], initial=0.0)
        floor = np.minimum(FLOOR_OF_LIMIT * self.limits, FLOOR_OF_LARGEST * largest)
        finite = np.where(np.isfinite(self.limits), self.limits, 0.0)
        floor = np.maximum(floor, LEAST_FLOOR * finite)
        return np.asarray(np.where(self.moves, floor, REST_FACTOR * floor))

    def _rows(self) -> Rows:
        """Return the rows of joints with measured efforts."""
        whole, robot, some = self.whole, self.dynamics.robot, self.some
        q, qd = whole.q, self.qd
        qdd: Floats = np.gradient(qd, whole.times, axis=0)
        index = self.index[self.searched]
        speeds = qd[:, index]
        fast = is_moving(speeds, FRICTION_WIDTH)
        moves = fast.mean(axis=0) > LEAST_MOVING
        measured = self.measured[some][:, self.searched]
        signals = Signals(
            joints=tuple(index.tolist()),
            times=whole.times[some],
            q=q[some],
            qd=qd[some],
            qdd=qdd[some],
            measured=measured,
            added=np.zeros_like(measured),
            direction=np.tanh(speeds[some] / FRICTION_WIDTH),
            rate=np.zeros_like(measured),
            used=fast[some] | ~moves,
            moves=moves,
            independent=float(whole.times[-1] - whole.times[0]) / INDEPENDENT,
            noise=self.floor[self.searched] / NOISE_FLOOR,
            dry=self.floor[self.searched] / REST_FACTOR,
        )
        rows = Rows(self.dynamics, signals, loaded_links(robot, q), self.convention)
        states = signals.q, signals.qd, signals.qdd
        rigid = rows.rigid(states, self.convention.in_measured)
        modelled = self.modelled[some][:, self.searched]
        return rows.at(signals._replace(added=modelled - rigid))

    def _exceeding(self, fit: Fit, fraction: float, has_drives: bool = False) -> dict[int, float]:
        """
        Return the residuals [N m or N] above a fraction of the effort, worst first.

        Friction is fitted, but not the bodies. Rotors and offsets are fitted if `has_drives` is
        true.
        """
        at, used = fit.columns.at, np.isfinite(fit.residual)
        left_out = [*at.bodies]
        if not has_drives:
            left_out.append(at.drive[ROTOR])
        if not has_drives or not fit.hypothesis.has_offsets:
            left_out.append(at.drive[OFFSET])
        part = fit.columns.matrix[:, :, left_out] @ fit.solution[:, left_out, None]
        residuals = rms(np.where(used, fit.residual - part[..., 0].T, 0.0))
        residuals = residuals * np.abs(fit.hypothesis.factor(len(self.searched)))
        found = {}
        for c, residual in zip(self.searched.tolist(), residuals.tolist(), strict=True):
            if residual > max(self.floor[c], fraction * self.effort[c]):
                found[c] = residual
        return dict(sorted(found.items(), key=lambda each: -each[1] / self.effort[each[0]]))

    def _may_be_friction(self, differs: dict[int, float]) -> bool:
        """Return whether dry friction of joints at rest may explain the difference."""
        if not differs or not np.isfinite(self.limits).all():
            return False
        return all(
            not self.moves[c] and residual < FRICTION_AT_REST * self.limits[c]
            for c, residual in differs.items()
        )

    def _sizes(self) -> tuple[Size, ...]:
        residual = self.measured - self.modelled
        return tuple(
            Size(
                float(np.sqrt(np.mean(residual[:, same] ** 2))),
                float(np.sqrt(np.mean(self.measured[:, same] ** 2))),
                kind,
            )
            for kind in (False, True)
            if (same := self.is_prismatic == kind).any()
        )


def _check(is_signed: bool, is_compared: bool, moves: bool) -> Check:
    if is_signed and is_compared:
        return Check.DONE
    if is_signed:
        return Check.NOT_MOVED
    return Check.FAINT if is_compared and moves else Check.NO_WEIGHT
