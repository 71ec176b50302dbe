"""
Compares measured and modelled efforts of the last few seconds, for the command `watch`.

The search for faults is the same as for recordings, except that temporary faults, delays and wrong
inertial parameters of several links are not considered. In a few seconds of filtered samples,
delays and wrong inertial parameters look like friction. The arm need not move. The modelled
efforts come from the running node, and include payloads and friction.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
import enum
from typing import Any, NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...robot.model import Booleans, Floats, RobotModel
from ..recordings.signals import rms
from .compared_efforts import not_measured
from .diagnoses import (
    diagnose,
    diagnose_axes,
    diagnose_constant,
    diagnose_positions,
    search_axes,
)
from .fault import Change, Fault, FaultKind, GravityConvention, WITH_GRAVITY
from .friction import is_moving, lacks_reversal
from .joint_samples import NOISE_FLOOR, sample_joints
from .loads import loaded_links
from .regression_data import RegressionData, RobotFit

DURATION = 10.0  # [s], length of the window

MIN_SAMPLES = 50  # one second at 50 Hz
LEAST_MOVING = 0.1  # smallest fraction of the window in which a joint moves in each direction
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

MOST_STATES = 60
"""
Largest number of states that the search uses, because the search repeats while the robot runs.
"""
INDEPENDENT = 0.2  # [s]; filtered samples at this distance have independent noise
LEAST_DURATION = 1.0
"""
Shortest duration of the samples [s]. The limit for recordings is higher. A short time is
sufficient here, because more time reveals no more about an arm at rest.
"""

GRAVE = (
    FaultKind.POSITIONS,
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
    FEW_JOINTS = 'few_joints'
    """Model and robot agree, but only a few joints could be compared."""


class Obstacle(enum.Enum):
    """A reason, apart from faults, to keep ``dry_run`` set to true."""

    SLOW_STATES = 'slow_states'
    SATURATED = 'saturated'
    FEW_JOINTS = 'few_joints'
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
    For `SLOW_STATES`, the measured rate and the lowest sufficient rate [Hz]. For `FEW_JOINTS`, the
    numbers of checked joints and of commanded joints.
    """
    reason: str = ''
    """Message of the node, for `NODE_STATE`."""
    sizes: tuple[Size, ...] = ()
    """RMS efforts of revolute joints, then of prismatic joints."""
    checked: tuple[str, ...] = ()
    """Joints with efforts that are large enough to reveal a wrong sign."""
    unchecked: tuple[str, ...] = ()
    """Joints with efforts that are too small to reveal a wrong sign."""
    unmeasured: tuple[str, ...] = ()
    """Commanded joints without measured efforts."""
    saturated: tuple[str, ...] = ()
    """Commanded joints with efforts at the effort limits."""
    is_moving: bool = True
    """Whether any compared joint moved in the window."""
    has_gravity: bool = True
    """Whether the modelled efforts contain gravity."""

    @property
    def cause(self) -> FaultKind | Obstacle | None:
        """Obstacle or fault that decides the outcome, or None if model and robot agree."""
        return self.obstacle or (self.faults[0].kind if self.faults else None)


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

    def restart_after_change(self, *measured: Any) -> None:
        """Drop all samples if a property of the measured efforts, such as the scale, changed."""
        if measured != self._measured:
            self._measured = measured
            self._times.clear()
            self._rows.clear()

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
        self.is_checked = rms(self.modelled) > self.floor
        self.silent = not_measured(self.measured, self.modelled, self.floor) & self.is_checked
        # A measured effort of zero needs no explanation if the modelled effort is also small.
        self.searched = np.flatnonzero(self.measured.any(axis=0) & ~self.silent)

    def agreement(self) -> Agreement:
        """Return whether model and robot agree."""
        common = Agreement(
            Outcome.AGREE,
            sizes=self._sizes(),
            checked=self._names(self.is_checked),
            unchecked=self._names(~self.is_checked),
            is_moving=bool(self.moves.any()),
            has_gravity=self.convention.in_measured,
        )
        is_zero = ~self.measured[:, self.silent].any()
        if self.silent.any() and is_zero and np.array_equal(self.silent, self.is_checked):
            return replace(common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.ZERO_EFFORTS)
        robot, q = self.dynamics.robot, self.whole.q
        if positions := diagnose_positions(robot, q, self.whole.joint_names):
            return replace(common, outcome=Outcome.DIFFER, faults=tuple(positions))
        known, left = self._search()
        unexplained = [self._unexplained(left)] if left else []
        faults = (*known, *unexplained)
        if not known and self._may_be_friction(left):
            return replace(
                common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.AT_REST, faults=faults
            )
        if faults:
            return replace(common, outcome=Outcome.DIFFER, faults=faults)
        if not self.is_checked.any():
            return replace(common, outcome=Outcome.UNDECIDED, obstacle=Obstacle.SMALL_EFFORTS)
        return common

    def _search(self) -> tuple[list[Fault], dict[int, float]]:
        """Return the identified faults, and the residuals that are still large, by joint index."""
        constant = np.flatnonzero(self.silent).tolist()
        silent = diagnose_constant({self.names[c]: float(self.measured[0, c]) for c in constant})
        data = self._regression_data(np.ones(len(self.searched)))
        fit = data.friction_only()
        left = self._exceeding(fit, AGREEMENT)
        if not self._exceeding(fit, SUSPICIOUS):
            return silent, left
        names = [self.names[c] for c in self.searched]
        axes = search_axes(data, self._regression_data)
        found = axes.robot_fit
        faults = [
            fault
            for fault in [*diagnose_axes(data, axes, names), *diagnose(axes.data, found, names)]
            if fault.kind is not FaultKind.UNEXPLAINED and (left or fault.kind in GRAVE)
        ]
        return silent + faults, self._exceeding(found, AGREEMENT) if faults else left

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

    def _regression_data(self, signs: Floats) -> RegressionData:
        """Return the data of joints with measured efforts, given the signs of the axes."""
        robot, times = self.dynamics.robot, self.whole.times
        q, qd = np.nan_to_num(self.whole.q), np.nan_to_num(self.whole.qd)
        qdd: Floats = np.gradient(qd, times, axis=0)
        duration = float(times[-1] - times[0])
        period = duration / (len(times) - 1)
        some, index = self.some, self.index[self.searched]
        every = np.ones(q.shape[1])
        every[index] = signs
        modelled = self.modelled[some, self.searched]
        states = q[some], qd[some], qdd[some]
        if (signs < 0.0).any():
            modelled = signs * (modelled - self._rigid(*states)[:, index])
            q, qd, qdd = every * q, every * qd, every * qdd
            states = q[some], qd[some], qdd[some]
            modelled += self._rigid(*states)[:, index]
        speeds = qd[:, index]
        moves = [
            not lacks_reversal(speed, period, FRICTION_WIDTH, LEAST_MOVING * duration)
            for speed in speeds.T
        ]
        links = loaded_links(robot, q)
        joints = sample_joints(
            self.dynamics,
            times[some],
            states,
            links,
            index.tolist(),
            measured=signs * self.measured[some, self.searched],
            modelled=modelled,
            gravity=self.dynamics.gravity_efforts(states[0])[:, index],
            direction=np.tanh(speeds[some] / FRICTION_WIDTH),
            used=[
                is_moving(speed[some], FRICTION_WIDTH) | (not moved)
                for speed, moved in zip(speeds.T, moves, strict=True)
            ],
            moves=moves,
            noise=self.floor[self.searched] / NOISE_FLOOR,
        )
        # A payload in the node may be heavier than the link that carries the payload.
        heaviest = float(np.sum(robot.mass))
        return RegressionData(
            joints,
            dict.fromkeys(links, heaviest),
            heaviest,
            self.dynamics.gravity,
            duration / INDEPENDENT,
            duration,
            LEAST_DURATION,
            self.convention,
        )

    def _rigid(self, *states: Floats) -> Floats:
        """Return the modelled efforts, with gravity if the measured efforts contain gravity."""
        efforts = self.dynamics.efforts(*states)
        if not self.convention.in_measured:
            efforts = efforts - self.dynamics.gravity_efforts(states[0])
        return efforts

    def _exceeding(self, robot_fit: RobotFit, fraction: float) -> dict[int, float]:
        """Return the residuals [N m or N] above a fraction of the effort, worst first."""
        found = {}
        for c, fit in zip(self.searched.tolist(), robot_fit.fits, strict=True):
            residual = float(np.sqrt(fit.remaining) * rms(self.measured)[c])
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

    def _names(self, selected: Booleans) -> tuple[str, ...]:
        return tuple(self.names[c] for c in np.flatnonzero(selected))


# ---- The verdict ---------------------------------------------------------------------------


DEFAULT_LEAST_RATE = 80.0  # [Hz]; the default rate of ros2_control is 100 Hz
OF_GIVEN_RATE = 0.8  # smallest fraction of the rate that the user gave
OF_UPDATE_RATE = 0.5  # smallest fraction of update_rate, because many drivers are slow

LEAST_CHECKED = 0.25
"""
Smallest fraction of the commanded joints that must be checked. In a random pose at rest, gravity
acts mainly on two of the six joints of a UR arm. One checked joint says little about the others.
"""


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


def check_agreement(
    reason: str,
    rate: StateRate,
    samples: LiveSamples | None,
    robot: RobotModel | None,
    gravity: Floats,
    limits: Floats | None = None,
    commanded: Sequence[str] = (),
    saturated: Sequence[str] = (),
    convention: GravityConvention = WITH_GRAVITY,
    payloads: Sequence[tuple[str, float, Floats]] = (),
) -> Agreement:
    """
    Check whether model and robot agreed in the last few seconds.

    `reason` says why the node does not compute efforts, and is empty if the node computes efforts.
    `samples` and `robot` are None if the robot is unknown. `commanded` contains all commanded
    joints. `saturated` contains the commanded joints with efforts that reached the effort limits
    in the last few seconds. `gravity`, `limits`, `convention` and `payloads` are the arguments of
    `diagnose_samples`.
    """
    if reason:
        return Agreement(Outcome.UNDECIDED, Obstacle.NODE_STATE, reason=reason)
    if samples is None or robot is None:
        agreement = Agreement(Outcome.UNDECIDED, Obstacle.TOO_FEW_SAMPLES)
    else:
        samples = _without_constant(samples, commanded)
        agreement = diagnose_samples(samples, robot, gravity, limits, convention, payloads)
    agreement = _completed(agreement, commanded, saturated)
    is_grave = any(fault.kind in GRAVE for fault in agreement.faults)
    if rate.is_slow and not is_grave:
        agreement = replace(
            agreement,
            outcome=Outcome.DIFFER,
            obstacle=Obstacle.SLOW_STATES,
            faults=(),
            numbers=(rate.measured or 0.0, rate.least),
        )
    if saturated and (agreement.outcome is not Outcome.DIFFER or agreement.obstacle):
        return replace(
            agreement,
            outcome=Outcome.SATURATED,
            obstacle=Obstacle.SATURATED,
            faults=(),
            numbers=(),
        )
    return agreement


def _without_constant(samples: LiveSamples, commanded: Sequence[str]) -> LiveSamples:
    """Leave out constant efforts of joints that are not commanded, such as gripper joints."""
    is_commanded = np.isin(samples.joint_names, commanded) if commanded else True
    is_constant = (samples.measured == samples.measured[:1]).all(axis=0)
    measured = np.where(is_constant & ~np.array(is_commanded), np.nan, samples.measured)
    return samples._replace(measured=measured)


def _completed(
    agreement: Agreement, commanded: Sequence[str], saturated: Sequence[str]
) -> Agreement:
    """Add unmeasured and saturated joints, and change the outcome if few joints were checked."""
    compared = (*agreement.checked, *agreement.unchecked)
    unmeasured = tuple(joint for joint in commanded if compared and joint not in compared)
    agreement = replace(agreement, saturated=tuple(saturated), unmeasured=unmeasured)
    count = len(set(commanded) & set(agreement.checked))
    if agreement.outcome is Outcome.AGREE and count < LEAST_CHECKED * len(commanded):
        numbers = (float(count), float(len(commanded)))
        return replace(
            agreement, outcome=Outcome.FEW_JOINTS, obstacle=Obstacle.FEW_JOINTS, numbers=numbers
        )
    return agreement
