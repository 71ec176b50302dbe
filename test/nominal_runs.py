"""
Plays arms without a fault for a long time, which no motion limit may stop.

Usage: python test/nominal_runs.py [SECONDS] [ROBOT ...] prints every limit stop, and the speed
that the arm really had. The default is ten minutes of simulated time for each robot.

A run is a sequence of scenes with random poses, modes and conditions. An arm follows sines at up
to `FASTEST` of its speed limits, or is pushed by a hand. Where the condition lets the arm leave
the reference, the sines are slower. A limit stop is right in two cases: the arm was really beyond
its speed limit, or it was really far from its reference. An unknown payload can cause both.
"""

import sys

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.simulation.mujoco import MujocoRobot
import numpy as np
from robot_files import OUR_ROBOTS, real_robots
from runaways import impedance, PERIOD
from states import store_state

SCENE = 8.0  # [s]
FASTEST, SLOWER = 0.9, 0.5  # [speed limits]; of sines
NOISE, STEP = 0.05, 5e-4  # [rad/s], [rad]; of velocities and of encoders; a tenth in [m/s], [m]
DELAY, PAUSE = 0.01, 0.06  # [s]; of all states, and between some of them
PAYLOAD, FRICTION = 5.0, 0.2  # [kg], [effort limits]
CARRIED = 0.2  # [effort limits]; which a payload needs, or feedback overcomes, at most
BEYOND, FAR = 1.1, 0.45  # [speed limits], [rad, m]; beyond, an arm is rightly stopped
MODES = ('floating', 'guided', 'computed torque', 'joint impedance', 'soft stop')
CONDITIONS = ('none', 'noise', 'encoder', 'delay', 'pauses', 'bursts', 'payload', 'friction')
ARMS = ('ur10_robot', 'panda')  # in addition to our robots
ROBOTS = {
    path.stem: path
    for path in [*OUR_ROBOTS, *real_robots()]
    if path in OUR_ROBOTS or path.stem in ARMS
}


class NominalRun:
    """One robot, and the limit stops of its scenes."""

    def __init__(self, path, seed=1979):
        self.robot = load_urdf(path)
        self.random = np.random.default_rng(seed)
        self.stops, self.false_alarms = [], 0
        robot = self.robot
        lower, upper = (np.clip(limit, -1.5, 1.5) for limit in (robot.lower, robot.upper))
        self.middle, self.half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        self.unit = np.where(robot.is_prismatic_joint, 0.1, 1.0)
        limits = robot.velocity_limits
        self.speeds = np.where(np.isfinite(limits), limits, 2.0 * self.unit)
        self.limits = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1e3)
        self.tip = [name for name in robot.link_names if 'finger' not in name][-1]

    def play(self, seconds):
        """Play scenes until `seconds` have passed; return this run."""
        for _ in range(round(seconds / SCENE)):
            self._play_scene(self.random.choice(MODES), self.random.choice(CONDITIONS))
        return self

    def _play_scene(self, mode, condition):
        robot, random, n = self.robot, self.random, len(self.middle)
        loop = ControlLoop(robot, settings=Settings(start_ramp=0.0))
        follows = mode in ('computed torque', 'joint impedance')
        sine = self._sine(loop, FASTEST if condition in CONDITIONS[:4] else SLOWER)
        q = sine(0.0)[0] if follows else self.middle + 0.4 * self.half * random.uniform(-1, 1, n)
        hardware = MujocoRobot(robot, q, friction=False)
        if follows:
            hardware._data.qvel[hardware._order] = sine(0.0)[1]
        if condition == 'payload' and follows:
            hardware.set_payload(self.tip, self._payload(loop, sine))
        if condition == 'friction':
            friction = FRICTION * self.limits
            if follows:  # feedback must overcome it at a fifth of max_tracking_error
                pull = 100.0 * 0.1 * self.unit * loop.dynamics.mass_matrix(q).diagonal()
                friction = np.minimum(friction, 0.5 * pull)
            hardware._model.dof_frictionloss[hardware._order] = friction
        settings = {
            'guided': {'mode': Mode.GRAVITY_COMPENSATION},
            'computed torque': {'mode': Mode.COMPUTED_TORQUE},
            'joint impedance': impedance(loop, q),
            'soft stop': {'stop_damping': 50.0},
        }.get(mode, {})
        loop.apply(Settings(**{'start_ramp': 0.0, **settings}))
        loop.start()
        hand, stops_at = Hand(self, 0.5 if mode != 'soft stop' else 0.2), random.uniform(1.0, 3.0)
        states, waiting, next_pause, paused_until = [], [], 0.5, 0.0
        efforts = np.zeros(n)
        for k in range(round(SCENE / PERIOD)):
            t = k * PERIOD
            states.append(self._measure(hardware, condition))
            if condition in ('pauses', 'bursts') and t >= next_pause:
                paused_until, next_pause = t + PAUSE, t + random.uniform(0.2, 1.0)
            if mode == 'soft stop' and t >= stops_at and not loop.supervisor.is_stopping:
                loop.stop()
            waiting.append(states[max(0, k - round(DELAY / PERIOD) * (condition == 'delay'))])
            if t >= paused_until:
                for i, state in enumerate(waiting if condition == 'bursts' else waiting[-1:]):
                    now = t + 2e-5 * i
                    if follows:
                        at, qd, qdd = sine(now)
                        loop.reference = Reference(qdd, np.zeros(n), now, at, qd)
                    store_state(loop.collector, now, robot.joint_names, *state)
                    efforts = loop.step(now).efforts
                waiting = []
            if loop.supervisor.limit_stop:
                real = float(np.max(np.abs(hardware.velocities()) / self.speeds))
                self.stops.append((mode, condition, t, loop.supervisor.limit_stop, real))
                behind = np.abs(sine(t)[0] - hardware.positions()).max() if follows else 0.0
                self.false_alarms += real <= BEYOND and behind < FAR
                return
            pushes = not follows and (mode != 'soft stop' or t < stops_at)
            force = hand.push(loop, hardware) if pushes else 0.0
            hardware.command(np.clip(efforts, -self.limits, self.limits) + force)
            hardware.advance(PERIOD)

    def _sine(self, loop, fastest):
        """Return a motion within the limits of speeds and efforts, as a function of time."""
        amplitude = np.minimum(0.8 * self.half, 1.0)
        rate = fastest * self.speeds / amplitude
        phase = self.random.uniform(0.0, 2.0 * np.pi, len(rate))

        def motion(t):
            angle = rate * t + phase
            q, qd = self.middle + amplitude * np.sin(angle), amplitude * rate * np.cos(angle)
            return q, qd, -amplitude * rate**2 * np.sin(angle)

        for _ in range(30):
            states = motion(np.linspace(0.0, 20.0, 1000)[:, None])
            if (np.abs(loop.dynamics.efforts(*states)) < 0.7 * self.limits).all():
                break
            rate *= 0.9
        return motion

    def _payload(self, loop, sine):
        """Return a mass that no joint carries with more than `CARRIED` of its effort [kg]."""
        q = sine(np.linspace(0.0, 20.0, 200)[:, None])[0]
        empty = loop.dynamics.gravity_efforts(q)
        loop.dynamics.set_payload(self.tip, PAYLOAD)
        share = (np.abs(loop.dynamics.gravity_efforts(q) - empty) / self.limits).max()
        loop.dynamics.set_payload(self.tip, 0.0)
        return PAYLOAD * min(1.0, CARRIED / share) if share else PAYLOAD

    def _measure(self, hardware, condition):
        q, qd = hardware.positions(), hardware.velocities()
        if condition == 'encoder':
            q = np.round(q / (STEP * self.unit)) * STEP * self.unit
        if condition == 'noise':
            qd = qd + NOISE * self.unit * self.random.standard_normal(len(qd))
        return q, qd


class Hand:
    """Pushes an arm to and fro, at up to a fraction of the speed limits."""

    def __init__(self, run, fastest):
        self.run, self.fastest = run, 0.9 * fastest
        self.wanted = self.speed = np.zeros(len(run.speeds))
        self.count = 0

    def push(self, loop, hardware):
        """Return the efforts of the hand."""
        run, q = self.run, hardware.positions()
        if self.count % 160 == 0:
            self.wanted = self.fastest * run.speeds * run.random.uniform(-1, 1, len(q))
        self.count += 1
        away = (np.abs(q - run.middle) > 0.6 * run.half) & (self.wanted * (q - run.middle) > 0.0)
        self.wanted = np.where(away, -self.wanted, self.wanted)
        change = 3.0 * run.speeds * PERIOD
        self.speed = self.speed + np.clip(self.wanted - self.speed, -change, change)
        pull = loop.dynamics.mass_matrix(q) @ (20.0 * (self.speed - hardware.velocities()))
        return np.clip(pull, -0.5 * run.limits, 0.5 * run.limits)


def main(seconds='600', *names):
    false_alarms = 0
    for name in names or ROBOTS:
        run = NominalRun(ROBOTS[name]).play(float(seconds))
        print(f'{name}: {len(run.stops)} limit stops in {seconds} s', flush=True)
        for mode, condition, t, reason, real in run.stops:
            print(f'    {mode}, {condition}, {t:.2f} s: {reason} (real: {real:.2f} of the limit)')
        false_alarms += run.false_alarms
    print(f'limit stops of arms that were within their limits: {false_alarms}')
    return int(false_alarms > 0)


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
