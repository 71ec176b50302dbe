"""
Drives the control core with random events, and checks every command against the promises.

Usage: python test/random_driver.py [--events 1000000] [--seed 0], or --sequence N for one of them.

The control loop is the real one; the clock, the arm and the order of events are made up. A
sequence is one robot from its start on: joint states that arrive whole, in parts, late, in bursts
of old ones after a suspension, contradicting or invalid; parameters, stops, dry runs, loads,
references, clocks that jump.

"""

import argparse
import contextlib
from dataclasses import dataclass, replace
from functools import partial
import math
import random
import sys
import time

from inverse_dynamics_node import InverseDynamicsError, load_urdf
from inverse_dynamics_node.control.following import plan
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
from inverse_dynamics_node.dynamics.trajectory import Trajectory
import numpy as np
from promises import BrokenPromiseError, Promises, require
from robot_files import ROOT
from states import store_state

ROBOT = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
NAMES, N = list(ROBOT.joint_names), len(ROBOT.joint_names)
TIP = ROBOT.link_names[-1]
WATCH = 0.01  # [s]; period of the steps without joint states
SETTINGS = {
    'state_timeout': [0.1, 0.1, 0.5, 1.0],
    'reference_timeout': [0.5, 0.1],
    'on_stale_state': [StalePolicy.ZERO, StalePolicy.ZERO, StalePolicy.HOLD],
    'start_ramp': [0.5, 0.5, 1.0],
    'stop_ramp': [0.5, 0.5, 1.0],
    'stop_damping': [0.0, 20.0, 200.0],
    'kp': [50.0, 100.0],
    'stiffness': [10.0, 50.0],
    'impedance_damping': [0.0, 2.0],
    'friction_scale': [0.8, 0.3],
    'guiding_damping': [0.0, 2.0],
    'velocity_filter_cutoff': [0.0, 20.0],
    'effort_scale': [1.0, 0.8, -1.0],
    'effort_limits': [math.inf, 30.0],
    'effort_rate_limits': [math.inf, math.inf, 50.0],
    'wrench_timeout': [0.05, 0.1, 1.0],
    'guiding_speed': [0.5, 1.0, 1.0],
    'velocity_limits': [-1.0, -1.0, 0.0],
}


class Node:
    """What the node does around the control loop; the time of its clock is an argument."""

    def __init__(self, rate, imu, pick):
        self.pick = pick
        self.rate, self.is_dry_run, self.include_gravity = rate, False, True
        self.include_friction = False
        mode = pick.choice(list(Mode))
        self.settings = Settings(mode=mode, stop_damping=pick.choice([0.0, 50.0, 50.0]))
        self.imu, period = imu, 1.0 / rate if rate else 0.0
        self.loop = ControlLoop(ROBOT, settings=self.settings, period=period, has_imu=imu)
        self.loop.start()
        self.has_restarted = False
        self.has_wrong_sign = pick.random() < 0.1  # of the velocities

    def apply(self):
        self.loop.loads.include(gravity=self.include_gravity)
        damping, coulomb, load = self.include_friction * np.array([1.2, 0.6, 0.05])
        self.loop.dynamics.set_friction(damping, coulomb, load_friction=load)
        self.loop.apply(self.settings)

    def set_wrench(self, now, force):
        self.loop.loads.set_external_wrench(now, TIP, force, np.zeros(3))

    def set_gravity(self, now, angle):
        gravity = 9.8 * np.array([math.sin(angle), 0.0, -math.cos(angle)])
        self.loop.loads.set_gravity(gravity, now)

    def step(self, now):
        """Return the computed command, and the efforts that are sent."""
        has_switched = self.loop.switch_dry_run(is_wanted=self.is_dry_run)
        self.has_restarted |= has_switched and not self.is_dry_run
        command = self.loop.step(now)
        return (None, None) if command is None else (command, command.sent)


@dataclass
class Arm:
    """The true motion: a sine for each joint."""

    center: np.ndarray
    amplitude: np.ndarray
    rate: np.ndarray

    def at(self, t):
        angle = self.rate * t
        q = self.center + self.amplitude * np.sin(angle)
        return q, self.amplitude * self.rate * np.cos(angle)


class Sequence:
    """One robot from its start on."""

    def __init__(self, seed):
        pick = self.pick = random.Random(seed)
        self.steady, self.shift = 100.0, 0.0  # [s]; the clock of the node may be shifted
        self.state_period = pick.choice([0.01, 0.01, 0.005, 0.002, 0.001])
        self.has_velocities, self.jitter = pick.random() < 0.8, pick.choice([0.0, 0.5, 2.0])
        speeds = pick.choice([0.0, 0.3, 0.8, 1.2]) * ROBOT.velocity_limits
        self.arm = Arm(
            np.array([pick.uniform(-1.0, 1.0) for _ in NAMES]),
            np.array([pick.uniform(0.2, 1.5) for _ in NAMES]),
            np.ones(N),
        )
        self.arm.rate = speeds / self.arm.amplitude
        self.node = Node(pick.choice([0, 0, 200, 100]), pick.random() < 0.2, pick)
        self.promises = Promises(self.node)
        self.offset = np.zeros(N)  # of the reported positions
        self.lag = pick.choice([0.0, 0.0, 0.03, 0.06])  # [s]; of all states as a whole
        self.next_state = self.next_tick = self.last_imu = self.steady
        self.events = 0
        self.wrench, self.acceleration, self.distance = None, None, None

    @property
    def now(self):
        return self.steady + self.shift

    def play(self, actions):
        if self.node.imu:
            self.send_imu()
        self.pick.choice([self.change_reference, self.end_reference])()
        for _ in range(actions):
            action = self.pick.choice(ACTIONS)
            self.events += 1
            action(self)
            self.run(self.pick.choice([0.0, 0.0, 0.02, 0.05, 0.1, 0.3, 0.7]))
        return self

    def settle(self):
        """Check that all ramps and blends end at the computed efforts, and a stop at zero."""
        node, loop = self.node, self.node.loop
        self.arm.rate, self.acceleration, self.wrench = np.zeros(N), None, None
        self.state_period, self.jitter, node.is_dry_run = 0.01, 0.0, False
        for name, value in (('start_ramp', 0.5), ('stop_ramp', 0.5), ('stop_damping', 0.0)):
            self.set(name, value)
        self.set('effort_rate_limits', math.inf)
        self.run(1.2)  # a fall ends, and states have been back for a while
        loop.resume()
        self.run(1.4)
        self.step()  # with the last loads
        self.promises.check_settled()
        self.stop()
        self.run(0.7)
        require(not loop.shaper.command.any(), 'efforts after a stop', loop.shaper.command)
        return self

    def step(self):
        command, sent = self.node.step(self.now)
        self.promises.check(self.now, command, sent)

    def run(self, duration, *, has_states=True):
        """Let time pass: joint states, ticks of the loop, and its steps while states are lost."""
        end = self.steady + duration
        node = self.node
        while True:
            watch = self.steady + WATCH
            due = min(self.next_state, self.next_tick if node.rate else watch, watch)
            if due > end:
                break
            self.steady = max(self.steady, due)
            if due == self.next_state:
                late = self.jitter * self.state_period * self.pick.random()
                self.next_state += self.state_period
                if has_states:
                    self.keep_streams()
                    self.steady += late
                    self.send_state(self.steady - late)
            elif node.rate and due == self.next_tick:
                self.next_tick = max(self.next_tick + 1.0 / node.rate, self.steady)
                self.step()
            else:
                self.watch()
        self.steady = max(end, self.steady)

    def watch(self):
        state = self.node.loop.collector.state()
        timeout = self.node.settings.state_timeout
        if state is None or not 0.0 <= self.now - state.time <= timeout:
            self.step()

    def keep_streams(self):
        if self.node.imu and self.steady > self.last_imu + 0.01:
            self.send_imu()
        if self.wrench is not None:
            self.load('wrench', lambda now: self.node.set_wrench(now, self.wrench))
        if self.acceleration is not None:
            self.node.loop.reference = self.reference()

    def reference(self):
        """Return accelerations, in part with positions near those of the arm."""
        accelerations = Reference(self.acceleration, np.zeros(N), self.now)
        if self.distance is None:
            return accelerations
        q, qd = self.arm.at(self.steady)
        return accelerations._replace(positions=q + self.distance, velocities=qd)

    def send_imu(self):
        self.last_imu = self.steady
        force = np.array([math.sin(self.steady), 0.0, 9.8])
        loop = self.node.loop
        self.load('imu', lambda now: loop.loads.set_base_motion(now, force, np.zeros(3)))

    def load(self, kind, act):
        self.promises.load(self.now, partial(act, self.now), kind)

    def send_state(self, measured, joints=None, offset=0.0):
        """Send the joint state that was measured at a steady time."""
        self.events += 1
        q, qd = self.arm.at(measured - self.lag)
        q = q + self.offset + offset
        joints = range(N) if joints is None else joints
        names = [NAMES[k] for k in joints]
        sign = -1.0 if self.node.has_wrong_sign else 1.0
        velocities = [sign * qd[k] for k in joints] if self.has_velocities else []
        with contextlib.suppress(InverseDynamicsError):
            store_state(
                self.node.loop.collector, self.now, names, [q[k] for k in joints], velocities
            )
        if not self.node.rate:
            self.step()

    # Actions

    def change_mode(self):
        self.set('mode', self.pick.choice(list(Mode)))

    def change_setting(self):
        name = self.pick.choice(list(SETTINGS))
        self.set(name, self.pick.choice(SETTINGS[name]))

    def set(self, name, value):
        self.node.settings = replace(self.node.settings, **{name: value})
        self.node.apply()

    def toggle_gravity(self):
        self.node.include_gravity = not self.node.include_gravity
        self.node.apply()

    def toggle_friction(self):
        self.node.include_friction = not self.node.include_friction
        self.node.apply()

    def stop(self):
        self.promises.stop()
        self.node.loop.stop()
        self.node.loop.reference = self.acceleration = None

    def stop_and_sink(self):
        self.stop()
        self.run(self.pick.choice([0.1, 0.4, 1.5]))

    def stop_and_lose_states(self):
        self.stop()
        self.lose_states()

    def resume(self):
        self.node.loop.resume()

    def toggle_dry_run(self):
        self.node.is_dry_run = not self.node.is_dry_run

    def lose_states(self):
        self.run(self.pick.choice([0.03, 0.09, 0.3, 0.9, 2.0]), has_states=False)

    def suspend(self):
        """Run nothing; some messages wait in the socket and then arrive at once."""
        duration = self.pick.choice([0.05, 0.2, 0.5, 1.0, 5.0])
        began, self.steady = self.steady, self.steady + duration
        self.next_state = self.next_tick = self.steady
        kept = min(int(duration / self.state_period), self.pick.choice([0, 20, 200]))
        if self.pick.random() < 0.3:
            self.step()  # the timer comes first
        between = self.pick.choice([1e-4, 3e-4, 1e-3])
        for k in range(0, kept, self.pick.choice([1, 1, 7])):
            self.steady += between
            self.send_state(began + k * self.state_period)
            if self.node.rate and self.steady >= self.next_tick:
                self.next_tick = self.steady + 1.0 / self.node.rate
                self.step()
        self.next_state = max(self.next_state, self.steady)

    def jump_clock(self):
        self.shift += self.pick.choice([-50.0, -0.5, 0.3, 5.0, 1000.0])

    def send_part(self):
        self.send_state(self.steady, sorted(self.pick.sample(range(N), self.pick.randint(1, N))))

    def send_invalid(self):
        without_one = np.where(np.arange(N) == self.pick.randrange(N), math.nan, 0.0)
        offset = self.pick.choice([math.nan, without_one, math.inf, np.full(N, 1e300)])
        self.send_state(self.steady, offset=offset)

    def shift_positions(self):
        self.offset[self.pick.randrange(N)] += self.pick.choice([-1.0, -0.4, 0.5])

    def contradict(self):
        for _ in range(self.pick.choice([1, 3, 20])):
            self.send_state(self.steady, offset=np.eye(N)[1] * 0.7)
            self.run(self.state_period)

    def set_payload(self):
        mass = self.pick.choice([0.0, 2.0, 5.0])
        self.node.loop.loads.set_payload(TIP, mass, np.zeros(3), np.zeros((3, 3)))

    def toggle_wrench(self):
        self.wrench = None if self.wrench is not None else np.array([0.0, 20.0, 30.0])

    def change_gravity(self):
        if not self.node.imu:
            angle = self.pick.uniform(0.0, 3.0)
            self.node.set_gravity(self.now, angle)

    def turn_base(self):
        """Publish gravity at 100 Hz while the base turns."""
        if not self.node.imu:
            speed = self.pick.uniform(-2.0, 2.0)
            for k in range(self.pick.choice([3, 30])):
                self.load('gravity', lambda now, k=k: self.node.set_gravity(now, 0.01 * speed * k))
                self.run(0.01)

    def change_reference(self):
        self.acceleration = np.array([self.pick.uniform(-1.0, 1.0) for _ in NAMES])
        self.distance = self.pick.choice([None, self.pick.uniform(-0.7, 0.7)])

    def send_absurd_reference(self):
        self.acceleration, self.distance = np.full(N, 1e308), None

    def end_reference(self):
        self.acceleration = None

    def follow_trajectory(self):
        """Follow a trajectory of some joints, at once, later, or from its middle; or end it."""
        loop, pick = self.node.loop, self.pick
        self.acceleration = None
        if pick.random() < 0.2:
            loop.following.hold(loop.following.state, 'an empty one')
            return
        joints = pick.sample(range(N), pick.randint(1, N))
        times = np.cumsum([pick.choice([0.0, 0.05, 0.5]), *pick.choices([0.3, 0.6], k=2)])
        present = loop.present_motion()
        ways = [[pick.uniform(-0.1, 0.1) for _ in joints] for _ in times]
        path = Trajectory(tuple(NAMES[k] for k in joints), times, present[0, joints] + ways)
        time = pick.choice([-0.2, 0.0, 0.1])
        with contextlib.suppress(InverseDynamicsError):
            found = plan(path, loop.following.limits, present, max(time, 0.0))
            loop.follow_trajectory(found, time)


# Some are more likely than others.
ACTIONS = [
    *(Sequence.change_mode, *3 * [Sequence.change_setting]),
    *(Sequence.toggle_gravity, Sequence.toggle_friction),
    *(Sequence.stop, *2 * [Sequence.stop_and_sink], Sequence.stop_and_lose_states),
    *(*3 * [Sequence.resume], Sequence.toggle_dry_run),
    *(*2 * [Sequence.lose_states], *2 * [Sequence.suspend], Sequence.jump_clock),
    *(Sequence.send_part, Sequence.send_invalid, Sequence.shift_positions, Sequence.contradict),
    *(*2 * [Sequence.set_payload], Sequence.toggle_wrench),
    *(Sequence.change_gravity, Sequence.turn_base),
    *(*3 * [Sequence.change_reference], Sequence.send_absurd_reference, Sequence.end_reference),
    *3 * [Sequence.follow_trajectory],
]


def play(seed, actions=20):
    """Play one sequence; return the numbers of events, of commands, and of damped ones."""
    sequence = Sequence(seed)
    try:
        sequence.play(actions).settle()
    except BrokenPromiseError as error:
        where = f'sequence {seed}, {sequence.steady - 100.0:.4f} s'
        raise BrokenPromiseError(f'{where}: {error}') from None
    return sequence.events, sequence.promises.count, sequence.promises.damped


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--events', type=int, default=100_000)
    parser.add_argument('--seed', type=int, default=0, help='the first sequence')
    parser.add_argument('--sequence', type=int, help='play only this sequence')
    options = parser.parse_args()
    if options.sequence is not None:
        print('{} events, {} commands: every promise is kept'.format(*play(options.sequence)))
        return 0
    events = commands = broken = 0
    seed, shown = options.seed, time.monotonic()
    while events < options.events and broken < 10:
        try:
            more = play(seed)
            events, commands = events + more[0], commands + more[1]
        except BrokenPromiseError as error:
            broken += 1
            print(error, flush=True)
        seed += 1
        if time.monotonic() > shown + 10.0:
            shown = time.monotonic()
            print(f'{seed - options.seed} sequences, {events} events', flush=True)
    verdict = f'{broken} broken promises' if broken else 'every promise is kept'
    print(f'{seed - options.seed} sequences, {events} events, {commands} commands: {verdict}')
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
