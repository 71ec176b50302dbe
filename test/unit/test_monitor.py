"""Conditions of the node, and the level, the message and the values that the status then has."""

import dataclasses
import math
from types import SimpleNamespace

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import Command, ControlLoop
from inverse_dynamics_node.control.monitor import Monitor
from inverse_dynamics_node.control.settings import MeasuredGravity, Mode, Settings, StalePolicy
from inverse_dynamics_node.control.status import (
    ClockStatus,
    GraphInfo,
    Level,
    NodeNames,
    OtherNodesStatus,
    Topics,
)
from inverse_dynamics_node.control.status_text import activity, describe_imu_frame, judge_clock
from inverse_dynamics_node.control.supervision import DryRun
from inverse_dynamics_node.robot.kinematics import rotation_of_rpy
from inverse_dynamics_node.robot.model import ModelWarning
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from states import store_state

pytest.importorskip('diagnostic_msgs')

from inverse_dynamics_node.ros.diagnostics import write_values

OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR
ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
JOINTS = ROBOT.joint_names
BOTH = ', '.join(JOINTS)
FINE = GraphInfo(receivers=1, publishers=1, is_active=True, state='active')
INACTIVE = {'is_active': False, 'state': 'inactive'}
REST = np.zeros(2)
NEITHER = np.zeros(2, dtype=bool)
SECOND = np.array([False, True])
FAR = 'starts too far away or jumps too far (max_tracking_error: 0.2 rad or m)'
RISING = 'efforts rise again after joint states have arrived for 0.2 s without a gap longer than '


def part(which, loop, now=0.05, monitor=None, **around):
    """Return a part of a report with its texts in /diagnostics."""
    status = (monitor or Monitor()).report(now, loop, FINE._replace(**around))
    for each, found in status.parts().items():
        texts = [each, found.message, *write_values(found), *write_values(found).values()]
        assert all(isinstance(text, str) for text in texts)
        assert 'None' not in texts
        assert isinstance(found.level, Level)
        assert found.message
    found = status.parts()[which]
    return SimpleNamespace(level=found.level, message=found.message, values=write_values(found))


def receive(loop, now, q=(0.1, 0.2), qd=(0.0, 0.0)):
    store_state(loop.collector, now, JOINTS, list(q), list(qd))


@pytest.fixture
def loop():
    loop = ControlLoop(ROBOT, period=0.05)
    receive(loop, 0.0)
    loop.step(0.0)
    return loop


def step_until(loop, start, end):
    for now in np.arange(start, end, 0.05):
        loop.step(float(now))


# Times of commands since the last report; None is a pause of the loop.
@pytest.mark.parametrize(
    ('period', 'times', 'level', 'words', 'values'),
    [
        (
            0.01,
            [0.01 * k + 0.008 * (k == 50) for k in range(100)],
            OK,
            'floating',
            {
                'rate [Hz]': '100.0',
                'requested rate [Hz]': '100',
                'period p99 [ms]': '10.160',
                'period worst [ms]': '18.000',
                'compute time p99 [ms]': '0.100',
                'overruns': '1',
            },
        ),
        (0.01, [0.011 * k for k in range(90)], WARN, 'only 90.9 commands/s', {}),
        (1.0, [0.0, 2.0], WARN, 'only 0.5 commands/s', {'overruns': '1'}),
        # A loop that has started within the second is not slow.
        (0.01, [None, *(0.6 + 0.01 * k for k in range(40))], OK, '', {'rate [Hz]': '100.0'}),
        (0.01, [], OK, 'floating', {'rate [Hz]': '0.0'}),
        (2.0, [0.0, 3.0, 6.5], WARN, 'only 0.3 commands/s', {'overruns': '1'}),
        (0.01, [5.0, None, 9.0, 1.0], OK, '', {'overruns': '0'}),
        (
            0.0,
            [0.0, 0.0, 1.0],
            OK,
            'floating',
            {
                'overruns': '0',
                'rate [Hz]': '2.0',
                'requested rate [Hz]': 'that of the joint states',
            },
        ),
    ],
)
def test_rates_and_late_commands(loop, period, times, level, words, values):
    monitor = Monitor(period)
    part('loop', loop, 0.0, monitor)
    for time in times:
        if time is None:
            monitor.pause()
        else:
            monitor.step(time, 1e-4, Command(REST, NEITHER, NEITHER), JOINTS)
    found = part('loop', loop, 1.0, monitor)
    assert (found.level, words in found.message) == (level, True), found
    assert values.items() <= found.values.items()
    assert part('loop', loop, 1.5, monitor).values['rate [Hz]'] == '0.0'


def test_counts_clamped_commands_and_warns_of_those_since_the_last_report(loop):
    monitor = Monitor()
    for is_clamped in (SECOND, SECOND, SECOND, ~SECOND):
        monitor.step(0.0, 1e-4, Command(REST, is_clamped, SECOND), JOINTS)
    found = part('efforts', loop, 1.0, monitor)
    assert found.level is WARN
    assert found.message == f'effort cut to its limit: {JOINTS[1]}, {JOINTS[0]}'
    assert found.values[f'{JOINTS[1]} cut to limit'] == '3'
    assert found.values[f'{JOINTS[1]} slowed'] == '4'
    assert found.values['cut to limit since the last report'] == f'{JOINTS[1]}, {JOINTS[0]}'
    found = part('efforts', loop, 2.0, monitor)
    assert found.level is OK
    assert found.values[f'{JOINTS[1]} cut to limit'] == '3'
    assert found.values['cut to limit since the last report'] == 'none'


def test_counts_rejected_messages_by_a_limited_number_of_reasons(loop):
    monitor = Monitor()
    monitor.reject('imu', 'broken')
    monitor.reject('imu', 'broken')
    found = part('messages', loop, 0.0, monitor)
    assert (found.level, found.values) == (WARN, {'imu: broken': '2'})
    for k in range(1000):
        monitor.reject('imu', f'is {k}')
    assert len(monitor.rejected) <= 21
    assert sum(monitor.rejected.values()) == 1002
    found = part('messages', loop, 1.0, monitor)
    assert (found.level, found.message) == (WARN, 'messages rejected since the last report: 1000')
    found = part('messages', loop, 2.0, monitor)
    assert (found.level, found.message) == (OK, 'messages rejected in total: 1002')


def others_of(subscribers=(), rivals=(), namesakes=0):
    names = NodeNames.of(subscribers), NodeNames.of(rivals)
    return OtherNodesStatus(OK, '', '/commands', *names, namesakes)


RIVALS = others_of(rivals=('/a', '/b'))
NAMESAKES = others_of(namesakes=1)
BRIDGE = others_of(subscribers=('/bridge',))


@pytest.mark.parametrize(
    ('around', 'name', 'level', 'words'),
    [
        ({}, 'loop', OK, 'floating: no reference'),
        (INACTIVE, 'loop', OK, 'inactive'),
        ({}, 'joint states', OK, 'fresh'),
        ({}, 'reference', OK, 'no reference is used'),
        ({}, 'efforts', OK, 'floating: no reference'),
        ({'receivers': 0}, 'efforts', WARN, 'the commands have no subscribers'),
        (
            {'receivers': 0, 'others': BRIDGE},
            'efforts',
            WARN,
            'another type or quality of service is used by /bridge',
        ),
        ({'others': others_of()}, 'other nodes', OK, 'no other node publishes the commands'),
        ({'others': RIVALS}, 'other nodes', ERROR, '/commands is also published by /a, /b'),
        (
            {'others': RIVALS, **INACTIVE},
            'other nodes',
            WARN,
            '/commands is also published by /a, /b',
        ),
        ({'others': NAMESAKES}, 'other nodes', ERROR, 'another node has the name /arm'),
        ({'others': NAMESAKES, **INACTIVE}, 'other nodes', ERROR, 'another node has the name'),
        (
            {'others': others_of(namesakes=2)},
            'other nodes',
            ERROR,
            '2 other nodes have the name /arm',
        ),
        (
            {'others': others_of(rivals=tuple(f'/n{k}' for k in range(100)))},
            'other nodes',
            ERROR,
            '/n0, /n1, /n2, /n3, /n4 and 95 more',
        ),
        (
            {'others': others_of(rivals=tuple(f'/n{k}' for k in range(5)))},
            'other nodes',
            ERROR,
            '/n3, /n4 (',
        ),
    ],
)
def test_other_nodes_and_the_state_of_this_one(loop, around, name, level, words):
    found = part(name, loop, name='/arm', **around)
    assert (found.level, words in found.message) == (level, True), found


@pytest.mark.parametrize(
    ('clock', 'level', 'words'),
    [
        ((0.0, 0.5, 0), OK, 'no message on /clock yet'),
        ((0.0, 2.0, 0), WARN, 'nothing publishes /clock'),
        ((0.0, 6.0, 0), ERROR, 'nothing publishes /clock'),
        ((0.0, 6.0, 1), WARN, 'is the simulation paused?'),
        ((9.0, 0.2, 1), OK, 'simulated time advances'),
        ((9.0, 6.0, 1), WARN, 'has not advanced for more than 5 s'),
        ((9.0, 6.0, 0), ERROR, 'more than 5 s: nothing publishes /clock any more'),
    ],
)
def test_simulated_time_that_stands_still_is_reported(clock, level, words):
    found, message = judge_clock(*clock)
    assert found is level
    assert words in message


def test_without_a_robot_there_are_three_statuses():
    around = FINE._replace(is_active=False, state='unconfigured')
    parts = Monitor().report(0.0, None, around).parts()
    assert [(name, found.level) for name, found in parts.items()] == [
        ('loop', OK),
        ('messages', OK),
        ('other nodes', OK),
    ]


def test_a_report_describes_the_loop_the_topics_and_the_limits():
    settings = Settings(
        mode=Mode.COMPUTED_TORQUE,
        effort_scale=(2.0, -0.5),
        effort_limits=(3.0, 4.0),
        state_timeout=0.25,
        start_ramp=0.2,
    )
    loop = ControlLoop(ROBOT, JOINTS[::-1], settings, period=0.05)
    for now in (0.0, 0.05):
        receive(loop, now)
        loop.step(now)
    around = {
        'topics': Topics('/states', '/commands_with_names', '/external'),
        'state_rate': 123.4,
        'receivers': 2,
        'publishers': 3,
        'clock': ClockStatus(OK, 'simulated time advances', 12.5, 0.25, 4),
        'others': others_of(('/bridge',), ('/rival',), 3),
    }
    for name, expected in {
        'loop': {
            'state': 'active',
            'mode': 'computed_torque',
            'phase': 'floating: no reference',
            'dry run': 'no',
            'gain': '0.250',
        },
        'joint states': {
            'topic': '/states',
            'rate [Hz]': '123.4',
            'age [s]': '0.200',
            'timeout [s]': '0.25',
            'publishers': '3',
        },
        'reference': {'age [s]': 'never', 'timeout [s]': '0.5', 'mode': 'computed_torque'},
        'efforts': {
            'receivers': '2',
            'topic with names': '/commands_with_names',
            'topic of the external efforts': '/external',
            'scale': '2, -0.5',
            'limits [N m, N]': '3, 4',
            'measured efforts contain gravity': 'yes',
            'scale of the measured efforts': '1, 1',
        },
        'model': {
            'joints': ', '.join(JOINTS[::-1]),
            'robot': ROBOT.name,
            'mass [kg]': f'{ROBOT.mass.sum():.4g}',
            'payload': 'none',
            'gravity [m/s^2]': '0.000, 0.000, -9.807',
        },
        'clock': {'time [s]': '12.500', 'unchanged for [s]': '0.2', 'publishers': '4'},
        'other nodes': {
            'commands': '/commands',
            'subscribers of the commands': '/bridge',
            'other publishers of the commands': '/rival',
            'other nodes with this name': '3',
        },
    }.items():
        values = part(name, loop, 0.25, **around).values
        assert expected == {key: values.get(key) for key in expected}


def test_a_node_that_is_not_active_has_a_state_but_no_phase(loop):
    values = part('loop', loop, **INACTIVE).values
    assert values['state'] == 'inactive'
    assert not {'mode', 'phase', 'dry run', 'gain'} & set(values)


@pytest.mark.parametrize('mode', [Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE])
def test_warns_of_a_loop_without_damping(mode):
    loop = ControlLoop(ROBOT, settings=Settings(mode=mode))
    receive(loop, 0.0, qd=())
    found = part('joint states', loop, 0.0)
    assert found.level is WARN
    assert found.message == f'joints reported without velocity have no damping in {mode.value}'
    assert found.values['without velocity'] == BOTH
    receive(loop, 0.0)
    assert part('joint states', loop, 0.0).level is OK


def test_activity_names_the_reason_to_float(loop):
    assert activity(0.0, loop) == 'floating: no reference'
    loop.reference = Reference(REST, REST, 0.0)
    loop.step(0.05)
    assert activity(0.05, loop) == 'following the reference'
    receive(loop, 1.0)
    loop.step(1.0)
    assert activity(1.0, loop) == 'floating: no reference for more than 0.5 s'
    loop.apply(Settings(mode=Mode.GRAVITY_COMPENSATION))
    assert 'not used in mode gravity_compensation' in activity(1.0, loop)


@pytest.mark.parametrize(
    ('mode', 'doing'),
    [(Mode.COMPUTED_TORQUE, 'floating'), (Mode.JOINT_IMPEDANCE, 'holding position')],
)
def test_the_reference_is_judged_by_its_use(loop, mode, doing):
    loop.apply(Settings(mode=mode, max_tracking_error=0.2))
    loop.step(0.0)
    assert activity(0.0, loop) == f'{doing}: no reference'
    loop.reference = Reference(REST, REST, 0.02, positions=np.array([0.1, 0.2]))
    loop.step(0.05)
    found = part('reference', loop)
    assert (found.level, found.message, found.values['age [s]']) == (OK, 'followed', '0.030')
    loop.reference = Reference(REST, REST, 0.05, positions=REST + 3.0)
    loop.step(0.06)
    assert activity(0.06, loop) == f'{doing}: the reference {FAR}'
    found = part('reference', loop, 0.06)
    assert (found.level, found.message) == (WARN, f'{doing}: the reference is too far away')
    loop.controller.stop()
    loop.step(0.07)
    found = part('reference', loop, 0.07)
    assert (found.level, found.message) == (OK, 'disabled')


def test_activity_names_the_reason_to_stop(loop):
    step_until(loop, 0.0, 0.2)
    reason = f'no joint state of {BOTH} for more than 0.1 s'
    assert activity(0.2, loop) == f'ramping efforts down: {reason}'
    loop.apply(Settings(on_stale_state=StalePolicy.HOLD))
    assert activity(0.2, loop) == f'keeping the last efforts: {reason}'
    loop.apply(Settings())
    step_until(loop, 0.2, 2.0)
    assert activity(2.0, loop) == f'stopped, zeros sent: {reason}'
    found = part('loop', loop, 2.0)
    assert found.message == part('efforts', loop, 2.0).message == activity(2.0, loop)
    receive(loop, 2.0)
    loop.step(2.0)
    assert RISING in activity(2.0, loop)


@pytest.mark.parametrize('policy', StalePolicy)
def test_activity_while_disabled(loop, policy):
    loop.apply(Settings(on_stale_state=policy))
    step_until(loop, 0.0, 0.1)
    loop.controller.stop()
    step_until(loop, 0.1, 0.2)
    assert activity(0.15, loop) == 'ramping efforts down: disabled by ~/enable'
    step_until(loop, 0.2, 2.0)
    assert activity(2.0, loop) == 'stopped, zeros sent: disabled by ~/enable'
    loop.dry_run = DryRun(is_active=True)
    assert activity(2.0, loop) == 'dry run: stopped: disabled by ~/enable'


def test_activity_without_usable_efforts(loop):
    loop.reference = Reference(np.full(2, 1.7e308), REST, 0.0)
    loop.step(0.01)
    assert activity(0.01, loop).endswith(
        'no finite efforts for this joint state and reference: '
        "the acceleration of joint 'shoulder' is 1.7e+308"
    )


def test_a_dry_run_is_named_in_the_activity_and_in_the_report(loop):
    for is_dry_run, word in ((True, 'yes'), (False, 'no')):
        loop.dry_run = DryRun(is_active=is_dry_run)
        assert part('loop', loop).values['dry run'] == word
        for name in ('loop', 'efforts'):
            assert ('dry run: floating' in part(name, loop).message) is is_dry_run


def test_an_unknown_motion_of_the_base_is_an_error_of_the_model():
    loop = ControlLoop(ROBOT, has_imu=True)
    receive(loop, 0.0)
    assert loop.missing('/joint_states', '/base/imu') == ['the motion of the base on /base/imu']
    assert part('joint states', loop, 0.0).level is OK
    for now, level, words in (
        (0.0, ERROR, 'no message on imu yet'),
        (0.1, OK, ROBOT.name),
        (0.5, ERROR, 'no message on imu for more than 0.2 s'),
    ):
        found = part('model', loop, now)
        assert (found.level, words in found.message) == (level, True)
        loop.loads.set_base_motion(0.0, (0.0, 0.0, 9.8), np.zeros(3))


def test_reports_that_states_were_lost_until_they_have_been_fresh_for_a_while(loop):
    def found_at(now, arrival, **around):
        receive(loop, arrival)
        loop.step(now)
        return part('joint states', loop, now, **around)

    for k in range(10):
        assert found_at(0.1 * k, 0.1 * k).level is OK
    for now, arrival, words in (
        (1.1, 0.9, f'lost: {BOTH}'),
        (1.2, 0.9, 'lost: '),
        (1.3, 1.3, RISING),
        (1.4, 1.4, RISING),
    ):
        found = found_at(now, arrival)
        assert (found.level, words in found.message) == (ERROR, True)
        assert part('joint states', loop, now, **INACTIVE).level is WARN
    assert found_at(1.55, 1.55).level is OK


@pytest.mark.parametrize(
    ('publishers', 'silence', 'words'),
    [
        (0, 9.0, ''),
        (2, 4.0, ''),
        (2, 9.0, '2 publishers are connected'),
        (1, 9.0, '1 publisher is connected'),
    ],
)
@pytest.mark.parametrize(('is_active', 'level'), [(True, ERROR), (False, WARN)])
def test_missing_joint_states_are_reported(publishers, silence, words, is_active, level):
    loop = ControlLoop(ROBOT, period=0.05)
    loop.step(0.0)
    around = {'publishers': publishers, 'silence': silence, 'is_active': is_active}
    found = part('joint states', loop, 9.0, **around)
    assert found.level is level
    assert f'waiting for the positions of {BOTH}' in found.message
    assert words in found.message
    assert ('connected' in found.message) is bool(words)
    assert found.values['age [s]'] == 'never'


def test_warns_of_joints_far_outside_their_limits():
    robot = load_urdf(STANFORD)
    loop = ControlLoop(robot)
    store_state(loop.collector, 0.0, robot.joint_names, [0.0, 57.3, 0.5, 0.0, 4.0, 0.0], [0.0] * 6)
    found = part('joint states', loop, 0.0)
    assert found.level is WARN
    assert found.message == (
        'joint_2 is at 57.3 rad, outside its limits -1.745 to 1.745 (in degrees?); '
        'joint_5 is at 4 rad, outside its limits -1.92 to 1.92'
    )


def test_locked_and_late_joints_are_named():
    robot = load_urdf(STANFORD)
    names = robot.joint_names
    loop = ControlLoop(robot, names[:4], locked={names[4]: 0.0})
    q = [0.0, 0.0, 0.5, 0.0, 0.0]
    store_state(loop.collector, 0.0, [*names[:4], names[5]], q, [0.0] * 5)
    loop.step(0.0)
    found = part('joint states', loop)
    assert (found.level, 'locked' in found.message) == (WARN, True)
    assert found.values['locked, never reported'] == names[4]
    assert found.values['late, not commanded'] == found.values['without velocity'] == 'none'
    store_state(loop.collector, 9.0, names[:4], q[:4], [0.0] * 4)
    loop.step(9.0)
    found = part('joint states', loop, 9.0)
    assert found.level is WARN
    assert found.values['late, not commanded'] == names[5]


def test_loads_and_what_measured_efforts_contain_are_described(loop):
    loop.loads.set_payload(ROBOT.link_names[-1], 2.5, [0.1, 0.0, 0.0], np.zeros((3, 3)))
    loop.loads.include(gravity=False)
    found = part('model', loop)
    assert (found.level, ROBOT.name in found.message) == (OK, True)
    assert found.values['payload'] == f'2.5 kg on {ROBOT.link_names[-1]}'
    assert found.values['payload com [m]'] == '0.1, 0, 0'
    assert found.values['gravity [m/s^2]'] == 'not included'
    assert found.values['gravity in the root link [m/s^2]'].endswith('-9.807')
    loop.external_effort_estimator.scale[:] = -1.0, 0.5
    values = part('efforts', loop).values
    assert values['measured efforts contain gravity'] == 'no'
    assert values['scale of the measured efforts'] == '-1, 0.5'
    loop.measured_gravity = MeasuredGravity.INCLUDED
    assert part('efforts', loop).values['measured efforts contain gravity'] == 'yes'


def test_warnings_about_the_description_are_listed():
    warnings = tuple(ModelWarning(text, 'hint') for text in ('first', 'second'))
    found = part('model', ControlLoop(dataclasses.replace(ROBOT, warnings=warnings)), 0.0)
    assert found.level is WARN
    assert found.message.startswith('2 warnings')
    assert (found.values['warning 1'], found.values['warning 2']) == ('first', 'second')


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
    quarter = rotation_of_rpy(0.0, 0.0, math.pi / 2)
    for name in fixed:
        R_BS = robot.link_rotation[robot.link_index(name)]
        assert not describe_imu_frame(loop, name, R_BS)
        assert 'by 90 degrees' in describe_imu_frame(loop, name, R_BS @ quarter)
        tilted = R_BS @ rotation_of_rpy(math.radians(30.0), 0.0, 0.0)
        assert 'by 30 degrees' in describe_imu_frame(loop, name, tilted)
        for yaw in np.linspace(0.0, 3.0, 50):  # cosines may round to above 1 or below -1
            about, back = rotation_of_rpy(0.0, 0.0, yaw), rotation_of_rpy(0.0, 0.0, -yaw)
            assert not describe_imu_frame(loop, name, R_BS @ about @ back)
            axis = np.array([math.cos(yaw), math.sin(yaw), yaw]) / math.hypot(1.0, yaw)
            turned = R_BS @ (2.0 * np.outer(axis, axis) - np.eye(3))
            assert 'by 180 degrees' in describe_imu_frame(loop, name, turned)


def test_a_joint_that_is_whole_turns_away_from_its_reference_is_named():
    arm = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
    loop = ControlLoop(arm, settings=Settings(mode=Mode.COMPUTED_TORQUE))
    q, zeros = np.full(7, 0.3), np.zeros(7)
    store_state(loop.collector, 1.0, arm.joint_names, q, zeros)
    turned = q + 2.0 * math.pi * np.eye(7)[2]
    loop.reference = Reference(zeros, zeros, 1.0, turned, zeros)
    loop.step(1.0)
    assert activity(1.0, loop).endswith(f'; whole turns away: {arm.joint_names[2]}')
