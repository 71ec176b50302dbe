"""Conditions of the node, and the level, the message and the values that its status then has."""

import dataclasses
import math

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import Command, ControlLoop
from inverse_dynamics_node.control.settings import MeasuredGravity, Mode, Settings, StalePolicy
from inverse_dynamics_node.control.shaping import DryRun
from inverse_dynamics_node.node.status_text import describe_controllers, describe_imu_frame
from inverse_dynamics_node.robot.kinematics import rotation_of_rpy
from inverse_dynamics_node.robot.model import ModelWarning
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from states import store_state

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from inverse_dynamics_node.node.monitor import lasting_silence, Monitor
from inverse_dynamics_node.node.scheduling import Scheduled
from inverse_dynamics_node.node.status import describe_node, Surroundings
from inverse_dynamics_node.ros.controllers import Controller
from inverse_dynamics_node.ros.diagnostics import (
    Level,
    NodeStatus,
    Part,
    read_status,
    write_status,
)
from inverse_dynamics_node.ros.graph import OtherNodes, SimulatedClock

OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR
ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
ARM = load_urdf(STANFORD)
JOINTS = ROBOT.joint_names
BOTH = ', '.join(JOINTS)
NAMES = ARM.joint_names
TIP = ROBOT.link_names[-1]
REST, REST6 = np.zeros(2), np.zeros(6)
WAITING = f'waiting for the positions of {BOTH} on /joint_states (1 publisher)'
NEITHER = np.zeros(2, dtype=bool)
SECOND = np.array([False, True])
FINE = Surroundings(
    state='active',
    is_active=True,
    name='/arm',
    receivers=1,
    publishers=1,
    silence=0.0,
    state_rate=123.4,
    inputs=('/joint_states (1 publisher)', '/imu (0 publishers)'),
    topics=('/joint_states', '/arm/joint_efforts', '/arm/external_efforts'),
    others=OtherNodes('/arm/commands'),
    controllers=[],
    objection='',
    clock=None,
    scheduled=Scheduled('SCHED_FIFO', 50, '', is_requested=False),
)
CLOSED = Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE
RISING = 'efforts rise again after joint states have arrived for 0.2 s without a gap longer than '
TOO_FAR = 'starts too far away or jumps too far (max_tracking_error: 0.2 rad or m)'
NO_STATE = f'no joint state of {BOTH} for more than 0.1 s'
NO_SUBSCRIBERS = 'the commands have no subscribers that match; another type or quality of service'
NO_DAMPING = 'joints reported without velocity have no damping in '
NOT_SOLVED = 'no finite efforts for this joint state and reference'
NO_CLOCK = 'use_sim_time is set, but nothing publishes /clock'
OSCILLATING = 'shoulder may oscillate: with a delay of 5 ms, kd should be at most 2e+02'
SET_ORDER = 'than that of the node; set the parameter joints to [joint_3, joint_2, joint_1]'
SET_TWO = (
    '/fec expects 2 efforts, but the node commands 3; set the parameter joints to '
    '[joint_1, joint_2]'
)
SET_OTHERS = (
    '/fec expects efforts for other joints than the node commands; set the parameter joints to '
    '[joint_1, joint_2, joint_6]'
)
NO_JOINT = (
    "/fec expects 4 efforts, but the node commands 3; finger: no joint of robot 'stanford' that "
    'the node can command'
)
NO_EFFORTS = (
    "/fec takes the commands as 'position' of the joints, expected effort: set its parameter "
    'interface_name to effort'
)
COMPENSATES = (
    '/ns/franka_robot_state_broadcaster belongs to a driver that compensates gravity itself, but '
    'include_gravity is true, so the arm would get gravity twice: use the settings in '
    'config/robots/franka_ros2.yaml'
)
TURNED = load_urdf(ROOT / 'test/robots/seven_dof.urdf').joint_names[2]
DEGREES = [0.0, 57.3, 0.5, 0.0, 4.0, 0.0]
IN_DEGREES = (
    'joint_2 is at 57.3 rad, outside its limits -1.745 to 1.745 (in degrees?); '
    'joint_5 is at 4 rad, outside its limits -1.92 to 1.92'
)


class Node:
    """A control loop, what surrounds it, and the statistics since the last report."""

    def __init__(self, robot=ROBOT, joints=(), *, has_imu=False, locked=None, **settings):
        options = {'has_imu': has_imu, 'locked': locked, 'period': 0.05}
        self.loop = ControlLoop(robot, joints, Settings(**settings), **options)
        self.monitor = Monitor()
        self.around = FINE
        self.now = 0.0

    def amid(self, **around):
        """Change what surrounds the loop."""
        self.around = self.around._replace(**around)
        return self

    def receive(self, now, q=(0.1, 0.2), qd=(0.0, 0.0), joints=JOINTS):
        store_state(self.loop.collector, now, joints, list(q), list(qd))
        return self

    def step(self, now, until=None):
        """Step at a time, or every 0.05 s until another time."""
        for time in (now,) if until is None else np.arange(now, until, 0.05):
            self.now = float(time)
            self.loop.step(self.now)
        return self

    def refer(self, now, accelerations=REST, positions=None):
        self.loop.reference = Reference(accelerations, REST, now, positions=positions)
        return self

    def put(self, **values):
        """Change attributes of the loop."""
        for name, value in values.items():
            setattr(self.loop, name, value)
        return self

    def call(self, method, *arguments):
        """Call a method of the loop."""
        getattr(self.loop, method)(*arguments)
        return self

    def dry(self):
        return self.put(dry_run=DryRun(is_active=True))

    def status(self):
        status = describe_node(self.now, self.loop, self.around, self.monitor)
        self.monitor.begin_report()
        for level, message, values in status.values():
            assert isinstance(level, Level)
            assert message
            assert all(isinstance(text, str) and text != 'None' for text in values.values())
        return status


def fresh(**settings):
    return Node(**settings).receive(0.0).step(0.0)


def lost(**settings):
    return fresh(**settings).step(0.0, until=0.2)


def stopped(end, **settings):
    return fresh(**settings).step(0.0, until=0.1).call('stop').step(0.1, until=end)


def fallen():
    return fresh().step(0.0, until=2.05)


def inactive(node):
    return node.amid(is_active=False, state='inactive')


def amid_others(**others):
    return fresh().amid(others=OtherNodes('/c', **others))


def amid_clock(*clock):
    return fresh().amid(clock=SimulatedClock(*clock))


def moved(now):
    return Node().receive(now).step(now).put(motion_problem=('too fast', 0.0))


def too_far(mode):
    node = fresh(mode=mode, max_tracking_error=0.2)
    return node.refer(0.05, positions=REST + 3.0).step(0.06)


def rejecting():
    node = fresh()
    node.monitor.reject('imu', 'broken')
    node.monitor.reject('imu', 'broken')
    return node


def with_cuts(*flags):
    node = fresh()
    for flag in flags:
        node.monitor.step(0.0, 1e-4, Command(REST, flag, SECOND), JOINTS)
    return node


def late(now):
    """Return an arm with a joint that is locked, and one that is late some time after 0 s."""
    names, q = ARM.joint_names, [0.0, 0.0, 0.5, 0.0, 0.0]
    node = Node(ARM, names[:4], locked={names[4]: 0.125})
    node.receive(0.0, q, [0.0] * 5, [*names[:4], names[5]])
    return node.receive(now, q[:4], [0.0] * 4, names[:4]).step(now)


def with_imu(now, *, has_message=True):
    node = Node(has_imu=True).receive(now)
    if has_message:
        node.loop.loads.set_base_motion(0.0, (0.0, 0.0, 9.8), np.zeros(3))
    return node.step(now)


def with_controller(joints, interface=''):
    """Return an arm with three commanded joints, and a controller that takes the commands."""
    controller = Controller('/fec', tuple(joints), interface, is_late=False)
    node = Node(ARM, NAMES[:3]).amid(controllers=[controller])
    return node.amid(objection=describe_controllers(node.loop, [controller]))


def beside(driver, *, include_gravity=True):
    others = FINE.others._replace(names=('/arm', f'/ns/{driver}'))
    node = Node().amid(others=others)
    node.loop.loads.include(gravity=include_gravity)
    return node


def turned():
    """Return an arm whose third joint is a turn away from its reference."""
    arm = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
    q, zeros = np.full(7, 0.3), np.zeros(7)
    node = Node(arm, mode=Mode.COMPUTED_TORQUE).receive(1.0, q, zeros, arm.joint_names)
    node.loop.reference = Reference(zeros, zeros, 1.0, q + 2.0 * math.pi * np.eye(7)[2], zeros)
    return node.step(1.0)


def warned(count):
    warnings = tuple(ModelWarning(f'text {k}', 'hint') for k in range(count))
    return Node(dataclasses.replace(ROBOT, warnings=warnings))


def at_normal_priority(*, is_requested):
    problem = 'normal priority: not permitted'
    return fresh().amid(scheduled=Scheduled('SCHED_OTHER', 0, problem, is_requested))


ACTIVITIES = [
    (fresh, 'floating: no reference'),
    (lambda: fresh().dry(), 'dry run: floating: no reference'),
    (lambda: fresh().refer(0.0).step(0.05), 'following the reference'),
    (
        lambda: fresh().refer(0.0).receive(1.0).step(1.0),
        'floating: no reference for more than 0.5 s',
    ),
    (
        lambda: fresh(mode=Mode.GRAVITY_COMPENSATION),
        'floating: the reference is not used in mode gravity_compensation',
    ),
    (lambda: fresh(mode=Mode.JOINT_IMPEDANCE), 'holding position: no reference'),
    (lambda: too_far(Mode.COMPUTED_TORQUE), f'floating: the reference {TOO_FAR}'),
    (lambda: too_far(Mode.JOINT_IMPEDANCE), f'holding position: the reference {TOO_FAR}'),
    (lost, f'ramping efforts down: {NO_STATE}'),
    (lambda: lost(on_stale_state=StalePolicy.HOLD), f'keeping the last efforts: {NO_STATE}'),
    (fallen, f'stopped, zeros sent: {NO_STATE}'),
    (lambda: fallen().dry(), f'dry run: stopped: {NO_STATE}'),
    (lambda: fallen().receive(2.0).step(2.0), RISING),
    (lambda: stopped(0.15), 'ramping efforts down: disabled by ~/enable'),
    (lambda: stopped(2.0), 'stopped, zeros sent: disabled by ~/enable'),
    (
        lambda: stopped(0.15, on_stale_state=StalePolicy.HOLD),
        'ramping efforts down: disabled by ~/enable',
    ),
]


@pytest.mark.parametrize(('make', 'words'), ACTIVITIES)
def test_the_activity_is_the_message_of_loop_and_efforts(make, words):
    status = make().status()
    assert words in status['loop'].message
    assert status['loop'].message == status['efforts'].message
    assert status['loop'].level is status['efforts'].level is OK


CONDITIONS = {
    'loop': [
        (lambda: inactive(fresh()), OK, 'inactive'),
        (lambda: fresh().call('limit_stop', 'x').step(0.05), ERROR, 'stopped: x'),
        (lambda: fresh().refer(0.0, REST + 1.7e308).step(0.01), ERROR, NOT_SOLVED),
    ],
    'messages': [
        (fresh, OK, 'messages rejected in total: 0'),
        (rejecting, WARN, 'messages rejected since the last report: 2'),
    ],
    'other nodes': [
        (fresh, OK, 'no other node publishes the commands'),
        (lambda: amid_others(rivals='/a'), ERROR, '/c is also published by /a (stop the other'),
        (lambda: inactive(amid_others(rivals='/a')), WARN, '/c is also published by /a'),
        (lambda: amid_others(rivals='/a').dry(), WARN, '/c is also published by /a'),
        (lambda: inactive(amid_others(namesakes=1)), ERROR, 'another node has the name /arm'),
        (lambda: amid_others(namesakes=2), ERROR, '2 other nodes have the name /arm'),
        (lambda: with_controller(NAMES[:3], 'effort'), OK, ''),
        (lambda: with_controller(NAMES[:3]), OK, ''),
        (lambda: with_controller(NAMES[2::-1]), ERROR, f'in another order {SET_ORDER}'),
        (lambda: with_controller(NAMES[:2]), ERROR, SET_TWO),
        (lambda: with_controller((*NAMES[:2], NAMES[5])), ERROR, SET_OTHERS),
        (lambda: with_controller((*NAMES[:3], 'finger')), ERROR, NO_JOINT),
        (lambda: with_controller(NAMES[:3], 'position'), ERROR, NO_EFFORTS),
        (lambda: beside('franka_robot_state_broadcaster'), WARN, COMPENSATES),
        (lambda: beside('io_and_status_controller'), WARN, 'config/robots/ur.yaml'),
        (lambda: beside('io_and_status_controller', include_gravity=False), OK, ''),
        (lambda: beside('joint_state_broadcaster'), OK, ''),
    ],
    'clock': [
        (lambda: amid_clock(0.0, 0.5, 0), OK, 'no message on /clock yet'),
        (lambda: amid_clock(0.0, 2.0, 0), WARN, NO_CLOCK),
        (lambda: amid_clock(0.0, 6.0, 0), ERROR, NO_CLOCK),
        (lambda: amid_clock(0.0, 6.0, 1), WARN, 'is the simulation paused?'),
        (lambda: amid_clock(9.0, 0.2, 1), OK, 'simulated time advances'),
        (lambda: amid_clock(9.0, 6.0, 1), WARN, 'has not advanced for more than 5 s'),
        (lambda: amid_clock(9.0, 6.0, 0), ERROR, 'than 5 s: nothing publishes /clock any more'),
    ],
    'joint states': [
        (fresh, OK, 'fresh'),
        (lambda: Node().step(0.0), ERROR, f'no command yet: {WAITING}'),
        (lambda: inactive(Node().step(0.0)), WARN, WAITING),
        (lambda: Node().receive(0.0).step(9.0), ERROR, f'for new joint states of {BOTH}'),
        (lost, ERROR, f'joint states are lost: {BOTH}'),
        (lambda: inactive(lost()), WARN, f'joint states are lost: {BOTH}'),
        (lambda: fallen().receive(2.0).step(2.0), ERROR, RISING),
        (lambda: fresh().amid(silence=9.0), ERROR, 'for 9 s, although 1 publisher is connected'),
        (lambda: fresh().amid(silence=9.0, publishers=2), ERROR, '2 publishers are connected'),
        (lambda: fresh().amid(silence=4.0), OK, 'fresh'),
        (lambda: fresh().amid(silence=9.0, publishers=0), OK, 'fresh'),
        (lambda: moved(5.0).dry(), ERROR, 'the motion limits would stop the arm: too fast'),
        (lambda: moved(11.0).dry(), OK, 'fresh'),
        (lambda: moved(5.0), OK, 'fresh'),
        (lambda: Node(ARM).receive(0.0, DEGREES, REST6, NAMES), WARN, IN_DEGREES),
        (lambda: late(0.05), WARN, f"'{NAMES[4]}' is not reported; its locked position is used"),
        (lambda: late(9.0), WARN, f'set locked_positions.{NAMES[5]}; '),
        (lambda: Node().receive(0.0, qd=()), OK, 'fresh'),
        (lambda: Node(mode=CLOSED[0]).receive(0.0, qd=()), WARN, NO_DAMPING),
        (lambda: Node(mode=CLOSED[1]).receive(0.0, qd=()), WARN, NO_DAMPING),
        (lambda: with_imu(0.1, has_message=False), OK, 'fresh'),
    ],
    'reference': [
        (fresh, OK, 'no reference is used'),
        (lambda: fresh().refer(0.0).step(0.05), OK, 'followed'),
        (lambda: fresh().call('stop').step(0.05), OK, 'disabled'),
        (lambda: too_far(CLOSED[0]), WARN, 'floating: the reference is too far away'),
        (lambda: too_far(CLOSED[1]), WARN, 'holding position: the reference is too far away'),
    ],
    'efforts': [
        (lambda: fresh().amid(receivers=0), WARN, 'the commands have no subscribers'),
        (lambda: fresh().amid(receivers=0).dry(), OK, 'dry run: floating'),
        (lambda: amid_others(subscribers='/b').amid(receivers=0), WARN, NO_SUBSCRIBERS),
        (lambda: with_cuts(SECOND, ~SECOND), WARN, 'effort cut to its limit: elbow, shoulder'),
        (lambda: fresh(mode=CLOSED[0], kd=1e4), WARN, OSCILLATING),
        (turned, OK, f'rad or m); whole turns away: {TURNED}'),
    ],
    'model': [
        (fresh, OK, f"robot '{ROBOT.name}'"),
        (lambda: with_imu(0.1), OK, f"robot '{ROBOT.name}'"),
        (lambda: with_imu(0.1, has_message=False), ERROR, 'the base on /imu (0 publishers)'),
        (lambda: with_imu(0.5), ERROR, 'no message on imu for more than 0.2 s'),
        (lambda: warned(1), WARN, '1 warning about the robot description'),
        (lambda: warned(2), WARN, '2 warnings about the robot description'),
        (lambda: fresh().put(is_outdated=True), WARN, 'another robot description has arrived'),
    ],
    'scheduling': [
        (fresh, OK, 'real-time priority'),
        (lambda: at_normal_priority(is_requested=False), OK, 'normal priority: not permitted'),
        (lambda: at_normal_priority(is_requested=True), WARN, 'normal priority: not permitted'),
    ],
}


@pytest.mark.parametrize(
    ('part', 'make', 'level', 'words'),
    [(part, *condition) for part, found in CONDITIONS.items() for condition in found],
)
def test_a_condition_has_a_level_and_a_message(part, make, level, words):
    found = make().status()[part]
    assert (found.level, words in found.message) == (level, True), found


# Times of commands since the last report; None is a pause of the loop.
@pytest.mark.parametrize(
    ('period', 'times', 'level', 'values'),
    [
        (
            0.01,
            [0.01 * k + 0.008 * (k == 50) for k in range(100)],
            OK,
            {
                'rate [Hz]': '100',
                'requested rate [Hz]': '100',
                'period p99 [ms]': '10.16',
                'period worst [ms]': '18',
                'compute time p99 [ms]': '0.1',
                'overruns': '1',
            },
        ),
        (0.01, [0.011 * k for k in range(90)], WARN, {'rate [Hz]': '90.9091'}),
        (1.0, [0.0, 2.0], WARN, {'rate [Hz]': '0.5', 'overruns': '1'}),
        # A loop that has started within the second is not slow.
        (0.01, [None, *(0.6 + 0.01 * k for k in range(40))], OK, {'rate [Hz]': '100'}),
        (0.01, [], OK, {'rate [Hz]': '0', 'period p99 [ms]': 'none'}),
        (0.01, [5.0, None, 9.0, 1.0], OK, {'overruns': '0'}),
        (0.0, [0.0, 0.0, 1.0], OK, {'rate [Hz]': '2', 'overruns': '0'}),
        (0.0, [], OK, {'requested rate [Hz]': 'that of the joint states'}),
    ],
)
def test_rates_and_late_commands(period, times, level, values):
    node = fresh()
    node.monitor = Monitor(period)
    for time in times:
        if time is None:
            node.monitor.pause()
        else:
            node.monitor.step(time, 1e-4, Command(REST, NEITHER, NEITHER), JOINTS)
    found = node.status()['loop']
    assert found.level is level
    slow = f'only {float(found.values["rate [Hz]"]):.1f} commands/s'
    assert found.message == (slow if level is WARN else 'floating: no reference')
    assert values.items() <= found.values.items()
    assert node.status()['loop'].values['rate [Hz]'] == '0'


def test_counts_continue_after_a_report_and_lists_do_not():
    node = with_cuts(SECOND, SECOND, SECOND, ~SECOND)
    counts = {f'{JOINTS[1]} cut to limit': '3', f'{JOINTS[1]} slowed': '4'}
    for cut in (f'{JOINTS[1]}, {JOINTS[0]}', 'none'):
        values = node.status()['efforts'].values
        assert (counts | {'cut to limit since the last report': cut}).items() <= values.items()
    for k in range(1000):
        node.monitor.reject('imu', f'is {k}')
    found = node.status()['messages']
    assert found.values['imu: is 0'] == '1'
    assert len(found.values) <= 21
    assert sum(map(int, found.values.values())) == 1000
    assert node.status()['messages'].message == 'messages rejected in total: 1000'


def test_joints_that_a_spring_pushes_back_are_named():
    for margin, names in ((0.0, 'none'), (10.0, f'{JOINTS[0]}, {JOINTS[1]}')):
        values = fresh(limit_stiffness=5.0, limit_margin=margin).status()['efforts'].values
        assert values['pushed back from position limits'] == names


def test_without_a_robot_there_are_four_parts():
    around = FINE._replace(is_active=False, state='unconfigured')
    status = describe_node(0.0, None, around, Monitor())
    assert [(name, part.level) for name, part in status.items()] == [
        ('loop', OK),
        ('messages', OK),
        ('other nodes', OK),
        ('scheduling', OK),
    ]
    assert not {'mode', 'phase', 'dry run', 'gain'} & status['loop'].values.keys()


def described():
    """Return a status in which as many values as possible are not the defaults."""
    node = Node(
        joints=JOINTS[::-1],
        mode=Mode.COMPUTED_TORQUE,
        effort_scale=(2.0, -0.5),
        effort_limits=(3.0, math.inf),
        use_urdf_effort_limits=False,
        state_timeout=0.25,
        start_ramp=0.2,
    )
    for now in (0.0, 0.05):
        node.receive(now).step(now)
    node.now = 0.25
    loop = node.loop
    loop.loads.set_payload(TIP, 2.5, [0.1, 0.0, 0.0], np.zeros((3, 3)))
    loop.loads.include(gravity=False)
    loop.external_effort_estimator.scale[:] = -1.0, 0.5
    loop.measured_gravity = MeasuredGravity.INCLUDED
    others = OtherNodes('/commands', '/bridge', '/rival', 3)
    clock = SimulatedClock(12.5, 0.25, 4)
    return node.amid(receivers=2, publishers=3, clock=clock, others=others).status()


VALUES = {
    'loop': {
        'state': 'active',
        'mode': 'computed_torque',
        'phase': 'floating: no reference',
        'dry run': 'no',
        'gain': '0.25',
    },
    'joint states': {
        'topic': '/joint_states',
        'rate [Hz]': '123.4',
        'age [s]': '0.2',
        'timeout [s]': '0.25',
        'publishers': '3',
        'without velocity': 'none',
    },
    'reference': {'age [s]': 'never', 'timeout [s]': '0.5', 'mode': 'computed_torque'},
    'efforts': {
        'receivers': '2',
        'topic with names': '/arm/joint_efforts',
        'topic of the external efforts': '/arm/external_efforts',
        'scale': '2, -0.5',
        'limits [N m, N]': '3, inf',
        'measured efforts contain gravity': 'yes',
        'scale of the measured efforts': '0.5, -1',
    },
    'model': {
        'joints': ', '.join(JOINTS[::-1]),
        'robot': ROBOT.name,
        'mass [kg]': f'{ROBOT.mass.sum():g}',
        'payload': f'2.5 kg on {TIP}',
        'payload links': TIP,
        'payload masses [kg]': '2.5',
        'payload com [m]': '0.1, 0, 0',
        'gravity [m/s^2]': 'not included',
        'gravity in the root link [m/s^2]': '0, 0, -9.80665',
    },
    'clock': {'time [s]': '12.500', 'unchanged for [s]': '0.25', 'publishers': '4'},
    'other nodes': {
        'commands': '/commands',
        'subscribers of the commands': '/bridge',
        'other publishers of the commands': '/rival',
        'other nodes with this name': '3',
    },
    'scheduling': {'policy': 'SCHED_FIFO', 'priority': '50'},
}


@pytest.mark.parametrize('part', VALUES)
def test_values_are_those_of_the_interface(part):
    values = described()[part].values
    assert VALUES[part] == {key: values.get(key) for key in VALUES[part]}


def test_values_of_single_conditions():
    values = late(9.0).status()['joint states'].values
    assert values['late, not commanded'] == NAMES[5]
    assert values['locked, never reported'] == NAMES[4]
    assert values['locked positions [rad, m]'] == '0.125'
    assert Node().status()['joint states'].values['age [s]'] == 'never'
    assert warned(2).status()['model'].values['warning 2'] == 'text 1'
    assert fresh().status()['model'].values['gravity [m/s^2]'] == '0, 0, -9.80665'
    assert fresh().status()['model'].values['payload'] == 'none'
    assert fresh().dry().status()['loop'].values['dry run'] == 'yes'
    values = with_controller(NAMES[:2]).status()['other nodes'].values
    assert values['joints of the controllers'] == '/fec: joint_1, joint_2'


# What `watch` reads


def test_what_is_written_is_what_is_read():
    status = described()
    message = write_status(Time(), '/left/arm', status)
    found = read_status(message, '/left/arm')
    assert found == status
    assert message.status[0].name == 'left/arm: loop'
    assert message.status[0].hardware_id == ROBOT.name
    for name in ('/arm', '/left', '/left/arm_2', '/right/arm'):
        assert read_status(message, name) is None
    assert found.by_joint('limits [N m, N]') == {JOINTS[1]: 3.0, JOINTS[0]: math.inf}
    assert found.measured_scale() == {JOINTS[1]: 0.5, JOINTS[0]: -1.0}
    assert found.gravity() == [0.0, 0.0, -9.80665]
    assert found.payloads() == [(TIP, 2.5, [0.1, 0.0, 0.0])]
    assert found.number('joint states', 'rate [Hz]') == 123.4
    assert found.is_computing
    assert 'other nodes' in found.problems()


def test_values_that_are_unknown_or_of_another_version_are_left_out():
    status = NodeStatus(loop=Part(OK, 'words', {'state': 'active', 'phase': 'x', 'gain': '?'}))
    assert status.number('loop', 'gain') is None
    assert status.number('model', 'mass [kg]') is None
    assert not status.is_computing
    assert status.names('model', 'joints') == status.payloads() == status.gravity() == []
    status['model'] = Part(OK, 'words', {'joints': 'hip, knee', 'payload links': 'hand'})
    status['efforts'] = Part(OK, 'words', {'scale': '1, 2, 3', 'limits [N m, N]': 'none'})
    assert status.by_joint('scale') == status.by_joint('limits [N m, N]') == {}
    assert status.payloads() == []
    assert (
        read_status(write_status(Time(), 'arm', NodeStatus(model=status['model'])), 'arm') is None
    )


def test_problems_are_the_parts_that_are_not_ok_errors_first():
    levels = {'loop': OK, 'messages': WARN, 'joint states': ERROR, 'model': WARN}
    status = NodeStatus({name: Part(level, name, {}) for name, level in levels.items()})
    assert list(status.problems()) == ['joint states', 'messages', 'model']


# Single messages


def test_silence_lasts_until_a_message_arrives_and_excludes_suspensions():
    silence = 0.0
    for elapsed, is_silent, expected in (
        (1.0, True, 1.0),
        (1.0, True, 2.0),
        (60.0, True, 4.0),
        (1.0, False, 0.0),
        (1.0, True, 1.0),
    ):
        silence = lasting_silence(silence, elapsed, is_silent=is_silent)
        assert silence == expected


def test_the_frame_of_an_imu_is_compared_with_the_robot_description():
    loop = ControlLoop(load_urdf(ROOT / 'test/robots/fixed_chain.urdf'))
    robot = loop.robot
    fixed = [
        name for name, body in zip(robot.link_names, robot.link_body, strict=True) if not body
    ]
    moving = next(name for name in robot.link_names if name not in fixed)
    for name in ('', 'imu_link', loop.base_link):
        assert not describe_imu_frame(loop, name, np.eye(3))
    assert 'a link moved by joints' in describe_imu_frame(loop, moving, np.eye(3))
    for name in fixed:
        R_BS = robot.link_rotation[robot.link_index(name)]
        for degrees in (0.0, 30.0, 90.0, 180.0):  # cosines may round to above 1 or below -1
            for axis in np.eye(3):
                turned = R_BS @ rotation_of_rpy(*(math.radians(degrees) * axis))
                words = f'by {degrees:.0f} degrees' if degrees else ''
                found = describe_imu_frame(loop, name, turned)
                assert words in found
                assert bool(found) is bool(words)
