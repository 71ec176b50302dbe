"""
Agreement with Pinocchio with loads, in effort terms and in joint wrenches.

The robot has a floating base in pinocchio, which moves as set in the core; the base wrench is the
wrench of the floating joint.
"""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from kinematics import assert_close
from loads import apply, everything, random_loads
import numpy as np
from numpy.testing import assert_allclose
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


@pytest.mark.parametrize(
    'setter',
    ['set_gravity', 'set_base_motion', 'set_armature', 'set_payload', 'set_external_wrench'],
)
@each_robot
def test_one_kind_of_load(path, setter):
    robot, calls, states = random_case(path)
    calls = [call for call in calls if call[0] == setter]
    bare = InverseDynamics(robot)
    dynamics = apply(InverseDynamics(robot), calls)
    peer = FloatingPeer(robot, path.read_text())
    peer.set_gravity(STANDARD_GRAVITY)
    apply(peer, calls).ready()
    for state in states:
        assert_equal_to_pinocchio(dynamics, peer, *state)
        without, loaded = everything(bare, *state), everything(dynamics, *state)
        what = 'efforts' if setter == 'set_armature' else 'forces'
        assert (without[what] != loaded[what]).any()


@each_robot
def test_terms(path):
    robot, calls, states = random_case(path)
    calls = [call for call in calls if call[0] != 'set_base_motion']
    dynamics = apply(InverseDynamics(robot), calls)
    peer = apply(FloatingPeer(robot, path.read_text()), calls).ready()
    model, data = peer.model, peer.data
    is_nothing = []
    for q, qd, qdd in states:
        Q, QD = peer.positions(q), peer.fold @ qd
        terms = dynamics.effort_terms(q, qd, qdd)
        weight = pinocchio.computeGeneralizedGravity(model, data, Q)
        both = pinocchio.nonLinearEffects(model, data, Q, QD)
        velocity = pinocchio.computeCoriolisMatrix(model, data, Q, QD) @ QD
        held = pinocchio.computeStaticTorque(model, data, Q, peer.wrenches)
        scale = np.abs(terms).max()
        is_nothing.append([not np.abs(term).max() > 1e-6 * scale for term in terms])
        for ours, theirs in (
            (terms.gravity, weight),
            (terms.gravity + terms.coriolis, both),
            (terms.coriolis, velocity),
            (dynamics.coriolis_efforts(q, qd), velocity),
            (terms.gravity + terms.external, held),
            (dynamics.gravity_efforts(q), held),
        ):
            assert_allclose(ours, peer.fold.T @ theirs, rtol=0, atol=1e-10 * scale)
    if path in REAL:
        inertial, velocity, gravity, friction, external = np.all(is_nothing, axis=0)
        assert friction  # no friction was set
        assert not any((inertial, velocity, gravity, external))


def test_the_real_robots_are_installed():
    if not real_robots():
        pytest.skip('example-robot-data is not installed')
    assert {path.stem for path in REAL} == {'panda', 'talos_reduced', 'tiago'}
