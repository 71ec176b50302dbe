"""Laws of physics on random trees."""

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import assert_close
import numpy as np
from random_trees import robots_with_states as cases


@given(cases(vectors=1))
def test_mass_matrix_is_symmetric_and_positive_definite(case):
    _, robot, (q,) = case
    matrix = InverseDynamics(robot).mass_matrix(q)
    assert (matrix == matrix.T).all()
    assert np.linalg.eigvalsh(matrix).min() > 0.0


@given(cases())
def test_order_of_links_in_the_file_changes_nothing(case):
    links, robot, (q, qd, qdd) = case
    backwards = ''.join(link.urdf(i) for i, link in reversed(list(enumerate(links))))
    other = load_urdf(f'<robot name="tree">{backwards}</robot>')
    order = [robot.joint_names.index(name) for name in other.joint_names]
    efforts = InverseDynamics(other).efforts(q[order], qd[order], qdd[order])
    assert_close(efforts, InverseDynamics(robot).efforts(q, qd, qdd)[order])


@given(cases(vectors=12 * 20), st.integers(0, 2**32 - 1))
def test_batches_agree_with_single_states(case, seed):
    _, robot, vectors = case
    q, qd, qdd = vectors.reshape(3, 4, 20, -1)
    dynamics = InverseDynamics(robot)
    let_everything_act(dynamics, np.random.default_rng(seed))
    batch = dynamics.efforts(q, qd, qdd)
    assert batch.shape == q.shape
    single = np.empty_like(batch)
    for index in np.ndindex(4, 20):
        single[index] = dynamics.efforts(q[index], qd[index], qdd[index])
    assert_close(batch, single, 1e-12)


def let_everything_act(dynamics, rng):
    """Put a load, a wrench, friction and rotors on a robot whose base moves."""
    n, links = len(dynamics.robot.joint_names), dynamics.robot.link_names
    dynamics.set_base_motion(*rng.uniform(-1.0, 1.0, (3, 3)))
    inertia = np.diag(rng.uniform(0.1, 0.2, 3))
    dynamics.set_payload(rng.choice(links), 1.5, rng.uniform(-0.3, 0.3, 3), inertia)
    dynamics.set_external_wrench(rng.choice(links), *rng.uniform(-9.0, 9.0, (2, 3)))
    dynamics.set_friction(*rng.uniform(0.1, 2.0, (3, n)), rng.uniform(0.0, 0.5, n))
    dynamics.set_armature(rng.uniform(0.0, 0.3, n))
