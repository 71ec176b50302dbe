"""Agreement with Pinocchio on our robots, on real ones, and on long chains."""

import contextlib

from inverse_dynamics_node import InverseDynamics, load_urdf, UrdfError
import numpy as np
from numpy.testing import assert_allclose
from pinocchio_joints import write_positions
import pytest
from random_trees import random_chain, urdf_of
from robot_files import OUR_ROBOTS, real_robots

pinocchio = pytest.importorskip('pinocchio')

RELATIVE = 1e-10  # to the largest effort; the order of summation differs
REGRESSOR = 1e-12  # to the largest entry
GRAVITY = np.array([0.4, -1.2, -9.5])


class Peer:
    """The same robot in pinocchio, whose mimic joints are independent joints, folded here."""

    def __init__(self, robot, urdf):
        self.robot = robot
        self.model = pinocchio.buildModelFromXML(urdf)
        self.model.gravity.linear = GRAVITY
        self.data = self.model.createData()
        self.bodies = [robot.body_names.index(name) for name in list(self.model.names)[1:]]
        # d(velocities in pinocchio) / d(velocities of the robot)
        self.fold = np.zeros((self.model.nv, len(robot.joint_names)))
        for joint, body in zip(list(self.model.joints)[1:], self.bodies, strict=True):
            self.fold[joint.idx_v, robot.joint_index[body]] = robot.multiplier[body]

    def positions(self, q):
        positions = np.empty(self.model.nq)
        return write_positions(positions, self.robot, list(self.model.joints)[1:], self.bodies, q)

    def efforts(self, q, qd, qdd):
        arguments = self.positions(q), self.fold @ qd, self.fold @ qdd
        return self.fold.T @ pinocchio.rnea(self.model, self.data, *arguments)

    def mass_matrix(self, q):
        upper = np.triu(pinocchio.crba(self.model, self.data, self.positions(q)))
        matrix = upper + np.triu(upper, 1).T
        return self.fold.T @ matrix @ self.fold

    def regressor(self, q, qd, qdd):
        arguments = self.positions(q), self.fold @ qd, self.fold @ qdd
        found = pinocchio.computeJointTorqueRegressor(self.model, self.data, *arguments)
        found = found.reshape(self.model.nv, -1)  # a vector if there is one joint
        blocks = (self.fold.T @ found).reshape(len(q), len(self.bodies), 10)
        return blocks[:, np.argsort(self.bodies)].reshape(len(q), -1)

    def links(self, q):
        """Yield name, pose and Jacobian of every link."""
        pinocchio.computeJointJacobians(self.model, self.data, self.positions(q))
        pinocchio.updateFramePlacements(self.model, self.data)
        axes = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for name in self.robot.link_names:
            frame = self.model.getFrameId(name, pinocchio.FrameType.BODY)
            jacobian = pinocchio.getFrameJacobian(self.model, self.data, frame, axes)
            jacobian = jacobian.reshape(6, -1)  # a vector if there is one joint
            yield name, self.data.oMf[frame].homogeneous, jacobian @ self.fold


def assert_equal_to_pinocchio(robot, urdf, relative=RELATIVE, states=5):
    peer = Peer(robot, urdf)
    dynamics = InverseDynamics(robot, GRAVITY)
    rng = np.random.default_rng(1979)
    for _ in range(states):
        q, qd, qdd = rng.uniform(-2.0, 2.0, (3, len(robot.joint_names)))
        expected = peer.efforts(q, qd, qdd)
        assert np.abs(expected).max() > 0.0
        tolerance = relative * np.abs(expected).max()
        assert_allclose(dynamics.efforts(q, qd, qdd), expected, rtol=0, atol=tolerance)
        expected = peer.mass_matrix(q)
        assert np.abs(expected).max() > 0.0
        tolerance = relative * np.abs(expected).max()
        assert_allclose(dynamics.mass_matrix(q), expected, rtol=0, atol=tolerance)
        expected = peer.regressor(q, qd, qdd)
        assert np.abs(expected).max() > 0.0
        tolerance = min(relative, REGRESSOR) * np.abs(expected).max()
        assert_allclose(dynamics.regressor(q, qd, qdd), expected, rtol=0, atol=tolerance)
    for link, pose, jacobian in peer.links(q):
        tolerance = relative * np.abs(pose).max()
        assert_allclose(dynamics.pose(q, link), pose, rtol=0, atol=tolerance)
        assert_allclose(dynamics.jacobian(q, link), jacobian, rtol=0, atol=tolerance)


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_our_robots(path):
    assert_equal_to_pinocchio(load_urdf(path), path.read_text())


@pytest.mark.parametrize('path', real_robots(), ids=lambda path: path.stem)
def test_real_robots(path):
    try:
        robot = load_urdf(path)
    except UrdfError as error:
        pytest.skip(f'not for us: {error.problems[0]}')
    if not robot.joint_names:
        pytest.skip('nothing moves')
    if not robot.mass[1:].any():
        pytest.skip('nothing that moves has a mass')
    assert_equal_to_pinocchio(robot, path.read_text(), states=2)


def test_most_real_robots_are_supported():
    """The skips above must stay exceptions."""
    paths = real_robots()
    if not paths:
        pytest.skip('example-robot-data is not installed')
    loaded = set()
    for path in paths:
        with contextlib.suppress(UrdfError):
            load_urdf(path)
            loaded.add(path.stem)
    assert {'panda', 'ur5_robot', 'talos_full_v2', 'kinova', 'xarm7', 'tiago'} <= loaded
    assert sum(path.stem in loaded for path in paths) >= 0.9 * len(paths)


@pytest.mark.parametrize(
    ('count', 'relative'),
    [
        *((count, 1e-10) for count in (1, 7, 30, 100)),
        pytest.param(400, 1e-9, marks=pytest.mark.long),  # needs 4 GB
    ],
)
def test_long_chains(count, relative):
    urdf = urdf_of(random_chain(np.random.default_rng(count), count))
    assert_equal_to_pinocchio(load_urdf(urdf), urdf, relative, states=2)
