"""Laws of loads on random trees: payloads, wrenches, friction, moving bases."""

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.dynamics.robot_table import joints_before
from kinematics import assert_close, derivative, link_inertia, rotation_of_rpy, Tree
from loads import apply, everything, random_loads, some_links, without_any
import numpy as np
from random_trees import random_link, robots_with_states, urdf_of

GRAVITY = np.array([0.6, -1.5, -9.0])
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def assert_same(actual, expected, tolerance=1e-10):
    for name in expected:
        assert_close(actual[name], expected[name], tolerance)


def differs(a, b):
    return np.abs(a - b).max() > 1e-6 * np.abs(b).max()


# Payloads


def with_payload(dynamics, k, link):
    """Set a payload on link k that equals another link welded to it."""
    R = rotation_of_rpy(link.rpy)
    com = np.array(link.xyz) + R @ link.com
    dynamics.set_payload(f'link{k}', link.mass, com, R @ link_inertia(link) @ R.T)


@given(robots_with_states(), seeds)
def test_payloads_equal_welded_links(case, rng):
    links, robot, (q, qd, qdd) = case
    calls = [call for call in random_loads(robot, rng) if call[0] != 'set_payload']
    loaded = apply(InverseDynamics(robot), calls)
    bare = everything(loaded, q, qd, qdd)
    welded = list(links)
    for name in some_links(robot, rng):  # including the base and merged links
        k = int(name.removeprefix('link'))
        welded.append(random_link(rng, k, 'fixed', -1))
        with_payload(loaded, k, random_link(rng, k, 'fixed', -1))  # is replaced
        with_payload(loaded, k, welded[-1])
    other = apply(InverseDynamics(load_urdf(urdf_of(welded))), calls)
    expected = everything(other, q, qd, qdd)
    assert differs(expected['forces'], bare['forces'])
    assert_same(everything(loaded, q, qd, qdd), expected)


# External wrenches


@given(robots_with_states(), seeds)
def test_external_wrenches_act_through_the_transposed_jacobian(case, rng):
    links, robot, (q, qd, qdd) = case
    placed = Tree(links, robot.joint_names).placed(q)
    dynamics = InverseDynamics(robot)
    bare = dynamics.efforts(q, qd, qdd)
    held = dynamics.gravity_efforts(q)
    bare_force, bare_moment = dynamics.joint_wrenches(q, qd, qdd)
    pushed = np.zeros(len(q))
    total_force, total_moment = np.zeros(3), np.zeros(3)
    for name in some_links(robot, rng):
        at = placed[int(name.removeprefix('link'))]
        dynamics.set_external_wrench(name, *rng.uniform(-99.0, 99.0, (2, 3)))  # is replaced
        force, moment = rng.uniform(-99.0, 99.0, (2, 3))
        dynamics.set_external_wrench(name, force, moment)
        force, moment = at.R @ force, at.R @ moment
        pushed += at.linear.T @ force + at.angular.T @ moment
        total_force += force
        total_moment += moment + np.cross(at.p, force)
    scale = max(np.abs(bare).max(), np.abs(held).max(), 99.0)
    expected = bare - pushed
    np.testing.assert_allclose(dynamics.efforts(q, qd, qdd), expected, rtol=0, atol=1e-10 * scale)
    held_and_pushed = dynamics.gravity_efforts(q)
    np.testing.assert_allclose(held_and_pushed, held - pushed, rtol=0, atol=1e-10 * scale)
    external = dynamics.effort_terms(q, qd, qdd).external
    np.testing.assert_allclose(external, -pushed, rtol=0, atol=1e-10 * scale)
    force, moment = dynamics.joint_wrenches(q, qd, qdd)
    assert_close(force[0], bare_force[0] - total_force)
    assert_close(moment[0], bare_moment[0] - total_moment)
    assert differs(force[0], bare_force[0])


# Wrenches at the joints


@given(robots_with_states())
@settings(max_examples=30)
def test_joint_wrenches_are_momentum_rate_and_weight_of_the_carried_links(case):
    links, robot, (q, qd, qdd) = case
    tree = Tree(links, robot.joint_names)
    placed = tree.placed(q)
    wrenches = InverseDynamics(robot, GRAVITY).joint_wrenches(q, qd, qdd)
    assert wrenches.force.shape == wrenches.moment.shape == (len(robot.body_names), 3)
    for name, force, moment in zip(robot.body_names, *wrenches, strict=True):
        i = int(name.removeprefix('link').removeprefix('joint'))
        of = tree.carried_by(i)
        growth, spin = derivative(lambda t, of=of: tree.momentum(q + t * qd, qd + t * qdd, of))
        for k in of:
            weight = links[k].mass * GRAVITY
            growth -= weight
            spin -= np.cross(placed[k].point(np.array(links[k].com))[0], weight)
        R, p = placed[i].R, placed[i].p
        assert_close(force, R.T @ growth)
        assert_close(moment, R.T @ (spin - np.cross(p, growth)), 1e-9)


@given(robots_with_states(), seeds)
def test_joint_wrenches_along_the_axes_are_the_efforts_without_friction_and_armature(case, rng):
    links, robot, (q, qd, qdd) = case
    calls = random_loads(robot, rng)
    dynamics = apply(InverseDynamics(robot), calls)
    wrenches = dynamics.joint_wrenches(q, qd, qdd)
    expected = np.zeros(len(q))
    for name, force, moment in zip(robot.body_names[1:], *(w[1:] for w in wrenches), strict=True):
        link = links[int(name.removeprefix('joint'))]
        axis = np.array(link.axis) / np.linalg.norm(link.axis)
        along = axis @ (force if link.kind == 'prismatic' else moment)
        if link.mimics >= 0:
            expected[robot.joint_names.index(f'joint{link.mimics}')] += link.multiplier * along
        else:
            expected[robot.joint_names.index(name)] += along
    inside = [call for call in calls if call[0] in ('set_friction', 'set_armature')]
    apply(dynamics, without_any(inside))
    assert_close(dynamics.efforts(q, qd, qdd), expected)
    after = dynamics.joint_wrenches(q, qd, qdd)
    assert (after.force == wrenches.force).all()
    assert (after.moment == wrenches.moment).all()


# Friction and armature


def set_drives(dynamics, rng):
    """Set coupled drives, springs and all kinds of friction; return their numbers."""
    n = len(dynamics.robot.joint_names)
    before = joints_before(dynamics.robot)
    drives = np.eye(n)
    for k in np.flatnonzero(before >= 0):
        drives[k, before[k]] = rng.choice([0.0, 1.0, -0.4])
    friction = rng.uniform(0.2, 2.0, (4, n))
    armature, stiffness, rest = rng.uniform(0.1, 2.0, (3, n))
    dynamics.set_friction(*friction)
    dynamics.set_armature(armature)
    dynamics.set_drive_coupling((drives - np.eye(n)).sum(axis=1))
    dynamics.set_springs(stiffness, rest)
    return drives, friction, armature, stiffness, rest


@given(robots_with_states(), seeds)
def test_springs_act_on_joints_and_drives_on_all_joints_that_turn_them(case, rng):
    _, robot, (q, qd, qdd) = case
    names = 'set_friction', 'set_armature'
    calls = [call for call in random_loads(robot, rng) if call[0] not in names]
    bare, dynamics = (apply(InverseDynamics(robot), calls) for _ in range(2))
    drives, friction, armature, stiffness, rest = set_drives(dynamics, rng)
    damping, coulomb, width, eta = friction
    spring, rate = stiffness * (q - rest), drives @ qd
    load = bare.efforts(q, qd, qdd) + spring
    dry = coulomb + eta * np.abs(load)
    expected = drives.T @ (damping * rate + dry * np.tanh(rate / width))
    rotors = drives.T @ np.diag(armature) @ drives
    total = load + rotors @ qdd + expected

    assert_close(dynamics.efforts(q, qd, qdd), total)
    assert_close(dynamics.mass_matrix(q), bare.mass_matrix(q) + rotors)
    many = [np.tile(x, (70, 1)) for x in (q, qd, qdd)]
    np.testing.assert_allclose(
        dynamics.efforts(*many), np.tile(total, (70, 1)), atol=1e-10 * np.abs(total).max()
    )
    terms, others = dynamics.effort_terms(q, qd, qdd), bare.effort_terms(q, qd, qdd)
    scale = np.abs(terms).max()
    for actual, wanted in (
        (terms.friction, expected),
        (terms.inertial, others.inertial + rotors @ qdd),
        (terms.gravity, others.gravity + spring),
        (terms.coriolis, others.coriolis),
        (terms.external, others.external),
        (dynamics.effort_terms(*many).friction[3], expected),
    ):
        np.testing.assert_allclose(actual, wanted, rtol=0, atol=1e-10 * scale)
    assert terms.friction @ qd >= 0.0  # friction never drives the robot


@given(robots_with_states(vectors=1), seeds)
def test_springs_belong_to_the_efforts_that_hold_the_robot(case, rng):
    _, robot, (q,) = case
    dynamics = InverseDynamics(robot)
    expected = dynamics.gravity_efforts(q)
    *_, stiffness, rest = set_drives(dynamics, rng)
    assert_close(dynamics.gravity_efforts(q), expected + stiffness * (q - rest))
    assert (dynamics.gravity_efforts(q) == dynamics.efforts(q, 0.0 * q, 0.0 * q)).all()
    out = q.copy()
    assert (dynamics.gravity_efforts(q) == dynamics.gravity_efforts(out, out)).all()


# Effort terms


@given(robots_with_states(), seeds)
def test_terms_add_up_and_each_has_its_own_cause(case, rng):
    _, robot, (q, qd, qdd) = case
    calls = random_loads(robot, rng)
    settings_of = dict(calls)
    dynamics = apply(InverseDynamics(robot), calls)
    terms = dynamics.effort_terms(q, qd, qdd)
    total = dynamics.efforts(q, qd, qdd)
    coriolis_efforts = dynamics.coriolis_efforts(q, qd)
    scale = np.abs(terms).max()

    def same(actual, expected):
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10 * scale)

    assert_close(sum(terms), total)
    assert_close(terms.inertial, dynamics.mass_matrix(q) @ qdd)
    same(terms.coriolis, coriolis_efforts)
    damping, coulomb, width, eta = settings_of['set_friction']
    load = total - terms.friction - settings_of['set_armature'][0] * qdd
    expected = damping * qd + (coulomb + eta * np.abs(load)) * np.tanh(qd / width)
    same(terms.friction, expected)

    for name in ('set_friction', 'set_external_wrench'):
        apply(dynamics, without_any(call for call in calls if call[0] == name))
    same(terms.external, total - terms.friction - dynamics.efforts(q, qd, qdd))
    assert_close(terms.gravity, dynamics.gravity_efforts(q))
    # The remainder depends on the velocity and is zero at rest.
    rest = dynamics.effort_terms(q, 0.0 * qd, qdd)
    assert not rest.coriolis.any()
    assert not rest.friction.any()
    assert (rest.gravity == terms.gravity).all()


@given(robots_with_states(), seeds)
@settings(max_examples=30)
def test_coriolis_efforts_depend_on_the_base_only_by_its_angular_velocity(case, rng):
    _, robot, (q, qd, _) = case
    dynamics = InverseDynamics(robot)
    expected = dynamics.coriolis_efforts(q, qd)
    omega, omega_dot, accel = rng.uniform(-2.0, 2.0, (3, 3))
    dynamics.set_base_motion(angular_acceleration=omega_dot, linear_acceleration=accel)
    assert (dynamics.coriolis_efforts(q, qd) == expected).all()
    dynamics.set_base_motion(angular_velocity=omega)
    turning = dynamics.coriolis_efforts(q, qd)
    dynamics.set_base_motion(omega, omega_dot, accel)
    scale = 1.0 + np.abs(turning).max()
    again = dynamics.coriolis_efforts(q, qd)
    np.testing.assert_allclose(again, turning, rtol=0, atol=1e-10 * scale)


# A base that moves


@given(robots_with_states(), seeds)
@settings(max_examples=30)
def test_a_moving_base_equals_a_robot_carried_by_another(case, rng):
    links, robot, (q, qd, qdd) = case
    # Three prismatic and three revolute joints carry the base, which becomes link 6.
    kinds = ['prismatic'] * 3 + ['revolute'] * 3
    carried = [random_link(rng, -1, 'fixed', -1)]
    carried += [random_link(rng, i, kind, -1) for i, kind in enumerate(kinds[:-1])]
    carried.append(links[0].moved(parent=5, kind=kinds[-1]))
    for link in links[1:]:
        mimics = link.mimics + 6 if link.mimics >= 0 else -1
        carried.append(link.moved(parent=link.parent + 6, mimics=mimics))
    whole = load_urdf(urdf_of(carried))
    Q, QD, QDD = (np.r_[rng.uniform(-3.0, 3.0, 6), vector] for vector in (q, qd, qdd))
    names = [f'joint{int(name.removeprefix("joint")) + 6}' for name in robot.joint_names]
    assert whole.joint_names == (*(f'joint{i}' for i in range(1, 7)), *names)
    calls = [
        call
        for call in random_loads(robot, rng)
        if call[0] in ('set_payload', 'set_external_wrench')
    ]
    far = [
        (name, (f'link{int(link.removeprefix("link")) + 6}', *numbers))
        for name, (link, *numbers) in calls
    ]
    expected = everything(apply(InverseDynamics(whole, GRAVITY), far), Q, QD, QDD)

    tree = Tree(carried, whole.joint_names)

    def velocity(t):
        base = tree.placed(Q + t * QD)[6]
        return np.array([base.angular, base.linear]) @ (QD + t * QDD)

    R = tree.placed(Q)[6].R
    omega, (omega_dot, accel) = velocity(0.0)[0], derivative(velocity)
    dynamics = apply(InverseDynamics(robot, R.T @ GRAVITY), calls)
    assert differs(everything(dynamics, q, qd, qdd)['forces'], expected['forces'][6:])
    dynamics.set_base_motion(R.T @ omega, R.T @ omega_dot, R.T @ accel)
    actual = everything(dynamics, q, qd, qdd)
    assert_close(actual['forces'], expected['forces'][6:])
    assert_close(actual['moments'], expected['moments'][6:])
    assert_close(actual['mass matrix'], expected['mass matrix'][6:, 6:])
    scale = np.abs(expected['efforts']).max()
    assert np.abs(expected['efforts'][6:]).max() > 0.0
    np.testing.assert_allclose(
        actual['efforts'], expected['efforts'][6:], rtol=0, atol=1e-10 * scale
    )


# Setting and clearing


@given(robots_with_states(), seeds)
@settings(max_examples=30)
def test_the_order_of_settings_does_not_matter(case, rng):
    _, robot, state = case
    calls = random_loads(robot, rng)
    shuffled = [calls[i] for i in rng.permutation(len(calls))]
    expected = everything(apply(InverseDynamics(robot), calls), *state)
    assert_same(everything(apply(InverseDynamics(robot), shuffled), *state), expected, 1e-12)


@given(robots_with_states(), seeds)
@settings(max_examples=30)
def test_cleared_loads_have_no_effect(case, rng):
    _, robot, state = case
    expected = everything(InverseDynamics(robot), *state)
    calls = random_loads(robot, rng)
    dynamics = apply(InverseDynamics(robot), calls)
    loaded = everything(dynamics, *state)
    apply(dynamics, without_any(calls))
    actual = everything(dynamics, *state)
    for name, values in expected.items():
        assert (loaded[name] != values).any()
        assert (actual[name] == values).all(), name
