"""The node, as a process, stops an arm that runs away, until it is enabled again."""

from diagnostic_msgs.msg import DiagnosticStatus
from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT
from robot_side import ZERO
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from test_soft_stop import run_moving_arm

ARM = ROOT / 'test/robots/seven_dof.urdf'
# Takes its commands from a relay.
SIMULATE = ['-m', 'inverse_dynamics_node.cli.main', 'simulate', ARM, '--ros-args']
SIMULATE += ['-r', 'commands:=relay/commands']
JOINTS = load_urdf(ARM).joint_names


def test_wrong_velocities_stop_the_arm_until_it_is_enabled(run_node, robot, wait_for_status):
    node, motion = run_moving_arm(run_node, robot, sign=-1.0)
    robot.wait_for_command(ZERO, tolerance=0.0)
    words = 'stopped: the velocities of joint_'
    robot.wait_for_text(node, words)
    assert 'contradict its positions' in node.output
    assert '[ERROR]' in node.output
    wait_for_status('loop', DiagnosticStatus.ERROR, words)
    motion.sign = 1.0
    motion.rest()
    count = len(robot.commands)
    assert robot.call(SetBool, 'enable', SetBool.Request(data=True)).success
    robot.wait_until(lambda: np.any(robot.commands[-1]), 'efforts after the stop')
    assert len(robot.commands) > count


def test_a_driver_whose_states_arrive_late_stops_the_arm(run_node, robot):
    robot.age = 0.07
    robot.publish_state(JOINTS, np.zeros(len(JOINTS)), np.zeros(len(JOINTS)))
    node = run_node(robot_description_file=str(ARM), mode='computed_torque')
    zeros = np.zeros(len(JOINTS))
    robot.publish_reference(JOINTS, zeros, positions=zeros, velocities=zeros)
    robot.wait_for_text(
        node, f'stopped: {JOINTS[0]} may oscillate with these gains, because joint'
    )


def test_an_arm_floats_after_a_contact_until_it_is_enabled(run_node, robot, wait_for_status):
    zeros = np.zeros(len(JOINTS))
    held = InverseDynamics(load_urdf(ARM)).gravity_efforts(zeros)
    robot.publish_state(JOINTS, zeros, zeros, held)
    limits = {'contact_limits': 5.0, 'state_timeout': 0.5, 'start_ramp': 0.1}
    node = run_node(robot_description_file=str(ARM), mode='joint_impedance', **limits)
    holding = 'holding position: no reference'
    robot.wait_for_text(node, holding)
    robot.publish_state(JOINTS, zeros, zeros, held + 7.0)
    words = 'floating after a contact at '
    robot.wait_for_text(node, words)
    wait_for_status('loop', DiagnosticStatus.WARN, words)
    robot.publish_state(JOINTS, zeros, zeros, held)
    assert robot.call(SetBool, 'enable', SetBool.Request(data=True)).success
    robot.wait_until(lambda: node.output.count(holding) == 2, 'the end of the contact')


def relay_commands(robot, faulty='', order=slice(None)):
    """Pass commands on to the simulated robot, with a wrong sign or in another order."""
    factor = np.where(np.array(JOINTS) == faulty, -1.0, 1.0)
    relay = robot.node.create_publisher(Float64MultiArray, 'relay/commands', 10)
    robot.node.create_subscription(
        Float64MultiArray,
        'inverse_dynamics/commands',
        lambda m: relay.publish(Float64MultiArray(data=(factor * m.data)[order].tolist())),
        10,
    )


@pytest.mark.parametrize('fault', ['sign', 'order'])
def test_wrong_commands_stop_the_arm(run_program, run_node, robot, fault):
    """One command with the wrong sign, and commands in alphabetical order."""
    pytest.importorskip('mujoco')
    faults = {'sign': {'faulty': 'elbow'}, 'order': {'order': np.argsort(JOINTS)}}
    relay_commands(robot, **faults[fault])
    states = robot.listen(JointState, 'joint_states')
    run_program(*SIMULATE)
    robot.wait_until(lambda: states, 'the simulated robot')
    node = run_node(robot_description_file=str(ARM), start_ramp=0.1, state_timeout=0.5)
    robot.wait_until(lambda: robot.commands and np.any(robot.commands[-1]), 'commands')
    robot.wait_for_text(node, ': stopped: ')
    robot.wait_until(lambda: not np.any(robot.commands[-1]), 'zeros')


def test_damping_that_drives_the_base_yaw_is_stopped(drive_arm, robot):
    """The yaw carries no weight, so that a wrong sign shows only in motion."""
    pytest.importorskip('mujoco')
    relay_commands(robot, JOINTS[0])
    states = robot.listen(JointState, 'joint_states')
    parameters = {'start_ramp': 0.1, 'state_timeout': 0.5, 'stop_damping': 50.0}
    node = drive_arm(ARM, 'relay/commands', **parameters)
    assert robot.call(SetBool, 'enable', SetBool.Request(data=False)).success
    robot.wait_for_text(node, ': stopped: ')
    robot.wait_until(lambda: not np.any(robot.commands[-1]), 'zeros')
    # The yaw, which gravity does not move, drives the other joints too.
    yaw = [state.velocity[state.name.index(JOINTS[0])] for state in states]
    assert np.abs(yaw).max() > 0.3
    assert ' moved at ' in node.output.partition(': stopped: ')[2]
