"""Payloads measured by simulated arms whose links, friction, offsets and gains are not known."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.payload import measure_payload
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.errors import RecordingError
import numpy as np
from payload_runs import Arm, motion_of, poses_of, random_load
import pytest
from robot_files import ROOT, STANFORD

ROBOTS = ROOT / 'test' / 'robots'
SEVEN_DOF = load_urdf(ROBOTS / 'seven_dof.urdf')
ARMS = {
    'seven_dof': (SEVEN_DOF, 'tool0'),
    'gripper_arm': (load_urdf(ROBOTS / 'gripper_arm.urdf'), 'palm'),
    'stanford': (load_urdf(STANFORD), 'tool0'),
}


def measured(robot, link, seed, motion=motion_of, has_empty=True, measures_currents=False):
    """Return errors of mass [kg] and centre of mass [m], their standard errors, and the load."""
    rng = np.random.default_rng(seed)
    arm = Arm(robot, rng, measures_currents)
    load = random_load(link, rng, rng.uniform(1.0, 4.0))
    motion = motion(robot, rng)
    empty, loaded = arm.record(motion), arm.record(motion, load)
    result = measure_payload(robot, loaded, empty if has_empty else None, link, STANDARD_GRAVITY)
    error = np.append(result.body.mass - load[1], result.body.com - load[2])
    return error, np.append(result.mass_error, result.com_error), load, result


def short_motion(robot, rng):
    """Return a motion with few samples, for a test that is fast."""
    times, *signals = motion_of(robot, rng, 16.0)
    return times[::3], *(signal[::3] for signal in signals)


@pytest.mark.parametrize('motion', [short_motion, poses_of])
def test_mass_and_centre_of_mass_are_found_within_their_errors(motion):
    error, standard_error, load, result = measured(SEVEN_DOF, 'tool0', 0, motion)
    assert abs(error[0]) < 0.02 * load[1]
    assert np.abs(error[1:]).max() < 0.005
    assert (np.abs(error) < 3.0 * standard_error).all()
    assert standard_error[0] < 0.02 * load[1]
    assert result.is_certain
    assert result.unknown == ()
    assert result.poses == (7 if motion is poses_of else 0)
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
    normalised = rms(errors / standard_errors, axis=0)  # of the mass, and of each coordinate
    assert normalised.min() > 0.7
    assert normalised.max() < 1.3


def rms(values, axis=None):
    """Return the root mean square."""
    return np.sqrt(np.mean(np.square(values), axis))


def test_without_an_empty_run_the_error_contains_wrong_links():
    error, alone, _, result = measured(SEVEN_DOF, 'tool0', 1, short_motion, has_empty=False)
    _, both, _, _ = measured(SEVEN_DOF, 'tool0', 1, short_motion)
    assert alone[0] > 3.0 * both[0]
    assert (np.abs(error) < 3.0 * alone).all()
    assert np.isnan(result.matched)


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
