"""
Sends a million messages, most of them useless, to the subscriptions of the node.

The program checks these conditions:

- Commands are complete, finite and within their limits. The last command is zero.
- The node continues to run, and answers a service.
- The memory of the node grows by at most the size of its executor's queue.
- Lost joint states and SIGTERM take effect in time.

It prints a table for doc/evidence/reliability.md.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
from pathlib import Path
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from domain_coordinator import domain_id
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.ros.middleware import start_ros
from lifecycle_msgs.srv import GetState
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from stalls import StallMeter
from std_msgs.msg import Float64MultiArray

from . import machine, processes

ROOT = Path(__file__).parent.parent
ROBOT = ROOT / 'config/stanford.urdf'
Q = (0.3, 0.8, 0.5, -0.4, 0.6, 0.2)
STATE_TIMEOUT, STOP_RAMP = 0.1, 0.2  # [s]
ALLOWANCE = 0.5  # [s]; for the detection of lost states, in addition to timeout and ramp
LONGEST_END = 1.5  # [s]; longest time from SIGTERM to the end of the process
EVENT, BEFORE = 200.0, 50.0  # [bytes] per message in the queue; [MB] for all other memory
PATIENCE = 60.0  # [s]; time limit of each wait


class StormError(Exception):
    """A check of the storm test failed."""


class Robot:
    """Publishes joint states at 200 Hz and checks every command."""

    def __init__(self) -> None:
        model = load_urdf(ROBOT)
        self.names = list(model.joint_names)
        self.limits = model.effort_limits
        self.hold = InverseDynamics(model).gravity_efforts(Q)
        self.node = rclpy.create_node('robot')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.is_publishing = True
        self.commands = 0
        self.last: list[float] = []
        self.longest_gap = 0.0
        self._last_time = math.nan
        self._message = JointState(name=self.names, position=Q, velocity=[0.0] * len(Q))
        self._states = self.node.create_publisher(JointState, 'joint_states', 10)
        self.node.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._check, 100
        )
        self._state = self.node.create_client(GetState, 'inverse_dynamics/get_state')
        self.node.create_timer(0.005, self._publish)

    def _publish(self) -> None:
        if self.is_publishing:
            self._states.publish(self._message)

    def _check(self, message: Float64MultiArray) -> None:
        now = time.monotonic()
        if self.commands:
            self.longest_gap = max(self.longest_gap, now - self._last_time)
        self._last_time = now
        self.commands += 1
        self.last = list(message.data)
        if len(self.last) != len(self.names):
            raise StormError(f'a command has {len(self.last)} efforts, expected {len(self.names)}')
        if not np.isfinite(self.last).all():
            raise StormError(f'a command is not finite: {self.last}')
        if (np.abs(self.last) > self.limits).any():
            raise StormError(f'a command exceeds the limits {self.limits}: {self.last}')

    def wait(self, is_true: Any, what: str, patience: float = PATIENCE) -> float:
        """Spin until a condition is true; return the waiting time [s]."""
        began = time.monotonic()
        while not is_true():
            if time.monotonic() > began + patience:
                raise StormError(
                    f'{what}: not within {patience:g} s; the last command: {self.last}'
                )
            self.executor.spin_once(timeout_sec=0.02)
        return time.monotonic() - began

    def ask_for_state(self, patience: float) -> str:
        """Ask the node for its lifecycle state with a service; return the name of the state."""
        self.wait(self._state.service_is_ready, 'service get_state', patience)
        future = self._state.call_async(GetState.Request())
        self.wait(future.done, 'answer of get_state', patience)
        return str(future.result().current_state.label)

    def holds(self) -> bool:
        """Return whether the last command holds the arm against gravity."""
        return bool(self.last) and bool(np.allclose(self.last, self.hold, rtol=1e-3, atol=1e-3))


class Waiting:
    """Measures the longest time that a thread of a process waits for a CPU, from now on."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._before = self._last = processes.waiting_times(pid)

    def update(self) -> bool:
        """Read the waiting times again if the process still exists; return False."""
        with contextlib.suppress(OSError):
            self._last = {**self._last, **processes.waiting_times(self._pid)}
        return False

    @property
    def longest(self) -> float:
        """Longest waiting time of a thread [s]."""
        return max(last - self._before.get(thread, 0.0) for thread, last in self._last.items())


def run(messages: int, seconds: float, log: Any) -> tuple[dict[str, str], list[str]]:
    """Run the node through a storm; return the measurements and a list of problems."""
    settings = {
        'robot_description_file': ROBOT,
        'start_ramp': 0.0,
        'state_timeout': STATE_TIMEOUT,
        'stop_ramp': STOP_RAMP,
    }
    arguments = [part for name, x in settings.items() for part in ('-p', f'{name}:={x}')]
    node = processes.start(
        ['inverse_dynamics_node.node.main', '--ros-args', *arguments], stdout=log, stderr=log
    )
    robot = None
    storms: list[subprocess.Popen[str]] = []
    try:
        robot = Robot()
        robot.wait(robot.holds, 'holding the arm before the storm')
        memory = processes.resident(node.pid)
        robot.longest_gap = 0.0
        began = time.monotonic()
        with StallMeter() as stalls:
            storms += [start_storm(messages // 2, seconds, seed) for seed in (1, 2)]
            is_over = lambda: all(storm.poll() is not None for storm in storms)  # noqa: E731
            robot.wait(is_over, 'end of it', seconds + PATIENCE)
        took = time.monotonic() - began
        outputs = [storm.stdout.read() for storm in storms if storm.stdout]
        counts = [re.findall(r'sent (\d+) in ([\d.]+) s', output)[0] for output in outputs]
        sent = sum(int(count) for count, _ in counts)
        rate = sum(int(count) / float(duration) for count, duration in counts)
        gap, longest_stall = robot.longest_gap, stalls.longest
        growth = processes.resident(node.pid) - memory
        if node.poll() is not None:
            raise StormError(f'the node ended with code {node.returncode}')
        # The node first handles its queue. This takes at most as long as filling the queue took.
        began = time.monotonic()
        if robot.ask_for_state(PATIENCE + 2.0 * took) != 'active':
            raise StormError('the node is not active after the storm')
        answer = time.monotonic() - began
        # In a second storm, joint states stop and the node receives SIGTERM.
        storms += [start_storm(messages, seconds, seed) for seed in (3, 4)]
        # Each storm process prints a line when it has found all subscriptions.
        lines = [storm.stdout for storm in storms[2:]]
        robot.wait(lambda: len(select.select(lines, (), (), 0.0)[0]) == 2, 'the second storm')
        sent_before = robot.commands
        robot.wait(lambda: robot.commands > sent_before + 50, 'commands during the storm')
        waiting = Waiting(node.pid)
        robot.is_publishing = False
        zeros = robot.wait(
            lambda: waiting.update() or not any(robot.last), 'zeros after the states were lost'
        )
        node.send_signal(signal.SIGTERM)
        end = robot.wait(lambda: waiting.update() or node.poll() is not None, 'end after SIGTERM')
        for _ in range(20):
            robot.executor.spin_once(timeout_sec=0.01)
        if node.returncode != 0:
            raise StormError(f'the node ended with code {node.returncode}, expected 0')
        if any(robot.last):
            raise StormError(f'the last command is {robot.last}, expected zeros')
    finally:
        processes.end([*storms, node])
        if robot:
            robot.executor.shutdown()
            robot.node.destroy_node()
    limit = STATE_TIMEOUT + STOP_RAMP + ALLOWANCE + waiting.longest
    problems = [
        f'{what}: {value:.2f}, expected at most {most:.2f}'
        for what, value, most in (
            ('zeros after lost states [s]', zeros, limit),
            ('end after SIGTERM [s]', end, LONGEST_END + waiting.longest),
            ('growth of memory [MB]', growth, BEFORE + EVENT * sent / 2**20),
        )
        if value > most
    ]
    if sent < messages:
        problems.append(f'{sent} messages in {seconds:g} s, expected {messages}')
    results = {
        'messages sent': f'{sent}',
        'messages per second': f'{rate:.0f}',
        'commands checked': f'{robot.commands}',
        'longest time between commands [s]': f'{gap:.3f}',
        'longest stall of this program meanwhile [s]': f'{longest_stall:.3f}',
        'growth of memory [MB]': f'{growth:.0f}',
        'answer of a service after the storm [s]': f'{answer:.1f}',
        'zeros after lost states [s]': f'{zeros:.2f}',
        'end after SIGTERM [s]': f'{end:.2f}',
        'time for which the node waited for a CPU in these two [s]': f'{waiting.longest:.3f}',
    }
    return results, problems


def start_storm(messages: int, seconds: float, seed: int) -> subprocess.Popen[str]:
    """Start one of the processes that send messages."""
    options = {'messages': messages, 'seconds': seconds, 'seed': seed}
    arguments = [part for name, x in options.items() for part in (f'--{name}', str(x))]
    return processes.start(['storm', *arguments], stdout=subprocess.PIPE)


def main() -> int:
    """Run the storm and print the measurements; return the exit code."""
    parser = argparse.ArgumentParser(prog='make storm', description=__doc__)
    parser.add_argument('--messages', type=int, default=1_000_000)
    parser.add_argument('--seconds', type=float, default=3000.0, help='the longest time to send')
    options = parser.parse_args()
    processes.heed_signals()
    before = machine.describe(machine.ROS_PACKAGES)
    processes.raise_robot_side()
    with domain_id() as domain, tempfile.NamedTemporaryFile(suffix='.log') as log:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        start_ros([])
        try:
            results, problems = run(options.messages, options.seconds, log)
        except StormError as failure:
            log.seek(max(0, os.fstat(log.fileno()).st_size - 3000))
            print(f'{log.read().decode(errors="replace")}\nFAILED: {failure}', file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print('interrupted', file=sys.stderr)
            return 130
        finally:
            rclpy.shutdown()
    print('| | |\n|---|---|')
    for name, value in results.items():
        print(f'| {name} | {value} |')
    print(f'\n{before} Load {machine.load()} at the end.')
    if problems:
        print(f'FAILED: {"; ".join(problems)}', file=sys.stderr)
        return 1
    print('Every command was complete, finite and within its limits; the node ended with zeros.')
    return 0


if __name__ == '__main__':
    sys.exit(main())
