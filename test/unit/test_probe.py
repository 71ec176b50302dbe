"""A probe finds faults of the commands without moving a joint far, and passes healthy arms."""

import math

import numpy as np
import pytest
from robot_files import OUR_ROBOTS

pytest.importorskip('mujoco')

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.probe import fit_scale, JointResult, Push, Verdict
from inverse_dynamics_node.control.laws import ComputedTorque, Reference
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.report.probe_report import as_json, probe_table, probe_verdict
from inverse_dynamics_node.simulation.mujoco import MujocoRobot
from probes import faults, ProbedArm
from states import joint_state

PATHS = {path.stem: path for path in OUR_ROBOTS}
FARTHEST = 0.05  # [rad or m]
LONG = pytest.mark.long
SAMPLE = [('planar_2r', 0.2), ('gripper_arm', 0.0), ('seven_dof', 0.02), ('continuous', 0.1)]
EVERY = [
    pytest.param(name, friction, marks=LONG)
    for name in PATHS
    for friction in (0.0, 0.02, 0.1, 0.2)
    if (name, friction) not in SAMPLE
]


@pytest.mark.parametrize(('name', 'friction'), [*SAMPLE, *EVERY])
def test_an_arm_without_a_fault_passes_and_ends_where_it_was(name, friction):
    arm = ProbedArm(PATHS[name], friction, gain_error=0.03).run()
    assert arm.outcome == 'passes', arm.probe.results
    assert arm.travel < 0.02
    assert arm.ended_at < 0.006
    assert arm.time < 8.0 * len(arm.joints)
    text = probe_verdict(list(arm.probe.results.values()), arm.joints, '')
    assert text.startswith(f'All {len(arm.joints)} joints move as commanded.')


@pytest.mark.parametrize(
    ('period', 'noise'), [(0.01, 1e-5), pytest.param(0.005, 1e-4, marks=LONG)]
)
def test_slow_and_noisy_joint_states_suffice(period, noise):
    arm = ProbedArm(PATHS['stanford'], 0.02, 0.03, noise=noise, period=period).run()
    assert arm.outcome == 'passes', arm.probe.results


FAULTS = [
    ('seven_dof', 0.0, 'sign shoulder_pan', Verdict.WRONG_SIGN),
    ('seven_dof', 0.1, 'sign wrist_roll', Verdict.WRONG_SIGN),
    ('seven_dof', 0.02, 'swap wrist_bend wrist_roll', Verdict.WRONG_JOINT),
    ('cartesian', 0.02, 'sign x_axis', Verdict.WRONG_SIGN),
    ('cartesian', 0.0, 'scale y_axis 2', Verdict.WRONG_SCALE),
    ('stanford', 0.0, 'scale joint_1 0.5', Verdict.WRONG_SCALE),
    ('planar_2r', 0.1, 'scale shoulder 0.5', Verdict.NOT_MOVED),
]


@pytest.mark.parametrize(('name', 'friction', 'fault', 'verdict'), FAULTS)
def test_a_fault_is_found_before_a_joint_has_moved_far(name, friction, fault, verdict):
    arm = ProbedArm(PATHS[name], friction, gain_error=0.03, fault=fault).run()
    assert arm.outcome == ('undecided' if verdict is Verdict.NOT_MOVED else 'stopped')
    assert arm.travel < FARTHEST
    (found,) = (r for r in arm.probe.results.values() if r.verdict is not Verdict.RIGHT)
    if not arm.probe.reason:  # the motion limits of the node may be faster
        assert found.verdict is verdict
        assert found.joint in fault.split()


@pytest.mark.long
@pytest.mark.parametrize('name', PATHS)
def test_every_wrong_sign_and_order_is_found(name):
    of_joints = faults(load_urdf(PATHS[name]).joint_names)
    for fault in of_joints['sign'] + of_joints['order']:
        for friction in (0.0, 0.02, 0.1):
            arm = ProbedArm(PATHS[name], friction, 0.03, fault=fault).run()
            assert arm.outcome == 'stopped', (fault, friction)
            assert arm.travel < FARTHEST, (fault, friction)


def test_a_joint_that_brakes_hold_is_not_called_right():
    arm = ProbedArm(PATHS['planar_2r'])
    arm.hardware._model.dof_frictionloss[arm.hardware._order[1]] = 1e3
    arm.run()
    assert arm.outcome == 'undecided'
    assert arm.found == {'elbow': Verdict.NOT_MOVED, 'shoulder': Verdict.RIGHT}
    text = probe_verdict(list(arm.probe.results.values()), arm.joints, '')
    assert 'elbow did not move with 7.5: brakes, a position controller or friction hold' in text


def test_springs_that_the_model_lacks_hide_only_the_scale():
    """As the gains of drives do, which get the position of the reference."""
    arm = ProbedArm(PATHS['planar_2r'], judges_scale=False)
    model, order = arm.hardware._model, arm.hardware._order
    model.jnt_stiffness[model.dof_jntid[order]] = 150.0
    model.qpos_spring[order] = arm.start_q
    model.dof_damping[order] = 10.0
    arm.run()
    assert arm.outcome == 'passes', arm.probe.results


def test_a_joint_at_its_limit_is_pushed_away_from_it():
    path = PATHS['gripper_arm']
    robot = load_urdf(path)
    finger = robot.joint_names.index('finger_left')
    arm = ProbedArm(path, 0.02)
    start = arm.start_q.copy()
    start[finger] = robot.upper[finger]
    arm = ProbedArm(path, 0.02, start=start).run()
    verdicts = [push.verdict for push in arm.probe.results['finger_left'].pushes]
    assert verdicts == [Verdict.NO_ROOM, Verdict.RIGHT]
    assert arm.outcome == 'passes'


@pytest.mark.parametrize('scale', [0.4, 1.0, 3.0])
@pytest.mark.parametrize('friction', [0.0, 0.5])
def test_the_scale_is_that_of_the_acceleration_beyond_the_friction(scale, friction):
    times = np.arange(0.0, 0.5, 0.002)
    effort = 10.0 * times
    net = np.where(np.abs(effort) > friction, effort - friction, 0.0)
    way = scale * np.cumsum(np.cumsum(net)) * 0.002**2
    breakaway, found = fit_scale(times, effort, way)
    if friction and scale < 0.6:
        assert np.isnan(found)  # a creep looks the same
    else:
        assert found == pytest.approx(scale, rel=0.1)
        assert breakaway == pytest.approx(friction, abs=0.1)


def test_large_friction_permits_no_statement_about_the_scale():
    times = np.arange(0.0, 2.0, 0.002)
    effort = 10.0 * times
    way = np.cumsum(np.cumsum(np.where(effort > 18.0, effort - 18.0, 0.0))) * 0.002**2
    breakaway, scale = fit_scale(times, effort, way)
    assert np.isnan(scale)
    assert breakaway == pytest.approx(20.0, abs=0.1)


PUSH = Push(Verdict.RIGHT, 1.25, 1.0, 'elbow')
VERDICTS = [
    (Verdict.WRONG_SIGN, {}, 'elbow moves against its commands: the sign is wrong'),
    (
        Verdict.WRONG_JOINT,
        {'pushes': (PUSH._replace(moved='shoulder'),)},
        'the commands of elbow move shoulder: the order of the joints is wrong',
    ),
    (Verdict.WRONG_SCALE, {}, 'elbow accelerates 2 times as fast as the model'),
    (
        Verdict.WRONG_SCALE,
        {'pushes': (PUSH._replace(scale=0.5),)},
        'elbow accelerates 2 times as slowly as the model',
    ),
    (
        Verdict.WRONG_LOAD,
        {'pushes': (PUSH, PUSH._replace(effort=7.25)), 'load_error': -3.0, 'load': 6.0},
        'elbow breaks away at 1.25 and 7.25: the efforts that hold it (6) are wrong by about -3',
    ),
    (Verdict.STOPPED, {}, 'the node stopped the arm when elbow was pushed'),
    (Verdict.RESTLESS, {}, 'the arm does not rest, so elbow was not pushed'),
    (Verdict.NO_ROOM, {}, 'elbow is at a position limit'),
]


@pytest.mark.parametrize(('verdict', 'values', 'words'), VERDICTS)
def test_verdicts_say_what_is_wrong(verdict, values, words):
    pushes = (PUSH._replace(scale=2.0),)
    result = JointResult('elbow', verdict, pushes)._replace(**values)
    assert words in probe_verdict([result], ['shoulder', 'elbow'], '')
    table = probe_table([result], load_urdf(PATHS['planar_2r']))
    assert verdict.value in table.splitlines()[-1]
    assert as_json([result], '')['joints'][0]['verdict'] == verdict.value


@pytest.mark.parametrize(
    ('offset', 'effort', 'is_added'),
    [(0.0, 2.0, True), (0.002, 2.0, True), (0.004, 2.0, False), (-0.004, 2.0, True)],
)
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_the_node_adds_no_effort_to_a_joint_that_has_moved_in_its_direction(
    offset, effort, is_added, sign
):
    dynamics = InverseDynamics(load_urdf(PATHS['planar_2r']))
    settings = Settings(mode=Mode.COMPUTED_TORQUE, effort_reach=0.003, kp=0.0, kd=0.0)
    law = ComputedTorque(dynamics, [0, 1])
    law.apply(settings, settings.expanded(2))
    q, rest = np.array([0.3, 0.4]), np.zeros(2)
    reference = Reference(rest, np.array([0.0, sign * effort]), 0.0, q, rest)
    moved = q + np.array([0.0, sign * offset])
    law.efforts(0.0, joint_state(moved, rest, 0.0), reference)
    assert law.added.tolist() == [0.0, sign * effort * is_added]


@pytest.mark.parametrize('name', ['planar_2r', pytest.param('stanford', marks=LONG)])
@pytest.mark.parametrize('friction', [0.0, 0.02, 0.1])
def test_an_arm_is_released_where_it_hangs_and_probed(name, friction):
    robot = load_urdf(PATHS[name])
    hanging = MujocoRobot(robot, np.full(len(robot.joint_names), 0.3), friction=False)
    hanging._model.dof_damping[:] = 3.0
    hanging.advance(15.0)
    arm = ProbedArm(PATHS[name], friction, 0.03, start=hanging.positions()).run()
    assert arm.outcome == 'passes', arm.probe.results
    assert arm.travel < 0.012


def test_an_arm_that_drifts_is_restless_and_has_no_wrong_order():
    """The drift has the same direction whatever is pushed."""
    drift = Push(Verdict.WRONG_JOINT, 1.0, math.nan, 'shoulder', 1.0, is_certain=False)
    to_and_fro = [drift, drift._replace(side=-1.0)]
    arm = ProbedArm(PATHS['planar_2r'])
    arm.probe.step(0.0, arm.start_q, np.zeros(2))
    for pushes, verdict in (
        ([drift, drift], Verdict.RESTLESS),
        ([drift, Push(Verdict.RIGHT, 1.0, 1.0, 'elbow', -1.0)], Verdict.RESTLESS),
        (to_and_fro, Verdict.WRONG_JOINT),
    ):
        assert arm.probe._judge(1, 'elbow', tuple(pushes), [0.0, 0.0]).verdict is verdict
