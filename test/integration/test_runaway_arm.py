"""The node, as a process, stops an arm that runs away, until it is enabled again."""

from diagnostic_msgs.msg import DiagnosticStatus
from inverse_dynamics_node import load_urdf
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


def test_commands_in_another_order_stop_the_arm(run_program, run_node, robot):
    """The simulated robot gets the commands in alphabetical order."""
    pytest.importorskip('mujoco')
    order = np.argsort(JOINTS)
    relay = robot.node.create_publisher(Float64MultiArray, 'relay/commands', 10)
    robot.node.create_subscription(
        Float64MultiArray,
        'inverse_dynamics/commands',
        lambda m: relay.publish(Float64MultiArray(data=np.array(m.data)[order].tolist())),
        10,
    )
    states = robot.listen(JointState, 'joint_states')
    run_program(*SIMULATE)
    robot.wait_until(lambda: states, 'the simulated robot')
    node = run_node(robot_description_file=str(ARM), start_ramp=0.1, state_timeout=0.5)
    robot.wait_until(lambda: robot.commands and np.any(robot.commands[-1]), 'commands')
    robot.wait_for_text(node, ': stopped: ')
    robot.wait_until(lambda: not np.any(robot.commands[-1]), 'zeros')
