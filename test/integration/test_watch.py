"""`inverse_dynamics watch` beside a running node: verdicts, pipes, JSON, and the terminal."""

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
import time

from fork_server import SERVER
from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import STANFORD
from robot_side import recording_at_rest
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

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
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        for call in calls:
            running.append(SERVER.run([*COMMAND[1:], *call], environment, stdout=subprocess.PIPE))
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


def decided(watch, *options):
    """Run a watch, and longer ones as long as the machine is too busy to collect the samples."""
    for seconds in ('3', '10', '30'):
        ((code, output),) = watch([*options, '--for', seconds, *ANY_RATE])
        if 'collecting samples' not in output.splitlines()[-1]:
            break
    return code, output


def last_object(output):
    """Return the last line of --json as an object."""
    return json.loads(output.splitlines()[-1])


def test_verdicts_of_a_dry_run_in_a_pipe(run_node, robot, watch):
    node = run_node(**PATIENT)
    hold(robot)
    robot.wait_for_text(node, 'floating')
    code, output = decided(watch)
    assert code == 6, output
    lines = [line for line in output.splitlines() if '/inverse_dynamics' in line]
    assert 1 <= len(lines) <= 30 + 10 + 2  # one a second, also while the node is discovered
    assert all(re.match(r'\d\d:\d\d:\d\d /inverse_dynamics', line) for line in lines)
    assert 'dry run' in lines[-1]
    assert ': not checked: move joint_1' in lines[-1]
    assert 'Otherwise model and robot agree: ' in lines[-1]
    code, output = decided(watch, '--unchecked', *NAMES)
    assert code == 0, output
    assert 'model and robot agree: ' in output.splitlines()[-1]

    robot.set_parameter('effort_limits', [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    robot.wait_for_text(node, 'effort cut to its limit: joint_2')
    code, output = decided(watch)
    assert code == 5, output
    assert 'joint_2: the effort is cut to its limit, so the arm cannot hold itself' in output
    robot.set_parameter('effort_limits', 0.0)

    efforts = HELD.copy()
    efforts[2] *= -1.0
    hold(robot, efforts)
    code, output = decided(watch, '--json')
    last = last_object(output)
    assert (code, last['exit_code'], last['outcome'], last['cause']) == (3, 3, 'differ', 'sign')
    assert last['problem_joints'] == ['joint_3']
    assert last['sentence'].startswith('joint_3 reports efforts with the wrong sign; ')
    assert '; do not go live. Change the sign in the driver' in last['sentence']
    loop, states = last['status']['loop'], last['status']['joint states']
    assert loop['values']['dry run'] == 'yes'
    assert loop['values']['mode'] == 'inverse_dynamics'
    assert (states['level'], states['values']['timeout [s]']) == ('OK', '5')
    joint = last['joints'][2]
    assert joint['name'] == 'joint_3'
    assert joint['position'] == pytest.approx(Q[2], abs=1e-6)
    for key, effort in (('measured', -HELD[2]), ('modelled', HELD[2]), ('command', HELD[2])):
        assert joint[key] == pytest.approx(effort, abs=1e-3), key
    assert joint['fraction'] == pytest.approx(abs(HELD[2]) / 200.0, abs=1e-4)

    robot.publish_state(NAMES, Q, np.zeros(6))
    ((code, output),) = watch(['--for', '2', *ANY_RATE])
    assert code == 4, output
    assert 'joint_states has no efforts' in output
    assert not robot.commands


def moving(factor=1.0, names=NAMES):
    """Return a function that returns the joint state of a moving arm with friction."""
    real = InverseDynamics(load_urdf(STANFORD))
    real.set_friction(0.0, 3.0)
    rate, reach = 1.2 + 0.1 * np.arange(6), np.array([0.5, 0.5, 0.1, 0.5, 0.5, 0.5])
    kept = [NAMES.index(name) for name in names]

    def state():
        angle = rate * time.monotonic()
        q, qd = Q + reach * np.sin(angle), reach * rate * np.cos(angle)
        qdd = -reach * rate**2 * np.sin(angle)
        held = [NAMES.index(name) for name in set(NAMES) - set(names)]
        q[held], qd[held], qdd[held] = 0.3, 0.0, 0.0
        efforts = real.efforts(q, qd, qdd)
        return JointState(
            name=list(names),
            position=q[kept].tolist(),
            velocity=(factor * qd[kept]).tolist(),
            effort=efforts[kept].tolist(),
        )

    return state


def test_an_arm_that_moves_is_checked_beside_a_joint_that_is_never_published(
    run_node, robot, watch
):
    names = NAMES[:5]
    node = run_node(**PATIENT, joints=names, **{'locked_positions.joint_6': 0.3})
    robot.keep_publishing('joint_states', moving(names=names), JointState)
    robot.wait_for_text(node, 'floating')
    for seconds in ('12', '30'):  # on a busy machine, few samples arrive
        ((code, output),) = watch(['--for', seconds, *ANY_RATE])
        if code == 0:
            break
    assert code == 0, output
    assert 'model and robot agree: ' in output.splitlines()[-1]


@pytest.mark.parametrize(('factor', 'words'), [(-1.0, 'has the wrong sign'), (0.0, 'is zero')])
def test_velocities_that_contradict_positions_are_a_difference(
    run_node, robot, watch, factor, words
):
    node = run_node(**PATIENT)
    robot.keep_publishing('joint_states', moving(factor), JointState)
    robot.wait_for_text(node, 'floating')
    code, output = decided(watch)
    assert code == 3, output
    assert f'the velocity of joint_1 {words}' in output.splitlines()[-1]


@pytest.mark.long
def test_gravity_that_a_driver_measures_but_adds_to_commands_is_named(run_node, robot, watch):
    sign = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    settings = {'include_gravity': False, 'measured_effort_scale': sign.tolist()}
    node = run_node(**PATIENT, **settings)
    real = InverseDynamics(load_urdf(STANFORD))
    real.set_payload('tool0', 2.0, (0.0, 0.0, 0.1))
    held = real.gravity_efforts(Q)
    robot.replay(recording_at_rest(NAMES, Q, sign * held))
    robot.wait_for_text(node, 'floating')
    load = Inertia(m=2.0, com=Vector3(z=0.1))
    message = InertiaStamped(header=Header(frame_id='tool0'), inertia=load)
    robot.publish_until(
        lambda: 'payload' in node.output, 'payload', 'inverse_dynamics/payload', message
    )
    code, output = decided(watch, '--json')
    last = last_object(output)
    assert (code, last['cause']) == (3, 'gravity_measured')
    assert last['sentence'].startswith(
        'the measured efforts contain gravity, but the commands do not; '
    )
    assert last['sentence'].endswith(
        'Is this intended? If the driver adds gravity to the commands, set measured_gravity to '
        'included in the node. Otherwise set include_gravity to true, or the arm will sink'
    )
    assert "link 'tool0' carries" not in last['sentence']  # the node knows the payload
    assert last['joints'][1]['measured'] == pytest.approx(held[1], abs=0.1)
    assert robot.set_parameter('measured_gravity', 'included').successful
    code, output = decided(watch, '--unchecked', *NAMES)
    assert code == 0, output
    assert 'model and robot agree: ' in output.splitlines()[-1]


def test_node_is_found_by_name_with_its_remapped_topics(run_node, robot, watch):
    first = run_node(**PATIENT)
    remaps = ('joint_states:=/joint_states', '~/external_efforts:=/contact', '__ns:=/left')
    left = run_node(*(x for remap in remaps for x in ('-r', remap)), **PATIENT)
    hold(robot)
    for node in (first, left):
        robot.wait_for_text(node, 'floating')
    named = decided(watch, '/left/inverse_dynamics', '--json')
    assert named[0] == 6, named[1]
    assert last_object(named[1])['node'] == '/left/inverse_dynamics'
    (ambiguous,) = watch(['--for', '20'])  # ends as soon as both are discovered
    assert ambiguous[0] == 1
    assert '2 nodes: /inverse_dynamics, /left/inverse_dynamics; choose one' in ambiguous[1]


class Terminal:
    """A process in the foreground of a terminal of its own, with everything that it shows."""

    def __init__(self, arguments, domain_id):
        self._master, self._terminal = pty.openpty()
        self.settings = termios.tcgetattr(self._terminal)
        self.resize(14, 80)

        def become_foreground():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            signal.signal(signal.SIGINT, signal.SIG_DFL)

        self.process = subprocess.Popen(
            arguments,
            stdin=self._terminal,
            stdout=self._terminal,
            stderr=self._terminal,
            preexec_fn=become_foreground,
            env={
                **os.environ,
                'ROS_DOMAIN_ID': str(domain_id),
                'TERM': 'xterm-256color',
                'COLUMNS': '80',  # as some shells export them
                'LINES': '14',
            },
        )
        self._shown = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        with contextlib.suppress(OSError):  # closed
            while data := os.read(self._master, 65536):
                self._shown.append(data.decode(errors='replace'))

    @property
    def screen(self):
        """Return all output so far, with its escape sequences."""
        return ''.join(self._shown)

    def resize(self, rows, columns):
        size = struct.pack('4H', rows, columns, 0, 0)
        fcntl.ioctl(self._terminal, termios.TIOCSWINSZ, size)

    def press_ctrl_c(self, robot):
        """Interrupt the process as a user does; return its exit code and how long it took [s]."""
        began = time.monotonic()
        os.write(self._master, b'\x03')
        robot.wait_until(lambda: self.process.poll() is not None, 'end of the process')
        return self.process.returncode, time.monotonic() - began

    def is_restored(self):
        """Return whether line editing, echo and signals are as before the process."""
        return termios.tcgetattr(self._terminal) == self.settings

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._terminal)
        os.close(self._master)


@pytest.fixture
def terminal(domain_id):
    """Return a function that starts `watch` in a terminal."""
    terminals = []

    def start(*arguments):
        terminals.append(Terminal([*COMMAND, *arguments], domain_id))
        return terminals[-1]

    yield start
    for each in terminals:
        each.close()


# Ending takes a fraction of a second. This is shorter than everything that `watch` may wait for in
# these tests: --for ends after ten minutes, and the node never ends.
SOON = 10.0  # [s]


def test_view_fits_the_terminal_and_restores_it(run_node, robot, terminal):
    node = run_node(**PATIENT)
    hold(robot)
    robot.wait_for_text(node, 'floating')
    view = terminal(*ANY_RATE, '--for', '600')
    robot.wait_until(lambda: 'model and robot agree' in view.screen, 'verdict on the screen')
    before = view.screen
    assert '\x1b[?1049h' in before  # the alternate screen
    assert '\x1b[?25l' in before  # no cursor
    assert 'DRY RUN' in before
    assert '\x1b[?1049l' not in before
    assert re.search(r' \d+%', before)  # the last column of the joints
    latest = before.rpartition('/inverse_dynamics')[2]
    assert 'no reference is used' not in latest  # below the last line of the terminal
    view.resize(40, 120)
    robot.wait_until(
        lambda: 'no reference is used' in view.screen.rpartition('/inverse_dynamics')[2],
        'all lines',
    )
    # Without diagnostics, nothing old is shown as if it were the present state.
    node.may_end = True
    node.kill()

    def shows_nothing_old():
        # On a busy machine, diagnostics may be late before the node ends.
        latest = view.screen.rpartition('/inverse_dynamics')[2]
        is_old = 'DRY RUN' in latest or 'no reference is used' in latest
        return 'NO DIAGNOSTICS' in view.screen and not is_old

    robot.wait_until(shows_nothing_old, 'end of the node')
    code, took = view.press_ctrl_c(robot)
    assert code == 130
    assert took < SOON
    # The terminal is as before, and the last verdict remains below the prompt.
    robot.wait_until(lambda: '\x1b[?1049l' in view.screen, 'end of the alternate screen')
    verdict = 'no diagnostics from /inverse_dynamics'
    robot.wait_until(lambda: verdict in view.screen.rpartition('\x1b[?1049l')[2], 'verdict')
    after = view.screen[len(before) :]
    assert after.rfind('\x1b[?25h') > after.rfind('\x1b[?25l')  # the cursor
    assert 'Traceback' not in after
    assert view.is_restored()


def test_interrupt_ends_the_wait_for_a_node(robot, terminal):
    view = terminal()
    robot.wait_until(lambda: 'still waiting' in view.screen, 'wait for a node')
    code, took = view.press_ctrl_c(robot)
    assert code == 130
    assert took < SOON
    assert 'Traceback' not in view.screen
    assert view.is_restored()
