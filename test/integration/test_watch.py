"""`inverse_dynamics watch` beside a running node: verdicts, pipes, JSON, and the terminal."""

import fcntl
import json
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('rich')

NAMES = list(load_urdf(STANFORD).joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
HELD = InverseDynamics(load_urdf(STANFORD)).gravity_efforts(Q)
PATIENT = {'robot_description_file': STANFORD, 'state_timeout': 5.0, 'dry_run': True}
# The machine may be too busy for 80 joint states per second.
ANY_RATE = ('--rate', '1')
COMMAND = [sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'watch']


@pytest.fixture
def watch(domain_id, robot):
    """Return a function that runs several watches at once, and returns codes and outputs."""
    running = []

    def run(*calls):
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        for call in calls:
            running.append(
                subprocess.Popen(
                    [*COMMAND, *call],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    env=environment,
                )
            )
        outputs = [''] * len(calls)

        def read(k, process):
            outputs[k] = process.stdout.read()

        threads = [
            threading.Thread(target=read, args=each) for each in enumerate(running[-len(calls) :])
        ]
        for thread in threads:
            thread.start()
        # The robot publishes only while it waits.
        robot.wait_until(lambda: not any(thread.is_alive() for thread in threads), 'end of watch')
        codes = [process.wait() for process in running[-len(calls) :]]
        return list(zip(codes, outputs, strict=True))

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
            process.wait()


def hold(robot, efforts=HELD):
    """Publish the state of an arm at rest in Q."""
    robot.publish_state(NAMES, Q, np.zeros(6), efforts)


def last_object(output):
    """Return the last line of --json as an object."""
    return json.loads(output.splitlines()[-1])


def test_verdicts_of_a_dry_run_in_a_pipe(run_node, robot, watch):
    node = run_node(**PATIENT)
    hold(robot)
    robot.wait_for_text(node, 'holding position')
    ((code, output),) = watch(['--for', '3', *ANY_RATE])
    assert code == 0, output
    lines = [line for line in output.splitlines() if '/inverse_dynamics' in line]
    assert 1 <= len(lines) <= 8
    assert all(re.match(r'\d\d:\d\d:\d\d /inverse_dynamics', line) for line in lines)
    assert 'dry run' in lines[-1]
    assert 'model and robot agree: ' in lines[-1]
    assert 'not checked, because the efforts are small: joint_1' in lines[-1]

    efforts = HELD.copy()
    efforts[2] *= -1.0
    hold(robot, efforts)
    ((code, output),) = watch(['--for', '3', '--json', *ANY_RATE])
    last = last_object(output)
    assert (code, last['exit_code'], last['outcome'], last['cause']) == (3, 3, 'differ', 'sign')
    assert last['problem_joints'] == ['joint_3']
    assert (
        last['sentence']
        == 'joint_3: measured and modelled effort have opposite signs; do not go live'
    )
    assert last['status']['dry_run'] is True
    assert last['status']['mode'] == 'inverse_dynamics'
    assert last['status']['joint_state_timeout'] == 5.0
    joint = last['joints'][2]
    assert joint['name'] == 'joint_3'
    assert joint['position'] == Q[2]
    for key, effort in (('measured', -HELD[2]), ('modelled', HELD[2]), ('command', HELD[2])):
        assert joint[key] == pytest.approx(effort, abs=1e-3), key
    assert joint['fraction'] == pytest.approx(abs(HELD[2]) / 200.0, abs=1e-4)

    robot.publish_state(NAMES, Q, np.zeros(6))
    ((code, output),) = watch(['--for', '2', *ANY_RATE])
    assert code == 4, output
    assert 'joint_states has no efforts' in output
    assert not robot.commands


def test_node_is_found_by_name_with_its_remapped_topics(run_node, robot, watch):
    run_node(**PATIENT)
    remaps = ('joint_states:=/joint_states', '~/external_efforts:=/contact', '__ns:=/left')
    left = run_node(*(x for remap in remaps for x in ('-r', remap)), **PATIENT)
    hold(robot)
    robot.wait_for_text(left, 'holding position')
    (named,) = watch(['/left/inverse_dynamics', '--for', '3', '--json', *ANY_RATE])
    assert named[0] == 0, named[1]
    assert last_object(named[1])['node'] == '/left/inverse_dynamics'
    (ambiguous,) = watch(['--for', '20'])  # ends as soon as both are discovered
    assert ambiguous[0] == 1
    assert '2 nodes: /inverse_dynamics, /left/inverse_dynamics; choose one' in ambiguous[1]


def test_interrupt_restores_the_terminal(run_node, robot, domain_id):
    node = run_node(**PATIENT)
    hold(robot)
    robot.wait_for_text(node, 'holding position')
    master, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)
    size = b'\x28\x00\x78\x00\x00\x00\x00\x00'  # 40 rows, 120 columns
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, size)

    def become_foreground():
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    process = subprocess.Popen(
        [*COMMAND, *ANY_RATE],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        preexec_fn=become_foreground,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id), 'TERM': 'xterm-256color'},
    )
    shown = []

    def read():
        try:
            while data := os.read(master, 65536):
                shown.append(data.decode(errors='replace'))
        except OSError:  # closed
            pass

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        robot.wait_until(
            lambda: 'model and robot agree' in ''.join(shown), 'verdict on the screen'
        )
        screen = ''.join(shown)
        assert '\x1b[?1049h' in screen  # the alternate screen
        assert 'DRY RUN' in screen
        assert '\x1b[?1049l' not in screen
        os.write(master, b'\x03')  # Ctrl-C
        robot.wait_until(lambda: process.poll() is not None, 'end of watch')
        assert process.returncode == 130
        # The terminal is as before, and the last verdict remains below the prompt.
        robot.wait_until(lambda: '\x1b[?1049l' in ''.join(shown), 'end of the alternate screen')
        end = ''.join(shown).rpartition('\x1b[?1049l')[2]
        robot.wait_until(lambda: 'agree' in ''.join(shown).rpartition('\x1b[?1049l')[2], 'verdict')
        assert '\x1b[?25h' in ''.join(shown)[len(screen) :]  # the cursor
        assert 'Traceback' not in end
        assert termios.tcgetattr(terminal) == before
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        os.close(terminal)
        os.close(master)
