"""The node as a process, and the robot that it is connected to, on their own domain."""

import itertools
import os
import random

import pytest

# Before rclpy is loaded: nothing that a test sends may leave this machine.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.pop('ROS_STATIC_PEERS', None)
os.environ.pop('ROS_LOCALHOST_ONLY', None)
os.environ.pop('FASTDDS_BUILTIN_TRANSPORTS', None)
os.environ.pop('FASTDDS_DEFAULT_PROFILES_FILE', None)
os.environ.pop('FASTRTPS_DEFAULT_PROFILES_FILE', None)
os.environ['PYTHONUNBUFFERED'] = '1'

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from domain_coordinator import domain_id as unused_domain_id
from fork_server import MAIN, SERVER
from late_compilation import REPORT
from node_process import NodeProcess, PATIENCE, RUNNING
from rclpy.context import Context
from robot_side import LATCHED, RobotSide
from stalls import StalledMachineError, StallMeter, TOLERATED
from std_msgs.msg import Bool

_ROBOTS = []  # of the test
# In turn, and in another order in each process: a domain that was used a moment ago may still have
# participants and shared memory of a process that was killed.
_DOMAINS = itertools.cycle(random.Random(os.getpid()).sample(range(1, 101), 100))


def pytest_configure():
    SERVER.start()  # in parallel with the imports of the tests


def pytest_collection_modifyitems(items):
    for item in items:
        if item.get_closest_marker('real_time'):
            item.add_marker(pytest.mark.flaky(reruns=5, only_rerun=['StalledMachineError']))
    # The longest test begins first, and the others fill the time of the other workers.
    items.sort(key=lambda item: item.path.name != 'test_first_hour.py')


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Repeat a test of a control loop in real time if it failed while the machine stood still."""
    if not item.get_closest_marker('real_time'):
        return (yield)
    with StallMeter() as stalls:
        try:
            return (yield)
        except Exception as error:
            if stalls.longest > TOLERATED:
                text = (
                    f'it failed, and the machine stood still for {stalls.longest:.2f} s: {error}'
                )
                raise StalledMachineError(text) from error
            raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """Add the logs of the nodes, and the messages of the robot, to the report of a failure."""
    report = yield
    if report.failed:
        for node in RUNNING:
            code = node.process.poll()
            state = 'running' if code is None else f'ended with code {code}'
            report.sections.append((f'log of node {node.process.pid}, {state}', node.output))
        for side in _ROBOTS:
            report.sections.append(('robot', side.describe()))
    return report


@pytest.fixture
def domain_id():
    with unused_domain_id(lambda: next(_DOMAINS)) as number:
        yield number


@pytest.fixture
def run_node(domain_id):
    """
    Return a function that starts the node as a process, with ROS arguments.

    With `prepare`, a function for the new process, it starts as for a user, not as a copy.
    """
    nodes = []

    def run(*arguments, program=('-m', MAIN), prepare=None, may_crash=False, **parameters):
        nodes.append(NodeProcess(domain_id, arguments, parameters, program, prepare, may_crash))
        RUNNING.append(nodes[-1])
        return nodes[-1]

    yield run
    for node in nodes:
        node.kill()
    RUNNING.clear()
    for node in nodes:
        assert REPORT not in node.output, node.output


@pytest.fixture
def run_program(domain_id):
    """Return a function that starts a program, whose arguments are those of `python`."""
    processes = []

    def run(*arguments, **files):
        processes.append(SERVER.run(arguments, {'ROS_DOMAIN_ID': str(domain_id)}, **files))
        return processes[-1]

    yield run
    for process in processes:
        process.terminate()
        process.wait(PATIENCE)


@pytest.fixture
def robot(domain_id):
    """Return a robot that publishes joint states and stores the commands that it receives."""
    context = Context()
    context.init(args=[], domain_id=domain_id)
    side = RobotSide(context)
    _ROBOTS.append(side)
    yield side
    _ROBOTS.remove(side)
    side.close()


@pytest.fixture
def wait_for_status(robot):
    """Return a function that waits for a status of a part, and returns its values."""
    heard = robot.listen(DiagnosticArray, '/diagnostics')

    def wait(part, level, words, key='', value=''):
        def find(array):
            for status in array.status:
                values = {pair.key: pair.value for pair in status.values}
                if status.name != f'inverse_dynamics: {part}' or status.level != level:
                    continue
                if words in status.message and (not key or value in values.get(key, ())):
                    return values
            return None

        try:
            robot.wait_until(lambda: any(map(find, heard)), f'{part}: {words}')
        except AssertionError as error:
            raise AssertionError(f'{error}; last was {heard[-1:]}') from error
        found = next(filter(None, map(find, heard)))
        heard.clear()
        return found

    return wait


@pytest.fixture
def drive_arm(run_node, run_program, robot):
    """Return a function that starts a simulated arm, and a node that drives it."""

    def drive(urdf, commands='inverse_dynamics/commands', **parameters):
        held = []
        robot.node.create_subscription(Bool, 'brakes', held.append, LATCHED)
        arguments = '--ros-args', '-r', f'commands:={commands}'
        run_program('-m', 'inverse_dynamics_node.cli.main', 'simulate', urdf, *arguments)
        node = run_node(robot_description_file=str(urdf), **parameters)
        robot.wait_until(lambda: held and not held[-1].data, 'an arm that follows the commands')
        return node

    return drive
