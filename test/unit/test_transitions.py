"""Events between two steps of the control loop cause no step, and end nothing that must go on."""

from dataclasses import replace

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop, Phase
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
import numpy as np
import pytest
from robot_files import ROOT
from states import store_state

ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
NAMES, TIP, SPEED = ROBOT.joint_names, ROBOT.link_names[-1], ROBOT.velocity_limits
Q, REST, DT = np.array([0.4, -0.7]), np.zeros(2), 0.01
NOTHING = np.zeros((3, 3))


class Arm:
    """A control loop with one joint state per step, and the steps of its commands."""

    def __init__(self, **settings):
        self.loop = ControlLoop(ROBOT, settings=Settings(**settings))
        self.loop.start()
        self.now, self.q, self.efforts, self.step = 1.0, Q.copy(), REST, REST

    def run(self, count=1, qd=REST, has_state=True, behind=None):
        """Step, perhaps with a reference for which the arm is too far back."""
        for _ in range(count):
            self.now += DT
            self.q = self.q + DT * np.asarray(qd)
            if has_state:
                store_state(self.loop.collector, self.now, NAMES, self.q, qd)
            if behind is not None:
                self.loop.follow(Reference(REST, REST, self.now, self.q + behind, np.array(qd)))
            efforts = self.loop.step(self.now).efforts.copy()
            self.efforts, self.step = efforts, np.abs(efforts - self.efforts)
        return self.step.max()


def change(arm, **settings):
    arm.loop.apply(replace(arm.loop.settings, **settings))


def load(arm, mass=2.0):
    arm.loop.loads.set_payload(TIP, mass, np.zeros(3), NOTHING)


@pytest.mark.parametrize('event', [load, lambda arm: change(arm, effort_scale=2.0)])
@pytest.mark.parametrize('policy', StalePolicy)
@pytest.mark.parametrize('lost', [1, 2, 3])
def test_an_event_while_states_are_lost_briefly_is_blended_in(policy, lost, event):
    arm = Arm(on_stale_state=policy, start_ramp=0.5, stop_ramp=0.5, state_timeout=0.015)
    arm.run(100)
    arm.run(1 + lost, has_state=False)
    event(arm)
    arm.run(has_state=False)
    largest = 2.0 * np.abs(arm.efforts).max()
    assert max(arm.run() for _ in range(20)) <= 2.1 * DT / 0.5 * largest


@pytest.mark.parametrize(
    ('before', 'after', 'behind'),
    [
        ({'max_tracking_error': 0.2}, {'max_tracking_error': 0.5}, 0.3),
        ({'velocity_filter_cutoff': 0.2}, {'velocity_filter_cutoff': 0.0}, 0.0),
        ({'guiding_speed': 0.5}, {'guiding_speed': 0.35}, None),
    ],
)
def test_a_change_of_what_is_computed_repeats_the_last_command(before, after, behind):
    arm = Arm(mode=Mode.COMPUTED_TORQUE, **before)
    qd = 0.4 * SPEED * np.array([1.0, 0.0])
    arm.run(100, behind=behind)
    arm.run(20, qd, behind=behind)
    change(arm, **after)
    assert arm.run(1, qd, behind=behind) < 1e-9
    # The restraint near a speed limit acts within 0.03 s.
    assert arm.run(1, qd, behind=behind) < (2.0 if behind is not None else 6.0)


def test_a_spring_at_a_position_limit_does_not_act_twice_after_an_event():
    arm = Arm(limit_stiffness=200.0, start_ramp=0.5)
    arm.loop.motion_limits._upper = arm.q - 0.08
    arm.run(100)
    load(arm, 1e-3)
    assert arm.run() < 1e-6
    assert max(arm.run() for _ in range(60)) < 0.1


def test_enable_between_two_steps_does_not_end_the_damping():
    arm = Arm(stop_damping=50.0, start_ramp=0.0)
    arm.run(10, (0.2, 0.1))
    arm.loop.stop()
    arm.run(10, (0.2, 0.1))
    arm.loop.resume()
    arm.loop.stop()
    arm.run(1, (0.2, 0.1))
    assert arm.loop.stop_damping.is_active
    arm.loop.resume()
    arm.run(1, (0.2, 0.1))
    assert not arm.loop.stop_damping.is_active


def test_efforts_fade_when_a_reference_ends_above_the_speed_of_guiding():
    arm = Arm(reference_timeout=0.05, start_ramp=0.0)
    qd = np.array([0.7 * SPEED[0], 0.0])
    arm.q = np.array([-2.5, 0.0])
    arm.run(30, qd, behind=0.0)
    full = np.abs(arm.efforts).max()
    steps = [arm.run(1, qd) for _ in range(12)]
    assert arm.loop.phase is Phase.FLOATING
    assert max(steps) < 0.5 * full


def test_a_fast_motion_during_a_pause_is_no_jump():
    arm = Arm(mode=Mode.COMPUTED_TORQUE, state_timeout=0.3, max_tracking_error=1.0)
    arm.q = np.array([-2.0, -0.7])
    qd = np.array([0.9 * SPEED[0], 0.0])
    arm.run(40, qd, behind=0.0)
    arm.run(14, qd, has_state=False, behind=0.0)
    arm.run(10, qd, behind=0.0)
    assert not arm.loop.supervisor.limit_stop


def test_velocity_limits_above_those_of_the_urdf_permit_faster_motion():
    arm = Arm(velocity_limits=10.0 * SPEED[0], start_ramp=0.5)
    arm.q = np.array([-2.5, 0.0])
    arm.run(100)
    qd = np.array([2.5 * SPEED[0], 0.0])
    repeated = [arm.run(1, qd, behind=0.0) == 0.0 for _ in range(30)]
    assert sum(repeated) <= 1


def test_an_arm_that_was_pushed_away_is_not_pulled_back_by_a_reference():
    arm = Arm(mode=Mode.JOINT_IMPEDANCE, max_tracking_error=0.3)
    held = arm.q.copy()
    arm.run(20, behind=0.0)
    arm.loop.reference = None
    arm.run(25, (2.0, 0.0))
    for _ in range(10):
        arm.loop.follow(Reference(REST, REST, arm.now, held, REST))
        arm.run()
        assert arm.loop.phase is Phase.HOLDING_TOO_FAR


def test_a_dry_run_reports_an_arm_that_falls_behind():
    arm = Arm(mode=Mode.COMPUTED_TORQUE)
    arm.loop.start(is_dry_run=True)
    arm.run(20, behind=0.45)
    arm.run(10, (0.5, 0.0), behind=0.55)
    assert 'from its reference' in arm.loop.motion_problem[0]
    assert not arm.loop.supervisor.limit_stop


def test_velocities_that_are_lost_again_and_again_are_named_once():
    arm = Arm()
    for k in range(20):
        now = arm.now + 0.2 * k
        store_state(arm.loop.collector, now, NAMES, Q, REST)
        store_state(arm.loop.collector, now + 0.1, NAMES, Q, [])
    assert arm.loop.step(arm.now + 4.0).lost_velocities == NAMES


def test_a_limit_stop_during_a_stop_has_no_gain_left():
    arm = Arm(stop_ramp=0.2, start_ramp=0.1)
    arm.run(60)
    arm.loop.stop()
    arm.run(11)
    gain = arm.loop.shaper.gain
    arm.loop.limit_stop('a reason')
    arm.run()
    assert arm.loop.shaper.gain <= gain
