"""`inverse_dynamics probe` with the real node and the simulated robot, through a relay."""

from contextlib import contextmanager
import json
import signal
import subprocess

from fork_server import SERVER
from inverse_dynamics_node import load_urdf
from node_process import PATIENCE
import numpy as np
import pytest
from robot_files import STANFORD
from std_msgs.msg import Bool, Float64MultiArray
from test_soft_stop import LATCHED

pytest.importorskip('mujoco')
pytestmark = pytest.mark.real_time

NAMES = list(load_urdf(STANFORD).joint_names)
MAIN = ['-m', 'inverse_dynamics_node.cli.main']
SETTINGS = {
    'robot_description_file': STANFORD,
    'mode': 'gravity_compensation',
    'start_ramp': 0.1,
    'state_timeout': 0.5,
    'kp': 33.0,
}
KEPT = 'mode', 'kp', 'velocity_limits', 'max_tracking_error', 'effort_reach', 'stop_ramp'


@contextmanager
def program(domain_id, *arguments, **options):
    process = SERVER.run([*MAIN, *arguments], {'ROS_DOMAIN_ID': str(domain_id)}, **options)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE)


@contextmanager
def floating_arm(robot, domain_id, run_node, factor=1.0, order=slice(None)):
    """Run a simulated arm that follows the commands of a node, with a fault between them."""
    relay = robot.node.create_publisher(Float64MultiArray, 'relay/commands', 10)
    robot.node.create_subscription(
        Float64MultiArray,
        'inverse_dynamics/commands',
        lambda m: relay.publish(Float64MultiArray(data=(factor * np.array(m.data))[order])),
        10,
    )
    held = []
    robot.node.create_subscription(Bool, 'brakes', held.append, LATCHED)
    remap = ['--ros-args', '-r', 'commands:=relay/commands']
    with program(domain_id, 'simulate', str(STANFORD), *remap):
        node = run_node(**SETTINGS)
        robot.wait_until(lambda: held and not held[-1].data, 'an arm that follows the commands')
        yield node


def probe(robot, domain_id, *options):
    """Run a probe while the relay goes on; return the exit code and the output."""
    arguments = 'probe', '--json', *options
    files = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT}
    with program(domain_id, *arguments, **files) as process:
        robot.wait_until(lambda: process.poll() is not None, 'the end of the probe')
        with process.stdout as lines:
            return process.returncode, lines.read()


@pytest.mark.long  # needs a machine without other tests: an arm without friction leaves its room
def test_an_arm_without_a_fault_passes_and_the_parameters_are_restored(domain_id, run_node, robot):
    with floating_arm(robot, domain_id, run_node):
        before = [robot.get_parameter(name) for name in KEPT]
        code, output = probe(robot, domain_id)
        assert code in (0, 4), output
        result = json.loads(output.splitlines()[-1])
        verdicts = [joint['verdict'] for joint in result['joints']]
        # On a busy machine, the simulated robot falls behind the pushes. This is not a fault.
        assert set(verdicts) <= {'right', 'not moved', 'restless'}, output
        assert verdicts.count('right') >= len(NAMES) // 2, output
        assert [robot.get_parameter(name) for name in KEPT] == before
        assert np.any(robot.commands[-1])


@pytest.mark.parametrize('fault', ['sign', 'order'])
def test_wrong_commands_end_the_probe_with_zero_efforts(domain_id, run_node, robot, fault):
    """joint_1 and joint_6 carry no weight, so that the arm floats with each of the faults."""
    sign = np.where(np.array(NAMES) == 'joint_1', -1.0, 1.0)
    faults = {'sign': {'factor': sign}, 'order': {'order': [5, 1, 2, 3, 4, 0]}}
    with floating_arm(robot, domain_id, run_node, **faults[fault]):
        code, output = probe(robot, domain_id)
        assert code == 3, output
        result = json.loads(output.splitlines()[-1])
        last = result['joints'][-1]
        # On a busy machine, the arm may be stopped before the push is judged, and late joint
        # states look like a wrong scale of another joint. test_probe.py in test/unit judges both.
        if last['verdict'] not in ('stopped', 'wrong scale'):
            verdicts = {'sign': ('joint_1', 'wrong sign'), 'order': ('joint_6', 'wrong joint')}
            assert (last['name'], last['verdict']) == verdicts[fault], result
            assert fault == 'sign' or {'joint_1'} <= {*last['moved']} <= {'joint_1', None}
        robot.wait_until(lambda: not np.any(robot.commands[-1]), 'zeros')


def test_an_arm_floats_on_after_an_interruption(domain_id, run_node, robot):
    with floating_arm(robot, domain_id, run_node):
        with program(domain_id, 'probe') as process:
            robot.wait_until(
                lambda: robot.get_parameter('mode') == 'computed_torque', 'the strict limits'
            )
            process.send_signal(signal.SIGINT)
            robot.wait_until(lambda: process.poll() is not None, 'the end of the probe')
        assert process.returncode == 130
        assert robot.get_parameter('mode') == 'gravity_compensation'
        count = len(robot.commands)
        robot.wait_until(lambda: len(robot.commands) > count + 50, 'commands')
        assert np.any(robot.commands[-1])


def test_a_dry_run_is_not_probed(domain_id, run_node, robot):
    run_node(**SETTINGS, dry_run=True)
    robot.publish_state(NAMES, np.zeros(6), np.zeros(6))
    code, output = probe(robot, domain_id)
    assert code == 1
    assert 'the node is in a dry run, expected a live arm that floats' in output
    assert not robot.commands
