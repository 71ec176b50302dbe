"""The complete command: what a drive with gains of its own receives beside the efforts."""

from dataclasses import replace
import math

from inverse_dynamics_node.control.settings import Mode, Settings
import numpy as np
import pytest
from states import Arm, PERIOD, PLANAR, Q, reference

QD = np.array([0.1, -0.4])
TARGET, SPEED = Q + 0.1, np.array([0.5, 0.25])


class Drive(Arm):
    """An arm that is fed with the same state and reference in every step."""

    def __init__(self, robot=PLANAR, **settings):
        super().__init__(robot, is_observed=False, settings=Settings(start_ramp=0.1), **settings)

    def play(self, seconds, has_states=True, **motion):
        """Return the positions and velocities that are sent."""
        sent = []
        for _ in range(round(seconds / PERIOD)):
            now = self.now + PERIOD
            followed = reference(now, **motion) if motion else self.loop.reference
            self.at(now, Q, QD, followed, None if has_states else math.nan)
            sent.append(self.loop.drive_reference())
        return sent


def test_gains_of_the_drive_add_nothing_without_a_reference():
    for positions, velocities in Drive().play(0.2):
        assert positions == pytest.approx(Q, abs=0.0)
        assert velocities == pytest.approx(QD, abs=0.0)


def test_the_motion_of_the_reference_is_reached_within_the_start_ramp():
    arm = Drive()
    arm.play(0.05)
    motion = arm.play(0.2, positions=TARGET, velocities=SPEED)
    steps = np.diff([Q, *(positions for positions, _ in motion)], axis=0)
    assert np.abs(steps).max() <= 0.1 * PERIOD / 0.1 + 1e-12
    assert motion[-1][0] == pytest.approx(TARGET, abs=1e-15)
    assert motion[-1][1] == pytest.approx(SPEED, abs=1e-15)


def test_a_reference_without_velocities_is_at_rest():
    positions, velocities = Drive().play(0.2, positions=TARGET)[-1]
    assert positions == pytest.approx(TARGET)
    assert velocities == pytest.approx(np.zeros(2))


def test_a_reference_without_motion_lets_the_gains_add_nothing():
    reference = {'positions': None, 'velocities': None}
    positions, velocities = Drive().play(0.2, **reference)[-1]
    assert positions == pytest.approx(Q)
    assert velocities == pytest.approx(QD)


@pytest.mark.parametrize(('farthest', 'is_sent'), [(0.5, False), (0.0, True)])
def test_a_distant_reference_is_not_sent_unless_the_distance_is_unlimited(farthest, is_sent):
    arm = Drive(max_tracking_error=farthest)
    positions, _ = arm.play(0.2, positions=Q + 0.6)[-1]
    assert positions == pytest.approx(Q + 0.6 * is_sent)


def test_an_ignored_reference_is_not_sent():
    arm = Drive(mode=Mode.GRAVITY_COMPENSATION)
    positions, velocities = arm.play(0.2, positions=TARGET, velocities=SPEED)[-1]
    assert positions == pytest.approx(Q)
    assert velocities == pytest.approx(QD)


def begin_stop(arm):
    arm.loop.stop()
    return {}


def begin_dry_run(arm):
    arm.loop.switch_dry_run(is_wanted=True)
    return {}


def lose_states(arm):
    return {'has_states': False}


def end_reference(arm):
    arm.loop.reference = None
    return {}


def jump_away(arm):
    return {'positions': Q - 0.45, 'velocities': SPEED}


@pytest.mark.parametrize(
    'change', [begin_stop, begin_dry_run, lose_states, end_reference, jump_away]
)
def test_the_drive_is_led_gradually_from_the_reference_to_where_the_arm_is(change):
    """The gains of the drive may carry a part of the weight."""
    arm = Drive(stop_ramp=0.2)
    last = arm.play(0.2, positions=Q + 0.45, velocities=SPEED)[-1]
    arguments = change(arm)
    motion = arm.play(0.6, **arguments)
    steps = np.diff([last[0], *(positions for positions, _ in motion)], axis=0)
    assert np.abs(steps).max() <= 0.45 * PERIOD / 0.1 + 1e-12
    is_new = change is jump_away
    assert motion[-1][0] == pytest.approx(Q - 0.45 if is_new else Q)
    if not is_new:
        expected = QD if change is end_reference else np.zeros(2)
        assert motion[-1][1] == pytest.approx(expected)


def test_a_continuous_joint_takes_the_shorter_way():
    robot = replace(PLANAR, is_continuous=np.array([True, False]))
    arm = Drive(robot)
    positions, _ = arm.play(0.2, positions=TARGET + np.array([6.0 * math.pi, 0.0]))[-1]
    assert positions == pytest.approx(TARGET)


def follow(arm, seconds=0.2):
    """Follow a reference; return the last positions."""
    return arm.play(seconds, positions=TARGET, velocities=SPEED)[-1][0]


@pytest.mark.parametrize('cause', ['start', 'stop'])
def test_the_drive_is_led_to_the_reference_again_after_a_start_and_a_stop(cause):
    arm = Drive()
    follow(arm)
    if cause == 'start':
        arm.loop.start()
    else:
        arm.loop.stop()
        arm.play(0.6)
        arm.loop.resume()
    positions = follow(arm, PERIOD)
    assert np.abs(positions - Q).max() <= 0.1 * PERIOD / 0.1 + 1e-12
