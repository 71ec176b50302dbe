"""Commands of a lift of two sliding joints: settings, what happens, and the expected command."""

import math
from typing import NamedTuple

from inverse_dynamics_node import ConfigurationError, load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, StalePolicy
from inverse_dynamics_node.control.supervisor import Phase, recovery_time
import numpy as np
import pytest
from robot_files import NOTHING_MOVES
from states import Arm, reference, store_state

# Two point-like masses on two sliding joints, one above the other: efforts are sums of weights.
LIFT = """
<robot name="lift">
  <link name="base"/>
  <link name="lower"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <joint name="low" type="prismatic"><parent link="base"/><child link="lower"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="50" velocity="1"/></joint>
  <joint name="high" type="prismatic"><parent link="lower"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="15" velocity="1"/></joint>
</robot>"""
ROBOT = load_urdf(LIFT)
WHEELS = load_urdf(LIFT.replace('type="prismatic"', 'type="continuous"').replace('50"', '500"'))
HOLD = np.array([30.0, 10.0])  # with gravity 10
ZERO = np.zeros(2)
NEVER, ANY = math.nan, ...
CLOSED, GUIDED = {'mode': Mode.COMPUTED_TORQUE}, {'mode': Mode.GRAVITY_COMPENSATION}
KEEP = {'on_stale_state': StalePolicy.HOLD}
FREE = {'use_urdf_effort_limits': False}
WAITING, RUNNING, FLOATING = Phase.WAITING, Phase.RUNNING, Phase.FLOATING
TOO_FAR, LOST, STOPPED = Phase.TOO_FAR, Phase.STATE_LOST, Phase.STOPPED
start, stop, resume = ControlLoop.start, ControlLoop.stop, ControlLoop.resume


def lift(joints=(), robot=ROBOT, gravity=(0.0, 0.0, -10.0), **settings):
    arm = Arm(robot, joints, is_observed=False, **{'period': 0.1, 'gravity': gravity} | settings)
    arm.q = np.zeros(2)
    return arm


class At(NamedTuple):
    """
    A step at a time, and what is expected of its command.

    The state has arrived then, or at ``state``; the reference, if any of its values is given, has
    arrived then, or at ``sent``. Without efforts, no command is expected.
    """

    now: float
    efforts: object = HOLD
    phase: Phase | None = None
    qd: object = None
    state: float | None = None
    qdd: object = None
    more: object = None
    q_ref: object = None
    qd_ref: object = None
    sent: float | None = None
    cut: object = None
    slowed: object = None

    def check(self, arm):
        wanted = None
        if not all(x is None for x in (self.qdd, self.more, self.q_ref, self.qd_ref)):
            sent = self.now if self.sent is None else self.sent
            qdd, more = (ZERO if x is None else x for x in (self.qdd, self.more))
            wanted = reference(sent, self.q_ref, self.qd_ref, qdd, more)
        found = arm.at(self.now, None, self.qd, wanted, self.state)
        if self.efforts is None:
            assert found is None
        elif self.efforts is not ANY:
            assert found == pytest.approx(np.array(self.efforts), abs=1e-12)
        for expected, flags in ((self.cut, 'is_saturated'), (self.slowed, 'is_slowed')):
            assert expected is None or getattr(arm.command, flags).tolist() == expected
        assert self.phase is None or arm.phase is self.phase


def ramp(times, fractions, phase, **inputs):
    """Return steps in which the efforts are fractions of those that hold the lift."""
    pairs = zip(times, fractions, strict=True)
    return [At(now, fraction * HOLD, phase, **inputs) for now, fraction in pairs]


CASES = {
    'nothing is commanded before the first state': (
        {},
        [At(0.0, None, WAITING, state=NEVER, qdd=(1.0, 1.0))],
    ),
    'gravity is held without a reference': ({}, [At(0.0, HOLD, FLOATING)]),
    'accelerations and efforts of the reference act': (
        {},
        [At(0.0, (35.0 + 0.5, 13.0 + 0.25), RUNNING, qdd=(1, 2), more=(0.5, 0.25))],
    ),
    'joints have the requested order': (
        {'joints': ['high', 'low']},
        [At(0.0, (13.0, 35.0), qdd=(2.0, 1.0))],
    ),
    'joints that are not commanded are carried': ({'joints': ['low']}, [At(0.0, [30.0])]),
    'efforts are cut to the limits of the URDF and flagged': (
        {},
        [
            At(0.0, (50.0, 15.0), qdd=(-9.0, 60.0), cut=[True, True]),
            At(0.1, (-50.0, -15.0), qdd=(-60.0, 0.0), cut=[True, True]),
            At(0.2, cut=[False, False]),
        ],
    ),
    'limits of the URDF can be switched off': (
        FREE,
        [At(0.0, (120.0, 100.0), qdd=(0.0, 90.0), cut=[False, False])],
    ),
    'limits of the URDF are tightened and never loosened': (
        {'effort_limits': (20.0, 500.0)},
        [At(0.0, (20.0, 15.0), qdd=(0.0, 90.0))],
    ),
    'the scale comes before the limits': (
        {'effort_scale': (0.5, 2.0)},
        [At(0.0, (15.0, 15.0), cut=[False, True])],
    ),
    'a lost reference leaves the arm floating': (
        {},
        [
            At(0.5, (34.0, 12.0), RUNNING, qdd=(1.0, 0.0), more=(1.0, 1.0), sent=0.0),
            At(0.51, HOLD, FLOATING, qdd=(1.0, 0.0), more=(1.0, 1.0), sent=0.0),
        ],
    ),
    'a reference can hold forever': (
        {'reference_timeout': 0.0},
        [At(1e6, (33.0, 11.0), qdd=(1.0, 0.0), sent=0.0)],
    ),
    'efforts rise along the start ramp': (
        {'start_ramp': 0.4},
        ramp((0.0, 0.1, 0.2, 0.3, 0.4, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0, 1.0), FLOATING),
    ),
    'efforts fall when states are lost, and rise when they have been back for a while': (
        {'start_ramp': 0.2, 'stop_ramp': 0.2},
        [
            *ramp((0.0, 0.1, 0.2), (0.0, 0.5, 1.0), FLOATING),
            At(0.29, HOLD, FLOATING, state=0.2),
            *ramp((0.34, 0.39, 0.49, 0.54, 0.55), (1.0, 0.75, 0.25, 0.0, 0.0), LOST, state=0.2),
            *ramp((0.6, 0.7, 0.75), (0.0, 0.0, 0.0), LOST),
            At(0.81, ZERO, FLOATING),
            At(0.86, HOLD / 4, FLOATING, cut=[False, False]),
        ],
    ),
    'a loss ends after states without a gap for twice the time-out': (
        {'state_timeout': 0.5},
        [
            At(0.0, HOLD, FLOATING),
            At(0.6, ZERO, LOST, state=0.0),
            At(0.7, ZERO, LOST),
            At(1.3, ZERO, LOST, state=0.7),  # another gap
            At(1.4, ZERO, LOST),
            At(1.8, ZERO, LOST),
            At(2.2, ZERO, LOST),
            At(2.4, ZERO, LOST, state=2.2),  # the same state as before
            At(2.5, HOLD, FLOATING),
        ],
    ),
    'a state is fresh until the end of its time-out': (
        {'state_timeout': 0.125},
        [At(0.0), At(0.125, HOLD, FLOATING, state=0.0), At(0.126, ZERO, LOST, state=0.0)],
    ),
    'a loss that hardly lowered the efforts ends with the next state': (
        {'stop_ramp': 1.0},
        [
            At(0.5, HOLD, FLOATING),
            At(0.61, HOLD, LOST, state=0.5),
            At(0.65, 0.96 * HOLD, LOST, state=0.5),
            At(0.66, HOLD, FLOATING),
        ],
    ),
    'a clock that is set back means a lost state': (
        {'stop_ramp': 1.0},
        [
            At(100.0, (34.0, 12.0), RUNNING, qdd=(1.0, 1.0)),
            At(1.0, (34.0, 12.0), LOST, state=100.0, qdd=(1.0, 1.0), sent=100.0),
            At(1.1, HOLD, FLOATING, qdd=(1.0, 1.0), sent=100.0),
        ],
    ),
    'absurd references lead to zero along the stop ramp': (
        {'stop_ramp': 0.1, **FREE},
        [
            At(0.0),
            *ramp((0.05, 0.1, 0.151), (1.0, 0.5, 0.0), Phase.NO_SOLUTION, qdd=(1e308, 1e308)),
        ],
    ),
    'computed torque drives back to the reference': (
        {'kp': (100.0, 50.0), 'kd': 10.0, **CLOSED},
        [
            At(
                0.0,
                (30.0 + 3.0 * 3.5 - 0.5, 10.0 + 3.5 - 0.5),
                qdd=(0.5, 0.0),
                q_ref=(0.02, 0.01),
                qd_ref=(0.1, -0.1),
            )
        ],
    ),
    'inverse dynamics ignores positions and velocities of the reference': (
        {},
        [At(0.0, (31.5, 10.5), qdd=(0.5, 0.0), q_ref=(0.02, 0.01), qd_ref=(0.1, -0.1))],
    ),
    'gravity compensation ignores the reference': (
        GUIDED,
        [At(0.0, HOLD, FLOATING, qd=(1.0, 1.0), qdd=(1.0, 1.0), q_ref=(0.3, 0.3))],
    ),
    'feedback of positions without velocities is damped': (
        {'kp': 0.0, 'kd': 10.0, **CLOSED},
        [At(0.0, HOLD - [3.0, 1.0], qd=(0.1, 0.0), q_ref=(0.0, 0.0))],
    ),
    'a reference without positions and velocities is not damped': (
        {'kd': 10.0, **CLOSED},
        [At(0.0, (33.0, 11.0), qd=(0.1, 0.0), qdd=(1.0, 0.0))],
    ),
    'a reference that starts at the largest distance is followed': (
        {'max_tracking_error': 0.5, 'kp': 1.0, **CLOSED},
        [At(0.0, (31.0, 10.0), RUNNING, q_ref=(0.5, -0.5))],
    ),
    'a reference that starts or jumps too far away is not followed': (
        {'max_tracking_error': 0.1, 'kp': 1.0, **CLOSED},
        [
            At(0.0, HOLD, TOO_FAR, q_ref=(0.2, 0.0)),
            At(0.01, (30.15, 10.05), RUNNING, q_ref=(0.05, 0.0)),
            At(0.02, HOLD, TOO_FAR, q_ref=(0.3, 0.0)),
            At(0.03, (30.15, 10.05), RUNNING, q_ref=(0.05, 0.0)),
            # The arm must not fall behind.
            At(0.04, ZERO, Phase.LIMIT_STOP, q_ref=(0.14, 0.0)),
        ],
    ),
    'feedback that starts during motion does not start with a jump': (
        {'max_tracking_error': 0.1},
        [
            At(0.0, HOLD, RUNNING, q_ref=(3.0, 0.0)),
            CLOSED,
            At(0.01, HOLD, RUNNING, qdd=(0.0, 0.0)),  # no positions, so no distance
            At(0.02, HOLD, TOO_FAR, q_ref=(3.0, 0.0)),
        ],
    ),
    'a tightened limit is reached along the ramp': (
        {},
        [
            At(0.0),
            {'start_ramp': 0.1, 'effort_limits': 5.0},
            At(0.15, HOLD, FLOATING),
            At(0.2, (17.5, 7.5)),
            At(0.251, (5.0, 5.0), cut=[True, True]),
            {'start_ramp': 0.0, 'effort_rate_limits': 10.0, 'effort_limits': 3.0},
            At(0.351, (4.0, 4.0), slowed=[True, True]),
            At(0.451, (3.0, 3.0)),
            At(0.551, (3.0, 3.0)),
        ],
    ),
    'efforts change no faster than allowed, and this is flagged': (
        {'effort_rate_limits': (100.0, math.inf)},
        [
            At(0.0, ZERO, slowed=[True, True]),
            At(0.05, (5.0, 10.0), slowed=[True, False]),
            At(0.1, (10.0, 10.0), slowed=[True, False]),
            At(0.2, (20.0, 10.0), slowed=[True, False]),
            At(0.31, ZERO, LOST, state=0.2, slowed=[False, False]),
        ],
    ),
    'nothing is slowed without rate limits': (
        {'start_ramp': 0.5},
        [At(now, 2.0 * now * HOLD, slowed=[False, False]) for now in (0.0, 0.01, 0.02)],
    ),
    'efforts can be held while states are lost, without flags': (
        KEEP,
        [
            At(0.0, (50.0, 15.0), qdd=(9.0, 60.0), cut=[True, True]),
            At(5.0, (50.0, 15.0), LOST, state=0.0, cut=[False, False], slowed=[False, False]),
            stop,
            At(5.1, ZERO, STOPPED, state=0.0),
        ],
    ),
    'efforts held since a stop ramp began stay where they are': (
        {'stop_ramp': 0.2},
        [
            At(0.0),
            At(0.11, HOLD, LOST, state=0.0),
            At(0.21, 0.5 * HOLD, state=0.0),
            KEEP,
            *ramp((0.3, 0.4, 1.0), (0.5, 0.5, 0.5), LOST, state=0.0),
            {'on_stale_state': StalePolicy.ZERO},
            At(1.1, 0.5 * HOLD, state=0.0),
            At(1.2, 0.25 * HOLD, state=0.0),
        ],
    ),
    'a start waits for a fresh state': (
        {'start_ramp': 0.1},
        [
            At(0.101, None, WAITING, state=0.0),
            At(5.0, None, WAITING, state=0.0),
            At(5.01, ZERO, FLOATING, state=5.0),
            At(5.06, HOLD / 2, FLOATING),
            start,
            At(6.0, None, WAITING, state=5.06),
        ],
    ),
    'a stop lasts until it is ended': (
        {},
        [At(0.0), stop, At(0.1, ZERO, STOPPED), At(0.2, ZERO, STOPPED), resume, At(0.3, HOLD)],
    ),
    'a start ends a stop': ({}, [At(0.0), stop, At(0.1, ZERO, STOPPED), start, At(0.2, HOLD)]),
    'a start ramp of zero does not cut off a blend': (
        {'start_ramp': 0.5},
        [
            *ramp((0.0, 0.1, 0.2, 0.3, 0.4, 0.5), (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), FLOATING),
            {'effort_scale': 0.2},
            *ramp((0.6, 0.7), (1.0, 0.84), FLOATING),
            *3 * [{'start_ramp': 0.0}],  # several times between two steps
            *ramp((0.8, 0.9, 1.0, 1.1), (0.84, 0.68, 0.52, 0.36), FLOATING),
            *ramp((1.2, 1.3), (0.2, 0.2), FLOATING),
            {'effort_scale': 0.5},
            At(1.4, 0.5 * HOLD),  # no blend under way: at once
        ],
    ),
    'a start ramp of zero does not cut off a start': (
        {'start_ramp': 0.5},
        [
            *ramp((0.0, 0.1, 0.2), (0.0, 0.2, 0.4), FLOATING),
            {'start_ramp': 0.0},
            *ramp((0.3,), (0.4,), FLOATING),
        ],
    ),
    'losses in quick succession add up, and are forgotten after a while': (
        {'stop_ramp': 1.0},
        [
            At(10.0),
            At(10.11, HOLD, LOST, state=10.0),
            At(10.13, 0.98 * HOLD, LOST, state=10.0),
            At(10.14, HOLD, FLOATING),
            At(10.25, HOLD, LOST, state=10.14),
            At(10.27, 0.98 * HOLD, LOST, state=10.14),
            At(10.28, HOLD, FLOATING),
            At(10.39, HOLD, LOST, state=10.28),
            At(10.41, 0.98 * HOLD, LOST, state=10.28),  # 0.06 in all, of 0.05
            At(10.42, ANY, LOST),
            At(10.5, ANY, LOST),
            At(10.59, ANY, LOST),
            At(10.63, ANY, FLOATING),
            At(10.72, ANY, FLOATING),
            At(10.83, ANY, FLOATING),
            At(10.94, ANY, LOST, state=10.83),
            At(10.98, ANY, LOST, state=10.83),
            At(10.99, ANY, FLOATING),
        ],
    ),
}


@pytest.mark.parametrize('statement', CASES)
def test_commands_are_as_stated(statement):
    settings, events = CASES[statement]
    arm = lift(**settings)
    for event in events:
        if isinstance(event, At):
            event.check(arm)
        elif isinstance(event, dict):
            arm.change(**event)
        else:
            event(arm.loop)


def efforts_of(arm, times, **inputs):
    return np.array([arm.at(now, **inputs) for now in times])


@pytest.mark.parametrize('gap', [0.12, 0.125, 0.13, 0.4])
@pytest.mark.parametrize('stop_ramp', [0.1, 0.5, 2.0])
def test_intermittent_states_do_not_raise_and_lower_the_efforts_repeatedly(gap, stop_ramp):
    arm = lift(start_ramp=0.5, stop_ramp=stop_ramp)
    times = 0.01 * np.arange(1200)
    efforts = [arm.at(t, received=t if t < 1.0 else t - (t - 1.0) % gap)[0] for t in times]
    assert efforts[99] == pytest.approx(30.0)
    assert min(efforts[-300:]) == max(efforts[-300:])  # they neither sag nor shake
    assert gap < 0.2 or efforts[-1] == 0.0


@pytest.mark.parametrize('policy', StalePolicy)
def test_states_that_are_slightly_late_do_not_weaken_the_feedback(policy):
    arm = lift(start_ramp=0.5, stop_ramp=0.5, on_stale_state=policy, **CLOSED)
    target = np.array([0.01, 0.0])
    for k in range(1, 130):
        now = 0.11 * k
        before = arm.at(now - 0.005, None, None, reference(now - 0.005, target), now - 0.11)
        efforts = arm.at(now, None, None, reference(now, target))
        assert k < 2 or arm.phase is RUNNING
        assert before is None or np.abs(efforts - before).max() <= 40.0 * 0.02
    assert efforts == pytest.approx(HOLD + np.array([3.0, 1.0]))
    arm.at(now + 0.105, None, None, reference(now, target), now)
    assert arm.phase is LOST
    # The joint came closer meanwhile: the next command follows at once.
    efforts = arm.at(now + 0.11, None, None, reference(now + 0.11, 0.5 * target))
    assert efforts == pytest.approx(HOLD + np.array([1.5, 0.5]))


def test_feedback_acts_in_full_while_gains_change_all_the_time():
    arm = lift(start_ramp=0.5, kp=100.0, kd=0.0, **CLOSED)
    for k in range(2000):
        now, target = 0.001 * k, np.zeros(2)
        if k > 1000:
            target[0] = 0.01 * math.sin(5.0 * now)
            arm.change(kp=100.0 + 0.01 * (k % 7))
        efforts = arm.at(now, None, None, reference(now, target))
        # A change of kp by 0.06 makes a difference of 2 mN here.
        expected = HOLD + 100.0 * target[0] * np.array([3.0, 1.0])
        assert k < 1000 or efforts == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize('every', [1, 2, 50])
@pytest.mark.parametrize('kind', ['settings', 'inputs', 'blend'])
def test_a_blend_ends_although_changes_restart_it_all_the_time(every, kind):
    arm = lift(start_ramp=0.1)
    efforts_of(arm, np.arange(0.0, 1.0, 0.05))
    arm.change(effort_scale=0.5, effort_limits=8.0)
    steps = []
    for k in range(1200):
        steps.append(arm.at(1.0 + 0.001 * k))
        if k % every == 0 and kind == 'blend':
            arm.loop.blend()
        elif k % every == 0:
            arm.change(velocity_filter_cutoff=10.0 + k if kind == 'inputs' else 0.0)
    assert steps[-1] == pytest.approx([8.0, 5.0], rel=0.01)
    # No faster than a blend that is not restarted.
    assert np.abs(np.diff(steps, axis=0)).max() <= 22.0 * 0.001 / 0.1 + 1e-9


def test_the_time_to_fall_is_what_is_left_of_a_stop_ramp():
    arm = lift(stop_ramp=0.5)
    arm.at(0.0)
    assert arm.loop.shaper.time_to_fall == 0.5
    arm.loop.stop()
    for now, left in ((0.1, 0.5), (0.2, 0.4), (0.25, 0.35), (0.9, 0.25)):
        arm.at(now)
        assert arm.loop.shaper.time_to_fall == pytest.approx(left)
    arm.change(stop_ramp=9.0)
    efforts_of(arm, (1.0, 1.1, 1.2, 1.3))
    assert arm.loop.shaper.time_to_fall == 0.0
    arm.loop.resume()
    arm.at(1.4)
    assert arm.loop.shaper.time_to_fall == 9.0


def test_efforts_cut_during_a_blend_are_reported():
    arm = lift(start_ramp=0.5)
    efforts_of(arm, np.arange(0.0, 1.0, 0.05))
    high, low = (reference(1.0, efforts=(0.0, effort)) for effort in (4.0, -10.0))
    arm.loop.blend()
    for k in range(12):
        arm.at(1.0 + 0.01 * k, None, None, high)
    arm.loop.blend()
    for k, followed in enumerate([low, high, high]):
        arm.at(1.5 + 0.01 * k, None, None, followed._replace(time=1.5))
    # The rest of the difference would take the effort beyond its limit.
    assert arm.command.efforts[1] == 15.0
    assert arm.command.is_saturated.tolist() == [False, True]
    assert not arm.command.is_slowed.any()
    arm.loop.blend()
    arm.at(1.53, None, None, reference(1.53, accelerations=(0.0, 60.0)))
    assert arm.command.is_saturated.tolist() == [True, True]
    arm.at(1.54)
    assert not arm.command.is_saturated.any()


@pytest.mark.parametrize('start', [3.1, 6.0 * math.pi])
def test_continuous_joints_take_the_shorter_way(start):
    arm = lift(robot=WHEELS, gravity=(0, 0, 0), kp=1.0, kd=0.0, **CLOSED)
    target = 0.1 - start if start < 4.0 else 0.1
    found = arm.at(0.0, np.array([start, 0.0]), None, reference(0.0, (target, 0.0)))
    distance = math.remainder(target - start, 2.0 * math.pi)
    # Two bodies of inertia 1 about one axis: the first joint turns both.
    assert found == pytest.approx([2.0 * distance, distance])


SLOW = 1.0 - math.exp(-2.0 * math.pi * 1.0 * 0.05)  # share of a change after 50 ms at 1 Hz


@pytest.mark.parametrize(
    ('steps', 'expected'),
    [
        ([(0.0, 0.0, 0.0), (0.05, 1.0, 0.05)], SLOW),
        ([(1e5, 0.0, 1e5), (1e5 + 0.05, 1.0, 1e5 + 0.05)], SLOW),
        ([(0.0, 0.0, 0.0), (0.05, 1.0, 0.05), (0.06, 1.0, 0.05)], SLOW),  # each state once
        ([(0.0, 5.0, 0.0), (1.0, -1.0, 1.0)], -1.0),  # anew after a gap
        ([(0.0, 5.0, 0.0), start, (0.05, -1.0, 0.05)], -1.0),
        ([(0.0, 0.0, 0.0), (0.05, 1e9, 0.05), (1.0, 0.1, 1.0)], 0.1),
    ],
)
def test_the_velocity_filter_uses_each_state_once_and_begins_anew(steps, expected):
    arm = lift(velocity_filter_cutoff=1.0, **KEEP)
    for step in steps:
        if step is start:
            arm.loop.start()
        else:
            now, speed, received = step
            arm.at(now, None, np.array([0.0, speed]), None, received)
    assert arm.loop.law.velocities == pytest.approx([0.0, expected])


def test_the_velocity_filter_uses_the_arrival_times_of_each_joint():
    arm = lift(velocity_filter_cutoff=50.0)
    for k, now in enumerate(np.arange(0.0, 0.08, 0.002)):
        for joint in (0, 1)[k > 0 :]:
            name, speed = ROBOT.joint_names[joint], float(k > 0)
            store_state(arm.loop.collector, now, [name], [0.0], [speed])
        arm.loop.step(now)
    assert arm.loop.law.velocities == pytest.approx([0.0, 1.0], abs=1e-6)


@pytest.mark.parametrize(
    ('wanted', 'settings'),
    [
        ({'accelerations': [0.0, -1.7e308]}, {}),
        ({}, {'effort_scale': (1.0, 1e300)}),
        ({'efforts': [-math.inf, 0.0]}, {}),
        ({'accelerations': [5e307, 0.0], 'efforts': [math.nan, 0.0]}, FREE),
        (
            {'positions': [1.7e308, 0.0], 'velocities': [-1.7e308, 0.0]},
            {'max_tracking_error': 0.0, **CLOSED},
        ),
    ],
)
@pytest.mark.filterwarnings('error')
def test_efforts_that_are_not_finite_are_zero_instead(wanted, settings):
    arm = lift(**settings)
    arm.at(0.0)
    assert not arm.at(0.01, None, None, reference(0.01, **wanted)).any()
    assert arm.phase is Phase.NO_SOLUTION


def test_settings_change_completely_or_not_at_all():
    arm = lift()
    with pytest.raises(ConfigurationError, match='kp has 3 numbers, expected one, or one for ea'):
        arm.change(kp=(1.0, 2.0, 3.0), start_ramp=9.0)
    assert arm.loop.settings.start_ramp == 0.0


@pytest.mark.parametrize(
    ('joints', 'robot', 'words'),
    [
        (['low', 'middle'], LIFT, "joint 'middle' does not exist; joints are low, high"),
        (['low', 'low'], LIFT, 'lists a joint twice: low, low'),
        ([], NOTHING_MOVES, "'rock' has no movable joints"),
    ],
)
def test_names_the_joint_that_cannot_be_commanded(joints, robot, words):
    with pytest.raises(ConfigurationError, match=words):
        lift(joints, load_urdf(robot))


def test_the_recovery_time_is_twice_the_time_out_and_at_least_200_ms():
    assert [recovery_time(timeout) for timeout in (0.05, 0.5)] == [0.2, 1.0]
