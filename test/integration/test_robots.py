"""Each parameter file for a driver, with the node and a simulated robot that plays the driver."""

import itertools
import re
import signal
import subprocess
import time

from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.simulation.drivers import DRIVERS, Form
from inverse_dynamics_node.simulation.trajectory import start_pose
import numpy as np
import pytest
from robot_files import ROOT
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest.importorskip('mujoco')
pytest.importorskip('rich')

pytestmark = pytest.mark.real_time
ARM = ROOT / 'test' / 'robots' / 'planar_2r.urdf'
JOINTS = list(load_urdf(ARM).joint_names)
MODEL, PUSHED = InverseDynamics(load_urdf(ARM)), InverseDynamics(load_urdf(ARM))
COMMANDS = ['-m', 'inverse_dynamics_node.cli.main']
LINK, FORCE, MOMENT = 'forearm', (2.0, 0.0, 9.0), (0.0, -1.5, 0.0)
ZERO = np.zeros(2)
SWING = np.array([0.4, -0.3])  # [rad]
DURATION = 0.8  # [s]
FILES = {'ur_torques': 'ur'}
# What the user of this arm adds to the file.
ADDED = {
    'ur_torques': {'measured_gravity': 'excluded'},
    'openarm': {'mode': 'inverse_dynamics'},
    'dynamixel_current': {
        'effort_scale': 1000 / 1.793,
        'measured_effort_scale': 1.793 / 1000,
        'effort_limits': 33000.0,
    },
}
# One driver for each kind of convention; test_drivers.py and test_config.py are about all of them.
KINDS = [
    'franka_ros2',
    *(
        pytest.param(name, marks=pytest.mark.long)
        for name in ('ur_torques', 'openarm', 'ros2_kortex', 'dynamixel_current', 'isaac_sim')
    ),
]


def swing(elapsed):
    """Return positions from zero, velocities and accelerations at a time from the start [s]."""
    rate = np.pi / DURATION
    phase = rate * np.clip(elapsed, 0.0, DURATION)
    moves = 0.0 < elapsed < DURATION
    return (
        0.5 * SWING * (1.0 - np.cos(phase)),
        0.5 * SWING * rate * np.sin(phase),
        0.5 * SWING * rate**2 * np.cos(phase) * moves,
    )


class Robot:
    """The simulated robot behind a driver, and what it and the node publish."""

    def __init__(self, name, run_program, side, log):
        self.driver, self.side, self._log = DRIVERS[name], side, log
        # Fewer joint states than those of some drivers, on a machine with other work.
        command = ['simulate', ARM, '--driver', name, '--rate', min(self.driver.rate, 200.0)]
        with log.open('w') as output:
            files = {'stdout': output.fileno(), 'stderr': output.fileno()}
            self.process = run_program(*COMMANDS, *command, **files)
        self.states = side.listen(JointState, self.driver.joint_states)
        kind = Float64MultiArray if self.driver.form is Form.EFFORTS else JointState
        self.commands = []
        if self.driver.form is not Form.NONE:
            self.commands = side.listen(kind, self.driver.commands)
        self.external = side.listen(JointState, 'inverse_dynamics/external_efforts')
        self._began = np.inf

    def wait_for_states(self):
        self.side.wait_until(lambda: self.states, 'joint state')
        self.start = self.positions()

    def positions(self):
        return in_order(self.states[-1], 'position')

    def reference(self):
        q, qd, qdd = swing(time.monotonic() - self._began)
        point = JointTrajectoryPoint(
            positions=self.start + q, velocities=list(qd), accelerations=list(qdd)
        )
        return JointTrajectory(joint_names=JOINTS, points=[point])

    def move(self):
        """Let the reference move from now on; wait until the robot has followed it to its end."""
        self.states.clear()
        self._began = time.monotonic()
        goal = self.start + SWING

        def has_arrived():
            is_near = np.abs(self.positions() - goal).max() < 0.03
            return is_near and np.abs(in_order(self.states[-1], 'velocity')).max() < 0.02

        self.side.wait_until(lambda: self.states and has_arrived(), 'end of the trajectory')
        path = np.array([in_order(state, 'position') for state in self.states]) - self.start
        beside = path - np.outer(path @ SWING / (SWING @ SWING), SWING)
        assert np.abs(beside).max() < 0.05

    def wait_for_text(self, pattern):
        def is_there():
            assert self.process.poll() is None, self._log.read_text()
            return re.search(pattern, self._log.read_text())

        self.side.wait_until(is_there, f'{pattern!r} in the log of the robot')

    def wait_for_external_efforts(self, force, moment):
        """Wait until the node estimates the joint efforts of a push."""
        PUSHED.set_external_wrench(LINK, force, moment)
        self.external.clear()

        def are_there():
            if not self.external:
                return False
            q = self.positions()
            push = PUSHED.efforts(q, ZERO, ZERO) - MODEL.efforts(q, ZERO, ZERO)
            assert not np.any(force) or np.abs(push).min() > 1.0
            return np.abs(in_order(self.external[-1], 'effort') - push).max() < 0.25

        self.side.wait_until(are_there, 'external efforts')

    def push(self, force, moment):
        wrench = Wrench(force=Vector3(**xyz(force)), torque=Vector3(**xyz(moment)))
        message = WrenchStamped(header=Header(frame_id=LINK), wrench=wrench)
        self.side.publish_once('simulated_robot/push', message)
        self.wait_for_external_efforts(force, moment)


def in_order(message, field):
    values = dict(zip(message.name, getattr(message, field), strict=True))
    return np.array([values[joint] for joint in JOINTS])


def xyz(vector):
    return dict(zip('xyz', vector, strict=True))


def options_of(path):
    """Return the arguments in the command at the head of a parameter file."""
    text = re.search(r'#     ros2 run (?:.*\\\n)*.*\n', path.read_text()).group()
    remaps = re.findall(r"-r '?([^\s']+)", text)
    return list(itertools.chain.from_iterable(('-r', remap) for remap in remaps))


def verdict(run_program, side):
    """Return the exit code and the last line of `watch`."""
    for seconds in ('3', '5', '15', '30'):
        watch = ['watch', '/inverse_dynamics', '--for', seconds, '--rate', '1']
        process = run_program(*COMMANDS, *watch, stdout=subprocess.PIPE)
        side.wait_until(lambda ended=process.poll: ended() is not None, 'end of watch')
        code, last = process.wait(), process.communicate()[0].splitlines()[-1]
        if (
            code != 4 or 'modelled efforts are too small' in last
        ):  # decided, however busy the machine is
            break
    return code, last


@pytest.mark.parametrize('name', KINDS)
def test_node_with_the_file_of_a_driver(run_node, robot, run_program, tmp_path, name):
    arm = Robot(name, run_program, robot, tmp_path / 'robot.log')
    path = ROOT / 'config' / 'robots' / f'{FILES.get(name, name)}.yaml'
    node = run_node(
        *('--params-file', path, *options_of(path)),
        **{'mode': 'computed_torque', 'state_timeout': 1.0, **ADDED.get(name, {})},
        robot_description_file=ARM,
        joints=JOINTS,
        dry_run=True,
    )
    robot.wait_for_text(node, 'dry run: floating')
    arm.wait_for_states()
    code, last = verdict(run_program, robot)
    if arm.driver.measures_gravity:
        assert (code, 'model and robot agree' in last) == (6, True), last
    else:  # almost nothing is left at rest
        assert code == 4, last
    assert not arm.commands
    if arm.driver.form is not Form.NONE:
        robot.keep_publishing('inverse_dynamics/reference', arm.reference, JointTrajectory)
        robot.set_parameter('dry_run', False)
        arm.wait_for_text('the robot follows the commands')
        arm.move()
    arm.push(FORCE, MOMENT)
    arm.push((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    node.interrupt(signal.SIGINT)
    assert robot.wait_for_end(node) == 0
    if arm.driver.form is not Form.NONE:
        arm.wait_for_text('no commands arrive, so the position controller')
        last = arm.commands[-1]
        assert set(last.data if arm.driver.form is Form.EFFORTS else last.effort) == {0.0}


def test_efforts_beside_a_position_controller_end_the_sag(run_node, robot, run_program, tmp_path):
    """Without the node, the arm sags as far as the gains of its drives permit; it never falls."""
    arm = Robot('beside_a_position_controller', run_program, robot, tmp_path / 'robot.log')
    start = start_pose(MODEL.robot, MODEL)
    arm.wait_for_states()

    def sag():
        return np.abs(arm.positions() - start).max()

    def rests():
        return np.abs(in_order(arm.states[-1], 'velocity')).max() < 1e-4

    robot.wait_until(lambda: sag() > 0.02 and rests(), 'an arm that sags')
    before = sag()
    path = ROOT / 'config' / 'robots' / 'beside_a_position_controller.yaml'
    node = run_node(
        *('--params-file', path, *options_of(path)),
        robot_description_file=ARM,
        joints=JOINTS,
        state_timeout=1.0,
    )
    robot.wait_until(lambda: sag() < before / 20.0 and rests(), 'an arm that does not sag')
    node.interrupt(signal.SIGINT)
    assert robot.wait_for_end(node) == 0
    robot.wait_until(lambda: abs(sag() - before) < 0.01 * before and rests(), 'the same sag')
