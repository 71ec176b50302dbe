"""Code for one robot: the same efforts, at once whatever is set, and never a wrong one."""

import copy
import pickle

from inverse_dynamics_node import (
    InverseDynamics,
    JointStateError,
    load_urdf,
    Specialised,
)
from inverse_dynamics_node.dynamics import codegen as specialise
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import random_chain, urdf_of
from robot_files import NOTHING_MOVES, STANFORD

needs_numba = pytest.mark.skipif(not IS_COMPILED, reason='numba is not in use')


@pytest.fixture
def dynamics():
    return InverseDynamics(load_urdf(STANFORD))


def fill(specialised, vectors):
    for array, vector in zip(specialised.state, vectors, strict=False):
        array[:] = vector


def random_state(specialised, rng):
    vectors = rng.uniform(-2.0, 2.0, (3, len(specialised.state.q)))
    fill(specialised, vectors)
    return vectors


def two_ways(specialised):
    """Compute in the arrays of the object, and in others."""
    yield specialised.update()
    q, qd, qdd, _ = (array.copy() for array in specialised.state)
    out = np.full_like(q, np.nan)
    assert specialised.efforts(q, qd, qdd, out) is out
    yield out
    yield specialised.efforts(q, qd, qdd)
    yield specialised.efforts(q, qd, qdd, out=q)  # over what it reads


def refuse(*_):
    raise AssertionError('the general way was taken')


def assert_same(dynamics, specialised, rng):
    vectors = random_state(specialised, rng)
    expected = dynamics.efforts(*vectors)
    for efforts in two_ways(specialised):
        assert_allclose(efforts, expected, rtol=0, atol=1e-13 * abs(expected).max())


def assert_code_is_used(dynamics, specialised, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(dynamics, 'efforts', refuse)
        for _ in two_ways(specialised):
            pass


def assert_general_way_is_taken(dynamics, specialised, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(dynamics, 'efforts', refuse)
        for call in (specialised.update, lambda: specialised.efforts(*specialised.state)):
            with pytest.raises(AssertionError, match='general way'):
                call()


def set_everything(dynamics):
    tip = dynamics.robot.link_names[-1]
    dynamics.set_gravity((0.4, -1.2, -9.5))
    dynamics.set_base_motion((0.1, 0.2, 0.3), (-0.3, 0.1, 0.2), (1.0, -2.0, 0.5))
    dynamics.set_payload(tip, 2.0, (0.1, 0.2, 0.3), np.diag([0.1, 0.2, 0.3]))
    dynamics.set_external_wrench(tip, (1.0, 2.0, 3.0), (0.3, 0.2, 0.1))
    dynamics.set_friction(0.3, 0.2)
    dynamics.set_armature(0.05)


def test_same_efforts_of_our_robots(urdf_path, rng):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    assert_same(dynamics, Specialised(dynamics), rng)


def test_same_efforts_of_a_long_chain(rng):
    dynamics = InverseDynamics(load_urdf(urdf_of(random_chain(rng, 30))))
    assert_same(dynamics, Specialised(dynamics), rng)


def test_same_efforts_when_all_was_set_before(urdf_path, rng, monkeypatch):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    set_everything(dynamics)
    specialised = Specialised(dynamics)
    assert_same(dynamics, specialised, rng)
    if IS_COMPILED:
        assert_code_is_used(dynamics, specialised, monkeypatch)


def test_same_efforts_when_all_is_set_later(urdf_path, rng):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    specialised = Specialised(dynamics)
    set_everything(dynamics)
    assert_same(dynamics, specialised, rng)


@needs_numba
def test_what_was_there_may_change_without_leaving_the_code(dynamics, rng, monkeypatch):
    set_everything(dynamics)
    specialised = Specialised(dynamics)
    for share in (0.5, 2.0, 0.0):
        dynamics.set_payload(dynamics.robot.link_names[-1], share * 3.0, (0.3, 0.1, 0.2))
        dynamics.set_external_wrench(dynamics.robot.link_names[-1], (share, 4.0, 0.1))
        dynamics.set_gravity((share, 0.3, -9.0))
        dynamics.set_friction(share, share)
        assert_same(dynamics, specialised, rng)
        assert_code_is_used(dynamics, specialised, monkeypatch)


@needs_numba
def test_what_was_not_there_is_computed_the_general_way_until_it_goes(dynamics, rng, monkeypatch):
    specialised = Specialised(dynamics)
    assert_code_is_used(dynamics, specialised, monkeypatch)
    dynamics.set_external_wrench('tool0', (1.0, 0.0, 0.0))
    dynamics.set_base_motion((0.0, 0.1, 0.0))
    assert_same(dynamics, specialised, rng)
    assert_general_way_is_taken(dynamics, specialised, monkeypatch)
    dynamics.set_external_wrench('tool0')
    assert_general_way_is_taken(dynamics, specialised, monkeypatch)
    dynamics.set_base_motion()
    assert_same(dynamics, specialised, rng)
    assert_code_is_used(dynamics, specialised, monkeypatch)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('which', [0, 1, 2])
def test_values_that_are_not_finite_are_told_by_joint(dynamics, rng, which, bad):
    """Also the position of a vertical first axis, which reaches no effort."""
    specialised = Specialised(dynamics)
    for joint, name in enumerate(dynamics.robot.joint_names):
        random_state(specialised, rng)
        specialised.state[which][joint] = bad
        for call in (specialised.update, lambda: specialised.efforts(*specialised.state)):
            with pytest.raises(JointStateError, match=f"'{name}' is {bad}"):
                call()
    assert_same(dynamics, specialised, rng)


@pytest.mark.parametrize(
    'read',
    [
        np.ndarray.tolist,
        lambda x: np.array([x, x, x]),
        lambda x: np.array([x, x]).T.copy()[:, 0],
        lambda x: x.round().astype(int),
        lambda x: x.astype(np.float32),
        lambda x: np.frombuffer(x.tobytes()),
    ],
    ids=['list', 'batch', 'strided', 'integers', 'single', 'read-only'],
)
def test_arrays_of_all_kinds_are_read(dynamics, rng, read):
    specialised = Specialised(dynamics)
    q, qd, qdd = (read(x) for x in random_state(specialised, rng))
    expected = dynamics.efforts(q, qd, qdd)
    assert_allclose(specialised.efforts(q, qd, qdd), expected, rtol=1e-12)
    out = np.zeros(expected.shape)
    assert specialised.efforts(q, qd, qdd, out=out) is out
    assert_allclose(out, expected, rtol=1e-12)


@pytest.mark.parametrize('which', [0, 1, 2, 3])
@pytest.mark.parametrize('n', [0, 5, 7])
def test_arrays_of_another_size_are_refused(dynamics, which, n):
    arrays = [np.zeros(6) for _ in range(4)]
    arrays[which] = np.zeros(n)
    with pytest.raises(JointStateError, match='has shape'):
        Specialised(dynamics).efforts(*arrays)


def test_overflow_is_told(dynamics):
    specialised = Specialised(dynamics)
    specialised.state.qd[:] = 1e300
    with pytest.raises(JointStateError, match='beyond all reason'):
        specialised.update()


def test_efforts_stand_in_the_state(dynamics, rng):
    specialised = Specialised(dynamics)
    random_state(specialised, rng)
    assert specialised.update() is specialised.state.tau


def test_two_objects_of_one_dynamics_do_not_mix(dynamics, rng):
    one, other = Specialised(dynamics), Specialised(dynamics)
    first, second = random_state(one, rng), random_state(other, rng)
    one.update()
    other.update()
    for specialised, vectors in ((one, first), (other, second)):
        assert_allclose(specialised.state.tau, dynamics.efforts(*vectors), rtol=1e-12)


def test_robot_that_cannot_move():
    assert Specialised(InverseDynamics(load_urdf(NOTHING_MOVES))).update().shape == (0,)


def test_arrays_stay_where_the_code_knows_them(dynamics):
    specialised = Specialised(dynamics)
    for array in specialised.state:
        with pytest.raises(ValueError, match='resize'):
            array.resize(100, refcheck=False)
    with pytest.raises(AttributeError):
        specialised.state.q = np.zeros(6)
    for duplicate in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match='make another'):
            duplicate(specialised)


@needs_numba
def test_another_numba_is_a_warning(dynamics, rng, monkeypatch):
    def fail(*_):
        raise AttributeError('as_pointer')

    monkeypatch.setattr(specialise, 'write_out', fail)
    with pytest.warns(UserWarning, match='as_pointer'):
        specialised = Specialised(dynamics)
    assert_same(dynamics, specialised, rng)


@needs_numba
def test_no_product_with_a_zero_of_the_robot_is_left():
    """A wheel about its own axis, without weight: inertia times acceleration, and no sine."""
    robot = load_urdf(
        '<robot name="wheel"><link name="base"/><link name="wheel"><inertial><mass value="1"/>'
        '<inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="turn" type="continuous"><parent link="base"/><child link="wheel"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    dynamics = InverseDynamics(robot, (0.0, 0.0, 0.0))
    code = specialise.write_out(dynamics.table, np.zeros((4, 1))).in_block
    instructions = code.inspect_llvm(()).split('\n')
    assert sum(' fmul ' in line for line in instructions) <= 1
    assert not any('@llvm.sin' in line or '@sin' in line for line in instructions)
