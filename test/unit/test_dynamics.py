"""Efforts that can be derived by hand, and errors of invalid arguments."""

from inverse_dynamics_node import (
    ConfigurationError,
    InverseDynamics,
    JointStateError,
    load_urdf,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest

G = 9.80665


def body(name, mass, com, inertia):
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link>'
    )


def joint(name, kind, parent, child, xyz, axis, extra=''):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{extra}'
        '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
    )


def robot_of(*parts):
    return load_urdf(f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>')


# In the x-z plane, gravity along -z, angles about -y: positive lifts.
PLANAR = robot_of(
    body('upper', 3.0, '0.2 0 0', 0.04),
    body('lower', 2.0, '0.15 0 0', 0.02),
    joint('shoulder', 'revolute', 'base', 'upper', '0 0 0', '0 -1 0'),
    joint('elbow', 'revolute', 'upper', 'lower', '0.5 0 0', '0 -1 0'),
)


def test_planar_two_links():
    q1, q2 = q = np.array([0.4, -0.9])
    w1, w2 = qd = np.array([1.1, -0.6])
    qdd = np.array([0.5, 2.0])
    m1, m2, a1, c1, c2, i1, i2 = 3.0, 2.0, 0.5, 0.2, 0.15, 0.04, 0.02
    # The textbook's closed form: M(q), the velocity terms with h = -m2 a1 c2 sin q2, and gravity.
    m_12 = i2 + m2 * (c2**2 + a1 * c2 * np.cos(q2))
    m_11 = i1 + i2 + m1 * c1**2 + m2 * (a1**2 + c2**2 + 2 * a1 * c2 * np.cos(q2))
    matrix = np.array([[m_11, m_12], [m_12, i2 + m2 * c2**2]])
    h = -m2 * a1 * c2 * np.sin(q2)
    velocity = np.array([2 * h * w1 * w2 + h * w2**2, -h * w1**2])
    lower = m2 * c2 * G * np.cos(q1 + q2)
    gravity = np.array([(m1 * c1 + m2 * a1) * G * np.cos(q1) + lower, lower])
    dynamics = InverseDynamics(PLANAR)
    assert_allclose(dynamics.gravity_efforts(q), gravity, rtol=1e-13)
    assert_allclose(dynamics.mass_matrix(q), matrix, rtol=1e-13)
    assert_allclose(dynamics.efforts(q, qd, qdd), matrix @ qdd + velocity + gravity, rtol=1e-12)


def test_arguments_may_be_array_like():
    dynamics = InverseDynamics(PLANAR)
    expected = dynamics.efforts(np.array([1.0, 2.0]), np.array([0.0, 1.0]), np.array([3.0, 0.0]))
    frozen = np.array([1.0, 2.0])
    frozen.setflags(write=False)
    strided = np.array([0.0, 9.0, 1.0, 9.0])[::2]
    assert (dynamics.efforts(frozen, strided, [3, 0]) == expected).all()
    assert (dynamics.efforts((1, 2), np.array([0, 1]), np.float32([3, 0])) == expected).all()


def test_batches_broadcast_and_may_be_empty():
    dynamics = InverseDynamics(PLANAR)
    q = np.linspace(-1.0, 1.0, 12).reshape(3, 2, 2)
    batch = dynamics.efforts(q, np.zeros(2), np.ones((2, 2)))
    assert batch.shape == (3, 2, 2)
    assert_allclose(batch[1, 0], dynamics.efforts(q[1, 0], np.zeros(2), np.ones(2)))
    assert dynamics.efforts(np.zeros((0, 2)), np.zeros(2), np.zeros(2)).shape == (0, 2)
    assert dynamics.gravity_efforts(q).shape == (3, 2, 2)
    assert dynamics.mass_matrix(q).shape == (3, 2, 2, 2)
    assert_allclose(dynamics.mass_matrix(q)[2, 1], dynamics.mass_matrix(q[2, 1]))


def test_robot_without_movable_joints_has_no_efforts():
    plate = '<joint name="mount" type="fixed"><parent link="base"/><child link="plate"/></joint>'
    dynamics = InverseDynamics(robot_of('<link name="plate"/>', plate))
    assert dynamics.efforts([], [], []).shape == (0,)
    assert dynamics.mass_matrix([]).shape == (0, 0)
    assert dynamics.efforts(np.zeros((4, 0)), [], []).shape == (4, 0)


def test_earlier_results_do_not_change():
    dynamics = InverseDynamics(PLANAR)
    first = dynamics.efforts([0.0, 0.0], [0.0, 0.0], [1.0, 1.0])
    copy = first.copy()
    dynamics.mass_matrix([1.0, 1.0])
    second = dynamics.efforts([1.0, 0.0], [0.0, 0.0], [1.0, 1.0])
    assert (first == copy).all()
    assert (first != second).any()
    # The mass matrix does not change gravity.
    assert (dynamics.efforts([0.0, 0.0], [0.0, 0.0], [1.0, 1.0]) == copy).all()


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (([0.0], [0.0, 0.0], [0.0, 0.0]), r'q has shape \(1,\), but the robot has 2'),
        (([0.0, 0.0], np.zeros(3), [0.0, 0.0]), r'qd has shape \(3,\), but the robot has 2'),
        ((np.zeros(3), np.zeros(3), np.zeros(3)), r'q has shape \(3,\), but the robot has 2'),
        ((0.0, 0.0, 0.0), r'q has shape \(\), but the robot has 2'),
        ((np.zeros((3, 2)), np.zeros((4, 2)), np.zeros(2)), r'\(4, 2\), \(2,\), which cannot'),
        ((['a', 'b'], np.zeros(2), np.zeros(2)), 'q is an array of .*, expected real numbers'),
        ((np.zeros(2), [0.0, np.nan], np.zeros(2)), "qd of joint 'elbow' is nan"),
        ((np.array([np.inf, 0.0]), np.zeros(2), np.zeros(2)), "q of joint 'shoulder' is inf"),
        ((np.zeros((2, 2)), np.zeros(2), [[0, 0], [0, np.inf]]), r"'elbow' is inf \(sample \(1,"),
        ((np.zeros(2), np.array([1e200, 0.0]), np.zeros(2)), 'the result overflows'),
    ],
)
def test_errors_name_the_invalid_argument(arguments, words):
    with pytest.raises(JointStateError, match=words):
        InverseDynamics(PLANAR).efforts(*arguments)


@pytest.mark.parametrize(
    'out',
    [np.zeros(2, dtype=int), np.zeros(2, dtype=np.float32), [0.0, 0.0], np.broadcast_to(0.0, 2)],
)
def test_rejects_out_of_lower_precision(out):
    with pytest.raises(JointStateError, match='expected a writable array of float64'):
        InverseDynamics(PLANAR).efforts(np.zeros(2), np.zeros(2), np.zeros(2), out=out)


def test_nan_has_no_effect_on_later_calls():
    dynamics = InverseDynamics(PLANAR)
    good = dynamics.efforts([0.1, 0.2], [0.3, 0.4], [0.5, 0.6])
    for k in range(3):
        arguments = np.zeros((3, 2))
        arguments[k, 0] = np.nan
        with pytest.raises(JointStateError):
            dynamics.efforts(*arguments)
    for bad in (np.nan, np.inf):
        with pytest.raises(JointStateError):
            dynamics.mass_matrix([bad, 0.0])
    assert (dynamics.efforts([0.1, 0.2], [0.3, 0.4], [0.5, 0.6]) == good).all()


@pytest.mark.parametrize('gravity', [(0, 0), (0, 0, np.nan), 'down', None, [[0, 0, 1]]])
def test_rejects_gravity_that_is_not_a_vector(gravity):
    with pytest.raises(ConfigurationError, match='expected three finite numbers'):
        InverseDynamics(PLANAR, gravity)
