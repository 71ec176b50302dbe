"""Joint states by name: in any order, in parts, with gaps; never what is not finite."""

import contextlib
import math

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node.errors import JointStateError
from inverse_dynamics_node.state import JointStateCollector
import numpy as np
import pytest

NAN = math.nan


@pytest.fixture
def collector():
    return JointStateCollector(['shoulder', 'elbow', 'wrist'])


def test_is_taken_by_name_in_any_order_with_extra_joints(collector):
    names = ['wheel', 'wrist', 'shoulder', 'elbow']
    collector.update(1.0, names, [9.0, 3.0, 1.0, 2.0], [8.0, 0.3, 0.1, 0.2])
    state = collector.state()
    assert state.q.tolist() == [1.0, 2.0, 3.0]
    assert state.qd.tolist() == [0.1, 0.2, 0.3]
    assert state.time == 1.0


def test_is_no_state_before_every_joint_was_heard_from(collector):
    collector.update(1.0, ['wrist', 'shoulder'], [1.0, 2.0], [])
    assert collector.state() is None
    assert collector.missing() == ['elbow']


def test_comes_in_parts_and_is_as_old_as_the_oldest(collector):
    collector.update(1.0, ['wrist', 'shoulder'], [3.0, 1.0], [])
    collector.update(2.0, ['elbow'], [2.0], [])
    collector.update(3.0, ['elbow'], [2.5], [])
    state = collector.state()
    assert state.q.tolist() == [1.0, 2.5, 3.0]
    assert state.time == 1.0
    assert collector.stale(3.5, 1.0) == ['shoulder', 'wrist']
    assert collector.stale(2.5, 2.0) == ['elbow']  # from the future


def test_velocity_that_was_never_measured_is_zero_and_named(collector):
    names = ['shoulder', 'elbow', 'wrist']
    collector.update(1.0, names, [1.0, 2.0, 3.0], [0.1, NAN, 0.3])
    assert collector.state().qd.tolist() == [0.1, 0.0, 0.3]
    assert collector.without_velocity() == ['elbow']


@pytest.mark.parametrize('velocities', [[NAN], []])
def test_velocity_that_ceases_is_a_fault(collector, velocities):
    collector.update(1.0, ['elbow'], [2.0], [0.2])
    with pytest.raises(JointStateError, match="velocity of joint 'elbow' is nan"):
        collector.update(2.0, ['elbow'], [2.0], velocities)


@pytest.mark.parametrize(
    ('positions', 'velocities', 'words'),
    [
        ([1.0, NAN], [], "position of joint 'elbow' is nan"),
        ([math.inf, 1.0], [], "position of joint 'wrist' is inf"),
        ([1.0], [], '2 names, but 1 positions'),
        ([], [], '2 names, but 0 positions'),
        ([1.0, 2.0], [1.0], '2 names, but 1 velocities'),
    ],
)
def test_tells_what_is_wrong_and_changes_nothing(collector, positions, velocities, words):
    collector.update(1.0, ['wrist', 'elbow'], [3.0, 2.0], [])
    with pytest.raises(JointStateError, match=words):
        collector.update(2.0, ['wrist', 'elbow'], positions, velocities)
    assert collector.q.tolist() == [0.0, 2.0, 3.0]
    assert collector.times.tolist() == [-math.inf, 1.0, 1.0]


def test_ignores_joints_of_no_concern_that_are_named_twice(collector):
    assert collector.update(1.0, ['wheel', 'wheel', 'elbow'], [1.0, 2.0, 3.0], [])
    assert not collector.update(1.0, ['wheel'], [1.0], [])
    assert collector.missing() == ['shoulder', 'wrist']


def test_tells_of_a_joint_named_twice(collector):
    with pytest.raises(JointStateError, match="'elbow' is named twice"):
        collector.update(1.0, ['elbow', 'elbow'], [1.0, 2.0], [])


@given(
    st.lists(st.sampled_from(['shoulder', 'elbow', 'wrist', 'wheel']), max_size=6),
    st.lists(st.floats(), max_size=6),
    st.lists(st.floats(), max_size=6),
)
def test_never_holds_what_is_not_finite(names, positions, velocities):
    collector = JointStateCollector(['shoulder', 'elbow', 'wrist'])
    for _ in range(2):
        with contextlib.suppress(JointStateError):
            collector.update(1.0, names, positions, velocities)
        assert np.isfinite(collector.q).all()
        assert np.isfinite(collector.qd).all()
