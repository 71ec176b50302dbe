"""What the log of the node prints: each change once, and lasting problems from time to time."""

import logging

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
import pytest
from robot_files import ROOT
from states import store_state

pytest.importorskip('rclpy')

from inverse_dynamics_node.node.log import NodeLog
from inverse_dynamics_node.ros.diagnostics import Level, NodeStatus, Part

OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR


@pytest.fixture
def lines(caplog):
    """Return a log, and a function that returns the lines since its last call."""
    caplog.set_level(logging.INFO)

    def new():
        found = [(record.levelname, record.message) for record in caplog.records]
        caplog.clear()
        return found

    return NodeLog(logging.getLogger('node')), new


def clock(level, message):
    return NodeStatus(clock=Part(level, message, {}))


def test_the_log_prints_what_differs_from_the_last_status(lines):
    log, new = lines
    for level, message, expected in (
        (OK, 'fine', []),
        (WARN, 'paused for 3.5 s', [('WARNING', 'paused for 3.5 s')]),
        (WARN, 'paused for 4 s', []),  # the same problem
        (ERROR, 'paused for 9 s', [('ERROR', 'paused for 9 s')]),
        (OK, 'fine', [('INFO', 'solved: paused for 9 s')]),
        (ERROR, 'paused for 9 s', []),  # has just been logged
        (WARN, 'joint_1 is slow', [('WARNING', 'joint_1 is slow')]),
        (WARN, 'joint_2 is slow', [('WARNING', 'joint_2 is slow')]),
    ):
        log.report_status(clock(level, message), is_active=True)
        assert new() == expected


def test_three_different_reports_of_a_topic_are_logged_within_two_seconds(lines):
    log, new = lines
    for text in ('mass is -2.0', 'mass is -2.0', 'mass is inf', 'mass is nan', 'mass is -1.0'):
        log.report_message('~/payload', text)
    log.report_message('imu', 'mass is -1.0', is_problem=False)
    assert new() == [
        *(('WARNING', f'~/payload: mass is {mass}') for mass in ('-2.0', 'inf', 'nan')),
        ('INFO', 'imu: mass is -1.0'),
    ]


def test_what_is_logged_otherwise_is_not_logged_from_the_status(lines):
    log, new = lines
    for name in ('messages', 'reference', 'scheduling', 'model'):
        log.report_status(NodeStatus({name: Part(WARN, 'x', {})}), is_active=True)
    log.report_status(NodeStatus({'joint states': Part(WARN, 'x', {})}), is_active=False)
    assert not new()
    log.report_status(NodeStatus(model=Part(ERROR, 'x', {})), is_active=True)
    assert new() == [('ERROR', 'x')]


@pytest.fixture
def loop():
    robot = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
    loop = ControlLoop(robot, period=0.05)
    store_state(loop.collector, 0.0, robot.joint_names, [0.1, 0.2], [0.0, 0.0])
    loop.step(0.0)
    return loop


def test_a_limit_stop_is_logged_once(lines, loop):
    log, new = lines
    loop.limit_stop('elbow is too fast')
    loop.step(0.01)
    text = 'stopped: elbow is too fast'
    for _ in range(3):
        log.report_activity(0.01, loop)
        log.report_status(NodeStatus(loop=Part(ERROR, text, {})), is_active=True)
    assert new() == [('ERROR', text)]


def test_changes_in_quick_succession_are_not_all_logged(lines, loop):
    log, new = lines
    for k in range(20):  # as after jumps of the clock
        loop.supervisor.is_stopping = bool(k % 2)
        loop.step(0.001 * k)
        log.report_activity(0.001 * k, loop)
    assert len(new()) == 6
    log.begin()
    log.report_activity(0.02, loop)
    assert new() == [('INFO', 'ramping efforts down: disabled by ~/enable')]
