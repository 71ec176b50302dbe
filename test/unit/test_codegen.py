"""Generated code: the same efforts as the general kernel, with all loads."""

import copy
import pickle

from inverse_dynamics_node import (
    GeneratedDynamics,
    InverseDynamics,
    JointStateError,
    load_urdf,
)
from inverse_dynamics_node.dynamics.generated import codegen, generated_dynamics
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
from inverse_dynamics_node.dynamics.robot_table import joints_before
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import random_chain, urdf_of
from robot_files import NOTHING_MOVES, OUR_ROBOTS, STANFORD

needs_numba = pytest.mark.skipif(not IS_COMPILED, reason='numba is not in use')


@pytest.fixture(
    params=[
        path
        if path.stem in ('stanford', 'branched', 'mimic_gripper')
        else pytest.param(path, marks=pytest.mark.long)
        for path in OUR_ROBOTS
    ],
    ids=lambda path: path.stem,
)
def urdf_path(request):
    """Return the path of a robot; most of them are for `make test-all`."""
    return request.param


@pytest.fixture
def dynamics():
    return InverseDynamics(load_urdf(STANFORD))


@pytest.fixture(scope='module')
def shared():
    """Return generated code without loads; each test writes its own state before it is used."""
    dynamics = InverseDynamics(load_urdf(STANFORD))
    return dynamics, GeneratedDynamics(dynamics)


def fill(generated, vectors):
    for array, vector in zip(generated.state, vectors, strict=False):
        array[:] = vector


def random_state(generated, rng):
    vectors = rng.uniform(-2.0, 2.0, (3, len(generated.state.q)))
    fill(generated, vectors)
    return vectors


def two_ways(generated):
    """Yield efforts computed in the object's own arrays and in other arrays."""
    yield generated.update()
    q, qd, qdd, _ = (array.copy() for array in generated.state)
    out = np.full_like(q, np.nan)
    assert generated.efforts(q, qd, qdd, out) is out
    yield out
    yield generated.efforts(q, qd, qdd)
    yield generated.efforts(q, qd, qdd, out=q)  # overwrites its input


def refuse(*_):
    raise AssertionError('the general way was taken')


def assert_same(dynamics, generated, rng):
    vectors = random_state(generated, rng)
    expected = dynamics.efforts(*vectors)
    for efforts in two_ways(generated):
        assert_allclose(efforts, expected, rtol=0, atol=1e-13 * abs(expected).max())


def assert_code_is_used(dynamics, generated, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(dynamics, 'efforts', refuse)
        for _ in two_ways(generated):
            pass


def assert_general_way_is_taken(dynamics, generated, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(dynamics, 'efforts', refuse)
        for call in (generated.update, lambda: generated.efforts(*generated.state)):
            with pytest.raises(AssertionError, match='general way'):
                call()


def set_everything(dynamics):
    tip = dynamics.robot.link_names[-1]
    dynamics.set_gravity((0.4, -1.2, -9.5))
    dynamics.set_base_motion((0.1, 0.2, 0.3), (-0.3, 0.1, 0.2), (1.0, -2.0, 0.5))
    dynamics.set_payload(tip, 2.0, (0.1, 0.2, 0.3), np.diag([0.1, 0.2, 0.3]))
    dynamics.set_external_wrench(tip, (1.0, 2.0, 3.0), (0.3, 0.2, 0.1))
    dynamics.set_friction(0.3, 0.2, 0.05, 0.1, 0.15)
    dynamics.set_armature(0.05)
    dynamics.set_drive_coupling(np.where(joints_before(dynamics.robot) < 0, 0.0, 0.6))
    dynamics.set_springs(4.0, 0.3)


def test_same_efforts_of_our_robots_and_with_loads_set_later(urdf_path, rng):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    generated = GeneratedDynamics(dynamics)
    assert_same(dynamics, generated, rng)
    set_everything(dynamics)
    assert_same(dynamics, generated, rng)


def test_same_efforts_of_a_long_chain(rng):
    dynamics = InverseDynamics(load_urdf(urdf_of(random_chain(rng, 30))))
    assert_same(dynamics, GeneratedDynamics(dynamics), rng)


def test_same_efforts_with_loads_set_before(urdf_path, rng, monkeypatch):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    set_everything(dynamics)
    generated = GeneratedDynamics(dynamics)
    assert_same(dynamics, generated, rng)
    if IS_COMPILED:
        assert_code_is_used(dynamics, generated, monkeypatch)


@needs_numba
def test_code_is_used_while_existing_loads_change(dynamics, rng, monkeypatch):
    set_everything(dynamics)
    generated = GeneratedDynamics(dynamics)
    for scale in (0.5, 2.0, 0.0):
        dynamics.set_payload(dynamics.robot.link_names[-1], scale * 3.0, (0.3, 0.1, 0.2))
        dynamics.set_external_wrench(dynamics.robot.link_names[-1], (scale, 4.0, 0.1))
        dynamics.set_gravity((scale, 0.3, -9.0))
        dynamics.set_friction(scale, scale, 0.1, scale, scale)
        dynamics.set_springs(scale, 0.3)
        assert_same(dynamics, generated, rng)
        assert_code_is_used(dynamics, generated, monkeypatch)


@needs_numba
def test_new_loads_use_the_general_kernel_until_they_are_removed(dynamics, rng, monkeypatch):
    generated = GeneratedDynamics(dynamics)
    assert_code_is_used(dynamics, generated, monkeypatch)
    dynamics.set_external_wrench('tool0', (1.0, 0.0, 0.0))
    dynamics.set_base_motion((0.0, 0.1, 0.0))
    assert_same(dynamics, generated, rng)
    assert_general_way_is_taken(dynamics, generated, monkeypatch)
    dynamics.set_external_wrench('tool0')
    assert_general_way_is_taken(dynamics, generated, monkeypatch)
    dynamics.set_base_motion()
    assert_code_is_used(dynamics, generated, monkeypatch)
    dynamics.set_friction(0.0, 0.0, load_friction=0.1)
    assert_same(dynamics, generated, rng)
    assert_general_way_is_taken(dynamics, generated, monkeypatch)
    dynamics.set_friction(0.0, 0.0)
    assert_same(dynamics, generated, rng)
    assert_code_is_used(dynamics, generated, monkeypatch)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('which', [0, 1, 2])
def test_values_that_are_not_finite_are_reported_by_joint(shared, rng, which, bad):
    """This includes the position of a vertical first axis, which affects no effort."""
    dynamics, generated = shared
    for joint, name in enumerate(dynamics.robot.joint_names):
        random_state(generated, rng)
        generated.state[which][joint] = bad
        for call in (generated.update, lambda: generated.efforts(*generated.state)):
            with pytest.raises(JointStateError, match=f"'{name}' is {bad}"):
                call()
    assert_same(dynamics, generated, rng)


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
def test_arguments_may_be_array_like(shared, rng, read):
    dynamics, generated = shared
    q, qd, qdd = (read(x) for x in random_state(generated, rng))
    expected = dynamics.efforts(q, qd, qdd)
    assert_allclose(generated.efforts(q, qd, qdd), expected, rtol=1e-12)
    out = np.zeros(expected.shape)
    assert generated.efforts(q, qd, qdd, out=out) is out
    assert_allclose(out, expected, rtol=1e-12)


@pytest.mark.parametrize('which', [0, 1, 2, 3])
@pytest.mark.parametrize('n', [0, 5, 7])
def test_arrays_of_wrong_size_are_rejected(shared, which, n):
    arrays = [np.zeros(6) for _ in range(4)]
    arrays[which] = np.zeros(n)
    with pytest.raises(JointStateError, match='has shape'):
        shared[1].efforts(*arrays)


def test_overflow_is_reported(shared):
    _, generated = shared
    fill(generated, np.array([0.0, 1e300, 0.0])[:, None])
    with pytest.raises(JointStateError, match='is too large'):
        generated.update()


def test_update_writes_the_efforts_to_the_state(shared, rng):
    _, generated = shared
    random_state(generated, rng)
    assert generated.update() is generated.state.tau


def test_two_objects_of_one_dynamics_are_independent(dynamics, rng):
    one, other = GeneratedDynamics(dynamics), GeneratedDynamics(dynamics)
    first, second = random_state(one, rng), random_state(other, rng)
    one.update()
    other.update()
    for generated, vectors in ((one, first), (other, second)):
        assert_allclose(generated.state.tau, dynamics.efforts(*vectors), rtol=1e-12)


def test_robot_without_movable_joints():
    assert GeneratedDynamics(InverseDynamics(load_urdf(NOTHING_MOVES))).update().shape == (0,)


def test_arrays_cannot_be_moved(shared):
    _, generated = shared
    for array in generated.state:
        with pytest.raises(ValueError, match='resize'):
            array.resize(100, refcheck=False)
    with pytest.raises(AttributeError):
        generated.state.q = np.zeros(6)
    for duplicate in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match='make a new object'):
            duplicate(generated)


@needs_numba
def test_incompatible_numba_is_a_warning(dynamics, rng, monkeypatch):
    def fail(*_):
        raise AttributeError('as_pointer')

    monkeypatch.setattr(generated_dynamics, 'write_out', fail)
    with pytest.warns(UserWarning, match='as_pointer'):
        generated = GeneratedDynamics(dynamics)
    assert_same(dynamics, generated, rng)


@needs_numba
def test_products_with_zero_are_left_out():
    """A balanced wheel without gravity needs only inertia times acceleration, and no sine."""
    robot = load_urdf(
        '<robot name="wheel"><link name="base"/><link name="wheel"><inertial><mass value="1"/>'
        '<inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="turn" type="continuous"><parent link="base"/><child link="wheel"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    dynamics = InverseDynamics(robot, (0.0, 0.0, 0.0))
    code, _ = codegen.write_out(dynamics.table, np.zeros((4, 1)))
    instructions = code.inspect_llvm(()).split('\n')
    assert sum(' fmul ' in line for line in instructions) <= 1
    assert not any('@llvm.sin' in line or '@sin' in line for line in instructions)


def assert_same_mass_matrix(dynamics, generated, rng):
    q = rng.uniform(-2.0, 2.0, len(dynamics.robot.joint_names))
    expected = dynamics.mass_matrix(q)
    assert expected.any()
    out = np.full_like(expected, np.nan)
    assert generated.mass_matrix(q, out) is out
    for matrix in (out, generated.mass_matrix(q)):
        assert_allclose(matrix, expected, rtol=0, atol=1e-13 * abs(expected).max())
        assert (matrix == matrix.T).all()


def assert_code_of_mass_matrix_is_used(dynamics, generated, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(dynamics, 'mass_matrix', refuse)
        generated.mass_matrix(generated.state.q)


def test_same_mass_matrix_of_our_robots(urdf_path, rng, monkeypatch):
    dynamics = InverseDynamics(load_urdf(urdf_path))
    dynamics.set_armature(0.05)
    generated = GeneratedDynamics(dynamics)
    assert_same_mass_matrix(dynamics, generated, rng)
    if IS_COMPILED:
        assert_code_of_mass_matrix_is_used(dynamics, generated, monkeypatch)


@pytest.mark.parametrize('is_compiled_before', [True, False])
def test_same_mass_matrix_with_loads_set_later(dynamics, rng, is_compiled_before):
    tip = dynamics.robot.link_names[-1]
    generated = GeneratedDynamics(dynamics)
    if is_compiled_before:
        assert_same_mass_matrix(dynamics, generated, rng)
    set_everything(dynamics)
    assert_same_mass_matrix(dynamics, generated, rng)
    other = InverseDynamics(dynamics.robot)
    other.set_payload(tip, 0.5)
    generated = GeneratedDynamics(other)
    other.set_payload(tip, 3.0, (0.1, 0.2, 0.3))
    assert_same_mass_matrix(other, generated, rng)


def test_mass_matrix_of_invalid_positions_is_an_error(shared):
    _, generated = shared
    for joint in range(6):
        for value in (np.nan, np.inf):
            q = np.zeros(6)
            q[joint] = value
            with pytest.raises(JointStateError, match=rf"q of joint '\w+' is {value}"):
                generated.mass_matrix(q)
    with pytest.raises(JointStateError, match=r'q has shape \(5,\), but the robot has 6 joints'):
        generated.mass_matrix(np.zeros(5))
    with pytest.raises(JointStateError, match=r'out has shape \(5, 6\)'):
        generated.mass_matrix(np.zeros(6), np.empty((5, 6)))


def test_mass_matrices_of_lists_and_batches(shared, rng):
    dynamics, generated = shared
    q = rng.uniform(-2.0, 2.0, (3, 6))
    assert (generated.mass_matrix(q) == dynamics.mass_matrix(q)).all()
    assert (generated.mass_matrix(q[0].tolist()) == dynamics.mass_matrix(q[0])).all()
