"""Joint states by name: in any order, in parts, with gaps; all values stay finite."""

import contextlib
import math
import tracemalloc

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node.control.joint_states import Events, JointStateCollector
from inverse_dynamics_node.errors import ConfigurationError, JointStateError
from inverse_dynamics_node.node.status_text import similar_names
import numpy as np
import pytest
from states import store_state

NAN = math.nan
ARM = ['shoulder', 'elbow', 'wrist']


@pytest.fixture
def collector():
    return JointStateCollector(ARM)


def test_joints_are_found_by_name_in_any_order_among_others(collector):
    names = ['wheel', 'wrist', 'shoulder', 'elbow']
    store_state(collector, 1.0, names, [9.0, 3.0, 1.0, 2.0], [8.0, 0.3, 0.1, 0.2])
    state = collector.state()
    assert state.q.tolist() == [1.0, 2.0, 3.0]
    assert state.qd.tolist() == [0.1, 0.2, 0.3]
    assert state.time == 1.0


def test_there_is_no_state_before_every_joint_was_reported(collector):
    store_state(collector, 1.0, ['wrist', 'shoulder'], [1.0, 2.0], [])
    assert collector.state() is None
    assert collector.missing() == ['elbow']


def test_a_state_arrives_in_parts_and_is_as_old_as_the_oldest(collector):
    store_state(collector, 1.0, ['wrist', 'shoulder'], [3.0, 1.0], [])
    store_state(collector, 2.0, ['elbow'], [2.0], [])
    store_state(collector, 3.0, ['elbow'], [2.5], [])
    state = collector.state()
    assert state.q.tolist() == [1.0, 2.5, 3.0]
    assert state.time == 1.0
    assert collector.stale(3.5, 1.0) == ['shoulder', 'wrist']
    assert collector.stale(2.5, 2.0) == ['elbow']  # from the future


def test_velocity_that_was_never_measured_is_zero_and_named(collector):
    names = ['shoulder', 'elbow', 'wrist']
    store_state(collector, 1.0, names, [1.0, 2.0, 3.0], [0.1, NAN, 0.3])
    assert collector.state().qd.tolist() == [0.1, 0.0, 0.3]
    assert collector.without_velocity() == ['elbow']


@pytest.mark.parametrize('velocities', [[NAN], []])
def test_a_velocity_that_disappears_is_awaited_at_first_and_then_zero(collector, velocities):
    collector.velocity_timeout = 0.25
    for now in (0.75, 1.0):
        store_state(collector, now, ['elbow'], [2.0], [0.2])
    store_state(collector, 1.0, ['elbow', 'wrist'], [2.0, 3.0], [0.2, 0.3])
    for now in (1.0, 1.125, 1.2499):
        assert not store_state(collector, now, ['elbow'], [2.5], velocities)
    assert (collector.q[1], collector.qd[1], collector.times[1]) == (2.0, 0.2, 1.0)
    assert (events(collector), collector.without_velocity()) == (Events(), [])
    for now in (1.25, 1.26):
        store_state(collector, now, ['elbow'], [2.5], velocities)
    assert events(collector) == (True, ('elbow',))
    assert (collector.q[1], collector.qd[1], collector.times[1]) == (2.5, 0.0, 1.26)
    assert collector.without_velocity() == ['elbow']
    # With another layout, whose messages were complete before.
    store_state(collector, 1.27, ['elbow', 'wrist'], [2.5, 3.0], [0.1, 0.3])
    assert collector.qd.tolist() == [0.0, 0.1, 0.3]
    assert collector.without_velocity() == []
    assert events(collector) == (True, ())
    assert not store_state(collector, 1.28, ['elbow'], [2.5], velocities)
    assert events(collector) == Events()


def test_velocities_that_several_publishers_lose_and_regain_are_noticed_every_time(collector):
    collector.velocity_timeout = 0.25
    layouts = [collector.layout(names) for names in (('elbow',), ('elbow', 'wrist'), ('wrist',))]

    def report(now, speed):
        for layout in layouts:
            n = len(layout.names)
            collector.store(now, layout, [0.0] * n, [speed] * n)

    collector.store(0.0, layouts[0], [0.0], [])
    assert collector.without_velocity() == ['elbow']
    for start in (1.0, 2.0, 3.0):
        report(start, 0.1)
        assert collector.without_velocity() == []
        events(collector)
        report(start + 0.5, NAN)
        assert events(collector) == (True, ('elbow', 'wrist'))
        assert collector.without_velocity() == ['elbow', 'wrist']


def test_a_velocity_from_before_a_clock_reset_is_not_awaited(collector):
    store_state(collector, 9.0, ['elbow'], [2.0], [0.2])
    store_state(collector, 1.0, ['elbow'], [2.5], [])
    assert collector.q[1] == 2.5


TWO, TWICE = ['wrist', 'elbow'], ['elbow', 'elbow']


@pytest.mark.parametrize(
    ('names', 'values', 'words'),
    [
        (TWO, ([1.0, math.inf], []), "position of joint 'elbow' is inf"),
        (TWO, ([NAN, -math.inf], []), "position of joint 'elbow' is -inf"),
        (TWO, ([NAN, 2.5], [math.inf, 0.1]), "velocity of joint 'wrist' is inf"),
        (TWO, ([1.0], []), '2 names, but 1 positions'),
        (TWO, ([], []), '2 names, but 0 positions'),
        (TWO, ([1.0, 2.0], [1.0]), '2 names, but 1 velocities'),
        (TWO, ([1.0, 2.0], [], [3.0]), '2 names, but 1 efforts'),
        (TWICE, ([1.0, 2.0], []), "'elbow' is named twice"),
    ],
)
@pytest.mark.parametrize('before', [[0.1, 0.2], []])
def test_rejects_invalid_states_with_a_reason_and_changes_nothing(
    collector, names, values, words, before
):
    store_state(collector, 1.0, TWO, [3.0, 2.0], before)
    with pytest.raises(JointStateError, match=words):
        store_state(collector, 2.0, names, *values)
    assert collector.q.tolist() == [0.0, 2.0, 3.0]
    assert collector.times.tolist() == [-math.inf, 1.0, 1.0]


def test_ignores_other_joints_whatever_their_names_and_lengths(collector):
    for values in ([], [], []), ([1.0], [1.0, 2.0], [1.0]), ([math.inf], [math.inf]):
        assert not store_state(collector, 1.0, ['wheel'], *values)
        assert not store_state(collector, 1.0, [], *values)
    assert store_state(collector, 1.0, ['wheel', 'wheel', 'elbow'], [1.0, 2.0, 3.0], [])
    assert collector.missing() == ['shoulder', 'wrist']


FLOOD = [[f'sensor{k}'] for k in range(1000)]


@pytest.mark.parametrize(
    ('joints', 'messages', 'similar'),
    [
        (ARM, [['wheel', 'x' * 1000, 'sholder', 'wrist']], ['sholder']),
        (ARM, [['wrist', 'sholder'], ['elbow_joint']], ['sholder', 'elbow_joint']),
        (ARM, [['wrist', 'sholder'], ['elbow', 'shoulder']], []),
        (ARM, [*FLOOD, ['sholder']], []),
        (ARM, [[*k * ['wheel'], 'wrist'] for k in range(1, 100)] + [['sholder']], ['sholder']),
        (['elbow_joint', 'other'], [['elbow_joint1', 'elbow_joint12', 'other']], ['elbow_joint1']),
        (['joint1', 'joint2'], [['joint1']], []),  # of this robot
    ],
)
def test_some_names_that_resemble_the_missing_ones_are_remembered(joints, messages, similar):
    collector = JointStateCollector(joints)
    for names in messages:
        store_state(collector, 1.0, names, [0.0] * len(names), [])
    assert similar_names(collector) == similar


JOINTS = ['arm', 'wrist', 'finger', 'thumb']  # two of them commanded, one locked
NUMBERS = st.one_of(st.just(NAN), st.floats(-3.0, 3.0))
MESSAGES = st.tuples(
    st.sampled_from([0.0, 0.001, 0.1, 2.0, -1.0]),  # [s] after the last message
    st.lists(st.sampled_from([*JOINTS, 'wheel']), min_size=1, unique=True),
    st.lists(NUMBERS, min_size=5, max_size=5),
    st.lists(NUMBERS, min_size=5, max_size=5),
    st.lists(NUMBERS, min_size=5, max_size=5),
)


def events(collector, now=1.0):
    """Return what has happened since the last call."""
    return collector.at(now)[1]


def contents(collector, now):
    numbers = collector.q, collector.qd, collector.times, collector.efforts
    lists = collector.without_velocity(), collector.missing()
    flags = events(collector, now), collector.time
    return [x.tolist() for x in np.nan_to_num(numbers, nan=1e9)], lists, flags


@given(st.lists(MESSAGES, max_size=12))
def test_joints_with_nan_are_stored_as_if_the_message_did_not_name_them(messages):
    whole, reduced = [
        JointStateCollector(JOINTS, {'thumb': 0.1}, ['arm', 'wrist']) for _ in range(2)
    ]
    now, last_velocity = 10.0, {}
    for elapsed, names, *values in messages:
        now += elapsed
        rows = list(zip(names, *values, strict=False))
        kept = []
        for row in rows:
            name, position, velocity, _ = row
            is_due = now >= last_velocity.get(name, math.inf) + whole.velocity_timeout
            is_from_future = now < last_velocity.get(name, -math.inf)
            is_first = name not in last_velocity
            if math.isnan(position):
                continue
            if math.isnan(velocity) and not (is_due or is_from_future or is_first):
                continue
            kept.append(row)
            last_velocity.pop(name, None)
            if not math.isnan(velocity):
                last_velocity[name] = now
        is_stored = store_state(whole, now, names, *zip(*[row[1:] for row in rows], strict=True))
        assert is_stored == any(row[0] in JOINTS for row in kept)
        if kept:
            names, *values = zip(*kept, strict=True)
            store_state(reduced, now, names, *values)
        assert contents(whole, now) == contents(reduced, now)


def test_a_commanded_joint_with_nan_becomes_stale_and_no_other_joint_does():
    collector = JointStateCollector(JOINTS, {'thumb': 0.1}, ['arm', 'wrist'])
    store_state(collector, 0.0, JOINTS[:3], [0.0] * 3, [0.0] * 3)
    for k in range(1, 100):
        store_state(collector, 0.01 * k, JOINTS, [1.0, NAN, NAN, NAN], [0.0] * 4)
    assert collector.stale(0.99, 0.1) == ['wrist']
    assert collector.unseen() == ['thumb']


@given(
    st.lists(st.sampled_from(['shoulder', 'elbow', 'wrist', 'wheel']), max_size=6),
    st.lists(st.floats(), max_size=6),
    st.lists(st.floats(), max_size=6),
)
def test_never_stores_values_that_are_not_finite(names, positions, velocities):
    collector = JointStateCollector(ARM)
    for _ in range(2):
        with contextlib.suppress(JointStateError):
            store_state(collector, 1.0, names, positions, velocities)
        assert np.isfinite(collector.q).all()
        assert np.isfinite(collector.qd).all()


def test_a_locked_position_is_used_until_the_joint_is_reported():
    collector = JointStateCollector(['arm', 'finger'], {'finger': 0.02})
    assert collector.missing() == ['arm']
    store_state(collector, 1.0, ['arm'], [0.5], [])
    state = collector.state()
    assert state.time == 1.0
    assert list(state.q) == [0.5, 0.02]
    assert collector.unseen() == ['finger']
    assert collector.without_velocity() == ['arm']
    store_state(collector, 2.0, ['finger'], [0.01], [])
    assert list(collector.state().q) == [0.5, 0.01]
    assert collector.unseen() == []


def test_a_locked_joint_is_never_stale():
    collector = JointStateCollector(['arm', 'finger'], {'finger': 0.02})
    store_state(collector, 1.0, ['arm', 'finger'], [0.5, 0.0], [])
    store_state(collector, 9.0, ['arm'], [0.5], [])
    assert collector.stale(9.0, 0.1) == []
    assert collector.state().time == 9.0


@pytest.mark.parametrize(
    ('locked', 'words'),
    [
        ({'nope': 0.0}, 'nope.*, expected only joints of the robot: arm, finger, thumb'),
        ({'finger': math.nan}, "position of joint 'finger' is nan"),
        ({'arm': 0.0}, "joint 'arm' is both commanded and locked"),
    ],
)
def test_rejects_invalid_locked_positions(locked, words):
    with pytest.raises(ConfigurationError, match=words):
        hand(locked)


def test_efforts_are_kept_by_name_and_renewed(collector):
    for effort in (3.0, 4.0, 5.0):
        store_state(collector, 1.0, ['elbow', 'x'], [0.0, 0.0], [0.1, 0.1], [effort, 9.0])
        assert collector.efforts[1] == effort
    assert np.isnan(collector.efforts[[0, 2]]).all()


def test_a_state_is_stale_only_after_the_timeout(collector):
    store_state(collector, 1.0, collector.joint_names, [1.0, 2.0, 3.0], [])
    assert collector.stale(2.0, 1.0) == []
    assert collector.stale(2.125, 1.0) == list(collector.joint_names)


def test_messages_that_never_repeat_their_names_do_not_fill_the_memory(collector):
    tracemalloc.start()
    try:
        for k in range(2000):
            store_state(collector, 1.0, [f'sensor{k}'], [0.0], [])
        used, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert used < 300_000  # bytes


HAND = ['arm', 'finger', 'thumb']


def hand(locked=None):
    return JointStateCollector(HAND, locked, ['arm'])


def test_nothing_happens_before_a_joint_was_late_or_locked():
    collector = hand({'thumb': 0.1})
    assert events(collector, 0.0) == Events()
    store_state(collector, 1.0, HAND[:2], [0.0] * 2, [NAN, NAN])
    assert events(collector, 1.0) == Events()


def test_a_joint_that_becomes_late_or_returns_is_an_event():
    collector = hand()
    store_state(collector, 5.0, HAND, [0.0] * 3, [1.0] * 3)
    assert not events(collector, 5.5).has_changed
    store_state(collector, 7.0, ['arm', 'thumb'], [0.0] * 2, [1.0] * 2)
    assert events(collector, 7.0).has_changed
    assert collector.late(7.0) == {'finger': 2.0}
    assert collector.qd.tolist() == [1.0, 0.0, 1.0]
    assert not events(collector, 7.2).has_changed
    store_state(collector, 7.3, HAND, [0.0] * 3, [1.0] * 3)
    assert events(collector, 7.3).has_changed


def test_the_first_report_of_a_locked_joint_is_an_event_until_it_is_read():
    collector = hand({'thumb': 0.1})
    store_state(collector, 1.0, HAND[:2], [0.0] * 2, [])
    assert not events(collector).has_changed
    store_state(collector, 1.0, ['thumb'], [0.3], [])
    store_state(collector, 1.1, HAND[:2], [0.0] * 2, [])
    assert [events(collector, 1.1).has_changed for _ in range(2)] == [True, False]
