"""Laws of physics on random trees."""

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import assert_close, rotation_about
import numpy as np
from numpy.testing import assert_allclose
from random_trees import robots_with_states as cases
from random_trees import urdf_of

DIFFERENCE = 1e-6  # error of central differences with a step of 1e-5


@given(cases())
def test_mass_matrix_gives_the_efforts_of_accelerations(case):
    _, robot, (q, qd, qdd) = case
    dynamics = InverseDynamics(robot)
    expected = dynamics.efforts(q, qd, qdd) - dynamics.efforts(q, qd, 0.0 * qdd)
    assert_close(dynamics.mass_matrix(q) @ qdd, expected, 1e-9)


@given(cases(vectors=1))
def test_mass_matrix_is_symmetric_and_positive_definite(case):
    _, robot, (q,) = case
    matrix = InverseDynamics(robot).mass_matrix(q)
    assert (matrix == matrix.T).all()
    assert np.linalg.eigvalsh(matrix).min() > 0.0


@given(cases(vectors=1))
def test_gravity_efforts_are_the_gradient_of_potential_energy(case):
    _, robot, (q,) = case
    dynamics = InverseDynamics(robot)

    step = 1e-5 * np.eye(len(q))
    gradient = [potential_energy(robot, q + d) - potential_energy(robot, q - d) for d in step]
    expected = np.array(gradient) / 2e-5
    scale = max(np.abs(expected).max(), robot.mass.sum())
    assert_allclose(dynamics.gravity_efforts(q), expected, rtol=0, atol=DIFFERENCE * scale)


@given(cases())
def test_power_is_the_rate_of_change_of_energy(case):
    _, robot, (q, qd, qdd) = case
    dynamics = InverseDynamics(robot)

    def energy(t):  # along a motion that passes the state at t = 0
        position = q + qd * t + 0.5 * qdd * t * t
        velocity = qd + qdd * t
        kinetic = 0.5 * velocity @ dynamics.mass_matrix(position) @ velocity
        return kinetic + potential_energy(robot, position)

    growth = (energy(1e-5) - energy(-1e-5)) / 2e-5
    power = qd @ dynamics.efforts(q, qd, qdd)
    scale = np.abs(qd * dynamics.efforts(q, qd, qdd)).sum()
    assert scale > 0.0
    assert_allclose(power, growth, rtol=0, atol=1e-5 * max(scale, abs(energy(0.0))))


@given(cases(), st.integers(0, 2**32 - 1))
def test_rotating_base_and_gravity_together_changes_nothing(case, seed):
    links, robot, (q, qd, qdd) = case
    rotation = random_rotation(np.random.default_rng(seed))
    gravity = np.array([0.3, -2.0, -9.0])
    # A new base link carries the old one, rotated.
    turned = [links[0].moved(mass=0.0, box=(0.0, 0.0, 0.0))]
    rpy = np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            np.arcsin(-rotation[2, 0]),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )
    for link in links:
        mimics = link.mimics + 1 if link.mimics >= 0 else -1
        turned.append(link.moved(parent=link.parent + 1, mimics=mimics))
    turned[1] = turned[1].moved(xyz=(0.0, 0.0, 0.0), rpy=tuple(rpy))
    other = InverseDynamics(load_urdf(urdf_of(turned)), rotation @ gravity)
    assert_close(other.efforts(q, qd, qdd), InverseDynamics(robot, gravity).efforts(q, qd, qdd))


@given(cases(mimics=False))
def test_flipping_an_axis_flips_its_sign(case):
    links, robot, (q, qd, qdd) = case
    name = robot.joint_names[0]
    k = int(name.removeprefix('joint'))
    axis = tuple(-x for x in links[k].axis)
    flipped = [*links[:k], links[k].moved(axis=axis), *links[k + 1 :]]
    sign = np.ones(len(q))
    sign[0] = -1.0
    other = InverseDynamics(load_urdf(urdf_of(flipped)))
    expected = sign * InverseDynamics(robot).efforts(q, qd, qdd)
    assert_close(other.efforts(sign * q, sign * qd, sign * qdd), expected)


@given(cases())
def test_order_of_links_in_the_file_changes_nothing(case):
    links, robot, (q, qd, qdd) = case
    backwards = ''.join(link.urdf(i) for i, link in reversed(list(enumerate(links))))
    other = load_urdf(f'<robot name="tree">{backwards}</robot>')
    order = [robot.joint_names.index(name) for name in other.joint_names]
    efforts = InverseDynamics(other).efforts(q[order], qd[order], qdd[order])
    assert_close(efforts, InverseDynamics(robot).efforts(q, qd, qdd)[order])


@given(cases(), st.floats(0.1, 0.9))
def test_splitting_a_link_by_a_fixed_joint_changes_nothing(case, fraction):
    links, robot, (q, qd, qdd) = case
    k = int(robot.joint_names[-1].removeprefix('joint'))
    # The part keeps the frame of the whole: two bodies in one place, with the mass of one.
    rest = links[k].moved(mass=links[k].mass * fraction)
    part = links[k].moved(
        parent=k,
        kind='fixed',
        mimics=-1,
        mass=links[k].mass * (1.0 - fraction),
        xyz=(0.0, 0.0, 0.0),
        rpy=(0.0, 0.0, 0.0),
    )
    split = load_urdf(urdf_of([*links[:k], rest, *links[k + 1 :], part]))
    expected = InverseDynamics(robot).efforts(q, qd, qdd)
    assert_close(InverseDynamics(split).efforts(q, qd, qdd), expected)


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


def potential_energy(robot, q):
    """Sum m g z over the bodies, by independent forward kinematics."""
    energy = 0.0
    poses = []
    for i, parent in enumerate(robot.parent):
        R, p = np.eye(3), np.zeros(3)
        if i:
            joint = robot.joint_index[i]
            position = robot.multiplier[i] * q[joint] + robot.offset[i]
            R_parent, p_parent = poses[parent]
            R, p = R_parent @ robot.R_PL[i], p_parent + R_parent @ robot.p_PL[i]
            if robot.is_prismatic[i]:
                p = p + R @ robot.axis[i] * position
            else:
                R = R @ rotation_about(robot.axis[i], position)
        poses.append((R, p))
        energy += 9.80665 * robot.mass[i] * (p + R @ robot.com[i])[2]
    return energy


def random_rotation(rng):
    return rotation_about((0, 0, 1), rng.uniform(-3, 3)) @ rotation_about(
        (0, 1, 0), rng.uniform(-1.5, 1.5)
    )
