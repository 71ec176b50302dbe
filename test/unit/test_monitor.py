"""Statistics of the monitor, and the levels and texts of its reports."""

import dataclasses
import math
from types import SimpleNamespace

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.control_law import Reference
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

ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
JOINTS = ROBOT.joint_names
FINE = GraphInfo(receivers=1, publishers=1, is_active=True, state='active')
NEITHER = np.zeros(2, dtype=bool)
SECOND = np.array([False, True])


def command(is_saturated=NEITHER, is_slowed=NEITHER):
    return Command(np.zeros(2), is_saturated, is_slowed)


def part(status, name):
    """Return a part of a report with its texts in /diagnostics."""
    found = status.parts()[name]
    return SimpleNamespace(level=found.level, message=found.message, values=write_values(found))


@pytest.fixture
def loop():
    loop = ControlLoop(ROBOT, period=0.05)
    store_state(loop.collector, 0.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    loop.step(0.0)
    return loop


@pytest.fixture(autouse=True)
def complete_reports(monkeypatch):
    """Check that every report of these tests can be sent as a DiagnosticArray."""
    report = Monitor.report

    def checked(*args):
        status = report(*args)
        for name, found in status.parts().items():
            assert isinstance(found.level, Level)
            values = write_values(found)
            texts = [name, found.message, *values, *values.values()]
            assert all(isinstance(text, str) for text in texts)
            assert name
            assert found.message
            assert 'None' not in texts
        return status

    monkeypatch.setattr(Monitor, 'report', checked)


def test_measures_rate_and_periods(loop):
    monitor = Monitor(0.01)
    monitor.report(0.0, loop, FINE)
    for k in range(100):
        late = 0.008 if k == 50 else 0.0
        monitor.step(0.01 * k + late, 1e-4 * (1.0 + k), command(), JOINTS)
    values = part(monitor.report(1.0, loop, FINE), 'loop').values
    assert values['rate [Hz]'] == '100.0'
    assert values['requested rate [Hz]'] == '100'
    assert values['period worst [ms]'] == '18.000'
    assert 10.0 < float(values['period p99 [ms]']) < 18.0
    assert float(values['compute time p99 [ms]']) == pytest.approx(9.9, abs=0.05)
    assert values['overruns'] == '1'
    assert part(monitor.report(1.5, loop, FINE), 'loop').values['rate [Hz]'] == '0.0'


def test_warns_if_the_requested_rate_is_not_reached(loop):
    monitor = Monitor(0.01)
    monitor.report(0.0, loop, FINE)
    for k in range(90):
        monitor.step(0.011 * k, 1e-4, command(), JOINTS)
    status = part(monitor.report(1.0, loop, FINE), 'loop')
    assert status.level is Level.WARN
    assert status.message == 'only 90.9 commands/s'
    monitor = Monitor(1.0)
    for now in (0.0, 2.0):
        monitor.step(now, 1e-4, command(), JOINTS)
    assert part(monitor.report(2.0, loop, FINE), 'loop').message == 'only 0.5 commands/s'


def test_a_pause_and_a_clock_that_is_set_back_are_not_overruns(loop):
    monitor = Monitor(0.01)
    monitor.step(5.0, 1e-4, command(), JOINTS)
    monitor.pause()
    monitor.step(9.0, 1e-4, command(), JOINTS)
    monitor.step(1.0, 1e-4, command(), JOINTS)
    assert monitor.overruns == 0


def test_counts_clamped_commands_and_warns_of_those_since_the_last_report(loop):
    monitor = Monitor()
    for _ in range(3):
        monitor.step(0.0, 1e-4, command(SECOND, SECOND), JOINTS)
    status = part(monitor.report(1.0, loop, FINE), 'efforts')
    assert status.level is Level.WARN
    assert status.message == f'effort cut to its limit: {JOINTS[1]}'
    assert status.values[f'{JOINTS[1]} cut to limit'] == '3'
    assert status.values[f'{JOINTS[1]} slowed'] == '3'
    assert status.values['cut to limit since the last report'] == JOINTS[1]
    status = part(monitor.report(2.0, loop, FINE), 'efforts')
    assert status.level is Level.OK
    assert status.values[f'{JOINTS[1]} cut to limit'] == '3'
    assert status.values['cut to limit since the last report'] == 'none'


def test_counts_rejected_messages_by_a_limited_number_of_reasons(loop):
    monitor = Monitor()
    monitor.reject('imu', 'broken')
    monitor.reject('imu', 'broken')
    for k in range(1000):
        monitor.reject('imu', f'is {k}')
    assert monitor.rejected['imu: broken'] == 2
    assert len(monitor.rejected) <= 21
    assert sum(monitor.rejected.values()) == 1002
    status = part(monitor.report(1.0, loop, FINE), 'messages')
    assert (status.level, status.message) == (
        Level.WARN,
        'messages rejected since the last report: 1002',
    )
    status = part(monitor.report(2.0, loop, FINE), 'messages')
    assert (status.level, status.message) == (Level.OK, 'messages rejected in total: 1002')


@pytest.mark.parametrize(
    ('now', 'around', 'name', 'level', 'words'),
    [
        (0.05, FINE, 'joint states', Level.OK, 'fresh'),
        (5.0, FINE, 'joint states', Level.ERROR, 'lost: '),
        (5.0, FINE._replace(is_active=False), 'joint states', Level.WARN, 'lost: '),
        (0.05, FINE, 'efforts', Level.OK, 'floating: no reference'),
        (
            0.05,
            FINE._replace(receivers=0),
            'efforts',
            Level.WARN,
            'the commands have no subscribers',
        ),
        (0.05, FINE, 'reference', Level.OK, 'no reference is used'),
        (0.05, FINE, 'loop', Level.OK, 'floating: no reference'),
        (0.05, FINE._replace(is_active=False, state='inactive'), 'loop', Level.OK, 'inactive'),
    ],
)
def test_levels_depend_on_whether_the_user_must_act(loop, now, around, name, level, words):
    status = part(Monitor().report(now, loop, around), name)
    assert status.level is level
    assert words in status.message


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
        store_state(loop.collector, now, JOINTS, [0.1, 0.2], [0.0, 0.0])
        loop.step(now)
    topics = Topics('/states', '/commands_with_names', '/external')
    around = FINE._replace(topics=topics, state_rate=123.4)
    report = Monitor(0.05).report(0.05, loop, around)
    names = ('loop', 'joint states', 'efforts', 'model')
    loop_is, states_are, efforts_are, model_is = (part(report, name).values for name in names)
    assert loop_is['state'] == 'active'
    assert loop_is['mode'] == 'computed_torque'
    assert loop_is['phase'] == 'floating: no reference'
    assert loop_is['gain'] == '0.250'
    assert states_are['topic'] == '/states'
    assert states_are['rate [Hz]'] == '123.4'
    assert states_are['timeout [s]'] == '0.25'
    assert efforts_are['topic with names'] == '/commands_with_names'
    assert efforts_are['topic of the external efforts'] == '/external'
    assert efforts_are['scale'] == '2, -0.5'
    assert efforts_are['limits [N m, N]'] == '3, 4'
    assert model_is['joints'] == ', '.join(JOINTS[::-1])
    assert float(model_is['mass [kg]']) == pytest.approx(ROBOT.mass.sum(), rel=1e-3)


def test_a_node_that_is_not_active_has_a_state_but_no_phase(loop):
    around = FINE._replace(is_active=False, state='inactive')
    values = part(Monitor().report(0.0, loop, around), 'loop').values
    assert values['state'] == 'inactive'
    assert not {'mode', 'phase', 'dry run', 'gain'} & set(values)


def test_without_a_robot_there_are_three_statuses():
    around = FINE._replace(is_active=False, state='unconfigured')
    parts = Monitor().report(0.0, None, around).parts()
    assert [(name, found.level) for name, found in parts.items()] == [
        ('loop', Level.OK),
        ('messages', Level.OK),
        ('other nodes', Level.OK),
    ]


def test_a_loop_that_started_within_the_second_is_not_slow(loop):
    monitor = Monitor(0.01)
    monitor.report(0.0, loop, FINE)
    monitor.pause()
    for k in range(40):
        monitor.step(0.6 + 0.01 * k, 1e-4, command(), JOINTS)
    status = part(monitor.report(1.0, loop, FINE), 'loop')
    assert status.level is Level.OK
    assert status.values['rate [Hz]'] == '100.0'


@pytest.mark.parametrize('mode', [Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE])
def test_warns_of_a_loop_without_damping(mode):
    loop = ControlLoop(ROBOT, settings=Settings(mode=mode))
    store_state(loop.collector, 0.0, JOINTS, [0.1, 0.2], [])
    status = part(Monitor().report(0.0, loop, FINE), 'joint states')
    assert status.level is Level.WARN
    assert status.message == f'joints reported without velocity have no damping in {mode.value}'
    assert status.values['without velocity'] == ', '.join(JOINTS)
    store_state(loop.collector, 0.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    assert part(Monitor().report(0.0, loop, FINE), 'joint states').level is Level.OK


def test_activity_names_the_reason_to_float(loop):
    assert activity(0.0, loop) == 'floating: no reference'
    rest = np.zeros(2)
    loop.reference = Reference(rest, rest, 0.0)
    loop.step(0.05)
    assert activity(0.05, loop) == 'following the reference'
    store_state(loop.collector, 1.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    loop.step(1.0)
    assert activity(1.0, loop) == 'floating: no reference for more than 0.5 s'
    loop.controller.apply(Settings(mode=Mode.GRAVITY_COMPENSATION))
    assert 'not used in mode gravity_compensation' in activity(1.0, loop)
    loop.controller.apply(Settings(mode=Mode.COMPUTED_TORQUE, max_position_jump=0.2))
    loop.reference = Reference(rest, rest, 1.0, positions=rest + 1.0)
    loop.step(1.0)
    distance = 'starts too far away or jumps too far (max_position_jump: 0.2 rad or m)'
    assert activity(1.0, loop) == f'floating: the reference {distance}'


def test_activity_distinguishes_an_arm_that_is_held(loop):
    loop.controller.apply(Settings(mode=Mode.JOINT_IMPEDANCE, max_position_jump=0.2))
    loop.step(0.0)
    assert activity(0.0, loop) == 'holding position: no reference'
    loop.reference = Reference(np.zeros(2), np.zeros(2), 0.05, positions=np.ones(2))
    loop.step(0.05)
    distance = 'starts too far away or jumps too far (max_position_jump: 0.2 rad or m)'
    assert activity(0.05, loop) == f'holding position: the reference {distance}'
    status = part(Monitor().report(0.05, loop, FINE), 'reference')
    assert status.level is Level.WARN
    assert status.message == 'holding position: the reference is too far away'


def step_until(loop, start, end):
    for now in np.arange(start, end, 0.05):
        loop.step(float(now))


def test_activity_names_the_joints_that_stop_the_arm(loop):
    step_until(loop, 0.0, 0.2)
    reason = f'no joint state of {JOINTS[0]}, {JOINTS[1]} for more than 0.1 s'
    assert activity(0.2, loop) == f'ramping efforts down: {reason}'
    step_until(loop, 0.2, 2.0)
    assert activity(2.0, loop) == f'stopped, zeros sent: {reason}'
    report = Monitor().report(2.0, loop, FINE)
    assert report.loop.message == report.efforts.message == activity(2.0, loop)


def test_activity_distinguishes_the_policy_for_lost_states(loop):
    step_until(loop, 0.0, 0.1)
    loop.controller.apply(Settings(on_stale_state=StalePolicy.HOLD))
    step_until(loop, 0.1, 2.0)
    assert activity(2.0, loop).startswith('keeping the last efforts: no joint state of ')
    loop.controller.stop()
    step_until(loop, 2.0, 2.1)
    assert activity(2.1, loop) == 'ramping efforts down: disabled by ~/enable'


def test_activity_while_disabled(loop):
    step_until(loop, 0.0, 0.1)
    loop.controller.stop()
    loop.step(0.1)
    loop.step(0.15)
    assert activity(0.15, loop) == 'ramping efforts down: disabled by ~/enable'
    step_until(loop, 0.2, 2.0)
    assert activity(2.0, loop) == 'stopped, zeros sent: disabled by ~/enable'


def test_a_dry_run_is_named_in_the_activity_and_in_the_report(loop):
    loop.dry_run = DryRun(is_active=True)
    assert activity(0.0, loop) == 'dry run: floating: no reference'
    for is_dry_run, word in ((True, 'yes'), (False, 'no')):
        loop.dry_run = DryRun(is_active=is_dry_run)
        report = Monitor().report(0.0, loop, FINE)
        assert part(report, 'loop').values['dry run'] == word
        for name in ('loop', 'efforts'):
            assert ('dry run: floating' in part(report, name).message) is is_dry_run
    loop.controller.stop()
    step_until(loop, 0.05, 2.0)
    loop.dry_run = DryRun(is_active=True)
    assert activity(2.0, loop) == 'dry run: stopped: disabled by ~/enable'


def test_a_missing_imu_is_not_an_error_of_the_joint_states():
    loop = ControlLoop(ROBOT, has_imu=True)
    store_state(loop.collector, 0.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    assert loop.missing('/joint_states', '/base/imu') == ['the motion of the base on /base/imu']
    statuses = Monitor().report(0.0, loop, FINE)
    assert part(statuses, 'joint states').level is Level.OK
    assert part(statuses, 'model').level is Level.ERROR
    assert part(statuses, 'model').message.endswith('no message on imu yet')


def others_of(subscribers=(), rivals=(), namesakes=0):
    names = NodeNames.of(subscribers), NodeNames.of(rivals)
    return OtherNodesStatus(Level.OK, '', '/commands', *names, namesakes)


RIVALS = others_of(rivals=('/a', '/b'))
NAMESAKES = others_of(namesakes=1)


@pytest.mark.parametrize(
    ('others', 'is_active', 'level', 'words'),
    [
        (others_of(), True, Level.OK, 'no other node publishes the commands'),
        (RIVALS, True, Level.ERROR, '/commands is also published by /a, /b'),
        (RIVALS, False, Level.WARN, '/commands is also published by /a, /b'),
        (NAMESAKES, True, Level.ERROR, 'another node has the name /arm'),
        (NAMESAKES, False, Level.ERROR, 'another node has the name /arm'),
        (others_of(namesakes=2), True, Level.ERROR, '2 other nodes have the name /arm'),
    ],
)
def test_nodes_that_interfere_are_named(loop, others, is_active, level, words):
    around = FINE._replace(name='/arm', others=others, is_active=is_active)
    status = part(Monitor().report(0.05, loop, around), 'other nodes')
    assert status.level is level
    assert words in status.message


def test_subscribers_that_do_not_match_are_named(loop):
    others = others_of(subscribers=('/bridge',))
    around = FINE._replace(receivers=0, others=others)
    status = part(Monitor().report(0.05, loop, around), 'efforts')
    assert status.level is Level.WARN
    assert status.message.startswith('the commands have no subscribers')
    assert 'another type or quality of service is used by /bridge' in status.message


def test_only_the_first_of_many_nodes_are_named(loop):
    others = others_of(rivals=tuple(f'/n{k}' for k in range(100)))
    status = part(Monitor().report(0.0, loop, FINE._replace(others=others)), 'other nodes')
    assert '/n0, /n1, /n2, /n3, /n4 and 95 more' in status.message


@pytest.mark.parametrize(
    ('clock', 'level', 'words'),
    [
        ((0.0, 0.5, 0), Level.OK, 'no message on /clock yet'),
        ((0.0, 2.0, 0), Level.WARN, 'nothing publishes /clock'),
        ((0.0, 6.0, 0), Level.ERROR, 'nothing publishes /clock'),
        ((0.0, 6.0, 1), Level.WARN, 'is the simulation paused?'),
        ((9.0, 0.2, 1), Level.OK, 'simulated time advances'),
        ((9.0, 6.0, 1), Level.WARN, 'has not advanced for more than 5 s'),
        ((9.0, 6.0, 0), Level.ERROR, 'nothing publishes /clock any more'),
        ((9.0, 6.0, 0), Level.ERROR, 'has not advanced for more than 5 s'),
    ],
)
def test_simulated_time_that_stands_still_is_reported(clock, level, words):
    found, message = judge_clock(*clock)
    assert found is level
    assert words in message


def test_there_is_no_clock_status_without_simulated_time(loop):
    assert Monitor().report(0.05, loop, FINE).clock is None


def test_reports_that_states_were_lost_until_they_have_been_fresh_for_a_while(loop):
    def status_at(now, arrival):
        store_state(loop.collector, arrival, JOINTS, [0.1, 0.2], [0.0, 0.0])
        loop.step(now)
        return part(Monitor().report(now, loop, FINE), 'joint states')

    for k in range(10):
        assert status_at(0.1 * k, 0.1 * k).level is Level.OK
    for now, arrival, words in (
        (1.1, 0.9, f'lost: {", ".join(JOINTS)}'),
        (1.2, 0.9, 'lost: '),
        (1.3, 1.3, 'for 0.2 s without a gap longer than state_timeout (0.1 s)'),
        (1.4, 1.4, 'efforts rise again after joint states have arrived for 0.2 s'),
    ):
        status = status_at(now, arrival)
        assert status.level is Level.ERROR
        assert words in status.message
    assert status_at(1.55, 1.55).level is Level.OK


def test_warns_of_joints_far_outside_their_limits():
    robot = load_urdf(STANFORD)
    loop = ControlLoop(robot)
    store_state(loop.collector, 0.0, robot.joint_names, [0.0, 57.3, 0.5, 0.0, 4.0, 0.0], [0.0] * 6)
    status = part(Monitor().report(0.0, loop, FINE), 'joint states')
    assert status.level is Level.WARN
    assert status.message == (
        'joint_2 is at 57.3 rad, outside its limits -1.745 to 1.745 (in degrees?); '
        'joint_5 is at 4 rad, outside its limits -1.92 to 1.92'
    )


def test_contradictory_positions_are_an_error_with_the_publishers(loop):
    for k in range(100):
        store_state(loop.collector, 0.001 * k, JOINTS, [0.1, 1.5 * (k % 2)], [0.0, 0.0])
        loop.step(0.001 * k)
    words = f'positions of {JOINTS[1]} alternate between 0 and 1.5 faster than the joint can move'
    around = FINE._replace(state_publishers=('/robot', '/joint_state_publisher'))
    status = part(Monitor().report(0.1, loop, around), 'joint states')
    assert status.level is Level.ERROR
    assert status.message == f'{words} (published by /robot, /joint_state_publisher)'
    question = 'does more than one node publish the state of this joint?'
    assert f'{words} ({question})' in activity(0.1, loop)


def test_no_command_is_late_without_a_period(loop):
    monitor = Monitor()
    for now in (0.0, 0.0, 1.0):
        monitor.step(now, 1e-4, command(), JOINTS)
    values = part(monitor.report(1.0, loop, FINE), 'loop').values
    assert values['overruns'] == '0'
    assert values['rate [Hz]'] == '2.0'
    assert values['requested rate [Hz]'] == 'that of the joint states'


def test_a_command_that_is_late_by_half_a_period_is_not_an_overrun():
    monitor = Monitor(2.0)
    for now in (0.0, 3.0, 6.5):
        monitor.step(now, 1e-4, command(), JOINTS)
    assert monitor.overruns == 1


def test_a_loop_without_commands_yet_is_not_slow(loop):
    assert part(Monitor(0.01).report(0.0, loop, FINE), 'loop').level is Level.OK


def test_rejected_messages_are_listed_with_their_numbers(loop):
    monitor = Monitor()
    for _ in range(3):
        monitor.reject('imu', 'broken')
    assert part(monitor.report(0.0, loop, FINE), 'messages').values == {'imu: broken': '3'}


def test_other_nodes_are_listed(loop):
    others = others_of()
    values = part(Monitor().report(0.0, loop, FINE._replace(others=others)), 'other nodes').values
    assert list(values.values()) == ['/commands', 'none', 'none', '0']
    others = others_of(('/bridge',), ('/rival',), 3)
    values = part(Monitor().report(0.0, loop, FINE._replace(others=others)), 'other nodes').values
    assert list(values.values()) == ['/commands', '/bridge', '/rival', '3']


def test_the_clock_and_the_numbers_of_nodes_are_reported(loop):
    clock = ClockStatus(Level.OK, 'simulated time advances', 12.5, 0.25, 4)
    around = FINE._replace(receivers=2, publishers=3, clock=clock)
    statuses = Monitor().report(0.0, loop, around)
    assert list(part(statuses, 'clock').values.values()) == ['12.500', '0.2', '4']
    assert part(statuses, 'efforts').values['receivers'] == '2'
    assert part(statuses, 'joint states').values['publishers'] == '3'


@pytest.mark.parametrize(('count', 'end'), [(5, '/n4'), (6, '/n4 and 1 more')])
def test_a_few_nodes_are_all_named(loop, count, end):
    others = others_of(tuple(f'/n{k}' for k in range(count)))
    values = part(Monitor().report(0.0, loop, FINE._replace(others=others)), 'other nodes').values
    assert any(value.endswith(end) for value in values.values())


@pytest.mark.parametrize(('is_active', 'level'), [(True, Level.ERROR), (False, Level.WARN)])
def test_joints_that_were_never_reported_are_named(is_active, level):
    loop = ControlLoop(ROBOT, period=0.05)
    loop.step(0.0)
    around = FINE._replace(is_active=is_active)
    status = part(Monitor().report(0.0, loop, around), 'joint states')
    assert status.level is level
    assert ', '.join(JOINTS) in status.message
    assert status.values['age [s]'] == 'never'


def test_lost_states_are_not_an_error_while_inactive(loop):
    step_until(loop, 0.0, 0.5)
    store_state(loop.collector, 0.5, JOINTS, [0.1, 0.2], [0.0, 0.0])
    loop.step(0.5)
    for is_active, level in ((True, Level.ERROR), (False, Level.WARN)):
        around = FINE._replace(is_active=is_active)
        assert part(Monitor().report(0.5, loop, around), 'joint states').level is level


def test_locked_and_late_joints_are_named():
    robot = load_urdf(STANFORD)
    names = robot.joint_names
    loop = ControlLoop(robot, names[:4], locked={names[4]: 0.0})
    q = [0.0, 0.0, 0.5, 0.0, 0.0]
    store_state(loop.collector, 0.0, [*names[:4], names[5]], q, [0.0] * 5)
    loop.step(0.0)
    status = part(Monitor().report(0.05, loop, FINE), 'joint states')
    assert status.level is Level.WARN
    assert 'locked' in status.message
    assert status.values['age [s]'] == '0.050'
    assert status.values['locked, never reported'] == names[4]
    assert status.values['late, not commanded'] == 'none'
    assert status.values['without velocity'] == 'none'
    store_state(loop.collector, 9.0, names[:4], q[:4], [0.0] * 4)
    loop.step(9.0)
    status = part(Monitor().report(9.0, loop, FINE), 'joint states')
    assert status.level is Level.WARN
    assert status.values['late, not commanded'] == names[5]


def test_the_reference_is_judged_by_its_use(loop):
    rest = np.zeros(2)
    assert part(Monitor().report(0.05, loop, FINE), 'reference').values['age [s]'] == 'never'
    loop.reference = Reference(rest, rest, 0.02)
    loop.step(0.05)
    status = part(Monitor().report(0.05, loop, FINE), 'reference')
    assert (status.level, status.message) == (Level.OK, 'followed')
    assert status.values == {'age [s]': '0.030', 'timeout [s]': '0.5', 'mode': 'inverse_dynamics'}
    loop.controller.apply(Settings(mode=Mode.COMPUTED_TORQUE))
    loop.reference = Reference(rest, rest, 0.05, positions=rest + 3.0)
    loop.step(0.06)
    status = part(Monitor().report(0.06, loop, FINE), 'reference')
    assert status.level is Level.WARN
    assert 'too far away' in status.message
    loop.controller.stop()
    loop.step(0.07)
    status = part(Monitor().report(0.07, loop, FINE), 'reference')
    assert (status.level, status.message) == (Level.OK, 'disabled')


def test_the_model_is_described(loop):
    status = part(Monitor().report(0.05, loop, FINE), 'model')
    assert status.level is Level.OK
    assert ROBOT.name in status.message
    assert status.values['payload'] == 'none'
    assert status.values['gravity [m/s^2]'].endswith('-9.807')
    loop.loads.set_payload(ROBOT.link_names[-1], 2.5, [0.1, 0.0, 0.0], np.zeros((3, 3)))
    loop.loads.apply(loop.loads.settings, include_gravity=False)
    values = part(Monitor().report(0.05, loop, FINE), 'model').values
    assert values['payload'] == f'2.5 kg on {ROBOT.link_names[-1]}'
    assert values['payload com [m]'] == '0.1, 0, 0'
    assert values['gravity [m/s^2]'] == 'not included'
    assert values['gravity in the root link [m/s^2]'].endswith('-9.807')


def test_what_measured_efforts_contain_is_described(loop):
    def values():
        return part(Monitor().report(0.05, loop, FINE), 'efforts').values

    assert values()['measured efforts contain gravity'] == 'yes'
    assert values()['scale of the measured efforts'] == '1, 1'
    loop.loads.apply(loop.loads.settings, include_gravity=False)
    loop.external_effort_estimator.scale[:] = -1.0, 0.5
    assert values()['measured efforts contain gravity'] == 'no'
    assert values()['scale of the measured efforts'] == '-1, 0.5'
    loop.measured_gravity = MeasuredGravity.INCLUDED
    assert values()['measured efforts contain gravity'] == 'yes'


def test_warnings_about_the_description_are_listed():
    warnings = tuple(ModelWarning(text, 'hint') for text in ('first', 'second'))
    robot = dataclasses.replace(ROBOT, warnings=warnings)
    status = part(Monitor().report(0.0, ControlLoop(robot), FINE), 'model')
    assert status.level is Level.WARN
    assert status.message.startswith('2 warnings')
    assert status.values['robot'] == ROBOT.name
    assert status.values['warning 1'] == 'first'
    assert status.values['warning 2'] == 'second'


def test_a_lost_imu_is_an_error_until_it_returns():
    loop = ControlLoop(ROBOT, has_imu=True)
    loop.set_base_motion(0.0, (0.0, 0.0, 9.8), np.zeros(3))
    assert part(Monitor().report(0.1, loop, FINE), 'model').level is Level.OK
    status = part(Monitor().report(0.5, loop, FINE), 'model')
    assert status.level is Level.ERROR
    assert status.message.endswith('no message on imu for more than 0.2 s')


def test_activity_names_a_joint_that_only_a_new_description_has(loop):
    link = ROBOT.link_names[-1]
    extra = (
        f'<link name="jaw"/><joint name="jaw" type="continuous"><parent link="{link}"/>'
        '<child link="jaw"/></joint></robot>'
    )
    text = (ROOT / 'test/robots/planar_2r.urdf').read_text().replace('</robot>', extra)
    other = ControlLoop(load_urdf(text), JOINTS)
    other.continue_from(loop, is_active=True)
    other.step(0.01)
    assert activity(0.01, other).endswith('no joint state of jaw yet')


def test_activity_without_usable_efforts_and_while_states_are_fresh_again(loop):
    loop.reference = Reference(np.full(2, 1.7e308), np.zeros(2), 0.0)
    loop.step(0.01)
    assert activity(0.01, loop).endswith(
        'no finite efforts for this joint state and reference: '
        "the acceleration of joint 'shoulder' is 1.7e+308"
    )
    loop.reference = None
    step_until(loop, 0.05, 0.5)
    store_state(loop.collector, 0.5, JOINTS, [0.1, 0.2], [0.0, 0.0])
    loop.step(0.5)
    assert 'efforts rise again after joint states have arrived for 0.2 s' in activity(0.5, loop)


@pytest.mark.parametrize(
    ('publishers', 'silence', 'words'),
    [
        (0, 9.0, ''),
        (2, 4.0, ''),
        (2, 9.0, '2 publishers are connected'),
        (1, 9.0, '1 publisher is connected'),
    ],
)
def test_connected_publishers_from_which_nothing_arrives_are_reported(publishers, silence, words):
    loop = ControlLoop(ROBOT, period=0.05)
    around = FINE._replace(publishers=publishers, silence=silence)
    message = part(Monitor().report(9.0, loop, around), 'joint states').message
    assert words in message
    assert ('connected' in message) is bool(words)


def test_all_joints_that_were_clamped_since_the_last_report_are_named(loop):
    monitor = Monitor()
    for k in range(2):
        monitor.step(0.1 * k, 1e-4, command(np.arange(2) == k), JOINTS)
    message = part(monitor.report(0.2, loop, FINE), 'efforts').message
    assert all(joint in message for joint in JOINTS)


def test_messages_rejected_after_a_report_are_in_the_next_one(loop):
    monitor = Monitor()
    for _ in range(2):
        monitor.reject('imu', 'broken')
        assert part(monitor.report(0.0, loop, FINE), 'messages').level is Level.WARN


def test_the_age_of_the_joint_states_is_reported(loop):
    store_state(loop.collector, 7.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    values = part(Monitor().report(7.25, loop, FINE), 'joint states').values
    assert values['age [s]'] == '0.250'


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
