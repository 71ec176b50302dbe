"""The demo as a user runs it, and its verdict."""

from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import time

from fork_server import SERVER
import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.cli.demo import PASSED, verdict
from inverse_dynamics_node.simulation.demo import DemoRun, END, judge, Load

PATIENCE = 180.0  # [s]; a demo that can do nothing gives up by itself before this
ROBOT = load_urdf(STANFORD)
CHECKS = (
    'error while the arm moves',
    'drift while the arm holds its pose',
    'error with the load, before the payload is published',
    'error with the load, after the payload is published',
    'step of an effort when the payload arrives',
    'commands per second',
)


@contextmanager
def running_demo(*arguments):
    """Run the demo; end it even if the test fails."""
    command = ['-m', 'inverse_dynamics_node.cli.main', 'demo', *arguments]
    demo = SERVER.run(command, stdout=subprocess.PIPE)
    try:
        yield demo
    finally:
        if demo.poll() is None:
            demo.send_signal(signal.SIGINT)  # its processes end with it
            demo.communicate(timeout=PATIENCE)


def is_gone(number):
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            state = Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()[0]
        except OSError:
            return True
        if state == 'Z':
            return True
        time.sleep(0.01)
    return False


@pytest.mark.real_time
def test_arm_follows_holds_and_takes_a_payload(tmp_path):
    picture = tmp_path / 'closed_loop.png'
    with running_demo(STANFORD, '--picture', picture) as demo:
        output, _ = demo.communicate(timeout=PATIENCE)
    *_, last = output.splitlines()
    assert all(name in output for name in CHECKS), output
    assert (last == PASSED and demo.returncode == 0) or 'The machine was busy' in output, output
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('<link name="a"/>', 'one link and no joints'),
        (
            '<link name="a"/><link name="b"/><joint name="idle" type="continuous">'
            '<parent link="a"/><child link="b"/></joint>',
            "no mass resists the motion of joint 'idle'",
        ),
    ],
    ids=['no joints', 'no mass'],
)
def test_robot_that_cannot_be_simulated_is_rejected_with_the_reason(tmp_path, text, words):
    path = tmp_path / 'robot.urdf'
    path.write_text(f'<robot name="r">{text}</robot>')
    with running_demo(path) as demo:
        output, _ = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 1
    assert words in output
    assert 'Traceback' not in output


@pytest.mark.parametrize(
    ('is_child', 'number', 'code', 'words'),
    [
        (False, signal.SIGINT, 130, 'stopped'),
        (True, signal.SIGKILL, 1, 'the simulated robot ended early, with exit code -9'),
    ],
    ids=['Ctrl-C', 'robot dies'],
)
def test_no_process_is_left_behind(is_child, number, code, words):
    with running_demo(STANFORD) as demo:
        for line in demo.stdout:
            if line == ' 0.0 s: the arm follows a reference\n':
                break
        task = Path(f'/proc/{demo.pid}/task/{demo.pid}/children')
        children = [int(child) for child in task.read_text().split()]
        assert len(children) == 2
        os.kill(children[0] if is_child else demo.pid, number)
        output, _ = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == code
    assert words in output
    assert 'Traceback' not in output
    assert all(map(is_gone, children))


def run_of(moving=0.002, drift=0.0, unknown=0.1, known=0.0, step=0.0, period=0.002):
    """Return a run with the given errors [rad], largest step [N m] and period of commands [s]."""
    times, command_times = np.arange(0.0, END, 0.002), np.arange(0.0, END, period)
    count = len(ROBOT.joint_names)
    positions, commands = np.zeros((len(times), count)), np.ones((len(command_times), count))
    positions[times < 6.0, 0] = moving
    positions[(times >= 7.5) & (times < 8.0), 0] = drift
    positions[(times >= 8.0) & (times < 10.6), 0] = unknown
    positions[times >= 10.6, 0] = known
    commands[command_times >= 10.6, 0] += step
    load = Load('tool0', 2.0, np.full(count, 10.0), np.full(count, 0.1))
    return DemoRun(ROBOT, load, times, positions, 0.0 * positions, command_times, commands, 0.0)


@pytest.mark.parametrize(
    ('changes', 'failed'),
    [
        ({}, None),
        ({'moving': 0.011}, 0),
        ({'drift': 0.0011}, 1),
        ({'unknown': 0.04}, 2),
        ({'known': 0.0011}, 3),
        ({'known': np.nan}, 3),
        ({'step': 1.1}, 4),
        ({'period': 0.0021}, 5),
    ],
)
def test_each_value_beyond_its_limit_fails(changes, failed):
    checks = judge(run_of(**changes))
    assert tuple(check.name for check in checks) == CHECKS
    expected = PASSED if failed is None else f'FAILED: {CHECKS[failed]}'
    assert verdict(checks) == expected
