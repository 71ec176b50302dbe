"""The complete command: what a drive with gains of its own receives beside the efforts."""

import math

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings
import numpy as np
import pytest
from robot_files import ROOT
from states import store_state, unobserved

ARM = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
Q, QD = np.array([0.3, -0.2]), np.array([0.1, -0.4])
TARGET, SPEED = Q + 0.1, np.array([0.5, 0.25])
PERIOD = 0.005


class Arm:
    """A loop that is fed with the same state and reference in every step."""

    def __init__(self, robot=ARM, **settings):
        self.loop = unobserved(ControlLoop(robot, settings=Settings(start_ramp=0.1, **settings)))
        self.loop.start()
        self.now = 0.0

    def step(self, q=Q, qd=QD, **reference):
        loop, self.now = self.loop, self.now + PERIOD
        if q is not None:
            store_state(loop.collector, self.now, loop.robot.joint_names, q, qd)
        if reference:
            loop.reference = Reference(np.zeros(2), np.zeros(2), self.now, **reference)
        assert loop.step(self.now) is not None
        return loop.drive_reference()

    def play(self, seconds, **arguments):
        return [self.step(**arguments) for _ in range(round(seconds / PERIOD))]


def test_gains_of_the_drive_add_nothing_without_a_reference():
    for positions, velocities in Arm().play(0.2):
        assert positions == pytest.approx(Q, abs=0.0)
        assert velocities == pytest.approx(QD, abs=0.0)


def test_the_motion_of_the_reference_is_reached_within_the_start_ramp():
    arm = Arm()
    arm.play(0.05)
    motion = arm.play(0.2, positions=TARGET, velocities=SPEED)
    steps = np.diff([Q, *(positions for positions, _ in motion)], axis=0)
    assert np.abs(steps).max() <= 0.1 * PERIOD / 0.1 + 1e-12
    assert motion[-1][0] == pytest.approx(TARGET, abs=1e-15)
    assert motion[-1][1] == pytest.approx(SPEED, abs=1e-15)


def test_a_reference_without_velocities_is_at_rest():
    positions, velocities = Arm().play(0.2, positions=TARGET)[-1]
    assert positions == pytest.approx(TARGET)
    assert velocities == pytest.approx(np.zeros(2))


def test_a_reference_without_motion_lets_the_gains_add_nothing():
    reference = {'positions': None, 'velocities': None}
    positions, velocities = Arm().play(0.2, **reference)[-1]
    assert positions == pytest.approx(Q)
    assert velocities == pytest.approx(QD)


@pytest.mark.parametrize(('farthest', 'is_sent'), [(0.5, False), (0.0, True)])
def test_a_distant_reference_is_not_sent_unless_the_distance_is_unlimited(farthest, is_sent):
    arm = Arm(max_tracking_error=farthest)
    positions, _ = arm.play(0.2, positions=Q + 0.6)[-1]
    assert positions == pytest.approx(Q + 0.6 * is_sent)


def test_an_ignored_reference_is_not_sent():
    arm = Arm(mode=Mode.GRAVITY_COMPENSATION)
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
    return {'q': None}


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
    arm = Arm(stop_ramp=0.2)
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
    robot = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
    robot = robot.__class__(**{**vars(robot), 'is_continuous': np.array([True, False])})
    arm = Arm(robot)
    positions, _ = arm.play(0.2, positions=TARGET + np.array([6.0 * math.pi, 0.0]))[-1]
    assert positions == pytest.approx(TARGET)


def follow(arm, seconds=0.2):
    """Follow a reference; return the last positions."""
    return arm.play(seconds, positions=TARGET, velocities=SPEED)[-1][0]


@pytest.mark.parametrize('cause', ['start', 'stop'])
def test_the_drive_is_led_to_the_reference_again_after_a_start_and_a_stop(cause):
    arm = Arm()
    follow(arm)
    if cause == 'start':
        arm.loop.start()
    else:
        arm.loop.stop()
        arm.play(0.6)
        arm.loop.resume()
    positions = follow(arm, PERIOD)
    assert np.abs(positions - Q).max() <= 0.1 * PERIOD / 0.1 + 1e-12
