"""Quantities beside the efforts: their definition, batches, `out`, and errors."""

from inverse_dynamics_node import JointStateError, load_urdf
from loads import loaded_chain, loaded_dynamics
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import OUR_ROBOTS

LARGE = 150  # states: more than one block


def quantities(dynamics, q, qd, qdd):
    """Return a function of `out` for each quantity, and how the result is laid out in `out`."""
    return {
        'efforts': lambda out=None: dynamics.efforts(q, qd, qdd, out=out),
        'gravity_efforts': lambda out=None: dynamics.gravity_efforts(q, out=out),
        'coriolis_efforts': lambda out=None: dynamics.coriolis_efforts(q, qd, out=out),
        'mass_matrix': lambda out=None: dynamics.mass_matrix(q, out=out),
        'effort_terms': lambda out=None: np.array(dynamics.effort_terms(q, qd, qdd, out=out)),
        'joint_wrenches': lambda out=None: np.concatenate(
            dynamics.joint_wrenches(q, qd, qdd, out=out), axis=-1
        ),
        'regressor': lambda out=None: dynamics.regressor(q, qd, qdd, out=out),
        'pose': lambda out=None: dynamics.pose(q, last_link(dynamics), out=out),
        'jacobian': lambda out=None: dynamics.jacobian(q, last_link(dynamics), out=out),
    }


def last_link(dynamics):
    return dynamics.robot.link_names[-1]


NAMES = tuple(quantities(None, None, None, None))


@pytest.mark.parametrize('angular_velocity', [(0.0, 0.0, 0.0), (0.1, -0.3, 0.2)])
@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_quantities_follow_from_the_efforts(path, angular_velocity, rng):
    robot = load_urdf(path)
    dynamics, n = loaded_dynamics(robot, angular_velocity), len(robot.joint_names)
    q, qd, zeros = *rng.uniform(-2.0, 2.0, (2, n)), np.zeros(n)
    still = dynamics.efforts(q, zeros, zeros)
    assert np.abs(still).max() > 0.0
    assert_allclose(dynamics.gravity_efforts(q), still, rtol=0, atol=1e-12 * np.abs(still).max())
    columns = [dynamics.efforts(q, zeros, unit) - still for unit in np.eye(n)]
    scale = np.abs(columns).max() + np.abs(still).max()
    matrix = dynamics.mass_matrix(q)
    assert_allclose(matrix, np.transpose(columns), rtol=0, atol=1e-12 * scale)
    assert (matrix == matrix.T).all()
    dynamics.set_friction(0.0, 0.0)
    moving = dynamics.efforts(q, qd, zeros) - still
    scale += np.abs(moving).max()
    assert_allclose(dynamics.coriolis_efforts(q, qd), moving, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_batches_agree_with_single_states(path, name, rng):
    robot = load_urdf(path)
    dynamics = loaded_dynamics(robot, (0.1, -0.3, 0.2))
    states = rng.uniform(-2.0, 2.0, (3, LARGE, len(robot.joint_names)))
    actual = quantities(dynamics, *states)[name]()
    singles = [quantities(dynamics, *state)[name]() for state in states.transpose(1, 0, 2)]
    expected = np.stack(singles, axis=1 if name == 'effort_terms' else 0)
    assert actual.shape == expected.shape
    # A robot of one joint has no Coriolis efforts beyond rounding.
    scale = max(np.abs(expected).max(), 1e-3)
    assert_allclose(actual, expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('shape', [(), (3,), (LARGE,), (2, 40), (0,)])
def test_out_receives_the_result(name, shape, rng):
    dynamics = loaded_chain()
    call = quantities(dynamics, *rng.uniform(-2.0, 2.0, (3, *shape, 5)))[name]
    expected = call()
    out = np.full(expected.shape, np.nan)
    call(out)
    assert_allclose(out, expected, rtol=1e-15, atol=0)
    every_second = np.full((*expected.shape[:-1], 2 * expected.shape[-1]), np.nan)[..., ::2]
    call(every_second)
    assert_allclose(every_second, expected, rtol=1e-15, atol=0)


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('shape', [(), (3,), (LARGE,)])
def test_out_of_another_shape_or_type_is_an_error(name, shape, rng):
    dynamics = loaded_chain()
    call = quantities(dynamics, *rng.uniform(-2.0, 2.0, (3, *shape, 5)))[name]
    right = call().shape
    with pytest.raises(JointStateError, match='out has shape'):
        call(np.empty((*right, 2)))
    with pytest.raises(JointStateError, match='out has shape'):
        call(np.empty((*right[:-1], right[-1] + 1)))
    with pytest.raises(JointStateError, match='out has type float32'):
        call(np.empty(right, np.float32))


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('size', [1, LARGE])
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_position_that_is_not_finite_is_an_error(name, size, value, rng):
    dynamics = loaded_chain()
    for joint in range(5):
        states = rng.uniform(-2.0, 2.0, (3, size, 5))
        states[0, size // 2, joint] = value
        states = states if size > 1 else states[:, 0]
        with pytest.raises(JointStateError, match=rf"q of joint '\w+' is {value}"):
            quantities(dynamics, *states)[name]()
        # It leaves nothing in the scratch space.
        states[0] = 0.1
        assert np.isfinite(quantities(dynamics, *states)[name]()).all()


@pytest.mark.parametrize('name', NAMES)
def test_arguments_of_another_size_are_an_error(name):
    with pytest.raises(JointStateError, match=r'q has shape \(4,\), but the robot has 5 joints'):
        quantities(loaded_chain(), *np.zeros((3, 4)))[name]()


@pytest.mark.parametrize('name', NAMES)
def test_lists_and_integers_are_accepted(name):
    lists = quantities(loaded_chain(), [1] * 5, [2] * 5, [3] * 5)[name]()
    arrays = quantities(loaded_chain(), np.ones(5), np.full(5, 2.0), np.full(5, 3.0))[name]()
    assert (lists == arrays).all()


def test_changed_loads_apply_to_the_next_call(rng):
    dynamics = loaded_dynamics(loaded_chain().robot)
    q, qd = rng.uniform(-2.0, 2.0, (2, 5))
    calls = quantities(dynamics, q, qd, qd)
    calls['inertial_parameters'] = dynamics.inertial_parameters
    for name in ('regressor', 'pose', 'jacobian'):  # depend on the motion only
        calls.pop(name)
    for name, call in calls.items():
        before = call()
        dynamics.set_payload(dynamics.robot.link_names[-1], 3.0 + len(name), (0.1, 0.2, 0.3))
        assert np.abs(call() - before).max() > 1e-6 * np.abs(before).max(), name
