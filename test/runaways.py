"""
Puts a fault between the control loop and an arm in MuJoCo, and measures how far the arm runs away.

Usage: python test/runaways.py [ARM ...] prints a table of all faults in all modes.

Every fault is one that the model cannot show: a wrong sign, order or scale of the commands, wrong
velocities, a wrong zero, late states, an unknown load. A joint is driven while the motor's effort
has the direction of its motion.
"""

import sys

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.simulation.mujoco import MujocoRobot, SimulationError
import numpy as np
from robot_files import real_robots, ROOT
from states import store_state

PERIOD = 0.005  # [s]; of joint states and commands
BEGIN = 0.3  # [s]; the reference or the stop begins
DURATION = 2.5  # [s]
BEYOND, LONGEST = 1.1, 0.02  # [speed limits], [s]; no joint may be driven beyond this for longer
STIFFNESS, BANDWIDTH = 60.0, 10.0  # [N m/rad], [1/s]; of joint impedance
_REAL = {path.stem: path for path in real_robots()}
ARMS = {
    'seven_dof': (ROOT / 'test/robots/seven_dof.urdf', (0.3, 0.6, 0.2, 0.9, 0.1, 0.6, 0.1)),
    'ur10': (_REAL.get('ur10_robot'), (0.2, -0.9, 1.2, -0.6, 0.5, 0.1)),
    'panda': (_REAL.get('panda'), (0.2, 0.4, 0.1, -1.6, 0.2, 2.0, 0.3, 0.02)),
}
"""URDF and start pose; the description of a real robot may be missing."""
MODES = {
    'float': {},
    'computed_torque': {'mode': Mode.COMPUTED_TORQUE},
    'joint_impedance': {'mode': Mode.JOINT_IMPEDANCE},
    'guiding': {'mode': Mode.GRAVITY_COMPENSATION},
    'soft_stop': {'stop_damping': 50.0},
}


def faults(joints):
    """Return the names of the faults of an arm; '' is no fault."""
    of_joints = [
        f'{kind} {j}' for kind in ('-command', '-velocity', 'zero', '-axis') for j in joints
    ]
    others = ['order alphabetical', 'order reversed', 'scale 2', '-velocity all', 'degrees']
    return ['', *of_joints, *others, 'late 30', 'late 60', 'payload 5']


def impedance(loop, q):
    """Return settings of joint impedance with gains that suit the inertia in a pose."""
    # What a joint feels while the others give way.
    free = np.ix_(loop.index, loop.index)
    inertia = 1.0 / np.linalg.inv(loop.dynamics.mass_matrix(q)[free]).diagonal()
    stiffness = np.minimum(STIFFNESS, BANDWIDTH**2 * inertia)
    return {
        'mode': Mode.JOINT_IMPEDANCE,
        'start_ramp': 0.0,
        'stiffness': tuple(stiffness),
        'impedance_damping': tuple(2.0 * np.sqrt(stiffness * inertia)),
    }


class Runaway:
    """An arm with a fault; `run` fills the fields below."""

    def __init__(self, arm, mode, fault=''):
        path, start = ARMS[arm]
        self.robot = robot = load_urdf(path)
        fingers = [name for name in robot.joint_names if 'finger' in name]
        self.joints = [name for name in robot.joint_names if name not in fingers]
        self.hardware = MujocoRobot(robot, start, friction=False, joints=self.joints)
        self.index = robot.joint_indices(self.joints)
        self.mode, self.start = mode, np.array(start)
        settings = Settings(start_ramp=0.0, **MODES[mode])
        self.loop = ControlLoop(robot, self.joints, settings)
        self.loop.start()
        if mode == 'joint_impedance':
            self.loop.apply(Settings(**impedance(self.loop, self.start)))
        n, m = len(robot.joint_names), len(self.joints)
        self.factor, self.order, self.delay = np.ones(m), np.arange(m), 0
        self.of_velocity, self.axis, self.zero = np.ones(n), np.ones(n), np.zeros(n)
        self._plant(*fault.partition(' ')[::2])
        self.limits = robot.velocity_limits[self.index]
        self.reason = ''
        self.time_of_stop = np.inf  # [s]
        self.travel = 0.0  # largest way of a joint until the stop [rad]
        self.driven_beyond = 0.0  # longest time for which a joint was driven beyond `BEYOND` [s]
        self.top_speed = 0.0  # of a joint that is driven [speed limits]

    def _plant(self, kind, which):
        names = list(self.robot.joint_names)
        if kind == '-command':
            self.factor[self.joints.index(which)] = -1.0
        elif kind == 'order':
            is_sorted = which == 'alphabetical'
            self.order = np.argsort(self.joints) if is_sorted else self.order[::-1]
        elif kind == 'scale':
            self.factor[:] = float(which)
        elif kind == '-velocity':
            self.of_velocity[:] = [-1.0 if which in ('all', name) else 1.0 for name in names]
        elif kind == 'degrees':
            self.of_velocity[:] = np.degrees(1.0)
        elif kind == 'zero':
            self.zero[names.index(which)] = 0.6
        elif kind == '-axis':
            self.axis[names.index(which)] = -1.0
        elif kind == 'late':
            self.delay = round(1e-3 * float(which) / PERIOD)
        elif kind == 'payload':
            self.hardware.set_payload(self.robot.link_names[-1], float(which))
        else:
            assert not kind

    def run(self):
        """Play the arm; return it."""
        loop, hardware = self.loop, self.hardware
        applied, beyond, states = np.zeros(len(self.index)), np.zeros(len(self.index)), []
        for k in range(round(DURATION / PERIOD)):
            now, q, qd = k * PERIOD, hardware.positions(), hardware.velocities()
            speeds = np.abs(qd[self.index]) / self.limits
            is_driven = applied * qd[self.index] > 1e-9
            beyond = np.where(is_driven & (speeds > BEYOND), beyond + PERIOD, 0.0)
            self.driven_beyond = max(self.driven_beyond, beyond.max())
            self.top_speed = max(self.top_speed, np.max(speeds, where=is_driven, initial=0.0))
            states.append((self.axis * q + self.zero, self.axis * self.of_velocity * qd))
            loop.collector.delay = PERIOD * min(k, self.delay)  # as the stamps show it
            state = states[max(0, k - self.delay)]
            store_state(loop.collector, now, self.robot.joint_names, *state)
            if now >= BEGIN:
                self._act(now)
            efforts = loop.step(now).efforts
            if loop.supervisor.limit_stop and not self.reason:
                self.reason, self.time_of_stop = loop.supervisor.limit_stop, now
                self.travel = np.abs(q - self.start)[self.index].max()
            limits = self.robot.effort_limits[self.index]
            applied = np.clip((self.factor * efforts)[self.order], -limits, limits)
            applied *= self.axis[self.index]
            hardware.command(applied)
            try:
                hardware.advance(PERIOD)
            except SimulationError:
                self.driven_beyond = np.inf
                break
        return self

    def _act(self, now):
        """Begin the soft stop, or continue the reference: a sine that begins smoothly."""
        if self.mode == 'soft_stop' and not self.loop.supervisor.is_stopping:
            self.loop.stop()
        if self.mode not in ('computed_torque', 'joint_impedance') or self.reason:
            return
        rate, passed = np.pi, now - BEGIN
        amplitude = min(1.0, 2.0 * passed) * np.minimum(0.3 * self.limits / rate, 0.3)
        begin = (self.axis * self.start + self.zero)[self.index]
        self.loop.reference = Reference(
            amplitude * rate**2 * np.cos(rate * passed),
            np.zeros(len(self.index)),
            now,
            begin + amplitude * (1.0 - np.cos(rate * passed)),
            amplitude * rate * np.sin(rate * passed),
        )


def main(arms):
    print('| arm | mode | fault | stop after [s] | travel [rad] | driven beyond [ms] | reason |')
    print('|---|---|---|---:|---:|---:|---|')
    late = 0
    for arm in arms or [name for name, (path, _) in ARMS.items() if path]:
        for mode in MODES:
            for fault in faults(Runaway(arm, mode).joints):
                found = Runaway(arm, mode, fault).run()
                late += found.driven_beyond > LONGEST + 1e-9
                stop = f'{found.time_of_stop:.3f}' if found.reason else '-'
                print(
                    f'| {arm} | {mode} | {fault or "none"} | {stop} | {found.travel:.2f} | '
                    f'{1e3 * found.driven_beyond:.0f} | {found.reason or "-"} |',
                    flush=True,
                )
    print(
        f'\njoints that were driven beyond {BEYOND} times the speed limit for more than '
        f'{1e3 * LONGEST:.0f} ms: {late}'
    )


if __name__ == '__main__':
    main(sys.argv[1:])
