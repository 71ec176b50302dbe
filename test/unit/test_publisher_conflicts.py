"""Publishers that disagree about a joint are noticed; motion is not mistaken for that."""

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.position_tracks import (
    alternating,
    forget_silent,
    LATENESS,
    make_tracks,
    track,
    way,
)
import numpy as np
import pytest

URDF = """
<robot name="arm">
  <link name="slow"/><link name="l1"/><link name="l2"/><link name="l3"/>
  <joint name="wheel" type="continuous">
    <parent link="slow"/><child link="l1"/><axis xyz="0 0 1"/></joint>
  <joint name="slow" type="revolute">
    <parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>
    <limit lower="-2.97" upper="2.97" effort="10" velocity="2"/></joint>
  <joint name="slide" type="prismatic">
    <parent link="l2"/><child link="l3"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.4" effort="10" velocity="1"/></joint>
</robot>
"""
ROBOT = load_urdf(URDF)
WHEEL, SLOW, SLIDE = range(3)
SPEED = {WHEEL: 10.0, SLOW: 2.0, SLIDE: 1.0}


def first_alarm(joint, arrivals, positions, robot=ROBOT):
    """Return the number of the report with which an alarm begins, or None."""
    tracks = make_tracks(3, robot)
    last = None
    for k, (arrival, position) in enumerate(zip(arrivals, positions, strict=True)):
        elapsed = -1.0 if last is None else max(0.0, arrival - last)
        if track(tracks, joint, float(position), float(elapsed)):
            assert list(alternating(tracks)) == [joint]
            return k
        last = arrival
    return None


@pytest.mark.parametrize('joint', [WHEEL, SLOW, SLIDE])
@pytest.mark.parametrize(('rate', 'period'), [(1000.0, 2), (1000.0, 10), (1000.0, 50), (100.0, 2)])
def test_two_publishers_that_disagree_are_noticed(joint, rate, period):
    times = np.arange(0.0, 3.0, 1.0 / rate)
    positions = np.where(np.arange(len(times)) % period == 0, 0.8, 0.1 * np.sin(times))
    alarm = first_alarm(joint, times, positions)
    # After the minimum number of turns, or as soon as they are faster than the joint.
    assert 4 <= alarm < period * (4 + 4.0 * SPEED[joint])


def test_publishers_that_alternate_in_pairs_are_noticed():
    positions = np.tile([0.0, 0.0, 1.0, 1.0], 100)
    assert first_alarm(SLOW, 0.001 * np.arange(400), positions) < 20


def test_publishers_on_both_sides_of_a_turn_agree_on_a_joint_that_turns():
    positions = np.tile([3.14, -3.14], 1000)
    times = 0.001 * np.arange(2000)
    assert first_alarm(WHEEL, times, positions) is None
    assert first_alarm(SLOW, times, positions) is None  # not declared continuous
    assert first_alarm(SLIDE, times, positions) is not None


@pytest.mark.parametrize('jumps', [1, 2, 3])
def test_single_jumps_are_not_an_alternation(jumps):
    # Homing, or an encoder that is reset: 20 rad at once, and back.
    positions = np.zeros(1000)
    for k in range(jumps):
        positions[300 + 100 * k :] = 20.0 * ((k + 1) % 2)
    assert first_alarm(SLOW, 0.001 * np.arange(1000), positions) is None


def test_noise_is_not_an_alternation(rng):
    noise = rng.uniform(-0.009, 0.009, 10_000)
    assert first_alarm(SLOW, 0.001 * np.arange(10_000), noise) is None


@pytest.mark.parametrize('speed', [31.0, 62.8, 63.0, 125.0])
def test_a_fast_wheel_that_is_rarely_reported_is_not_an_alternation(speed, rng):
    times = np.cumsum(rng.uniform(0.04, 0.06, 1000))
    assert first_alarm(WHEEL, times, speed * times) is None


def test_the_alarm_ends_when_positions_agree_for_a_while():
    tracks = make_tracks(3, ROBOT)
    for k in range(1000):
        does_alternate = track(tracks, SLOW, float(k % 2), 0.001 if k else -1.0)
    assert does_alternate
    assert alternating(tracks) == {SLOW: (0.0, 1.0)}
    quiet = 0
    while track(tracks, SLOW, 0.0, 0.001):
        quiet += 1
    assert 500 < quiet <= 1000
    assert alternating(tracks) == {}


@pytest.mark.parametrize('joint', [WHEEL, SLOW, SLIDE])
@pytest.mark.parametrize('positions', [[1e308, -1e308], [np.inf, 0.0], [1e17, 0.5]])
def test_absurd_positions_are_accepted(joint, positions):
    tracks = make_tracks(3, ROBOT)
    for k in range(100):
        track(tracks, joint, positions[k % 2], 0.001)
    assert not np.isnan(tracks[6:]).any()


@st.composite
def reports(draw, speed, lateness=LATENESS):
    """Sample a motion within a speed limit, and deliver the samples late, many at once."""
    count = draw(st.integers(5, 60))
    seconds = st.floats(0.0, 0.3)
    ratios = st.floats(-1.0, 1.0)
    durations = np.array(draw(st.lists(seconds, min_size=count, max_size=count)))
    velocities = draw(
        st.lists(ratios | st.sampled_from([-1.0, 1.0]), min_size=count, max_size=count)
    )
    positions = np.cumsum(speed * np.array(velocities) * durations)
    stamps = np.cumsum(durations)
    delays = draw(st.lists(st.floats(0.0, lateness), min_size=count, max_size=count))
    # Messages arrive in the order in which they were sent, at most this late.
    arrivals = np.maximum.accumulate(stamps + np.array(delays) * draw(st.sampled_from([0.0, 1.0])))
    return arrivals, positions


@given(st.data(), st.sampled_from([WHEEL, SLOW, SLIDE]))
def test_no_motion_within_the_speed_limit_is_an_alternation(data, joint):
    # Turning at full speed between any two reports is harder than a joint can move.
    assert first_alarm(joint, *data.draw(reports(SPEED[joint]))) is None


@given(st.data())
def test_a_motion_and_its_jumps_are_not_an_alternation(data):
    arrivals, positions = data.draw(reports(SPEED[SLOW], 0.5 * LATENESS))
    where = data.draw(st.integers(0, len(positions)))
    positions[where:] += data.draw(st.floats(-100.0, 100.0))
    assert first_alarm(SLOW, arrivals, positions) is None


def test_full_turns_of_a_wheel_are_no_distance():
    arrivals = 0.005 * np.arange(1000)
    for turns in (1, 3):
        positions = 0.3 + 2.0 * np.pi * turns * (np.arange(1000) % 2)
        assert first_alarm(WHEEL, arrivals, positions) is None


def test_noise_depends_on_the_kind_of_joint():
    arrivals, positions = 0.001 * np.arange(3000), 0.05 * (np.arange(3000) % 2)
    assert first_alarm(SLOW, arrivals, positions) is None
    assert first_alarm(SLIDE, arrivals, positions) is not None


@pytest.mark.parametrize('count', [0.022, 0.04, 0.09])
def test_a_coarse_encoder_at_the_edge_of_a_count_is_not_an_alternation(count, rng):
    times = 0.001 * np.arange(5000)
    tiny = load_urdf(URDF.replace('velocity="2"', 'velocity="1"'))
    two, three = (np.rint(rng.uniform(-0.9, 0.9, 5000) + middle) for middle in (0.5, 0.0))
    assert len(set(two)) == 2
    assert first_alarm(SLOW, times, count * two, tiny) is None
    assert len(set(three)) == 3
    assert count > 0.05 or first_alarm(SLOW, times, count * three, tiny) is None
    assert first_alarm(SLOW, times, count * (np.arange(5000) % 2), tiny) is None


def test_a_contradiction_of_the_size_of_a_count_is_noticed_if_the_encoder_is_finer():
    times = 0.001 * np.arange(2000)
    motion = 0.01 * np.sin(5.0 * times)
    assert first_alarm(SLOW, times, motion + 0.09 * (np.arange(2000) % 2)) < 300


@pytest.mark.parametrize('delay', [0.002, 0.01])
@pytest.mark.parametrize('rate', [100.0, 1000.0])
@pytest.mark.parametrize('motion', ['steady', 'from rest', 'back and forth'])
def test_a_relay_that_is_a_little_late_is_not_an_alternation(delay, rate, motion):
    def position(times):
        if motion == 'steady':
            return 3.0 * times
        if motion == 'from rest':
            return 3.0 * np.maximum(0.0, times - 1.0)
        return 0.6 * np.sin(5.0 * times)  # up to 3 rad/s

    fast = load_urdf(URDF.replace('velocity="2"', 'velocity="3"'))
    times = np.arange(0.0, 4.0, 1.0 / rate)
    sent = np.stack([position(times), position(times - delay)], axis=1).ravel()
    arrivals = np.stack([times, times + 0.3 / rate], axis=1).ravel()
    assert first_alarm(SLOW, arrivals, sent, fast) is None


@pytest.mark.parametrize('speed', [0.0, 0.5, 3.0])
def test_two_publishers_that_disagree_are_noticed_while_the_joint_moves(speed):
    times = 0.001 * np.arange(4000)
    positions = np.where(np.arange(4000) % 2, 0.3 * np.sin(speed / 0.3 * times), 0.8)
    fast = load_urdf(URDF.replace('velocity="2"', 'velocity="3"'))
    assert first_alarm(SLOW, times, positions, fast) < 50


def test_the_alarm_of_a_joint_that_is_not_reported_any_more_ends():
    tracks = make_tracks(3, ROBOT)
    for k in range(1000):
        track(tracks, SLOW, float(k % 2), 0.001 if k else -1.0)
    forget_silent(tracks, np.full(3, 0.9))
    assert list(alternating(tracks)) == [SLOW]
    forget_silent(tracks, np.array([0.0, 1.1, 0.0]))
    assert alternating(tracks) == {}
    assert not track(tracks, SLOW, 0.0, 1.1)


def test_a_base_link_with_the_name_of_a_joint_does_not_matter():
    text = URDF.replace('<link name="slow"/>', '<link name="slide"/>')
    robot = load_urdf(text.replace('<parent link="slow"/>', '<parent link="slide"/>'))
    assert (make_tracks(3, robot) == make_tracks(3, ROBOT)).all()


def test_speed_limits_that_cannot_be_meant_are_not_believed():
    tiny = load_urdf(URDF.replace('velocity="2"', 'velocity="0.001"'))
    none = load_urdf(URDF.replace(' velocity="1"', ' velocity="1e9"'))
    for robot, joint, jitter in ((tiny, SLOW, 0.15), (none, SLIDE, 0.1)):
        tracks = make_tracks(3, robot)
        alarms = [track(tracks, joint, jitter * (k % 2), 0.1 if k else -1.0) for k in range(100)]
        assert not any(alarms)
    tracks = make_tracks(3, none)
    assert any(track(tracks, SLIDE, 0.2 * (k % 2), 0.01 if k else -1.0) for k in range(200))


def test_the_recent_way_covers_this_window_and_the_last():
    tracks = make_tracks(1)
    steps = [0.1, 0.1, 0.1, -0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    ways = [way(tracks, 0, step, 0.04) for step in steps]  # three steps exceed a window of 0.1 s
    assert ways == pytest.approx([0.1, 0.2, 0.3, 0.3, 0.3, 0.1, 0.1, 0.1, 0.0])


@pytest.mark.parametrize(('gap', 'expected'), [(0.05, 0.6), (0.15, 0.6), (0.17, 0.5)])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_the_recent_way_is_forgotten_after_a_gap(gap, expected, sign):
    tracks = make_tracks(1)
    assert way(tracks, 0, 0.1 * sign, 0.04) == pytest.approx(0.1)
    assert way(tracks, 0, 0.5 * sign, gap) == pytest.approx(expected)


def test_the_noise_of_joints_that_slide_is_smaller():
    assert make_tracks(3, ROBOT)[1].tolist() == [0.02, 0.02, 0.005]
