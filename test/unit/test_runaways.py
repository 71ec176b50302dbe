"""Faults between the node and the motors stop the arm before it becomes fast."""

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
    # States that are late as a whole are found only by the speed that they show too late.
    if fault and not fault.startswith('late') and (arm, mode, fault) not in SAMPLE
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
