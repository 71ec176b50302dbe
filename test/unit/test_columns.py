"""The columns of regressions, compared with efforts of robots that carry loads."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.columns import gravity_columns, payload_columns
from inverse_dynamics_node.analysis.diagnosis.loads import point_mass_parameters
import numpy as np
import pytest
from runs import ROBOTS

GRAVITY = np.array([0.7, -1.3, -9.4])


@pytest.fixture(params=sorted(ROBOTS))
def robot(request):
    return load_urdf(ROBOTS[request.param])


def random_states(robot):
    return np.random.default_rng(0).uniform(-2.0, 2.0, (3, 9, len(robot.joint_names)))


def test_columns_of_a_payload_are_the_efforts_that_it_adds(robot):
    states = random_states(robot)
    com = np.array([0.03, -0.2, 0.11])
    largest = []
    for link in robot.link_names:
        dynamics = InverseDynamics(robot, GRAVITY)
        bare = dynamics.efforts(*states)
        dynamics.set_payload(link, 1.5, com)
        added = dynamics.efforts(*states) - bare
        columns = payload_columns(robot, GRAVITY, link, tuple(states))
        found = columns @ point_mass_parameters(1.5, com)
        assert found == pytest.approx(added, abs=1e-11)
        largest.append(np.abs(added).max())
    assert max(largest) > 0.1


def test_columns_of_gravity_add_up_to_its_efforts(robot):
    q = random_states(robot)[0]
    expected = InverseDynamics(robot, GRAVITY).gravity_efforts(q)
    assert gravity_columns(robot, q) @ GRAVITY == pytest.approx(expected, abs=1e-11)
    assert np.abs(expected).max() > 0.1
