"""What is counted, and how bad it is."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.controller import Command, Mode, Settings
from inverse_dynamics_node.monitor import Level, Monitor, Surroundings
from inverse_dynamics_node.rig import Rig
import numpy as np
import pytest
from robot_files import ROOT

ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
JOINTS = ROBOT.joint_names
FINE = Surroundings(receivers=1, publishers=1, is_active=True, state='active')
NEITHER = np.zeros(2, dtype=bool)
SECOND = np.array([False, True])


def command(is_saturated=NEITHER, is_slowed=NEITHER):
    return Command(np.zeros(2), is_saturated, is_slowed)


def part(statuses, name):
    return next(status for status in statuses if status.part == name)


@pytest.fixture
def rig():
    rig = Rig(ROBOT)
    rig.collector.update(0.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    rig.step(0.0)
    return rig


def test_measures_rate_and_periods(rig):
    monitor = Monitor(0.01)
    monitor.report(0.0, rig, FINE)
    for k in range(100):
        late = 0.008 if k == 50 else 0.0
        monitor.step(0.01 * k + late, 1e-4 * (1.0 + k), command(), JOINTS)
    values = part(monitor.report(1.0, rig, FINE), 'loop').values
    assert values['rate [Hz]'] == '100.0'
    assert values['rate asked for [Hz]'] == '100'
    assert values['period worst [ms]'] == '18.000'
    assert float(values['compute time p99 [ms]']) == pytest.approx(9.9, abs=0.05)
    assert values['overruns'] == '1'
    assert part(monitor.report(1.5, rig, FINE), 'loop').values['rate [Hz]'] == '0.0'


def test_warns_of_a_rate_that_is_not_reached(rig):
    monitor = Monitor(0.01)
    monitor.report(0.0, rig, FINE)
    for k in range(90):
        monitor.step(0.011 * k, 1e-4, command(), JOINTS)
    status = part(monitor.report(1.0, rig, FINE), 'loop')
    assert status.level is Level.WARN
    assert status.message == 'only 90.9 commands/s'


def test_a_pause_and_a_clock_put_back_are_no_overrun(rig):
    monitor = Monitor(0.01)
    monitor.step(5.0, 1e-4, command(), JOINTS)
    monitor.pause()
    monitor.step(9.0, 1e-4, command(), JOINTS)
    monitor.step(1.0, 1e-4, command(), JOINTS)
    assert monitor.overruns == 0


def test_counts_every_clamp_and_warns_as_long_as_it_is_news(rig):
    monitor = Monitor()
    for _ in range(3):
        monitor.step(0.0, 1e-4, command(SECOND, SECOND), JOINTS)
    status = part(monitor.report(1.0, rig, FINE), 'efforts')
    assert status.level is Level.WARN
    assert status.message == f'cut to its limit: {JOINTS[1]}'
    assert status.values[f'{JOINTS[1]} cut to limit'] == '3'
    assert status.values[f'{JOINTS[1]} slowed'] == '3'
    status = part(monitor.report(2.0, rig, FINE), 'efforts')
    assert status.level is Level.OK
    assert status.values[f'{JOINTS[1]} cut to limit'] == '3'


def test_counts_rejected_messages_by_reason_but_not_without_end(rig):
    monitor = Monitor()
    monitor.reject('imu', 'broken')
    monitor.reject('imu', 'broken')
    for k in range(1000):
        monitor.reject('imu', f'is {k}')
    assert monitor.rejected['imu: broken'] == 2
    assert len(monitor.rejected) <= 21
    assert sum(monitor.rejected.values()) == 1002
    status = part(monitor.report(1.0, rig, FINE), 'messages')
    assert (status.level, status.message) == (Level.WARN, '1002 rejected lately')
    status = part(monitor.report(2.0, rig, FINE), 'messages')
    assert (status.level, status.message) == (Level.OK, '1002 rejected in all')


@pytest.mark.parametrize(
    ('now', 'around', 'name', 'level', 'words'),
    [
        (0.05, FINE, 'joint states', Level.OK, 'fresh'),
        (5.0, FINE, 'joint states', Level.ERROR, 'lost: '),
        (5.0, FINE._replace(is_active=False), 'joint states', Level.WARN, 'lost: '),
        (0.05, FINE, 'efforts', Level.OK, 'no fresh reference'),
        (0.05, FINE._replace(receivers=0), 'efforts', Level.WARN, 'nobody receives'),
        (0.05, FINE, 'reference', Level.OK, 'none'),
        (0.05, FINE, 'loop', Level.OK, 'no fresh reference'),
        (0.05, FINE._replace(is_active=False, state='inactive'), 'loop', Level.OK, 'inactive'),
    ],
)
def test_judges_by_what_a_user_must_do(rig, now, around, name, level, words):
    status = part(Monitor().report(now, rig, around), name)
    assert status.level is level
    assert words in status.message


def test_without_a_robot_there_is_little_to_tell():
    around = FINE._replace(is_active=False, state='unconfigured')
    statuses = Monitor().report(0.0, None, around)
    assert [(status.part, status.level) for status in statuses] == [
        ('loop', Level.OK),
        ('messages', Level.OK),
    ]


def test_all_values_are_texts(rig):
    for status in Monitor(0.01).report(0.05, rig, FINE):
        assert all(isinstance(x, str) for pair in status.values.items() for x in pair)


def test_a_loop_that_began_within_the_second_is_not_slow(rig):
    monitor = Monitor(0.01)
    monitor.report(0.0, rig, FINE)
    monitor.pause()
    for k in range(40):
        monitor.step(0.6 + 0.01 * k, 1e-4, command(), JOINTS)
    status = part(monitor.report(1.0, rig, FINE), 'loop')
    assert status.level is Level.OK
    assert status.values['rate [Hz]'] == '100.0'


def test_warns_of_a_loop_without_damping():
    rig = Rig(ROBOT, settings=Settings(mode=Mode.COMPUTED_TORQUE))
    rig.collector.update(0.0, JOINTS, [0.1, 0.2], [])
    status = part(Monitor().report(0.0, rig, FINE), 'joint states')
    assert status.level is Level.WARN
    assert status.message == 'no velocity, no damping of the loop'
    assert status.values['without velocity'] == ', '.join(JOINTS)
    rig.collector.update(0.0, JOINTS, [0.1, 0.2], [0.0, 0.0])
    assert part(Monitor().report(0.0, rig, FINE), 'joint states').level is Level.OK
