"""The node with the arguments and files that the launch file passes on."""

import os
import subprocess
import sys

from launch_arguments import ros_arguments
import rclpy
from rclpy.context import Context
from robot_files import STANFORD


def test_arguments_take_precedence_over_the_file(run_node, robot, tmp_path):
    urdf = tmp_path / 'my arm.urdf'
    urdf.write_text(STANFORD.read_text())
    (tmp_path / 'arm.yaml').write_text(
        '/**:\n  ros__parameters:\n    stop_ramp: 0.7\n'
        '/left/arm:\n  ros__parameters:\n'
        '    robot_description_file: other.urdf\n    joints: [joint_3]\n    dry_run: false\n'
    )
    topic = 'forward_effort_controller/commands'
    node = run_node(
        *ros_arguments(
            tmp_path,
            urdf=str(urdf),
            params_file=str(tmp_path / 'arm.yaml'),
            name='arm',  # as for one of two arms
            namespace='left',
            commands=topic,
            joints='[joint_2, joint_1]',
            dry_run='true',
            use_sim_time='true',
        )
    )
    robot.peer = '/left/arm'
    robot.wait_for_text(node, f'(dry run); nothing is sent to /left/{topic}')
    assert robot.get_parameter('dry_run') is True
    assert robot.get_parameter('use_sim_time') is True
    assert robot.get_parameter('robot_description_file') == str(urdf)
    assert robot.get_parameter('joints') == ['joint_2', 'joint_1']
    assert robot.get_parameter('stop_ramp') == 0.7


def test_arguments_that_are_not_given_do_not_change_the_file(run_node, robot, tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(
        f'/**:\n  ros__parameters:\n    robot_description_file: {STANFORD}\n'
        '    joints: [joint_3]\n    dry_run: false\n'
    )
    node = run_node(*ros_arguments(tmp_path, params_file=str(path), dry_rum='true'))
    robot.wait_for_text(node, 'efforts for joint_3 are sent to /inverse_dynamics/commands')
    assert robot.get_parameter('dry_run') is False
    assert robot.get_parameter('use_sim_time') is False


def test_without_a_word_on_it_the_node_starts_dry(tmp_path, domain_id):
    (tmp_path / 'arm.yaml').write_text('/**:\n  ros__parameters:\n    kp: 25.0\n')
    for given in ({}, {'params_file': str(tmp_path / 'arm.yaml'), 'dry_rum': 'true'}):
        context = Context()
        context.init(args=['--ros-args', *ros_arguments(tmp_path, **given)], domain_id=domain_id)
        try:
            node = rclpy.create_node('x', context=context, enable_rosout=False)
            assert node._parameter_overrides['dry_run'].value is True
            node.destroy_node()
        finally:
            context.shutdown()


def test_a_parameter_file_that_does_not_exist_ends_the_start(domain_id, tmp_path):
    node = [sys.executable, '-m', 'inverse_dynamics_node.node.main', '--ros-args']
    result = subprocess.run(
        [*node, *ros_arguments(tmp_path, params_file=str(tmp_path / 'nosuch.yaml'))],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 1
    assert f"params file: '--params-file {tmp_path}/nosuch.yaml'" in result.stderr
    assert 'Traceback' not in result.stderr
