"""Messages about impossible loads, which change nothing; and copies with the same loads."""

import copy
import pickle

from inverse_dynamics_node import (
    ConfigurationError,
    InverseDynamics,
    JointStateError,
    load_urdf,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import ROOT

ROBOT = load_urdf(ROOT / 'test' / 'robots' / 'planar_2r.urdf')
FRICTIONAL = load_urdf(ROOT / 'test' / 'robots' / 'mimic_gripper.urdf')
MERGED = load_urdf(ROOT / 'test' / 'robots' / 'fixed_chain.urdf')
LINK_BEFORE, LINK = ROBOT.link_names[-2:]
STATE = np.array([[0.3, -0.8], [1.1, 0.4], [-0.5, 2.0]])
BOX = np.diag([0.02, 0.03, 0.04])


def loaded():
    """Set all loads, so that a rejected call could damage them."""
    dynamics = InverseDynamics(ROBOT, (1.0, -2.0, -9.0))
    dynamics.set_base_motion((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9))
    dynamics.set_payload(LINK, 1.5, (0.1, 0.0, 0.2), BOX)
    dynamics.set_external_wrench(LINK, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    dynamics.set_friction((0.4, 0.5), (0.6, 0.7), (0.1, 0.2), (0.3, 0.2))
    dynamics.set_armature((0.8, 0.9))
    dynamics.set_drive_coupling((0.0, -0.7))
    dynamics.set_springs((5.0, -3.0), (0.2, 0.4))
    return dynamics


def inertia(**changes):
    moments = BOX.copy()
    for name, value in changes.items():
        moments['xyz'.index(name[0]), 'xyz'.index(name[1])] = value
    return moments


INFINITE = float('inf')
NAN = float('nan')


@pytest.mark.parametrize(
    ('setter', 'arguments', 'words'),
    [
        ('set_gravity', ((0, 0),), r'gravity is \(0, 0\), expected three finite .* \[m/s\^2\]'),
        ('set_gravity', ((0, 0, NAN),), r'gravity is \(0, 0, nan\)'),
        ('set_base_motion', ((1, 2),), r'angular_velocity is \(1, 2\), .* \[rad/s\]'),
        ('set_base_motion', ((9, 9, 9), (1, INFINITE, 3)), r'angular_acceleration is \(1, inf, 3'),
        (
            'set_base_motion',
            ((9, 9, 9), (9, 9, 9), 'up'),
            r"linear_acceleration is 'up', .*m/s\^2",
        ),
        ('set_base_motion', (None,), 'angular_velocity is None'),
        ('set_payload', ('hand', 1.0), rf"link 'hand' does not exist; links are .*{LINK}"),
        (
            'set_payload',
            (LINK, -1.0),
            r'mass is -1.0, expected a finite number of at least 0 \[kg',
        ),
        ('set_payload', (LINK, NAN), 'mass is nan'),
        ('set_payload', (LINK, INFINITE), 'mass is inf'),
        ('set_payload', (LINK, 'heavy'), "mass is 'heavy' and .* expected numbers"),
        ('set_payload', (LINK, None), 'mass is None'),
        ('set_payload', (LINK, 1.0, (0, 0)), r'com is \(0, 0\), expected three finite .* \[m\]'),
        ('set_payload', (LINK, 1.0, (0, 0, NAN)), 'com is'),
        ('set_payload', (LINK, 1.0, (0, 0, 0), (1, 1, 1)), r'inertia is \(1, 1, 1\), .* 3 by 3'),
        ('set_payload', (LINK, 1.0, (0, 0, 0), [[1], [1, 2]]), r'inertia is .* expected numbers'),
        ('set_payload', (LINK, 1.0, (0, 0, 0), inertia(xy=NAN)), 'finite 3 by 3 matrix'),
        ('set_payload', (LINK, 1.0, (0, 0, 0), inertia(xy=0.01)), 'expected a symmetric matrix'),
        ('set_payload', (LINK, 1.0, (0, 0, 0), inertia(zz=-0.01)), 'no negative principal moment'),
        (
            'set_payload',  # the diagonal is positive, the principal moments are not
            (LINK, 1.0, (0, 0, 0), inertia(xy=0.03, yx=0.03)),
            'no negative principal moment',
        ),
        ('set_external_wrench', ('hand',), r"link 'hand' does not exist; links are"),
        ('set_external_wrench', (LINK, (1, 2)), r'force is \(1, 2\), expected .* \[N\]'),
        ('set_external_wrench', (LINK, (1, 2, 3), (1, NAN, 3)), r'moment is .* \[N m\]'),
        ('set_friction', ((1, 2, 3),), r'damping is \(1, 2, 3\), .* one for each of 2 joints'),
        ('set_friction', ('much',), "damping is 'much', expected one number"),
        (
            'set_friction',
            ((1, -2),),
            r'damping is \(1, -2\), expected finite numbers of at least 0',
        ),
        ('set_friction', (9, NAN), 'coulomb is nan, expected finite'),
        ('set_friction', (9, (9, 9, 9)), r'coulomb is \(9, 9, 9\)'),
        ('set_friction', (9, 9, -0.1), 'width is -0.1'),
        ('set_friction', (9, 9, 0.0), 'width is 0.0, expected values above 0'),
        ('set_friction', (9, 9, (0.1, 0.0)), r'width is \(0.1, 0.0\), expected values above 0'),
        ('set_friction', (9, 9, 5e-324), 'width is 5e-324, expected values above 0'),
        ('set_friction', (9, 9, 9, -0.1), 'load_friction is -0.1, expected finite'),
        ('set_friction', (9, 9, 9, (1, NAN)), r'load_friction is \(1, nan\)'),
        ('set_drive_coupling', ((1, 2, 3),), r'coupling is \(1, 2, 3\)'),
        ('set_drive_coupling', ((0.0, NAN),), r'coupling is \(0.0, nan\), expected finite'),
        ('set_drive_coupling', (0.5,), r"coupling of joint '\w+' is 0.5, expected 0 because"),
        ('set_springs', (INFINITE,), 'stiffness is inf, expected finite numbers'),
        ('set_springs', (9, (1, 2, 3)), r'rest is \(1, 2, 3\)'),
        ('set_armature', ((1, 2, 3),), r'armature is \(1, 2, 3\)'),
        ('set_armature', (-1.0,), 'armature is -1.0'),
        ('set_armature', (INFINITE,), 'armature is inf'),
        ('set_armature', (None,), 'armature is None'),
    ],
)
def test_an_invalid_setting_is_rejected_with_a_reason_and_the_last_one_kept(
    setter, arguments, words
):
    dynamics = loaded()
    with pytest.raises(ConfigurationError, match=words):
        getattr(dynamics, setter)(*arguments)
    expected = loaded()
    assert (dynamics.efforts(*STATE) == expected.efforts(*STATE)).all()
    # Later calls write everything again from the stored arguments.
    for either in (dynamics, expected):
        either.set_payload(ROBOT.link_names[0], 1.0)
        either.set_external_wrench(LINK_BEFORE, (1.0, 0.0, 0.0))
        either.set_payload(LINK_BEFORE, 1.0)
        either.set_gravity((3.0, 0.0, 0.0))
    assert (dynamics.efforts(*STATE) == expected.efforts(*STATE)).all()


def test_a_rejected_payload_does_not_remove_the_earlier_one():
    links = np.array(MERGED.link_names)
    body = np.argmax(np.bincount(MERGED.link_body))
    first, second = links[MERGED.link_body == body][:2].tolist()
    still = np.zeros(len(MERGED.joint_names))
    dynamics = InverseDynamics(MERGED, (0.0, 0.0, -10.0))
    bare = dynamics.joint_wrenches(still, still, still).force[0]
    dynamics.set_payload(first, 2.0)
    with pytest.raises(ConfigurationError):
        dynamics.set_payload(first, -2.0)
    dynamics.set_payload(second, 3.0)  # sums up the mass of the body again
    added = dynamics.joint_wrenches(still, still, still).force[0] - bare
    assert_allclose(added, [0.0, 0.0, 50.0], atol=1e-9)


def test_an_inertia_may_have_rounding_where_it_has_zeros():
    c, s = np.cos(np.pi / 2), np.sin(np.pi / 2)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    moments = turn @ np.diag([0.02, 0.03, 0.04]) @ turn.T
    moments[0, 1] += 1e-19
    dynamics = InverseDynamics(ROBOT)
    dynamics.set_payload(LINK, 1.0, (0.0, 0.0, 0.0), moments)
    exact = InverseDynamics(ROBOT)
    exact.set_payload(LINK, 1.0, (0.0, 0.0, 0.0), np.diag([0.02, 0.04, 0.03]))
    assert_allclose(dynamics.mass_matrix(STATE[0]), exact.mass_matrix(STATE[0]), rtol=1e-14)


def test_friction_is_that_of_the_description_where_none_is_given():
    assert FRICTIONAL.damping.any()
    assert FRICTIONAL.friction.any()
    n = len(FRICTIONAL.joint_names)
    q, qd, qdd = np.random.default_rng(2).uniform(-1.0, 1.0, (3, n))
    dynamics = InverseDynamics(FRICTIONAL)
    assert not dynamics.effort_terms(q, qd, qdd).friction.any()  # off by default
    dynamics.set_friction()
    expected = FRICTIONAL.damping * qd + FRICTIONAL.friction * np.tanh(qd / 0.01)
    assert_allclose(dynamics.effort_terms(q, qd, qdd).friction, expected, rtol=1e-12)
    dynamics.set_friction(damping=0.0)
    expected = FRICTIONAL.friction * np.tanh(qd / 0.01)
    assert_allclose(dynamics.effort_terms(q, qd, qdd).friction, expected, rtol=1e-12)
    dynamics.set_friction(damping=3.0, coulomb=0.0)
    assert_allclose(dynamics.effort_terms(q, qd, qdd).friction, 3.0 * qd, rtol=1e-12)


@pytest.mark.parametrize('k', range(3))
def test_efforts_may_overwrite_an_argument(k):
    dynamics = loaded()
    expected = dynamics.efforts(*STATE)
    state = [row.copy() for row in STATE]
    assert dynamics.efforts(*state, out=state[k]) is state[k]
    assert (state[k] == expected).all()


def test_arguments_of_settings_may_change_later():
    vector, moments, joints = np.array([1.0, 2.0, 3.0]), BOX.copy(), np.array([0.1, 0.2])
    dynamics = InverseDynamics(ROBOT)

    def set_all():
        dynamics.set_gravity(vector)
        dynamics.set_base_motion(vector, vector, vector)
        dynamics.set_external_wrench(LINK, vector, vector)
        dynamics.set_payload(LINK, 1.0, vector, moments)
        dynamics.set_friction(joints, joints, joints, joints)
        dynamics.set_armature(joints)
        dynamics.set_springs(joints, joints)

    def sum_anew():
        """Make the object write all loads again from its stored arguments."""
        dynamics.set_gravity(dynamics.gravity)
        dynamics.set_external_wrench(LINK_BEFORE)
        dynamics.set_payload(LINK_BEFORE, 0.0)
        return dynamics.efforts(*STATE)

    set_all()
    expected = sum_anew()
    for array in (vector, moments, joints):
        array *= 7.0
    assert (sum_anew() == expected).all()
    set_all()
    assert (sum_anew() != expected).any()
    with pytest.raises(ValueError, match='read-only'):
        dynamics.gravity[0] = 0.0


def test_a_robot_with_fixed_joints_only_has_a_base_wrench():
    robot = load_urdf(
        '<robot name="r"><link name="base"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<link name="plate"/><joint name="mount" type="fixed"><parent link="base"/>'
        '<child link="plate"/></joint></robot>'
    )
    dynamics = InverseDynamics(robot, (0.0, 0.0, -10.0))
    dynamics.set_payload('base', 1.0, (0.4, 0.0, 0.0))
    dynamics.set_external_wrench('base', (0.0, 0.0, 5.0))
    dynamics.set_friction(1.0, 1.0)
    dynamics.set_armature(1.0)
    force, moment = dynamics.joint_wrenches([], [], [])
    assert_allclose(force, [[0.0, 0.0, 25.0]], atol=1e-14)
    # about y: -(2 kg at 0.1 m + 1 kg at 0.4 m) * 10 m/s^2; the push goes through the origin
    assert_allclose(moment, [[0.0, -6.0, 0.0]], atol=1e-14)
    assert dynamics.joint_wrenches(np.zeros((4, 0)), [], []).force.shape == (4, 1, 3)
    assert dynamics.effort_terms([], [], []).external.shape == (0,)


def test_every_method_names_the_argument_that_is_not_finite():
    dynamics = loaded()
    elbow = ROBOT.joint_names[1]
    for k, name in enumerate(('q', 'qd', 'qdd')):
        state = [row.tolist() for row in STATE]
        state[k][1] = NAN
        for method in (dynamics.efforts, dynamics.effort_terms, dynamics.joint_wrenches):
            with pytest.raises(JointStateError, match=rf"^{name} of joint '{elbow}' is nan"):
                method(*state)
        if name != 'qdd':
            with pytest.raises(JointStateError, match=rf"^{name} of joint '{elbow}' is nan"):
                dynamics.coriolis_efforts(*state[:2])
    with pytest.raises(JointStateError, match=r'qd has shape \(3,\), but the robot has 2 joints'):
        dynamics.joint_wrenches(STATE[0], np.zeros(3), STATE[2])
    with pytest.raises(JointStateError, match='cannot be broadcast together'):
        dynamics.effort_terms(np.zeros((3, 2)), np.zeros((4, 2)), STATE[2])


def test_results_may_be_kept_and_changed():
    dynamics = loaded()
    first = dynamics.joint_wrenches(*STATE)
    copy = first.force.copy()
    first.moment[...] = 0.0
    dynamics.joint_wrenches(*(2.0 * STATE))
    assert (first.force == copy).all()
    assert (dynamics.joint_wrenches(*STATE).force == copy).all()


@pytest.mark.parametrize(
    'duplicate',
    [copy.copy, copy.deepcopy, lambda dynamics: pickle.loads(pickle.dumps(dynamics))],
    ids=['copy', 'deepcopy', 'pickle'],
)
def test_a_copy_has_the_same_loads_and_is_independent(duplicate):
    dynamics = loaded()
    other = duplicate(dynamics)
    before = dynamics.effort_terms(*STATE)
    assert all(term.any() for term in before)
    assert np.array_equal(other.effort_terms(*STATE), before)
    assert np.array_equal(other.gravity, dynamics.gravity)
    assert not other.gravity.flags.writeable

    def change(each):
        each.set_payload(LINK_BEFORE, 2.0)
        each.set_external_wrench(LINK_BEFORE, (1.0, 1.0, 1.0))
        each.set_gravity((0.0, 0.0, -1.0))

    change(other)
    assert np.array_equal(dynamics.effort_terms(*STATE), before)
    change(dynamics)  # replaces the same loads on both
    assert np.array_equal(other.effort_terms(*STATE), dynamics.effort_terms(*STATE))
    assert np.array_equal(other.inertial_parameters(), dynamics.inertial_parameters())
