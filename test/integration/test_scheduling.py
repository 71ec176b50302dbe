"""Real-time priority, where the machine permits it and where it does not."""

import contextlib
import ctypes
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from node_process import heed_signals
import pytest
from robot_side import HOLD, NAMES, PATIENT, Q, ZERO

CAP_SYS_NICE = 23
PR_CAPBSET_DROP = 24


def is_permitted():
    """Try the default priority in another process."""
    code = 'import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(51))'
    return subprocess.run([sys.executable, '-c', code], stderr=subprocess.DEVNULL).returncode == 0


needs_permission = pytest.mark.skipif(
    not is_permitted(), reason='SCHED_FIFO is not permitted: neither CAP_SYS_NICE nor rtprio'
)


def forbid():
    """Take the permissions from a process that is about to start, also from that of root."""
    heed_signals()
    libc = ctypes.CDLL(None)
    libc.prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))


def threads_of(pid):
    """Return name, policy and priority of every thread, by id."""
    found = {}
    for task in Path(f'/proc/{pid}/task').iterdir():
        tid = int(task.name)
        with contextlib.suppress(OSError):  # it has ended
            policy, priority = os.sched_getscheduler(tid), os.sched_getparam(tid).sched_priority
            found[tid] = (task / 'comm').read_text().strip(), policy, priority
    return found


@needs_permission
def test_the_loop_and_the_middleware_get_the_priority_and_others_do_not(
    run_node, robot, wait_for_status
):
    node = run_node(**PATIENT, thread_priority=40)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    pid = node.process.pid
    values = wait_for_status('scheduling', DiagnosticStatus.OK, 'real-time priority')
    assert (values['policy'], values['priority']) == ('SCHED_FIFO', '40')

    def scheduling(is_middleware):
        """Return policies and priorities; the threads of rclpy have no names of their own."""
        threads = threads_of(pid)
        del threads[pid]
        return [
            thread[1:]
            for thread in threads.values()
            if thread[0].startswith('dds.') is is_middleware
        ]

    # One listens to the graph; the other one is the executor's, for timers, and starts late.
    robot.wait_until(
        lambda: (
            scheduling(is_middleware=False).count((os.SCHED_FIFO, 40)) >= 2
            and set(scheduling(is_middleware=True)) == {(os.SCHED_FIFO, 40)}
        ),
        'priority of the threads of rclpy and of the middleware',
    )
    threads = threads_of(pid)
    assert threads[pid][1:] == (os.SCHED_FIFO, 40)
    # The watchdog runs while the loop does not sleep; threads of libraries compute in peace.
    priorities = sorted(priority for _, _, priority in threads.values())
    assert priorities[-1] == 41
    assert priorities.count(41) == 1
    assert priorities[0] == 0
    assert 'SCHED_FIFO priority 40 for the control loop and the middleware' in node.output
    assert robot.set_parameter('thread_priority', 41).successful is False


@pytest.mark.parametrize(
    ('given', 'level', 'words'),
    [({}, 'INFO', 'SCHED_FIFO 50 is not'), ({'thread_priority': 40}, 'WARN', 'SCHED_FIFO 40 is')],
    ids=['default', 'given'],
)
def test_without_permission_the_node_works_and_says_what_to_do(
    run_node, robot, wait_for_status, given, level, words
):
    node = run_node(prepare=forbid, **PATIENT, **given)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    expected = DiagnosticStatus.WARN if given else DiagnosticStatus.OK
    wait_for_status('scheduling', expected, f'normal priority: {words}')
    pid = node.process.pid
    assert threads_of(pid)[pid][1] == os.SCHED_OTHER
    node.interrupt(signal.SIGTERM)
    assert robot.wait_for_end(node) == 0
    lines = [line for line in node.output.splitlines() if 'SCHED_FIFO' in line]
    assert len(lines) == 1
    assert f'[{level}]' in lines[0]
    for text in (words, 'permitted (rtprio limit 0)', '@realtime - rtprio 99', 'SYS_NICE'):
        assert text in lines[0]
