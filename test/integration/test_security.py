"""The policy of SROS 2 covers the node, and the node never starts without requested security."""

from fnmatch import fnmatchcase
import xml.etree.ElementTree as ElementTree

from fork_server import SERVER
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.node.node import InverseDynamicsNode
from inverse_dynamics_node.node.scheduling import Scheduling
from inverse_dynamics_node.node.worker import Worker
from inverse_dynamics_node.simulation.robot import RobotNode
from node_process import PATIENCE
import pytest
from rclpy.context import Context
from rclpy.node import Node
from robot_files import ROOT, STANFORD

RULES = 'topics subscribe', 'topics publish', 'services reply', 'services request'


def rules_of(enclave):
    """Return the permitted names by kind and permission."""
    found = {}
    for rule in RULES:
        kind, permission = rule.split()
        found[rule] = [name.text for name in enclave.iterfind(f'.//{kind}[@{permission}]/*')]
    return found


POLICY = ElementTree.parse(ROOT / 'config/sros2/policy.xml')
ENCLAVES = {enclave.get('path'): rules_of(enclave) for enclave in POLICY.iter('enclave')}


@pytest.fixture
def start(domain_id):
    """Return a function that creates a node in this process, with ROS arguments."""
    context, nodes = Context(), []

    def create(kind, *arguments):
        context.init(args=['--ros-args', *arguments], domain_id=domain_id)
        nodes.append(kind(context=context))
        return nodes[-1]

    yield create
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def permissions(enclave, node):
    """Return pairs of the names that an enclave permits and the names that a node uses."""
    own = node.get_name(), node.get_namespace()
    lists = (
        node.get_subscriber_names_and_types_by_node,
        node.get_publisher_names_and_types_by_node,
        node.get_service_names_and_types_by_node,
        node.get_client_names_and_types_by_node,
    )
    return [
        (permitted, [name for name, _ in find(*own) if '/_action/' not in name])
        for permitted, find in zip(ENCLAVES[enclave].values(), lists, strict=True)
    ]


def test_the_policy_covers_exactly_the_names_of_the_node(start):
    scheduling, worker = Scheduling(), Worker()  # before ROS, as in the program

    def own_node(context):
        return InverseDynamicsNode(lambda: False, scheduling, worker, context=context)

    node = start(own_node)
    *own, (requested, without_controller) = permissions(node.get_fully_qualified_name(), node)
    for permitted, used in own:
        assert sorted(permitted) == sorted(used)
    assert requested == ['/*/get_parameters']  # of the controllers that receive the commands
    assert not without_controller


def simulated_robot(context):
    return RobotNode(load_urdf(STANFORD), context=context)


def program(context):
    return Node('program', context=context)


@pytest.mark.parametrize(
    ('kind', 'enclave'), [(simulated_robot, '/driver'), (program, '/operator')]
)
def test_the_policy_covers_programs_around_the_node(kind, enclave, start):
    node = start(kind, '-r', 'commands:=/inverse_dynamics/commands')
    for permitted, used in permissions(enclave, node):
        for each in used:
            assert any(fnmatchcase(each, pattern) for pattern in permitted), each
    assert len(node.get_service_names_and_types_by_node(node.get_name(), '/')) >= 7


def test_only_the_operator_may_call_the_node_and_only_the_driver_publishes_states():
    senders = [p for p, rules in ENCLAVES.items() if '/joint_states' in rules['topics publish']]
    assert senders == ['/driver']
    callers = [p for p, rules in ENCLAVES.items() if rules['services request']]
    assert callers == ['/inverse_dynamics', '/operator']
    replies = ENCLAVES['/inverse_dynamics']['services reply']
    assert set(ENCLAVES['/operator']['services request']) == set(replies)
    assert ENCLAVES['/watch']['topics publish'] == ['/parameter_events']
    action = '/inverse_dynamics/follow_joint_trajectory'
    for path, right in (('inverse_dynamics', 'execute'), ('operator', 'call')):
        rule = f".//enclave[@path='/{path}']//actions[@{right}='ALLOW']/action"
        assert [each.text for each in POLICY.iterfind(rule)] == [action]
    assert len(list(POLICY.iter('action'))) == 2


@pytest.mark.parametrize(
    ('settings', 'words'),
    [
        ({}, 'ROS_SECURITY_KEYSTORE'),
        ({'ROS_SECURITY_KEYSTORE': '{keystore}'}, "enclaves/nosuch' does not exist"),
        (
            {
                'ROS_SECURITY_KEYSTORE': '{keystore}',
                'ROS_SECURITY_ENCLAVE_OVERRIDE': '/inverse_dynamics',
            },
            'ROS_SECURITY_ENABLE is true: set ',
        ),
        (
            {'ROS_SECURITY_STRATEGY': 'enforce'},
            "ROS_SECURITY_STRATEGY is 'enforce', expected Enforce or Permissive",
        ),
    ],
    ids=['no keystore', 'no enclave', 'no certificates', 'not quite Enforce'],
)
def test_the_node_never_starts_unprotected(
    run_node, robot, monkeypatch, tmp_path, settings, words
):
    (tmp_path / 'enclaves' / 'inverse_dynamics').mkdir(parents=True)
    robot.publish_state(['joint_1'], [0.0])
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    for name, value in settings.items():
        monkeypatch.setenv(name, value.format(keystore=tmp_path))
    node = run_node('--enclave', '/nosuch', robot_description_file=STANFORD)
    assert robot.wait_for_end(node) == 1
    assert words in node.output
    assert 'Traceback' not in node.output
    assert 'efforts for' not in node.output
    assert not robot.commands


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['watch'], 'ROS_SECURITY_ENCLAVE_OVERRIDE'),
        (
            ['simulate', STANFORD, '--ros-args', '--enclave', '/nosuch'],
            "enclaves/nosuch' does not",
        ),
    ],
    ids=['watch', 'simulate with arguments'],
)
def test_tools_without_an_enclave_print_one_line(arguments, words, domain_id, tmp_path):
    settings = {
        'ROS_DOMAIN_ID': str(domain_id),
        'ROS_SECURITY_ENABLE': 'true',
        'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(tmp_path),
    }
    program = ['-m', 'inverse_dynamics_node.cli.main', *arguments]
    result = SERVER.call(program, settings, timeout=PATIENCE)
    assert (result.returncode, result.stdout) == (1, '')
    (line,) = result.stderr.splitlines()
    assert 'ROS does not start: ' in line
    assert words in line


def test_arguments_of_ros_end_with_two_dashes(domain_id):
    arguments = ['watch', '--ros-args', '--foo', '--', '--for', '1']
    program = ['-m', 'inverse_dynamics_node.cli.main', *arguments]
    result = SERVER.call(program, {'ROS_DOMAIN_ID': str(domain_id)}, timeout=PATIENCE)
    assert (result.returncode, result.stdout) == (1, '')
    (line,) = result.stderr.splitlines()
    assert '--foo' in line
