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
from typing import Any, NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import rms
from .fault import Change, Fault, FaultKind, GravityConvention, WITH_GRAVITY
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
    # The following obstacles leave the outcome undecided.
    NO_DIAGNOSTICS = 'no_diagnostics'
    NODE_STATE = 'node_state'
    NO_EFFORTS = 'no_efforts'
    ZERO_EFFORTS = 'zero_efforts'
    TOO_FEW_SAMPLES = 'too_few_samples'
    SMALL_EFFORTS = 'small_efforts'
    AT_REST = 'at_rest'


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

    outcome: Outcome
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
    has_gravity: bool = True
    """Whether the modelled efforts contain gravity."""

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
        self.joint_names = tuple(joint_names)
        self.duration = duration
        self._times: deque[float] = deque()
        self._rows: deque[Floats] = deque()
        self._measured: tuple[Any, ...] = ()

    def add(self, time: float, q: Floats, qd: Floats, measured: Floats, modelled: Floats) -> None:
        """Add the newest sample, and drop samples that are too old."""
        self._times.append(time)
        self._rows.append(np.array([q, qd, measured, modelled]))
        while self._times[0] < time - self.duration:
            self._times.popleft()
            self._rows.popleft()

    def restart_after_change(self, *measured: Any) -> bool:
        """
        Drop all samples if a property of the measured efforts, such as the scale, changed.

        Return whether samples of other properties were dropped.
        """
        if measured == self._measured:
            return False
        has_changed = bool(self._measured)
        self._measured = measured
        self._times.clear()
        self._rows.clear()
        return has_changed

    def samples(self) -> LiveSamples:
        """Return the samples in the window."""
        rows = np.array(self._rows).reshape(-1, 4, len(self.joint_names))
        return LiveSamples(self.joint_names, np.array(self._times), *rows.transpose(1, 0, 2))


# ---- The comparison ------------------------------------------------------------------------


def diagnose_samples(
    samples: LiveSamples,
    robot: RobotModel,
    gravity: Floats,
    limits: Floats | None = None,
    convention: GravityConvention = WITH_GRAVITY,
    payloads: Sequence[tuple[str, float, Floats]] = (),
) -> Agreement:
    """
    Compare measured and modelled efforts.

    The samples contain all joints, in the order of `robot`. Joints whose positions were never
    reported are assumed to rest at zero, as in recordings. `gravity`, in the frame of the base
    link [m/s^2], is required even if the modelled efforts exclude gravity. By default, `limits`
    are the effort limits of the robot. A payload consists of a link, a mass [kg], and the centre
    of mass in the frame of the link [m].
    """
    limits = robot.effort_limits if limits is None else limits
    is_known = np.isfinite(samples.measured) & np.isfinite(samples.modelled)
    # Efforts are unknown until all topics are connected and the filters have settled.
    known_rows = is_known.any(axis=1).sum()
    columns = np.flatnonzero(2 * is_known.sum(axis=0) > known_rows).tolist()
    if len(samples.times) >= MIN_SAMPLES and not np.isfinite(samples.measured).any():
        return Agreement(Outcome.UNDECIDED, Obstacle.NO_EFFORTS)
    is_reported = np.isfinite(samples.q).any(axis=0)
    samples = samples._replace(q=np.where(is_reported, samples.q, 0.0))
    rows = is_known[:, columns].all(axis=1) & np.isfinite(samples.q).all(axis=1)
    if not columns or rows.sum() < MIN_SAMPLES:
        return Agreement(Outcome.UNDECIDED, Obstacle.TOO_FEW_SAMPLES)
    whole = LiveSamples(samples.joint_names, *(signal[rows] for signal in samples[1:]))
    dynamics = InverseDynamics(robot, gravity)
    for link, mass, com in payloads:
        dynamics.set_payload(link, mass, com)
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
        self.moves: Booleans = rms(np.nan_to_num(whole.qd[:, columns])) > MOVING
        self.effort = np.maximum(rms(self.measured), rms(self.modelled))
        self.floor = self._floor()
        self.is_large = rms(self.modelled) > self.floor
        self.silent = not_measured(self.measured, self.modelled, self.floor) & self.is_large
        # A measured effort of zero needs no explanation if the modelled effort is also small.
        self.searched = np.flatnonzero(self.measured.any(axis=0) & ~self.silent)

    def agreement(self) -> Agreement:
        """Return whether model and robot agree."""
        common = Agreement(
            Outcome.AGREE,
            sizes=self._sizes(),
            is_moving=bool(self.moves.any()),
            has_gravity=self.convention.in_measured,
        )
        is_zero = ~self.measured[:, self.silent].any()
        if self.silent.any() and is_zero and np.array_equal(self.silent, self.is_large):
            return replace(common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.ZERO_EFFORTS)
        robot, whole = self.dynamics.robot, self.whole
        if positions := positions_fault(robot, whole.q, whole.joint_names):
            return replace(common, outcome=Outcome.DIFFER, faults=tuple(positions))
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
        faults = (*known, *([self._unexplained(left)] if left else []))
        if not known and self._may_be_friction(left):
            return replace(
                common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.AT_REST, faults=faults
            )
        if faults:
            return replace(common, outcome=Outcome.DIFFER, faults=faults)
        if not self.is_large.any() and not is_signed.any():
            return replace(common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.SMALL_EFFORTS)
        return common

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
            fit = search.best()
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
            gravity = self.dynamics.gravity_efforts(np.nan_to_num(self.whole.q[self.some]))
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
        q, qd = np.nan_to_num(whole.q), np.nan_to_num(whole.qd)
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

    def _unexplained(self, differs: dict[int, float]) -> Fault:
        changes = [
            Change(self.names[c], bool(self.is_prismatic[c]), left, left, rms(self.measured)[c])
            for c, left in differs.items()
        ]
        return Fault(
            FaultKind.UNEXPLAINED, tuple(each.joint for each in changes), changes=tuple(changes)
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
