"""Batches of any size, and with invalid values."""

from inverse_dynamics_node import JointStateError
from inverse_dynamics_node.dynamics.batch import cosine_and_sine
from inverse_dynamics_node.dynamics.jit import simd_step
from loads import loaded_chain
import numpy as np
from numpy.testing import assert_allclose
import pytest

NAMES = ('q', 'qd', 'qdd')


BASE_ROTATION = (0.1, -0.3, 0.2), (0.5, 0.4, -0.6)  # velocity [rad/s], acceleration [rad/s^2]


@simd_step  # without a cache on disk, which would ignore changes of the functions called
def cosines_and_sines(x, cosines, sines):
    for k in range(len(x)):
        cosines[k], sines[k] = cosine_and_sine(x[k])


def one_by_one(dynamics, states):
    return np.array([dynamics.efforts(*state) for state in zip(*states, strict=True)])


def assert_batch_agrees(dynamics, states):
    expected = one_by_one(dynamics, states)
    scale = np.abs(expected).max()
    assert scale > 0.0
    assert_allclose(dynamics.efforts(*states), expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize(
    'x',
    [
        np.linspace(-10.0, 10.0, 200_001),
        np.random.default_rng(0).uniform(-1e5, 1e5, 200_000),
        # Close to the zeros of both, where most digits cancel
        np.nextafter(np.arange(-63_661, 63_661) * (np.pi / 2), np.inf),
        np.arange(-63_661, 63_661) * (np.pi / 2),
        np.arange(-63_661, 63_661) * (np.pi / 4),
        np.geomspace(1e-300, 1.0, 1000),
        np.array([0.0, -0.0, 1e5, -1e5]),
    ],
    ids=['small', 'large', 'beside zeros', 'zeros', 'eighths', 'tiny', 'ends'],
)
def test_cosines_and_sines_are_accurate_to_two_units_in_the_last_place(x):
    actual = np.empty((2, len(x)))
    cosines_and_sines(x, *actual)
    for function, values in zip((np.cos, np.sin), actual, strict=True):
        exact = function(x.astype(np.longdouble))
        error = np.abs(values - exact) / np.spacing(np.abs(exact).astype(np.float64))
        assert error.max() <= 2.0


@pytest.mark.parametrize('size', [0, 1, 15, 16, 17, 31, 32, 33, 63, 64, 65, 4096])
def test_any_number_of_states(size, rng):
    states = rng.uniform(-3.0, 3.0, (3, size, 5))
    if size:
        assert_batch_agrees(loaded_chain(*BASE_ROTATION), states)
    else:
        assert loaded_chain(*BASE_ROTATION).efforts(*states).shape == (0, 5)


def test_very_large_angles_are_computed(rng):
    states = rng.uniform(-3.0, 3.0, (3, 100, 5))
    states[0, 13] = 1e5 + 1.0, -1e9, 1.0, 1e12, 1e6
    states[0, 77] = -1e7
    assert_batch_agrees(loaded_chain(*BASE_ROTATION), states)


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('sample', [0, 40, 127, 128, 199])
def test_errors_name_the_state_that_is_not_finite(sample, value, rng):
    for k, name in enumerate(NAMES):
        for j, joint in enumerate(loaded_chain(*BASE_ROTATION).robot.joint_names):
            states = rng.uniform(-3.0, 3.0, (3, 200, 5))
            states[k, sample, j] = value
            words = rf"{name} of joint '{joint}' is {value} \(sample \({sample},\)\)"
            with pytest.raises(JointStateError, match=words):
                loaded_chain(*BASE_ROTATION).efforts(*states)


def test_reports_overflow():
    states = np.zeros((3, 100, 5))
    states[1, 70, 0] = 1e200
    with pytest.raises(JointStateError, match='the result overflows'):
        loaded_chain(*BASE_ROTATION).efforts(*states)


def test_earlier_failures_have_no_effect(rng):
    states = rng.uniform(-3.0, 3.0, (3, 100, 5))
    good = loaded_chain(*BASE_ROTATION).efforts(*states)
    with pytest.raises(JointStateError):
        loaded_chain(*BASE_ROTATION).efforts(np.nan * states[0], *states[1:])
    assert (loaded_chain(*BASE_ROTATION).efforts(*states) == good).all()


def test_out_may_be_any_array_of_the_shape(rng):
    states = rng.uniform(-3.0, 3.0, (3, 100, 5))
    expected = loaded_chain(*BASE_ROTATION).efforts(*states)
    for out in (
        np.empty((100, 5)),
        np.empty((100, 10))[:, ::2],
        np.empty((5, 100)).T,
        states[0],  # its own argument
    ):
        assert loaded_chain(*BASE_ROTATION).efforts(*states, out=out) is out
        assert (out == expected).all()
