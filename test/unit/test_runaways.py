"""Faults between the node and the motors stop the arm before it becomes fast."""

from nominal_runs import NominalRun, ROBOTS
import pytest

pytest.importorskip('mujoco')

from inverse_dynamics_node import load_urdf
from runaways import ARMS, faults, LONGEST, MODES, Runaway

# The first cases take 0.1 s each; the others are long.
SAMPLE = [
    ('seven_dof', 'float', '-command elbow'),
    ('seven_dof', 'computed_torque', '-command shoulder_pan'),
    ('seven_dof', 'computed_torque', '-velocity all'),
    ('seven_dof', 'computed_torque', 'order alphabetical'),
    ('seven_dof', 'joint_impedance', '-axis shoulder_lift'),
    ('seven_dof', 'guiding', 'order reversed'),
    ('seven_dof', 'soft_stop', '-command shoulder_pan'),
    ('seven_dof', 'soft_stop', '-velocity shoulder_lift'),
]
EVERY = [
    pytest.param(arm, mode, fault, marks=pytest.mark.long)
    for arm, (path, _) in ARMS.items()
    if path
    for mode in MODES
    for fault in faults([j for j in load_urdf(path).joint_names if 'finger' not in j])
    if fault and (arm, mode, fault) not in SAMPLE
]


@pytest.mark.parametrize(('arm', 'mode', 'fault'), [*SAMPLE, *EVERY])
def test_no_joint_is_driven_beyond_its_speed_limit(arm, mode, fault):
    found = Runaway(arm, mode, fault).run()
    assert found.driven_beyond <= LONGEST + 1e-9
    if (arm, mode, fault) in SAMPLE:
        assert any(joint in found.reason for joint in found.joints)


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('arm', [arm for arm, (path, _) in ARMS.items() if path])
def test_without_a_fault_the_arm_goes_on(arm, mode):
    found = Runaway(arm, mode).run()
    assert not found.reason
    assert bool(found.top_speed > 0.001) is (mode not in ('float', 'guiding'))


@pytest.mark.parametrize('name', ['panda', 'seven_dof'])
def test_an_arm_without_a_fault_is_not_stopped_within_its_limits(name):
    if name not in ROBOTS:
        pytest.skip('the description of this robot is not installed')
    run = NominalRun(ROBOTS[name], seed=3).play(48.0)
    assert run.false_alarms == 0, run.stops


@pytest.mark.long
@pytest.mark.parametrize('name', ROBOTS)
def test_no_arm_without_a_fault_is_stopped_within_its_limits_in_ten_minutes(name):
    run = NominalRun(ROBOTS[name]).play(600.0)
    assert run.false_alarms == 0, run.stops
