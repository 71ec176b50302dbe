"""Payloads measured by simulated arms whose links, friction, offsets and gains are not known."""

from dataclasses import replace

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.payload import measure_payload
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.errors import ConfigurationError, RecordingError
import numpy as np
from payload_runs import Arm, motion_of, poses_of, random_load
import pytest
from robot_files import ROOT, STANFORD

ROBOTS = ROOT / 'test' / 'robots'
SEVEN_DOF = load_urdf(ROBOTS / 'seven_dof.urdf')
SEVEN_DOF_DYNAMICS = InverseDynamics(SEVEN_DOF)
ARMS = {
    'seven_dof': (SEVEN_DOF, 'tool0'),
    'gripper_arm': (load_urdf(ROBOTS / 'gripper_arm.urdf'), 'palm'),
    'stanford': (load_urdf(STANFORD), 'tool0'),
}


def measured(robot, link, seed, motion=motion_of, changes=False, **options):
    """Return errors of mass [kg] and centre of mass [m], their standard errors, and the load."""
    rng = np.random.default_rng(seed)
    arm = Arm(robot, rng, **options)
    load = random_load(link, rng, rng.uniform(1.0, 4.0))
    motion = motion(robot, rng)
    empty = arm.record(motion)
    if changes:
        arm.change()
    loaded = arm.record(motion, load)
    result = measure_payload(robot, loaded, empty, link, STANDARD_GRAVITY)
    error = np.append(result.body.mass - load[1], result.body.com - load[2])
    return error, np.append(result.mass_error, result.com_error), load, result


def short_motion(robot, rng):
    """Return a motion with few samples, for a test that is fast."""
    times, *signals = motion_of(robot, rng, 16.0)
    return times[::3], *(signal[::3] for signal in signals)


@pytest.mark.parametrize('motion', [short_motion, poses_of])
def test_mass_and_centre_of_mass_are_found_within_their_errors(motion):
    for seed in range(3):
        error, standard_error, load, result = measured(SEVEN_DOF, 'tool0', seed, motion)
        assert abs(error[0]) < 0.02 * load[1]
        assert np.abs(error[1:]).max() < 0.005
        assert (np.abs(error) < 3.0 * standard_error).all()
        assert standard_error[0] < 0.02 * load[1]
        assert result.is_certain
        assert result.unknown == ()
        assert np.linalg.eigvalsh(result.body.inertia)[0] > 0.0


@pytest.mark.long
@pytest.mark.parametrize('name', ARMS)
@pytest.mark.parametrize('motion', [motion_of, poses_of])
def test_errors_of_arms_with_torque_sensors(name, motion):
    runs = [measured(*ARMS[name], seed, motion)[:3] for seed in range(40)]
    errors, standard_errors = (np.array(each) for each in list(zip(*runs, strict=True))[:2])
    masses = np.array([load[1] for _, _, load in runs])
    assert rms(errors[:, 0] / masses) < 0.02
    assert rms(errors[:, 1:]) < 0.005
    assert rms(errors / standard_errors, axis=0).max() < 1.3


@pytest.mark.long
@pytest.mark.parametrize('motion', [motion_of, poses_of])
def test_printed_errors_are_honest(motion):
    """
    100 pairs of runs with wrong gains, which drift, and with friction that changes.

    The gain of each joint is wrong by 10 %, and changes by 1 % between the runs. Friction changes
    by 5 %. Every second arm measures motor currents, which contain all of the friction.
    """
    scores = []
    for seed in range(100):
        robot, link = list(ARMS.values())[seed % len(ARMS)]
        error, standard_error, *_ = measured(
            robot, link, seed, motion, True, measures_currents=bool(seed % 2), gain_error=0.1
        )
        scores.append(error / standard_error)
    is_within = np.abs(scores) < 2.0
    print(motion.__name__, np.mean(is_within, axis=0), rms(scores, axis=0))
    assert (np.mean(is_within, axis=0) > 0.9).all()  # of the mass, and of each coordinate


def rms(values, axis=None):
    """Return the root mean square."""
    return np.sqrt(np.mean(np.square(values), axis))


class ExactArm(Arm):
    """A robot whose links are as described; the gains of all efforts are wrong by a factor."""

    def __init__(self, robot, rng, gain):
        super().__init__(robot, rng)
        self.real = replace(self.real, robot=robot)
        self.gain = np.full(len(robot.joint_names), gain)


@pytest.mark.parametrize('gain', [0.9, 1.0, 1.25])
def test_a_common_error_of_the_gains_is_stated_and_is_in_the_error(gain):
    rng = np.random.default_rng(1)
    arm, load = ExactArm(SEVEN_DOF, rng, gain), random_load('tool0', rng, 2.0)
    motion = short_motion(SEVEN_DOF, rng)
    empty, loaded = arm.record(motion), arm.record(motion, load)
    result = measure_payload(SEVEN_DOF, loaded, empty, 'tool0', STANDARD_GRAVITY)
    assert result.ratio == pytest.approx(gain, abs=0.03)
    assert result.body.mass == pytest.approx(2.0 * gain, rel=0.02)
    assert result.body.mass / result.ratio == pytest.approx(2.0, rel=0.03)
    assert result.is_scaled == (gain != 1.0)
    assert abs(result.body.mass - 2.0) < 1.5 * result.mass_error
    assert (result.mass_error < 0.04) == (gain == 1.0)


def test_a_link_that_does_not_move_carries_nothing():
    rng = np.random.default_rng(7)
    arm, motion = Arm(SEVEN_DOF, rng), short_motion(SEVEN_DOF, rng)
    runs = [arm.record(motion) for _ in range(2)]
    base = SEVEN_DOF.link_names[0]
    with pytest.raises(ConfigurationError, match=f"link '{base}' does not move"):
        measure_payload(SEVEN_DOF, *runs, base, STANDARD_GRAVITY)


def test_without_gravity_the_ratio_is_unknown():
    rng = np.random.default_rng(8)
    arm, motion = Arm(SEVEN_DOF, rng), short_motion(SEVEN_DOF, rng)
    empty, loaded = arm.record(motion), arm.record(motion, random_load('tool0', rng, 2.0))
    weight = SEVEN_DOF_DYNAMICS.gravity_efforts(empty.positions)
    runs = [run._replace(efforts=run.efforts - weight) for run in (loaded, empty)]
    result = measure_payload(SEVEN_DOF, *runs, 'tool0', STANDARD_GRAVITY, has_gravity=False)
    assert result.body.mass == pytest.approx(2.0, rel=0.03)
    assert not result.is_scaled


def test_one_pose_shows_no_centre_of_mass():
    _, _, _, result = measured(
        SEVEN_DOF, 'tool0', 2, lambda robot, rng: poses_of(robot, rng, count=1)
    )
    assert result.unknown


def turn_about_the_vertical(robot, rng):
    """Return a slow motion of the first joint, whose axis is vertical, with the others at rest."""
    times, *signals = short_motion(robot, rng)
    signals = [0.1 * signal for signal in signals]
    lower_arm = rng.uniform(-1.0, 1.0, 6)
    for signal, rest in zip(signals, (lower_arm, 0.0, 0.0), strict=True):
        signal[:, 1:] = rest
    return times, *signals


def test_a_motion_about_a_vertical_axis_shows_no_centre_of_mass():
    _, _, _, result = measured(SEVEN_DOF, 'tool0', 3, turn_about_the_vertical)
    assert result.unknown


def test_another_motion_is_refused():
    rng = np.random.default_rng(4)
    arm = Arm(SEVEN_DOF, rng)
    empty, loaded = (arm.record(short_motion(SEVEN_DOF, rng)) for _ in range(2))
    with pytest.raises(RecordingError, match='the two runs are different motions'):
        measure_payload(SEVEN_DOF, loaded, empty, 'tool0', STANDARD_GRAVITY)


def test_an_arm_without_a_payload_carries_none():
    rng = np.random.default_rng(5)
    arm, motion = Arm(SEVEN_DOF, rng), short_motion(SEVEN_DOF, rng)
    runs = [arm.record(motion) for _ in range(2)]
    assert not measure_payload(SEVEN_DOF, *runs, 'tool0', STANDARD_GRAVITY).is_certain
