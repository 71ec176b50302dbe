"""
A model of what doc/behaviour.md promises about commands, apart from how they are computed.

It asks the node for the inputs that a command was computed from, and for efforts of given inputs,
but decides by itself which changes of the inputs are motion, and how far ramps may advance.

"""

from dataclasses import dataclass
import math

from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.settings import Mode, StalePolicy
from inverse_dynamics_node.control.supervisor import COMPUTING_PHASES, Phase
import numpy as np

ROUNDING = 1e-6  # [N m]
LARGEST_CHANGE = 1e3  # [N m]; beyond the limits, so that larger ones make no difference
LIMIT_RAMP, LONGEST_DAMPING = 0.01, 20.0  # [s]; of a limit stop, of a damped stop
NOMINAL_STEP = 0.02  # [s]; ramps advance by at most as long in one command, or by a period
SHORTEST_RAMP = 0.5  # [s]; of all that the driver sets
RAMPS = 3.0  # ramps over the largest effort that may coincide: a start, a blend over twice of it
PAUSE, SETTLING = 0.1, 0.2  # [s]; after a pause, old messages may arrive for as long
FACTOR, LATENESS, LONGEST_STEP = 2.0, 0.03, 0.1  # of motion: of the speed limit, [s], [s]
WRONG_WAY = 0.1  # [rad, m]; after which a wrong sign of the velocities has been found
WINDOW = 0.02  # [s]; many small steps may be no motion either
NEAR, RETURN = 0.85, 0.45  # [speed limits], [s]; efforts fade near a limit, and return later
TIMEOUTS = {
    'wrench': lambda node: node.settings.wrench_timeout,
    'imu': lambda node: 0.2,
    'gravity': lambda node: 0.05,
}


class BrokenPromiseError(AssertionError):
    """A command is not what was promised."""


@dataclass
class Computed:
    """A command that was computed, and its inputs."""

    time: float
    efforts: np.ndarray
    q: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    measured: np.ndarray
    """Measured velocities, after the filter."""
    wanted: np.ndarray
    """Velocities of the reference that is followed, otherwise zero."""
    equilibrium: np.ndarray | None
    """Where joint impedance holds the joints."""
    times: np.ndarray
    ramps: float
    """Time by which ramps may have advanced since the start [s]."""
    applied: np.ndarray
    """Loads that acted at once since the start [N m]."""
    moved: np.ndarray
    """Changes of the efforts by motion since the start, added up [N m]."""


class Promises:
    """Checks the commands of a node."""

    def __init__(self, node):
        self.node = node
        self.count, self.now, self.time = 0, 0.0, None
        self.base = max(NOMINAL_STEP, 1.0 / node.rate if node.rate else 0.0)
        self.ramps, self.settling = 0.0, 0.0  # [s]
        n = len(node.loop.robot.joint_names)
        self.speeds = np.clip(node.loop.robot.velocity_limits, 1.0, 30.0)
        self.largest = 0.5 * node.loop.robot.effort_limits
        self.applied, self.renewed = np.zeros(n), {}
        self.limits = self.ceiling = self.stop_limits = np.zeros(n)
        self.last, self.last_sent = np.zeros(n), None
        self.history = []
        self.fall_time, self.fallen = None, 0.0  # [s]; None while efforts do not fall
        self.top, self.left, self.ramp_passed = np.zeros(n), np.zeros(n), 0.0  # of the stop ramp
        self.stopped_with, self.stopped_at = None, None  # settings and first positions of a stop
        self.damped = 0  # commands with damping
        self.gate_time, self.gate_fallen = None, 0.0
        self.was_limited = False
        self.restrained = np.full(n, -math.inf)  # when a joint was last near its speed limit

    def load(self, now, act, kind):
        """Apply a load; if it is renewed in time, it may act at once."""
        before, last = self._efforts_of_last(), self.renewed.get(kind)
        act()
        self.renewed[kind] = now
        if last is not None and 0.0 <= now - last <= TIMEOUTS[kind](self.node):
            self.applied = self.applied + np.abs(self._efforts_of_last() - before)

    def stop(self):
        """Note a stop: its damping has the settings and limits of this moment."""
        if self.node.loop.phase in COMPUTING_PHASES:
            self.stopped_with = self.node.settings
            self.stop_limits = self.node.loop.limits

    def _efforts(self, q, inputs):
        """Return the efforts at some positions, with the other inputs of a command."""
        efforts = self.node.loop.dynamics.efforts(q, inputs.velocities, inputs.accelerations)
        return efforts + self._added(q, inputs)

    def _added(self, q, inputs):
        settings, dynamics, rest = self.node.settings, self.node.loop.dynamics, 0.0 * q
        if settings.mode is Mode.GRAVITY_COMPENSATION:
            friction = dynamics.effort_terms(q, inputs.measured, rest).friction
            return settings.friction_scale * friction - settings.guiding_damping * inputs.measured
        if settings.mode is not Mode.JOINT_IMPEDANCE:
            return rest
        damper = settings.impedance_damping * (inputs.wanted - inputs.measured)
        way = rest if inputs.equilibrium is None else inputs.equilibrium - q
        return damper + settings.stiffness * way

    def _efforts_of_last(self):
        if not self.history:
            return np.zeros(len(self.last))
        last = self.history[-1]
        return self._efforts(last.q, last)

    def check(self, now, command, sent):
        """Check the command of one step, and the efforts that were sent."""
        if self.node.has_restarted:
            self.node.has_restarted = False
            self._forget()
        if command is None:
            self._forget()
            self.time = now
            return
        self.count += 1
        efforts, loop = command.efforts.copy(), self.node.loop
        passed = 0.0 if self.time is None else now - self.time
        self.time = now
        step = self._advance(passed)
        require(np.isfinite(efforts).all(), 'not finite', efforts)
        if (loop.limits != self.limits).any():
            # The bound falls to a tightened limit; below it, efforts follow the motion.
            self.limits, self.ceiling = loop.limits, np.abs(self.last)
            if self.fall_time is not None:
                self.ceiling = np.maximum(self.ceiling, np.abs(self.left))
        bound = np.maximum(self.limits, self.ceiling)
        if self.stopped_with is not None and loop.phase is Phase.STOPPED:
            bound = np.maximum(bound, self.stop_limits)  # of damping, until the next stop
            self.ceiling = np.maximum(np.abs(efforts), np.abs(self.left))
        require((np.abs(efforts) <= bound + ROUNDING).all(), 'beyond the limits', efforts, bound)
        settings = self.node.settings
        if loop.phase in COMPUTING_PHASES:
            self._check_computed(now, efforts, step)
        elif (
            loop.phase in (Phase.STOPPED, Phase.LIMIT_STOP)
            or settings.on_stale_state is StalePolicy.ZERO
        ):
            self._check_fall(now, efforts, passed, step)
        else:
            # Damping is not held.
            last = self.last if self.fall_time is None else self.left
            self.fall_time = None
            self._check_shrinking(efforts, last)
        if sent is not None or self.last_sent is not None:
            self._check_sent(efforts, sent, passed, step)
        self.was_limited = loop.phase is Phase.LIMIT_STOP
        self.last = efforts
        self.last_sent = None if sent is None else sent.copy()

    def _forget(self):
        self.time, self.fall_time, self.settling = None, None, 0.0
        self.last = np.zeros(len(self.last))
        self.history.clear()

    def _advance(self, passed):
        """Return the time by which ramps may advance [s]."""
        late = max(0.0, passed)
        step = min(late, self.base)
        self.ramps += step
        if not 0.0 <= passed <= max(PAUSE, 4.0 * self.base):
            self.settling = SETTLING + late
        self.settling = max(0.0, self.settling - late)
        if passed < 0.0:
            self.history.clear()
        return step

    def _check_fall(self, now, efforts, passed, step):
        is_limited = self.node.loop.phase is Phase.LIMIT_STOP
        if is_limited and not self.was_limited and self.fall_time is not None:
            is_damped = (np.abs(self.last - self.left) > 0.0).any()
            if is_damped or self.fall_time - self.ramp_passed > LIMIT_RAMP:
                self.fall_time = None  # a limit stop replaces a slower fall
        if self.fall_time is None:
            ramp = self.node.settings.stop_ramp
            self.fall_time, self.fallen = min(ramp, LIMIT_RAMP) if is_limited else ramp, 0.0
            self.top, self.ramp_passed = self.last, 0.0
            self.stopped_at = self.node.loop.collector.q.copy()
            self.fastest = np.zeros(len(efforts))  # [rad/s, m/s] since then
            change = np.abs(efforts - self.last)
            require((change <= ROUNDING).all(), 'a fall begins with a step', change)
        else:
            self.fallen += min(max(0.0, passed), self.base)
            advanced = self.node.loop.shaper.clock.step
            self.ramp_passed += advanced
            require(advanced <= step + 1e-9, 'a fall catches up', advanced, step)
        left = 1.0 - self.ramp_passed / self.fall_time if self.fall_time else 0.0
        self.left = max(0.0, left) * self.top
        is_late = self.fallen > self.fall_time + 2.0 * self.base
        require(not (is_late and self.left.any()), 'a fall takes too long', self.left)
        self._check_damping(now, efforts - self.left)

    def _check_damping(self, now, added):
        """Check what a stop adds to the efforts that fall: only damping, if anything."""
        loop, settings = self.node.loop, self.stopped_with
        is_fresh = (
            settings is not None and 0.0 <= now - loop.collector.time <= settings.state_timeout
        )
        if not is_fresh or loop.phase is not Phase.STOPPED:
            self.stopped_with = settings = None  # for the rest of this stop
        if self.settling:
            self.stopped_at = loop.collector.q.copy()  # old messages show no motion
        if not (np.abs(added) > ROUNDING).any():
            return
        require(settings is not None, 'damping without fresh states', added)
        self.damped += 1
        scale, qd = settings.effort_scale, loop.collector.qd
        self.fastest = np.maximum(self.fastest, np.abs(qd))
        require(qd @ added / scale <= ROUNDING, 'damping drives the arm', added)
        # Parallel to the momenta of the commanded joints, and no faster than it was requested.
        full = -scale * settings.stop_damping * loop.dynamics.mass_matrix(loop.collector.q) @ qd
        share = added @ full / (full @ full)
        off = np.abs(added - share * full)
        require((off <= ROUNDING).all(), 'damping of some joints only', off)
        most = min(1.0, (self.ramp_passed + 1e-9) / settings.stop_ramp)
        late = self.ramp_passed - LONGEST_DAMPING - settings.stop_ramp
        require(share <= most + ROUNDING, 'damping rises too fast', share, most)
        require(late <= 2.0 * self.base, 'damping takes too long', late)
        way = np.abs(loop.collector.q - self.stopped_at)
        # States may have been late, and one more may be needed.
        most = WRONG_WAY + (PAUSE + LATENESS) * self.fastest
        is_watched = self.node.has_wrong_sign and not loop.dry_run.is_active
        is_wrong = is_watched and (way > most).any()
        require(not is_wrong, 'damping with the wrong sign', way, most)

    @staticmethod
    def _check_shrinking(efforts, last):
        require((np.abs(efforts) <= np.abs(last)).all(), 'an effort grows in a fall', efforts)
        require((efforts * last >= 0.0).all(), 'an effort changes its sign in a fall', efforts)

    def _check_computed(self, now, efforts, step):
        was_falling, self.fall_time = self.fall_time is not None, None
        loop = self.node.loop
        law, collector = loop.law, loop.collector
        velocities, accelerations = law.velocities.copy(), law._qdd.copy()
        is_followed = loop.phase is Phase.RUNNING
        followed = loop.reference if is_followed else Reference(None, None, now)
        new = Computed(
            now,
            efforts,
            collector.q.copy(),
            velocities,
            accelerations,
            law._last_qd.copy(),
            0.0 * velocities if followed.velocities is None else followed.velocities,
            law.equilibrium,
            collector.times.copy(),
            self.ramps,
            self.applied,
            np.zeros(len(efforts)),
        )
        rate = self.node.settings.effort_rate_limits
        change, most = np.abs(efforts - self.last), math.inf if math.isinf(rate) else rate * step
        require((change <= most + ROUNDING).all(), 'beyond the rate limit', change)
        for old in self.history:
            if followed.positions is None or old.equilibrium is None:
                old.equilibrium = new.equilibrium  # holding another position is no motion
        tau = self._efforts(new.q, new)
        size = np.minimum(np.abs(tau), loop.robot.effort_limits)
        self.largest = np.maximum(self.largest, size)
        if was_falling:
            # The first command after a brief fall continues from it; compare the next ones.
            self.history.clear()
        if self.history:
            change = np.minimum(np.abs(tau - self._efforts_of_last()), LARGEST_CHANGE)
            new.moved = self.history[-1].moved + change
        are_motion = [self._check_motion(old, new, tau) for old in self._compared(now)]
        if not all(are_motion):
            self.history.clear()  # the motion in the same window would be hard to tell apart
        self.history.append(new)

    def _compared(self, now):
        """Return the last command and one at the begin of a window; forget older ones."""
        while len(self.history) > 1 and self.history[1].time <= now - WINDOW:
            del self.history[0]
        return {id(each): each for each in self.history[:1] + self.history[-1:]}.values()

    def _check_motion(self, old, new, tau):
        """Return whether the joints can have moved like this since an earlier command."""
        settings = self.node.settings
        way = np.abs(new.q - old.q)
        elapsed = np.clip(new.times - old.times, 0.0, LONGEST_STEP)
        lateness = 0.0 if self.settling else LATENESS
        room = FACTOR * self.speeds * (elapsed + lateness) + 1e-9
        is_motion = bool((way <= room).all())
        if is_motion:
            motion = new.moved - old.moved  # a joint that moved to and fro changed other efforts
        else:
            # The others may have moved before a joint jumped, but not in a pause.
            fraction = float(np.min(room[way > room] / way[way > room]))
            before = self._efforts(old.q, old)
            motion = fraction * np.abs(self._efforts(new.q, old) - before)
            if not self.settling:
                q = np.where(way > room, old.q, new.q)
                motion = motion + np.abs(self._efforts(q, new) - before)
        motion = abs(settings.effort_scale) * (motion + new.applied - old.applied)
        speeds = self.node.loop.robot.velocity_limits
        limit = NEAR * min(1.0, self.node.settings.guiding_speed) * speeds
        is_near = (np.abs(new.measured) > limit) | (way > limit * np.maximum(elapsed, 1e-3))
        self.restrained[is_near] = new.time
        ramps = RAMPS * self.largest * (new.ramps - old.ramps) / SHORTEST_RAMP
        change = np.abs(new.efforts - old.efforts)
        bound = motion + ramps + ROUNDING
        if not math.isinf(settings.effort_rate_limits):
            bound = bound + settings.effort_rate_limits * (new.ramps - old.ramps)
        bound = np.where(new.time - self.restrained <= RETURN, math.inf, bound)
        require((change <= bound).all(), 'a step beyond motion', change, bound)
        return is_motion

    def check_settled(self):
        """Check the last command of an arm at rest, after all ramps and blends."""
        require(self.history, f'no efforts are computed: {self.node.loop.phase}')
        last, limits, scale = self.history[-1], self.limits, self.node.settings.effort_scale
        expected = np.clip(scale * self._efforts(last.q, last), -limits, limits)
        error = np.abs(last.efforts - expected)
        require((error <= ROUNDING).all(), 'efforts of an arm at rest', last.efforts, expected)

    def _check_sent(self, efforts, sent, passed, step):
        if sent is None:
            require(not self.last_sent.any(), 'silence while the robot holds', self.last_sent)
            self.gate_time = None
            return
        if not self.node.loop.dry_run.is_active:
            self.gate_time = None
            require((sent == efforts).all(), 'not sent as computed', sent)
            return
        if self.gate_time is None:
            is_damped = (np.abs(self.last_sent - self.left) > 0.0).any()
            falls = self.fall_time is not None and not is_damped
            self.gate_time = max(0.0, self.fall_time - self.fallen) if falls else math.inf
            self.gate_time = min(self.gate_time, self.node.settings.stop_ramp)
            self.gate_fallen = 0.0
            # The fall of a limit stop goes on as fast as it has begun.
            is_limited = self.node.loop.phase is Phase.LIMIT_STOP
            self.gate_ramp = LIMIT_RAMP if is_limited else SHORTEST_RAMP
        self.gate_fallen += min(max(0.0, passed), self.base)
        self._check_shrinking(sent, self.last_sent)
        change = np.abs(sent - self.last_sent)
        bound = 2.0 * self.largest * step / self.gate_ramp + ROUNDING
        require((change <= bound).all(), 'the fall of a dry run catches up', change, bound)
        is_late = self.gate_fallen > self.gate_time + 2.0 * self.base
        require(not (is_late and sent.any()), 'the fall of a dry run takes too long', sent)


def require(is_kept, what, *numbers):
    """Raise a BrokenPromiseError unless a promise is kept."""
    if not is_kept:
        with np.printoptions(precision=4, suppress=True):
            raise BrokenPromiseError(f'{what}: {", expected at most ".join(map(str, numbers))}')
