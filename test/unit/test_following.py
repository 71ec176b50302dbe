"""Trajectories: what is refused, references without a step, and what ends a trajectory."""

import math

from hypothesis import assume, given
from hypothesis import strategies as st
from inverse_dynamics_node import TrajectoryError
from inverse_dynamics_node.control.following import Following, JointLimits, plan
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.settings import Mode
from inverse_dynamics_node.control.supervisor import Phase
from inverse_dynamics_node.dynamics.trajectory import Trajectory
import numpy as np
import pytest
from states import Arm, PERIOD, Q, reference, store_state

JOINTS = 'a', 'b', 'turn'
LIMITS = JointLimits(
    JOINTS,
    ('rad', 'm', 'rad'),
    np.array([False, False, True]),
    np.array([-2.0, -2.0, -math.inf]),
    np.array([2.0, 2.0, math.inf]),
    np.array([3.0, math.inf, math.inf]),
)
UNLIMITED = LIMITS._replace(
    lower=np.full(3, -math.inf), upper=np.full(3, math.inf), speeds=np.full(3, math.inf)
)
AT_ZERO = np.zeros((3, 3))
TINY = 1e-9  # [s]


def made(positions, velocities=None, accelerations=None, times=None, joints=JOINTS):
    """Return a trajectory whose points are a second apart."""
    rows = (None if x is None else np.array(x, float) for x in (velocities, accelerations))
    times = np.arange(1.0, 1.0 + len(positions)) if times is None else np.array(times, float)
    return Trajectory(joints, times, np.array(positions, float), *rows)


ONE = made([[0.1, 0.2, 0.3], [0.3, 0.1, 0.2]])
STILL = [[0.0, 0.0, 0.0]] * 2


@pytest.mark.parametrize(
    ('trajectory', 'message'),
    [
        (ONE._replace(joint_names=('a', 'c', 'b')), "joint 'c' does not exist; joints are a, b,"),
        (ONE._replace(joint_names=('a', 'b', 'a')), "joint 'a' is named twice"),
        (ONE._replace(joint_names=()), 'the trajectory has no joint names'),
        (
            ONE._replace(times=np.array([1.0, 1.0])),
            'point 1 is at 1 s, expected a time later than 1 s, the time of point 0',
        ),
        (
            made([[0.1, 0.2, 0.3], [0.3, math.nan, 0.2]]),
            "positions of joint 'b' are nan at point 1, expected finite numbers",
        ),
        (
            made([[0.1, 0.2, 0.3], [0.3, 2.5, 0.2]]),
            "point 1: joint 'b' is at 2.5 m, expected -2 to 2",
        ),
        (
            made([[1.9, 0.0, 0.0], [1.9, 0.0, 0.0]], [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
            "before point 1: joint 'a' is at 2.098 rad, expected -2 to 2",
        ),
        (
            made(STILL, [[3.5, 0.0, 0.0], [0.0, 0.0, 0.0]]),
            "point 0: joint 'a' moves at 3.5 rad/s, expected at most 3",
        ),
        (
            made([[1.9, 0.0, 0.0]], times=[0.5]),
            "before point 0: joint 'a' moves at 7.125 rad/s, expected at most 3",
        ),
        (
            made(STILL, [[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]),
            "point 1: joint 'b' moves at 0.3 m/s, expected 0 at the last point",
        ),
    ],
)
def test_a_trajectory_that_cannot_be_followed_is_refused_with_point_joint_and_value(
    trajectory, message
):
    with pytest.raises(TrajectoryError) as caught:
        plan(trajectory, LIMITS, AT_ZERO)
    assert str(caught.value).startswith(message)


def test_a_start_that_is_too_far_away_or_too_late_is_refused():
    following, far = Following(LIMITS), plan(made([[0.0, 0.7, 0.0]], times=[0.0]), LIMITS, AT_ZERO)
    message = "joint 'b' is 0.7 m from the trajectory where it begins, expected at most 0.5 m"
    with pytest.raises(TrajectoryError, match=message):
        following.start(far, 0.0, AT_ZERO, 0.5)
    with pytest.raises(TrajectoryError, match=r'the trajectory ended 1\.5 s'):
        following.start(far, 1.5, AT_ZERO, 1.0)
    assert not following.is_active
    following.start(far, 0.0, AT_ZERO, 1.0)
    assert following.is_active


def test_the_present_position_may_be_beyond_the_limits():
    present = AT_ZERO.copy()
    present[0, 0] = 2.1
    plan(made([[2.1, 0.0, 0.0], [1.0, 0.0, 0.0]], times=[0.0, 1.0]), LIMITS, present)


def test_continuous_joints_take_the_shorter_way():
    present = AT_ZERO.copy()
    present[0, 2] = 6.0 * math.pi + 0.1
    found = plan(made([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]), LIMITS, present)
    assert found.states[0, -1, 2] == pytest.approx(6.0 * math.pi + 0.5)


numbers = st.floats(-1.0, 1.0)
rows = st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=5)


@st.composite
def trajectories(draw):
    """Return a trajectory of some joints, with or without velocities and accelerations."""
    joints = tuple(draw(st.permutations(JOINTS))[: draw(st.integers(1, 3))])
    positions = np.array(draw(rows))
    k = len(positions)
    velocities = np.array([draw(st.tuples(numbers, numbers, numbers)) for _ in range(k)])
    velocities[-1] = 0.0
    accelerations = velocities[::-1].copy()
    steps = draw(st.lists(st.floats(0.05, 2.0), min_size=k, max_size=k))
    steps[0] *= draw(st.sampled_from([0.0, 0.1, 1.0]))
    given = [positions, velocities, accelerations][: draw(st.integers(1, 3))]
    given = [each[:, : len(joints)] for each in given]
    return made(*given, times=np.cumsum(steps), joints=joints)


def follow(following, duration, steps):
    """Take steps; return the largest change of the state in the tiny step after each of them."""
    largest = 0.0
    for _ in range(steps):
        following.reference(0.0, duration / steps)
        before = following.state
        following.reference(0.0, TINY)
        largest = max(largest, float(np.abs(following.state - before).max()))
    return largest


@given(st.lists(st.tuples(trajectories(), st.sampled_from([-0.7, 0.0, 0.3]), st.booleans())))
def test_no_event_causes_a_step_in_position_velocity_or_acceleration(events):
    following = Following(UNLIMITED)
    state = np.array([[0.1, 0.2, 0.3], [0.2, -0.1, 0.0], [0.0, 0.0, 0.0]])
    for trajectory, time, is_emptied in events:
        found = plan(trajectory, UNLIMITED, state, max(time, 0.0))
        if time <= found.times[-1]:
            following.start(found, time, state)
        if not following.is_active:
            continue
        following.reference(0.0, 0.0)
        assert following.state == pytest.approx(state, abs=1e-9)
        assert follow(following, 1.3, 14) < 1e-2
        if is_emptied:
            before = following.state
            following.hold(following.state, '')
            following.reference(0.0, 0.0)
            assert following.state == pytest.approx(before, abs=1e-9)
            assert follow(following, 1.3, 14) < 1e-2
        state = following.state


@given(trajectories())
def test_points_are_passed_without_a_step_and_the_last_one_is_held(trajectory):
    found = plan(trajectory, UNLIMITED, AT_ZERO)
    following = Following(UNLIMITED)
    following.start(found, 0.0, AT_ZERO)
    for time in found.times:
        while following._time < time - 0.5 * TINY:
            following.reference(0.0, min(0.05, time - 0.5 * TINY - following._time))
        before = following.state
        following.reference(0.0, TINY)
        assert np.abs(following.state - before).max() < 1e-2
    while following.time_left:
        following.reference(0.0, 0.1)
    assert following.state[0, found.joints] == pytest.approx(found.states[0, -1])
    assert not following.state[1:].any()
    assert following.progress == 1.0
    others = [k for k in range(3) if k not in found.joints]
    assert not following.state[0, others].any()


@given(trajectories(), st.floats(0.1, 1.0))
def test_an_empty_trajectory_decelerates_within_the_acceleration_of_the_last_one(
    trajectory, fraction
):
    found = plan(trajectory, UNLIMITED, AT_ZERO, trajectory.times[0])
    start = AT_ZERO.copy()
    start[:, found.joints] = found.states[:, 0]
    following = Following(UNLIMITED)
    following.start(found, trajectory.times[0], start)
    for _ in range(20):
        following.reference(0.0, fraction * (found.times[-1] - found.times[0]) / 20)
    most = np.zeros(3)
    most[found.joints] = found.accelerations
    assume((2.25 * np.abs(following.state[1]) <= 2.0 * most).all())
    # The largest acceleration is taken from states that are 10 ms apart.
    most = 1.02 * np.maximum(most, np.abs(following.state[2])) + 1e-6
    following.hold(following.state, '')
    for _ in range(100):
        following.reference(0.0, 0.021)
        assert (np.abs(following.state[2]) <= most).all()
    assert not following.time_left
    assert np.abs(following.state[1:]).max() < 1e-9


def test_an_arm_that_brakes_near_its_limit_does_not_exceed_it():
    following = Following(LIMITS)
    found = plan(made([[1.99, 0.0, 0.0]], times=[1.5]), LIMITS, AT_ZERO)
    following.start(found, 0.0, AT_ZERO)
    for _ in range(50):
        following.reference(0.0, 0.02)
    following.hold(following.state, '')
    for _ in range(120):
        following.reference(0.0, 0.02)
        assert following.state[0, 0] <= 2.0


def test_a_trajectory_with_a_later_stamp_waits_while_the_present_motion_goes_on():
    following = Following(LIMITS)
    first = plan(made([[1.0, 0.0, 0.0]], times=[2.0]), LIMITS, AT_ZERO)
    second = plan(made([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], times=[0.0, 2.0]), LIMITS, AT_ZERO)
    following.start(first, 0.0, AT_ZERO)
    following.start(second, -2.0, AT_ZERO, 0.01)
    following.reference(0.0, 0.05)
    assert following.plan is first
    assert following.time_left == pytest.approx(3.95)
    for _ in range(38):
        following.reference(0.0, 0.05)
    assert following.state[0, 0] == pytest.approx(1.0, abs=1e-3)
    for _ in range(44):
        following.reference(0.0, 0.05)
    assert following.plan is second
    assert following.state[0, 0] == pytest.approx(0.0, abs=1e-12)


class FollowingArm(Arm):
    """An arm that moves exactly as its reference."""

    def __init__(self, **settings):
        super().__init__(**{'mode': Mode.COMPUTED_TORQUE, **settings})
        self.move()

    def follow(self, positions, times, time=0.0):
        trajectory = Trajectory(self.loop.joints, np.array(times), np.array(positions))
        loop = self.loop
        begin = max(time, 0.0)
        found = plan(trajectory, loop.following.limits, loop.present_motion(), begin)
        loop.follow_trajectory(found, time)

    def run(self, duration, *, has_states=True):
        """Return the efforts."""
        efforts = []
        for _ in range(round(duration / PERIOD)):
            self.now += PERIOD
            if self.loop.following.is_active:
                q, qd, _ = self.loop.following.state
                self.q = q + PERIOD * qd
                if has_states:
                    store_state(self.loop.collector, self.now, self.names, self.q, qd)
            elif has_states:
                store_state(self.loop.collector, self.now, self.names, self.q, 0.0 * self.q)
            efforts.append(self._step())
        return np.array(efforts)


TARGET = Q + np.array([0.4, -0.3])


@pytest.mark.parametrize('mode', [Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE])
def test_the_last_position_is_held_without_a_time_out_and_no_effort_steps(mode):
    arm = FollowingArm(mode=mode)
    hold = arm.command.efforts.copy()
    arm.follow([TARGET], [1.0])
    efforts = np.concatenate([[hold], arm.run(3.0)])
    assert arm.phase is Phase.RUNNING
    assert arm.q == pytest.approx(TARGET)
    assert efforts[-1] == pytest.approx(arm.loop.dynamics.gravity_efforts(TARGET), abs=1e-9)
    assert np.abs(np.diff(efforts, axis=0)).max() < 0.02 * np.abs(np.ptp(efforts, axis=0)).max()
    assert np.abs(arm.loop.following.largest_error).max() < 1e-3


@pytest.mark.parametrize(
    ('event', 'reason'),
    [
        (lambda arm: arm.loop.stop(), 'the node was disabled'),
        (lambda arm: arm.loop.limit_stop('it burns'), 'it burns'),
        (lambda arm: arm.change(mode=Mode.GRAVITY_COMPENSATION), Phase.FLOATING.value),
        (lambda arm: arm.loop.follow(reference(arm.now, arm.q)), 'another reference has arrived'),
        (lambda arm: arm.loop.start(), 'the node was started anew'),
    ],
)
def test_what_ends_a_trajectory(event, reason):
    arm = FollowingArm()
    arm.follow([TARGET], [1.0])
    arm.run(0.3)
    event(arm)
    arm.run(0.05)
    assert not arm.loop.following.is_active
    assert arm.loop.following.reason == reason
    arm.loop.resume()
    arm.run(1.0)
    assert arm.phase is Phase.FLOATING


def test_an_arm_that_falls_behind_ends_its_trajectory():
    arm = FollowingArm(max_tracking_error=0.1)
    arm.follow([TARGET], [1.0])
    arm.move(duration=1.0)
    assert arm.phase is Phase.LIMIT_STOP
    assert 'from its reference, limit 0.1 rad' in arm.loop.following.reason


@pytest.mark.parametrize('gap', [0.09, 0.15])
def test_a_trajectory_waits_for_joint_states_and_continues_after_a_short_loss(gap):
    arm = FollowingArm(stop_ramp=10.0)
    arm.follow([TARGET], [1.0])
    arm.run(0.3)
    efforts = arm.run(gap, has_states=False)
    # Feedback that compared the reference with an old position would drive the arm.
    assert efforts[:18] == pytest.approx(np.tile(efforts[0], (len(efforts[:18]), 1)))
    arm.q = arm.q + gap * arm.loop.following.state[1]
    arm.run(0.1)
    assert arm.phase is Phase.RUNNING
    assert arm.loop.following.time_left == pytest.approx(0.6 - gap, abs=0.01)


@pytest.mark.parametrize('gap', [0.3, 3.0])
@pytest.mark.parametrize('is_suspended', [False, True])
def test_after_a_long_loss_or_suspension_the_arm_is_held_where_it_is_found(gap, is_suspended):
    arm = FollowingArm()
    arm.follow([TARGET], [1.0])
    arm.run(0.3)
    if is_suspended:
        arm.now += gap
    else:
        arm.run(gap, has_states=False)
    arm.q = arm.q + 0.3
    arm.loop.motion_limits.reset()
    arm.move(duration=1.0)
    assert arm.phase is Phase.RUNNING
    assert 'joint state' in arm.loop.following.reason
    assert arm.loop.following.state[0] == pytest.approx(arm.q, abs=1e-3)
    assert not arm.loop.following.state[1:].any()


def test_no_trajectory_begins_in_some_modes_and_phases():
    arm = FollowingArm(mode=Mode.GRAVITY_COMPENSATION)
    with pytest.raises(TrajectoryError, match='the mode is gravity_compensation, in which no'):
        arm.follow([TARGET], [1.0])
    arm.change(mode=Mode.COMPUTED_TORQUE)
    arm.loop.stop()
    arm.run(0.1)
    with pytest.raises(TrajectoryError, match='no trajectory can begin: stopped'):
        arm.follow([TARGET], [1.0])


PUSHED = Q + np.array([0.2, -0.1])


@pytest.mark.parametrize(
    ('settings', 'last'),
    [
        ({'mode': Mode.JOINT_IMPEDANCE, 'stiffness': 100.0}, (None, None, None)),
        ({}, (None, [0.3, -0.2], None)),
        ({}, (Q, [0.0, 0.0], [3.0, 3.0])),
        ({'mode': Mode.INVERSE_DYNAMICS}, (None, None, [3.0, 3.0])),
    ],
)
def test_a_trajectory_begins_without_a_step_after_every_reference(settings, last):
    arm = FollowingArm(is_observed=False, start_ramp=0.5, max_tracking_error=2.0, **settings)
    positions, velocities, added = (None if each is None else np.array(each) for each in last)
    efforts = np.zeros(2) if added is None else added
    for _ in range(200):
        arm.loop.follow(Reference(np.zeros(2), efforts, arm.now, positions, velocities))
        arm.q = PUSHED
        before = arm.move()[-1]
    arm.follow([TARGET], [2.0])
    after = arm.move()[-1]
    assert np.abs(after - before).max() < 0.3


def test_the_way_to_a_fast_trajectory_stays_within_the_speed_limits():
    times = np.linspace(0.0, 6.0, 61)
    rate = 2.0 * np.pi / 6.0
    swing = 0.85 / rate * (1.0 - np.cos(rate * times[:, np.newaxis])) * [1.0, 0.0, 0.0]
    found = plan(made(swing, times=times), LIMITS._replace(speeds=np.ones(3)), AT_ZERO, 1.0)
    following = Following(LIMITS._replace(speeds=np.ones(3)))
    behind = AT_ZERO.copy()
    behind[0, 0] = found.states[0, 10, 0] - 0.2
    following.start(found, 1.0, behind)
    speeds = []
    for _ in range(500):
        following.reference(0.0, 0.01)
        speeds.append(np.abs(following.state[1]))
    assert np.max(speeds) <= 1.12  # the difference in velocity fades too


def test_a_drive_with_gains_gets_no_step_when_a_trajectory_is_replaced():
    arm = FollowingArm(is_observed=False, mode=Mode.INVERSE_DYNAMICS, start_ramp=0.1)
    arm.follow([TARGET], [1.0])
    for _ in range(400):
        arm.q = Q - 0.1
        arm.move()
        before = arm.loop.drive_reference()[0]
    assert np.abs(before - arm.q).min() > 0.05
    arm.follow([Q], [2.0])
    arm.move()
    assert arm.loop.drive_reference()[0] == pytest.approx(before, abs=0.01)


def test_a_trajectory_that_is_lost_with_the_joint_states_ends():
    arm = FollowingArm()
    arm.follow([TARGET], [3.0])
    arm.run(0.3)
    plan_before = arm.loop.following.plan
    arm.run(1.0, has_states=False)
    assert arm.phase is Phase.STATE_LOST
    assert arm.loop.following.plan is not plan_before
    assert arm.loop.following.reason == 'joint states were lost'


def test_each_stop_and_reference_outdates_a_trajectory_that_is_being_read():
    arm = FollowingArm()
    for event in (
        arm.loop.stop,
        arm.loop.resume,
        lambda: arm.loop.limit_stop('it burns'),
        lambda: arm.loop.follow(reference(arm.now, arm.q)),
        arm.loop.start,
    ):
        before = arm.loop.endings
        event()
        assert arm.loop.endings > before


def test_a_continuous_joint_that_has_wrapped_meanwhile_takes_the_shorter_way():
    far = np.array([9.0, 2.0, 2.0])
    limits = LIMITS._replace(is_continuous=far > 2.0, lower=-far, upper=far)
    at = AT_ZERO.copy()
    at[0, 0] = 3.1
    found = plan(made([[3.2, 0.0, 0.0]], times=[2.0]), limits, at)
    wrapped = at.copy()
    wrapped[0, 0] -= 2.0 * np.pi
    following = Following(limits)
    following.start(found, 0.0, wrapped, 0.5)
    following.reference(0.0, 0.0)
    assert following.state[0, 0] == pytest.approx(3.1)
