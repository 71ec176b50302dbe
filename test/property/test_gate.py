"""Which faults `watch --for` lets pass; doc/evidence/gate.md counts them for more arms."""

from benchmarks import gate
from benchmarks.confusion import robot
from inverse_dynamics_node.analysis.diagnosis.live import Outcome
import numpy as np
import pytest

LONG = pytest.mark.long
ARM = robot('seven_dof')
JOINTS = [0, *(pytest.param(j, marks=LONG) for j in range(1, len(ARM.joint_names)))]
MOTIONS = [pytest.param('at rest', marks=LONG), pytest.param('swaying', marks=LONG), 'as asked']


def run_of(motion, friction):
    rng = np.random.default_rng(1979)
    return gate.Run(ARM, gate.poses(ARM, rng)[0], motion, rng, friction)


@pytest.mark.parametrize('friction', [0.0, gate.FRICTION])
@pytest.mark.parametrize('motion', MOTIONS)
@pytest.mark.parametrize('signal', ['factors', 'speeds'])
@pytest.mark.parametrize('joint', JOINTS)
def test_no_wrong_sign_of_an_effort_or_a_velocity_passes(joint, signal, motion, friction):
    run = run_of(motion, friction)
    getattr(run, signal)[joint] = -1.0
    assert run.result().outcome is not Outcome.AGREE


@pytest.mark.parametrize('friction', [gate.FRICTION, pytest.param(0.2, marks=LONG)])
def test_a_healthy_arm_passes_after_the_motion_that_watch_asks_for(friction):
    run = run_of('as asked', friction)
    gate.healthy(run)
    assert run.result().outcome is Outcome.AGREE


def test_an_arm_at_rest_does_not_pass():
    result = run_of('at rest', gate.FRICTION).result()
    assert result.outcome is Outcome.NOT_CHECKED
    assert set(result.unchecked) == set(ARM.joint_names)
