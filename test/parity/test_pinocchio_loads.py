"""
Agreement with Pinocchio with loads, in effort terms and in joint wrenches.

The robot has a floating base in pinocchio, which moves as set in the core; the base wrench is the
wrench of the floating joint.
"""

from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import assert_close
from loads import apply, random_loads
import numpy as np
from pinocchio_joints import write_positions
import pytest
from robot_files import OUR_ROBOTS, real_robots

pinocchio = pytest.importorskip('pinocchio')
if not hasattr(pinocchio.Model(), 'armature'):
    pytest.skip(f'pinocchio {pinocchio.__version__}, expected 3 or later', allow_module_level=True)

REAL = [path for path in real_robots() if path.stem in ('panda', 'talos_reduced', 'tiago')]
BASE = slice(0, 6)  # velocities of the floating joint


class FloatingPeer:
    """The same robot on a floating joint, with mimic joints as independent joints, folded here."""

    def __init__(self, robot, urdf):
        self.robot = robot
        self.model = pinocchio.buildModelFromXML(urdf, pinocchio.JointModelFreeFlyer())
        self.joints = list(self.model.joints)[2:]
        self.bodies = [robot.body_names.index(name) for name in list(self.model.names)[2:]]
        n = len(robot.joint_names)
        # d(velocities in pinocchio) / d(velocities of the robot), and the indices of master joints
        self.fold = np.zeros((self.model.nv, n))
        self.masters = np.zeros(n, int)
        for joint, body in zip(self.joints, self.bodies, strict=True):
            self.fold[joint.idx_v, robot.joint_index[body]] = robot.multiplier[body]
            if robot.body_names[body] in robot.joint_names:
                self.masters[robot.joint_index[body]] = joint.idx_v
        self.velocity, self.acceleration = np.zeros((2, 6))
        self.wrenches = [pinocchio.Force.Zero() for _ in self.model.joints]

    def set_gravity(self, gravity):
        self.model.gravity.linear = np.array(gravity)

    def set_base_motion(self, angular_velocity, angular_acceleration, linear_acceleration):
        # At zero linear velocity the spatial acceleration is the acceleration of the origin.
        self.velocity = np.r_[np.zeros(3), angular_velocity]
        self.acceleration = np.r_[linear_acceleration, angular_acceleration]

    def set_armature(self, armature):
        self.model.armature[self.masters] = armature

    def set_payload(self, link, mass, com, inertia):
        joint, placement = self.place(link)
        load = pinocchio.Inertia(mass, com, inertia)
        self.model.inertias[joint] = self.model.inertias[joint] + placement.act(load)

    def set_external_wrench(self, link, force, moment):
        joint, placement = self.place(link)
        self.wrenches[joint] = self.wrenches[joint] + placement.act(pinocchio.Force(force, moment))

    def place(self, link):
        frame = self.model.frames[self.model.getFrameId(link, pinocchio.FrameType.BODY)]
        return frame.parentJoint, frame.placement

    def ready(self):
        """Allocate the results after everything has been set."""
        self.data = self.model.createData()
        return self

    def positions(self, q):
        positions = np.zeros(self.model.nq)
        positions[6] = 1.0
        return write_positions(positions, self.robot, self.joints, self.bodies, q)

    def efforts(self, q, qd, qdd):
        v, a = self.fold @ qd, self.fold @ qdd
        v[BASE], a[BASE] = self.velocity, self.acceleration
        arguments = self.positions(q), v, a, self.wrenches
        return self.fold.T @ pinocchio.rnea(self.model, self.data, *arguments)

    def joint_wrenches(self):
        """Return force and moment at every joint for the state of the last efforts."""
        wrenches = np.empty((2, len(self.robot.body_names), 3))
        for joint, body in enumerate([0, *self.bodies], start=1):
            wrenches[:, body] = self.data.f[joint].linear, self.data.f[joint].angular
        return wrenches


def random_case(path):
    robot = load_urdf(path)
    rng = np.random.default_rng(1979)
    # The efforts of pinocchio have no friction.
    calls = [call for call in random_loads(robot, rng) if call[0] != 'set_friction']
    return robot, calls, rng.uniform(-2.0, 2.0, (5, 3, len(robot.joint_names)))


each_robot = pytest.mark.parametrize('path', OUR_ROBOTS + REAL, ids=lambda path: path.stem)


def assert_equal_to_pinocchio(dynamics, peer, q, qd, qdd):
    assert_close(dynamics.efforts(q, qd, qdd), peer.efforts(q, qd, qdd))
    forces, moments = peer.joint_wrenches()
    wrenches = dynamics.joint_wrenches(q, qd, qdd)
    assert_close(wrenches.force, forces)
    assert_close(wrenches.moment, moments)
    upper = np.triu(pinocchio.crba(peer.model, peer.data, peer.positions(q)))
    matrix = upper + np.triu(upper, 1).T
    assert_close(dynamics.mass_matrix(q), peer.fold.T @ matrix @ peer.fold)


@each_robot
def test_all_loads(path):
    robot, calls, states = random_case(path)
    dynamics = apply(InverseDynamics(robot), calls)
    peer = apply(FloatingPeer(robot, path.read_text()), calls).ready()
    for state in states:
        assert_equal_to_pinocchio(dynamics, peer, *state)


def test_the_real_robots_are_installed():
    if not real_robots():
        pytest.skip('example-robot-data is not installed')
    assert {path.stem for path in REAL} == {'panda', 'talos_reduced', 'tiago'}
