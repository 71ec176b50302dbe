"""A contact lets the arm float, or stops it, until the node is enabled."""

from dataclasses import replace

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import ContactPolicy, Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
import numpy as np
import pytest
from states import PLANAR, Q, reference, REST, store_state

NAMES = PLANAR.joint_names
HOLD = InverseDynamics(PLANAR).gravity_efforts(Q)
PERIOD = 0.005  # [s]
SETTINGS = Settings(
    mode=Mode.JOINT_IMPEDANCE,
    start_ramp=0.1,
    stop_ramp=0.2,
    stiffness=60.0,
    contact_limits=(8.0, 4.0),
    use_urdf_effort_limits=False,
)
PUSH = np.array([0.0, 6.0])  # [N m]


class PushedArm:
    """An arm at rest, whose drives measure their commands and a push."""

    def __init__(self, settings=SETTINGS):
        self.loop, self.now = ControlLoop(PLANAR, settings=settings), 0.0

    def play(self, seconds, push=0.0, q=Q):
        """Return all commands."""
        efforts = []
        for _ in range(round(seconds / PERIOD)):
            measured = InverseDynamics(PLANAR).gravity_efforts(q) + push
            store_state(self.loop.collector, self.now, NAMES, q, REST, measured)
            efforts.append(self.loop.step(self.now).efforts.copy())
            self.now += PERIOD
        return np.array(efforts)


def test_the_arm_floats_after_a_contact_until_it_is_enabled():
    arm = PushedArm()
    arm.play(1.0)
    assert arm.loop.phase is Phase.HOLDING
    arm.play(0.1, PUSH)
    arm.play(0.1)  # too short for a contact
    assert arm.loop.phase is Phase.HOLDING
    moved = Q + 0.01
    pushed = arm.play(1.0, PUSH, moved)
    assert arm.loop.phase is Phase.CONTACT
    assert arm.loop.supervisor.contact.startswith(f'at {NAMES[1]}: ')
    assert 'limit 4 N m' in arm.loop.supervisor.contact
    # The springs, which pull back before, are gone without a step.
    floating = InverseDynamics(PLANAR).gravity_efforts(moved)
    assert np.abs(pushed[0] - floating).max() > 0.3
    assert pushed[-1] == pytest.approx(floating)
    assert np.abs(np.diff(pushed, axis=0)).max() < 0.1
    arm.loop.follow(reference(arm.now, moved + 0.1))
    assert arm.play(0.1, 0.0, moved)[-1] == pytest.approx(floating)
    assert arm.loop.phase is Phase.CONTACT
    arm.loop.resume()
    arm.play(1.0, 0.0, moved)
    assert arm.loop.phase is Phase.HOLDING


def test_the_arm_stops_after_a_contact_if_wanted():
    arm = PushedArm(replace(SETTINGS, on_contact=ContactPolicy.STOP))
    arm.play(1.0)
    efforts = arm.play(0.6, PUSH)
    assert arm.loop.phase is Phase.STOPPED
    assert not efforts[-1].any()
    assert arm.loop.supervisor.contact.startswith('at ')
    arm.loop.resume()
    assert arm.play(1.0)[-1] == pytest.approx(HOLD)


@pytest.mark.parametrize(
    ('changes', 'push'),
    [
        ({'contact_limits': np.inf}, PUSH),  # the default
        ({}, 0.5 * PUSH),
        ({}, np.nan),  # not measured
    ],
)
def test_other_efforts_are_no_contact(changes, push):
    arm = PushedArm(replace(SETTINGS, **changes))
    arm.play(1.0)
    assert arm.play(1.0, push)[-1] == pytest.approx(HOLD)
    assert arm.loop.phase is Phase.HOLDING


def test_what_holds_the_arm_during_the_start_ramp_is_no_contact():
    arm = PushedArm(replace(SETTINGS, start_ramp=1.0))
    arm.play(0.9, -HOLD)
    arm.play(1.0)
    assert arm.loop.phase is Phase.HOLDING


def test_no_trajectory_begins_after_a_contact():
    arm = PushedArm(replace(SETTINGS, mode=Mode.COMPUTED_TORQUE))
    arm.play(1.0)
    arm.loop.follow(reference(arm.now, Q))
    arm.play(0.5, PUSH)
    assert arm.loop.phase is Phase.CONTACT
    with pytest.raises(Exception, match='floating after a contact'):
        arm.loop.follow_trajectory(None, 0.0)


def test_a_contact_outlasts_a_dry_run_and_a_new_one_takes_time_again():
    arm = PushedArm()
    arm.play(1.0)
    arm.play(0.5, PUSH)
    for is_wanted in (True, False):
        arm.loop.switch_dry_run(is_wanted=is_wanted)
        arm.play(1.0)
    assert arm.loop.phase is Phase.CONTACT
    arm.loop.resume()
    arm.play(1.0)
    arm.play(0.1, PUSH)
    assert arm.loop.phase is Phase.HOLDING
    arm.play(0.1, PUSH)
    assert arm.loop.phase is Phase.CONTACT


def test_an_arm_that_floats_after_a_contact_is_guided_like_any_other():
    arm = PushedArm(replace(SETTINGS, guiding_damping=3.0))
    arm.play(1.0)
    arm.play(0.5, PUSH)
    store_state(arm.loop.collector, arm.now, NAMES, Q, np.array([0.1, 0.0]), HOLD)
    moving = arm.loop.step(arm.now).efforts
    assert moving - HOLD == pytest.approx([-0.3, 0.0], abs=1e-6)
