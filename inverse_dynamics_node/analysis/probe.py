"""
Checks the commands of an arm that floats, one joint after another.

An effort is raised slowly until the arm moves, in both directions. The motion is then compared
with the model:

- Which joint has moved, and to which side? The product of the mass matrix and the displacement is
  the double integral of the efforts that have acted. It shows the joint on which the effort has
  acted, even if other joints have moved too.
- At which effort did the joint break away? If the two directions differ, the efforts that hold
  the arm are wrong, as they are if the driver scales them.
- How fast did the joint accelerate? If the effort that friction takes is small, this shows the
  scale of the commands.

`Probe` decides about the next effort and about the verdicts. It knows neither ROS nor clocks.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
import enum
import math
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.kinematics import whole_turns
from ..robot.model import Booleans, Floats, RobotModel

LARGEST_MOTION = 0.03
"""No joint may move farther than this from its start position [rad or m]."""
REACH = 0.003
"""The node ends a push when its joint is this far from the reference [rad or m]."""
PROBE_TIMEOUT = 60.0
"""Longest duration of a probe for each joint [s]."""
_MOVED = 0.002  # [rad or m]; a joint that has moved so far by a push has moved
FASTEST = 1.0
"""Speed limit of all joints [rad/s or m/s]."""
_LARGEST_KD, _KD_TIMES_DELAY = 40.0, 0.25  # [1/s], no unit; of joints that need feedback
_FIRST_JERK = 4.0  # [rad/s^3, m/s^3]; of a joint without friction when a push begins
_GROWTH = 3.0  # [1/s]; of a push that has become large
_JERK, _DETECTION = 0.012, 0.012  # [rad or m], [s]; the joint may slip this far until it is seen
_SETTLING, _WINDOW, _LONGEST = 0.25, 0.15, 2.0  # [s]; of the rest before a push
_RESTING = 0.0005  # [rad or m]; motion within a window of a joint that rests
_DRIFT_TIME, _DRIFT = 0.6, 0.001  # [s], [rad or m]; an arm that moves more does not float
_STRAY = 0.005  # [rad or m]; a joint that has moved so far by itself is held
_BALANCES = 4  # attempts to replace feedback by constant efforts
_COASTING = 0.06  # [s]; the motion is observed for this long after a push
_ROOM = 0.01  # [rad or m]; to the position limit, for a push
_HOLD = 0.3  # [s]; how long the largest push lasts
_UNLIMITED = 100.0  # [rad/s^2, m/s^2]; largest acceleration of a joint without effort limit
_UNBALANCED = 0.25  # [efforts that hold the joint]; tolerated error of these efforts
_LEAST_LOAD = 0.05  # [largest pushes]; smaller errors of the load are not judged
_UNEVEN = 0.15  # friction may differ by this fraction between the directions
_SCALES = 0.6, 1.65  # tolerated factors between command and acceleration
_STICTION = 0.3  # static friction may exceed friction in motion by this fraction
_LEAST_SAMPLES = 5  # of a motion whose acceleration is judged
_LARGEST_ERROR = 0.15  # standard error of a scale, as a fraction of the scale
_FREE_MISFIT = 0.01  # the same for a motion that looks like one without dry friction
_NO_FRICTION = 0.05  # of the largest push; a smaller friction is none
_SHORT = 0.8  # [s]
_DAMPED = 1.0  # of the motion; viscous friction that prevents more motion hides the inertia
_MISFIT = 0.05  # of the sum of squares; a motion that differs more is not judged
_CREEP = 0.15  # of the displacement; a joint that has moved less has not broken away


def node_parameters(
    robot: RobotModel, joints: Sequence[str], is_held: Booleans, period: float
) -> dict[str, Any]:
    """
    Return the parameters of the node during a probe.

    The mode is `computed_torque` with gains of zero, except for the joints that need feedback.
    `period` is the time between joint states [s].
    """
    kd = min(_LARGEST_KD, _KD_TIMES_DELAY / (2.0 * period + 0.003))
    limits = np.minimum(robot.velocity_limits[robot.joint_indices(joints)], FASTEST)
    return {
        'mode': 'computed_torque',
        'kp': (0.25 * kd**2 * is_held).tolist(),
        'kd': (kd * is_held).tolist(),
        'include_friction': False,
        'max_tracking_error': LARGEST_MOTION,
        'effort_reach': REACH,
        'velocity_limits': np.where(limits > 0.0, limits, FASTEST).tolist(),
        'guiding_speed': 0.5,
        'reference_timeout': 0.3,
        'start_ramp': 0.02,
        'stop_ramp': 0.0,
        'stop_damping': 0.0,
    }


class Verdict(enum.Enum):
    """What the pushes of one joint have shown."""

    RIGHT = 'right'
    WRONG_SIGN = 'wrong sign'
    WRONG_JOINT = 'wrong joint'
    WRONG_SCALE = 'wrong scale'
    WRONG_LOAD = 'wrong load'
    STOPPED = 'stopped'
    NOT_MOVED = 'not moved'
    NO_ROOM = 'no room'
    RESTLESS = 'restless'


FAULTS = (
    Verdict.WRONG_SIGN,
    Verdict.WRONG_JOINT,
    Verdict.WRONG_SCALE,
    Verdict.WRONG_LOAD,
    Verdict.STOPPED,
)
"""Verdicts that end the probe, because the arm is not safe."""


class Push(NamedTuple):
    """What one push of a joint has shown."""

    verdict: Verdict
    effort: float = math.nan
    """Effort at which the joint began to move, or the largest effort, positive [N m or N]."""
    scale: float = math.nan
    """Acceleration of the joint compared with the model; NaN if friction hides it."""
    moved: str = ''
    """The joint that has moved."""
    side: float = 0.0
    """The direction in which it has moved, 1 or -1."""
    is_certain: bool = True
    """Whether the effort explains the motion; otherwise it may be a drift."""


class JointResult(NamedTuple):
    """What the pushes of one joint have shown."""

    joint: str
    verdict: Verdict
    pushes: tuple[Push, ...] = ()
    """In the positive and in the negative direction."""
    load_error: float = math.nan
    """Effort that is missing to hold the joint [N m or N]; NaN if unknown."""
    load: float = math.nan
    """Modelled effort that holds the joint [N m or N]."""

    @property
    def scale(self) -> float:
        """Acceleration compared with the model; NaN if unknown."""
        known = [push.scale for push in self.pushes if math.isfinite(push.scale)]
        return math.exp(sum(map(math.log, known)) / len(known)) if known else math.nan


class Request(NamedTuple):
    """What the node has to do until the next joint state."""

    positions: Floats
    """Positions in which the joints should stay, shape (m,) [rad or m]."""
    efforts: Floats
    """Efforts to add to those that let the arm float, shape (m,) [N m or N]."""
    is_held: Booleans
    """Joints that need feedback of their position, shape (m,)."""


class _Sample(NamedTuple):
    time: float
    q: Floats
    net: Floats  # commanded efforts minus those that hold the arm, shape (m,)


_T = TypeVar('_T')
_Waiting = Generator[None, None, _T]  # a part of the sequence, with its result


class Probe:
    """
    Pushes the commanded joints one after another; call `step` for each joint state.

    Parameters
    ----------
    dynamics : InverseDynamics
        The model that the node uses, with its payloads. Gravity must be zero if the commands do
        not contain it.
    joints : sequence of str
        The m commanded joints, in the order of the commands.
    most : (m,) array
        Largest effort of a push [N m or N]; it may be infinite.
    period : float
        Time between joint states [s].
    judges_scale : bool
        Whether accelerations show the scale of the commands. They do not if the drives have gains.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        joints: Sequence[str],
        most: Floats,
        period: float,
        *,
        judges_scale: bool = True,
    ) -> None:
        self._dynamics, self._joints, self._most = dynamics, tuple(joints), most
        robot = dynamics.robot
        self._index = robot.joint_indices(joints)
        self._period, self._judges_scale = period, judges_scale
        self._history: list[_Sample] = []
        self._push, self._balance = np.zeros((2, len(joints)))
        self.is_held: Booleans = np.zeros(len(joints), dtype=bool)
        """Joints that need feedback of their position, shape (m,)."""
        self._drifts = False  # whether only feedback holds the arm
        self.results: dict[str, JointResult] = {}
        """Results by joint, in the order of the pushes."""
        self.start: Floats | None = None
        """Positions of all n joints at the beginning [rad or m]."""
        self.farthest: Floats = np.zeros(len(robot.joint_names))
        """Largest distance of each joint from its start position, shape (n,) [rad or m]."""
        self._stopped = ''
        self._sequence = self._run()
        self.is_over = False
        """Whether all joints have been pushed, or a fault was found."""

    @property
    def reason(self) -> str:
        """Why the node has stopped the arm; '' if it has not."""
        return self._stopped

    def step(self, now: float, q: Floats, commands: Floats, stopped: str = '') -> Request:
        """
        Evaluate a joint state, and return what the node has to do.

        `now` is the time of the state [s]. `q` has shape (n,). `commands` are the latest commanded
        efforts, shape (m,) [N m or N], and `stopped` says why the node has stopped the arm, if it
        has.
        """
        q = q.copy()
        if self.start is None:
            self.start = q
        q -= whole_turns(q - self.start, self._dynamics.robot.is_continuous)
        self.farthest = np.maximum(self.farthest, np.abs(q - self.start))
        self._stopped = self._stopped or stopped
        net = commands - self._dynamics.gravity_efforts(q)[self._index]
        self._history.append(_Sample(now, q, net))
        if not self.is_over:
            try:
                next(self._sequence)
            except StopIteration:
                self.is_over = True
        efforts = self._balance if self.is_over else self._balance + self._push
        return Request(self.start[self._index], efforts.copy(), self.is_held.copy())

    # The sequence: each `yield` waits for the next joint state.

    def _run(self) -> _Waiting[None]:
        end = self._history[-1].time + _DRIFT_TIME
        while self._history[-1].time < end and not self._stopped:
            yield
            if np.abs(self._mean(5) - self._history[0].q)[self._index].max() > _DRIFT:
                self._drifts = True
                self.is_held[:] = True
        inertia = self._dynamics.mass_matrix(self._history[-1].q).diagonal()[self._index]
        # Light joints first: a push of a heavy joint shakes those that nothing holds yet.
        for k in np.argsort(inertia, kind='stable'):
            result = yield from self._examine(int(k))
            self.results[result.joint] = result
            self._push[:] = 0.0
            if result.verdict in FAULTS:
                return
        yield from self._rest()

    def _examine(self, k: int) -> _Waiting[JointResult]:
        """Push a joint in both directions; return the result."""
        name = self._joints[k]
        pushes: list[Push] = []
        loads: list[float] = []
        for direction in (1.0, -1.0):
            rests = yield from self._rest()
            if self.is_held[k] and not self._drifts:
                self.is_held[k] = False  # feedback would disturb the motion
                rests = yield from self._rest()
            if self._stopped:
                pushes.append(self._attribute(k, 0.0, 0))
                break
            if not rests:
                pushes.append(Push(Verdict.RESTLESS))
                break
            if not self._has_room(k, direction):
                pushes.append(Push(Verdict.NO_ROOM))
                continue
            push, load = yield from self._push_joint(k, direction)
            pushes.append(push)
            loads.append(load)
            if push.verdict in FAULTS and push.is_certain:
                break
            self.is_held[k] = self._drifts or push.verdict is Verdict.RIGHT
        return self._judge(k, name, tuple(pushes), loads)

    def _push_joint(self, k: int, direction: float) -> _Waiting[tuple[Push, float]]:
        """Push a joint until it moves; return the push and the effort that held the joint."""
        begin = len(self._history)
        window = round(_WINDOW / self._period)
        base = self._history[-max(window, 1) :]
        q0 = np.mean([sample.q for sample in base], axis=0)
        net0 = np.mean([sample.net for sample in base], axis=0)
        M = self._dynamics.mass_matrix(q0)
        inertia = M[self._index[k], self._index[k]]
        slip = 2.0 * self._period + _DETECTION + 0.004
        fastest = _JERK / slip**3 * inertia
        effort, held_since = 0.0, math.inf
        while True:
            yield
            sample, last = self._history[-1], self._history[-2]
            moved, y = self._moved(M, sample.q - q0)
            if self._stopped:
                push = self._attribute(k, direction, begin)
                break
            if moved is not None:
                self._push[k] = 0.0
                yield from self._wait(_COASTING)
                push = self._evaluate(k, direction, moved, y, effort, begin, q0, net0, M)
                break
            if sample.time > held_since + _HOLD:
                push = Push(Verdict.NOT_MOVED, effort)
                break
            step = min(max(0.0, sample.time - last.time), 0.02)
            rate = min(_FIRST_JERK * inertia + _GROWTH * effort, fastest)
            effort = min(effort + rate * step, self._most[k])
            if effort == self._most[k]:
                held_since = min(held_since, sample.time)
            self._push[k] = direction * effort
        self._push[:] = 0.0
        return push, float(net0[k])

    def _wait(self, duration: float) -> _Waiting[None]:
        end = self._history[-1].time + duration
        while self._history[-1].time < end and not self._stopped:
            yield

    def _rest(self) -> _Waiting[bool]:
        """
        Wait until the arm rests; return whether it does.

        If nothing but feedback holds the arm, its efforts replace the feedback, so that the arm
        rests at its start position.
        """
        assert self.start is not None
        begin = self._history[-1].time
        balances = _BALANCES
        yield from self._wait(_SETTLING)
        while not self._stopped:
            count = max(5, round(_WINDOW / self._period))
            q = np.array([sample.q[self._index] for sample in self._history[-count:]])
            means = [part.mean(axis=0) for part in np.array_split(q, 5)]
            moved = np.ptp(means, axis=0).max()
            if not self.is_held.all():
                stray = np.abs(q[-1] - self.start[self._index])
                if np.any(stray[~self.is_held] > _STRAY):
                    self._drifts = True
                    self.is_held[:] = True
            if moved < _RESTING:
                stray = np.abs(q.mean(axis=0) - self.start[self._index]).max()
                if not (self._drifts and stray > 0.3 * REACH and balances):
                    return True
                nets = [sample.net for sample in self._history[-count:]]
                mean = np.mean(nets, axis=0)
                self._balance = np.clip(mean, -self._most, self._most)
                balances -= 1
                begin = self._history[-1].time
                yield from self._wait(_SETTLING)
                continue
            if self._history[-1].time > begin + _LONGEST:
                if self._drifts:
                    return False
                self._drifts = True
                self.is_held[:] = True
                begin = self._history[-1].time
            yield
        return False

    # Judgements

    def _mean(self, count: int) -> Floats:
        mean: Floats = np.mean([sample.q for sample in self._history[-count:]], axis=0)
        return mean

    def _has_room(self, k: int, direction: float) -> bool:
        """Return whether the joint is far enough from its position limit."""
        robot, i = self._dynamics.robot, self._index[k]
        end = self._history[-1].q[i] + direction * _ROOM
        return bool(robot.is_continuous[i] or robot.lower[i] <= end <= robot.upper[i])

    def _moved(self, M: Floats, way: Floats) -> tuple[int | None, Floats]:
        """Return the joint on which an effort has acted, if one has, and the displacements."""
        acted = M @ way
        i = int(np.argmax(np.abs(acted) / np.sqrt(M.diagonal())))
        # As far as the effort would have moved the joint, if it could move the others freely.
        free = acted[i] * np.linalg.inv(M)[i, i]
        has_moved = abs(free) > _MOVED or np.abs(way).max() > 0.5 * LARGEST_MOTION
        return (i if has_moved else None), acted

    def _evaluate(
        self,
        k: int,
        direction: float,
        moved: int,
        y: Floats,
        effort: float,
        begin: int,
        q0: Floats,
        net0: Floats,
        M: Floats,
    ) -> Push:
        """Judge a push that has moved a joint."""
        names = self._dynamics.robot.joint_names
        side = float(np.sign(y[moved]))
        samples = self._history[begin - 1 :]
        times = np.array([sample.time for sample in samples])
        net = np.array([sample.net[k] - net0[k] for sample in samples])
        way = np.array([M[moved] @ (sample.q - q0) for sample in samples])
        verdict = Verdict.RIGHT
        if moved != self._index[k]:
            verdict = Verdict.WRONG_JOINT
        elif side != direction:
            verdict = Verdict.WRONG_SIGN
        breakaway, scale = fit_scale(times, net, side * direction * way)
        if verdict is Verdict.RIGHT:
            return Push(verdict, abs(breakaway), scale, names[moved], side)
        return Push(verdict, effort, math.nan, names[moved], side, 0.1 < scale < 10.0)

    def _attribute(self, k: int, direction: float, begin: int) -> Push:
        """Find out which joint has moved when the node has stopped the arm."""
        assert self.start is not None
        sample = self._history[-1]
        count = max(2, round(_WINDOW / self._period))
        q0 = self._history[max(0, (begin or len(self._history) - count) - 1)].q
        moved, y = self._moved(self._dynamics.mass_matrix(q0), sample.q - q0)
        names, effort = self._dynamics.robot.joint_names, abs(self._push[k])
        if moved is None or not direction:
            return Push(Verdict.STOPPED, effort)
        if moved != self._index[k]:
            return Push(Verdict.WRONG_JOINT, effort, moved=names[moved])
        is_against = y[moved] * direction < 0.0
        return Push(Verdict.WRONG_SIGN if is_against else Verdict.STOPPED, effort)

    def _judge(
        self, k: int, name: str, pushes: tuple[Push, ...], loads: Sequence[float]
    ) -> JointResult:
        i = self._index[k]
        load = float(self._dynamics.gravity_efforts(self._history[-1].q)[i])
        verdicts = [push.verdict for push in pushes]
        error = math.nan
        if verdicts == [Verdict.RIGHT] * 2:
            error = float(np.mean(loads))
            # If only one of the pushes shows the acceleration, the other was disturbed.
            if len({math.isnan(push.scale) for push in pushes}) == 1:
                error += 0.5 * (pushes[0].effort - pushes[1].effort)
        result = JointResult(name, verdicts[-1], pushes, error, load)
        if _contradict(pushes):
            return result._replace(verdict=Verdict.RESTLESS)
        for verdict in (*FAULTS, Verdict.NOT_MOVED, Verdict.RESTLESS):
            if verdict in verdicts:
                return result._replace(verdict=verdict)
        if Verdict.RIGHT not in verdicts:
            return result
        friction = float(np.mean([push.effort for push in pushes]))
        tolerance = _LEAST_LOAD * self._most[k] + _UNEVEN * friction
        if abs(error) > _UNBALANCED * abs(load) + tolerance:
            return result._replace(verdict=Verdict.WRONG_LOAD)
        least, most = _SCALES
        is_known = self._judges_scale and not math.isnan(result.scale)
        if is_known and not least <= result.scale <= most:
            return result._replace(verdict=Verdict.WRONG_SCALE)
        return result._replace(verdict=Verdict.RIGHT)


def _contradict(pushes: Sequence[Push]) -> bool:
    """Return whether two pushes show that the arm drifts: it has not moved to and fro."""
    if len(pushes) < 2 or not all(push.moved for push in pushes):
        return False
    first, second = pushes
    is_fault = any(push.verdict in FAULTS and not push.is_certain for push in pushes)
    return is_fault and (first.moved != second.moved or first.side == second.side)


def fit_scale(times: Floats, net: Floats, way: Floats) -> tuple[float, float]:
    """
    Fit the effort at which a joint began to move, and the scale of its commands.

    Parameters
    ----------
    times : (N,) array
        Times of the samples [s].
    net : (N,) array
        Commanded effort in addition to the one that holds the joint [N m or N].
    way : (N,) array
        Displacement times inertia: the double integral of the effort that acts.

    Returns
    -------
    breakaway : float
        The effort at which the joint began to move [N m or N].
    scale : float
        Effort that has acted, divided by the commanded effort beyond the breakaway. NaN if there
        are too few samples, or if this effort is small compared with the friction.

    """
    largest = float(net[np.argmax(np.abs(net))])
    free, error, misfit = _regress(times, net, way, is_free=True)
    is_short = times[-1] - times[0] < _SHORT  # only friction makes a push long
    may_be_free = is_short and misfit < _FREE_MISFIT and 0.0 < error < _LARGEST_ERROR * free
    # The node ends a push when the joint has moved.
    end = int(np.flatnonzero(np.abs(net) > 0.5 * abs(largest))[-1]) + 1
    # The joint creeps a little before it breaks away, so only the last part is fitted.
    still = np.flatnonzero(np.abs(way[:end]) < _CREEP * np.abs(way[end - 1]))
    moving = end - 1 - (int(still[-1]) if len(still) else 0)
    count = end if may_be_free else min(end, 4 * max(moving, _LEAST_SAMPLES))
    part = slice(end - count, end)
    times, net, way = times[part], net[part], way[part]
    best, begin, scale = _MISFIT, -1, math.nan
    for first in range(count - _LEAST_SAMPLES):
        beyond = np.where(np.arange(count) >= first, net - net[first], 0.0)
        factor, error, misfit = _regress(times, beyond, way, is_free=False)
        if misfit < best:
            best, begin = misfit, first
            scale = factor if error < _LARGEST_ERROR * factor else math.nan
    has_begun_at_once = begin >= 0 and abs(net[begin]) < _NO_FRICTION * abs(largest)
    fits_better = _regress(times, net, way, is_free=True)[2] < best
    if may_be_free and (fits_better or has_begun_at_once):
        return 0.0, free
    breakaway = float(net[begin])
    has_friction = float(np.abs(net[begin:] - breakaway).max()) < _STICTION * abs(breakaway)
    # A slow motion may be a creep: friction then takes the effort, not the inertia.
    if not scale >= _SCALES[0] or has_friction:
        return largest, math.nan
    return breakaway, scale


def _regress(
    times: Floats, beyond: Floats, way: Floats, *, is_free: bool
) -> tuple[float, float, float]:
    """
    Fit the motion of a joint; return the scale, its standard error and the misfit.

    The motion is the double integral of the effort `beyond` the friction. If the joint `is_free`
    of dry friction, its initial motion and viscous friction are fitted too. The misfit is a
    fraction of the sum of squares.
    """
    steps = np.diff(times, prepend=times[0])
    acted = np.cumsum(np.cumsum(beyond * steps) * steps)
    if not acted.any():
        return math.nan, math.inf, math.inf
    columns = [acted, np.ones(len(way))]
    if is_free:
        columns += [times - times[0], -np.cumsum((way - way[0]) * steps)]
    matrix = np.stack(columns, axis=1)
    size = np.linalg.norm(matrix, axis=0) + 1e-300
    inverse = np.linalg.pinv(matrix / size)
    factors = inverse @ way
    if is_free and factors[3] < 0.0:  # friction does not drive the joint
        inverse = np.linalg.pinv(matrix[:, :3] / size[:3])
        factors = np.append(inverse @ way, 0.0)
    residual = way - matrix / size @ factors
    variance = float(residual @ residual) / max(1, len(way) - 4)
    error = math.sqrt(variance * float(inverse[0] @ inverse[0])) / size[0]
    if is_free and np.ptp(columns[3]) * factors[3] / size[3] > _DAMPED * np.ptp(way):
        return math.nan, math.inf, math.inf  # a creep: friction takes the effort
    change = way - way[0]
    misfit = float(residual @ residual) / max(float(change @ change), 1e-300)
    return float(factors[0] / size[0]), float(error), misfit


def largest_pushes(
    robot: RobotModel,
    joints: Sequence[str],
    limits: Floats,
    dynamics: InverseDynamics,
    q: Floats,
    share: float = 0.25,
) -> Floats:
    """
    Return the largest efforts of the pushes, shape (m,) [N m or N].

    They are `share` of the effort limits of the robot, and stay within the `limits` of the node,
    shape (m,), which the efforts that hold the arm at the positions `q` use too. A joint without
    limit is accelerated by at most 100 rad/s^2 (m/s^2).
    """
    index = robot.joint_indices(joints)
    own = robot.effort_limits[index]
    inertia = dynamics.mass_matrix(q).diagonal()[index]
    most = np.where(np.isfinite(own) & (own > 0.0), share * own, _UNLIMITED * inertia)
    room = limits - np.abs(dynamics.gravity_efforts(q)[index])
    return np.maximum(0.0, np.minimum(most, 0.9 * room))
