"""The figures that `identify` prints, and what they depend on."""

from dataclasses import replace

from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.identification import identify_parameters
from inverse_dynamics_node.analysis.identification.result import (
    calibrated_urdf,
    identified_parameters,
)
from inverse_dynamics_node.errors import RecordingError
from inverse_dynamics_node.report.identification_report import residual_table
import numpy as np
import pytest
from robot_files import ROOT

ROBOT = ROOT / 'test' / 'robots' / 'planar_2r.urdf'


def planar_run(seed=0, duration=15.0, rate=50.0, spread=0.15, **recorded):
    """Return a robot, the real one, a recording and the generator of random numbers."""
    robot, rng = load_urdf(ROBOT), np.random.default_rng(seed)
    real = real_robot(robot, rng, spread)
    return robot, real, record(real, exciting_motion(robot, rng, duration, rate), rng, **recorded)


def test_the_validation_does_not_change_what_is_written():
    robot, real, training = planar_run(has_velocities=False)
    rng = np.random.default_rng(1)
    written = []
    for noise in (1e-6, 2e-4):
        motion = exciting_motion(robot, rng, 10.0, 50.0)
        unseen = record(real, motion, rng, position_noise=noise, has_velocities=False)
        result = identify_parameters(robot, [training], [unseen])
        assert result.accepted
        written.append((calibrated_urdf(result, ROBOT), identified_parameters(result)))
    assert written[0] == written[1]


def test_a_validation_without_efforts_of_a_joint_is_rejected():
    robot, real, training = planar_run()
    rng = np.random.default_rng(1)
    unseen = record(real, exciting_motion(robot, rng, 10.0, 50.0), rng)
    unseen.efforts[:, 1] = np.nan
    with pytest.raises(RecordingError, match='but not of elbow'):
        identify_parameters(robot, [training], [unseen])


def test_residuals_are_those_of_smoothed_efforts():
    robot, _, training = planar_run(noise=0.1)
    result = identify_parameters(robot, [training])
    assert result.unseen.smoothing == pytest.approx(0.14)  # seven samples: the least for degree 3
    for joint in result.joints:
        assert joint.unseen.identified < 0.08 * joint.measured
        assert joint.unseen.identified == pytest.approx(joint.noise, rel=0.3)
    assert 'smoothed over 140 ms' in residual_table(result)
    assert result.verdict.endswith('after smoothing over 140 ms')


def test_a_delay_is_part_of_the_residuals():
    robot, _, training = planar_run(delay=0.02)
    result = identify_parameters(robot, [training])
    assert result.delay_removed == pytest.approx(0.02, abs=2e-3)
    _, _, on_time = planar_run()
    punctual = identify_parameters(robot, [on_time])
    for late, joint in zip(result.joints, punctual.joints, strict=True):
        assert late.unseen.identified > 1.5 * joint.unseen.identified


def test_widths_of_friction_are_three_times_the_noise_of_the_velocity():
    robot, real, _ = planar_run()
    real = replace(real, width=np.full(2, 0.01))
    rng = np.random.default_rng(0)
    motion = exciting_motion(robot, rng, 15.0, 50.0)
    found = []
    for noise in (0.0, 0.05):
        noisy = record(real, motion, rng, velocity_noise=noise)
        found.append([j.terms.width for j in identify_parameters(robot, [noisy]).joints])
    assert max(found[0]) < 0.05
    assert min(found[1]) > 0.13
    steps = record(real, motion, rng)
    steps = steps._replace(velocities=np.round(steps.velocities / 0.05) * 0.05)
    assert min(j.terms.width for j in identify_parameters(robot, [steps]).joints) > 0.13


@pytest.mark.parametrize(
    ('factor', 'hint'),
    [(0.9, 'the efforts is 11% too small'), (1.25, 'the efforts is 20% too large')],
)
def test_a_common_factor_of_all_efforts_is_named(factor, hint):
    robot, _, training = planar_run(spread=1e-3, noise=0.01)
    scaled = training._replace(efforts=factor * training.efforts)
    result = identify_parameters(robot, [scaled])
    assert result.scale[0] == pytest.approx(factor, rel=0.005)
    ((text, found),) = result.warnings
    assert text.startswith(f'all efforts are {result.scale[0]:.2f} ± ')
    assert hint in found


def test_a_common_factor_is_not_named_without_need():
    robot, _, training = planar_run(spread=0.03, noise=0.01)
    assert identify_parameters(robot, [training]).warnings == ()
    for factor in (-0.5, 0.1):
        scaled = training._replace(efforts=factor * training.efforts)
        assert identify_parameters(robot, [scaled]).scale is None


def test_errors_of_friction_contain_that_it_changes_with_time():
    robot, real, training = planar_run(duration=30.0, noise=0.002)
    steady = identify_parameters(robot, [training])
    step = real.coulomb[0] * np.tanh(training.velocities[:, 0] / real.width[0])
    training.efforts[:, 0] += step * np.linspace(-0.3, 0.3, len(step))
    drifting = identify_parameters(robot, [training])
    errors = [r.joints[0].terms.errors['coulomb'] for r in (steady, drifting)]
    assert errors[1] > 3.0 * errors[0]
    assert 0.02 < errors[1] / real.coulomb[0] < 0.3
