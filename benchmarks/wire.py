"""Measurement of a process that answers joint states with commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from typing import Any, NamedTuple

from inverse_dynamics_node.robot.model import Floats
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from .timing import missed

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of joint states, equal to the node's."""
EVERY_ONE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Quality of service of commands, equal to the node's."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

PATIENCE = 60.0  # [s]; time limit for a process to start, and to be discovered
LOST = 0.1  # [s]; a state without an answer after this time is lost
WARM_UP = 0.3  # [s]; time at the start of a turn that is not measured
LONGEST = 60.0  # [s]; time limit for other work of the process


class Answers(NamedTuple):
    """Answers to the states of one turn; the states are sent at a fixed rate."""

    times: Floats
    """Time from each state to the first command for this or a later state [s]."""
    cpu: float
    """CPU time of the process per second [s]."""


class Ticks(NamedTuple):
    """Commands in one turn at a fixed rate, with states at the same rate."""

    missed: int
    """Number of periods without a command in their first half."""
    slept: int
    """Number of periods without a state in their first half; the sender mostly sleeps."""
    periods: int
    cpu: float
    """CPU time of the process per second [s]."""


class Contender:
    """
    A process on its own ROS domain, stopped while other contenders have their turn.

    The process runs a Python module with the topics ``joint_states`` and ``~/commands``. The
    arguments for ROS come last. ``prepare`` runs in the new process before Python starts, and sets
    the priority. No other process may use the domain.
    """

    def __init__(
        self, module: str, arguments: Sequence[str], domain: int, prepare: Callable[[], None]
    ) -> None:
        self.domain = domain
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._node = rclpy.create_node('robot', context=self._context, enable_rosout=False)
        self._publisher = self._node.create_publisher(JointState, 'joint_states', NEWEST)
        self._accelerations = self._node.create_publisher(
            Float64MultiArray, 'contender/desired_accelerations', EVERY_ONE
        )
        self._commands = self._node.create_subscription(
            Float64MultiArray, 'contender/commands', self._on_command, 100, raw=True
        )
        self._description = self._node.create_publisher(String, 'robot_description', LATCHED)
        self._trajectories = self._node.create_publisher(
            JointTrajectory, 'contender/joint_trajectory_in', EVERY_ONE
        )
        self._filled = self._node.create_subscription(
            JointTrajectory, 'contender/joint_trajectory_out', _ignore, 1, raw=True
        )
        self._executor: Any = None
        self._states: list[bytes] = []
        self._k = 0
        self._sent = 0
        self._times: list[int] = []
        self._numbers: dict[bytes, int] = {}
        self._pending: deque[tuple[int, int]] = deque()
        self._process = subprocess.Popen(
            [sys.executable, '-m', module, *arguments, '-r', '__node:=contender'],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
            preexec_fn=prepare,
        )

    def start(
        self, states: Sequence[JointState], accelerations: Sequence[float], expected: Floats
    ) -> None:
        """
        Wait for the expected command for every joint state, then stop the process until its turn.

        ``accelerations`` are requested for all states. ``expected`` contains one command per row.
        Raise a TimeoutError if a command does not arrive, or the process ends.
        """
        deadline = time.monotonic() + PATIENCE
        for state, command in zip(states, expected, strict=True):
            data = serialize_message(state)
            last = b''
            while not _is_close(last, command):
                if time.monotonic() > deadline or self._process.poll() is not None:
                    raise TimeoutError(f'expected {command}, last was {_numbers(last)}')
                self._accelerations.publish(Float64MultiArray(data=accelerations))
                self._publisher.publish(data)
                time.sleep(0.005)
                last = self._take() or last
            self._numbers[last[-8 * len(command) :]] = len(self._states)
            self._states.append(data)
        if len(self._numbers) != len(self._states):
            raise ValueError('the commands for several states are equal')
        self._size = 8 * len(command)
        self._process.send_signal(signal.SIGSTOP)

    def answers(self, seconds: float, period: float) -> Answers:
        """Send one state per period [s] for a time [s], without waiting for answers."""
        if self._executor is None:
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self._node)
        self._pending.clear()
        with self._turn():
            self._stream(WARM_UP, period)
            self._pending.clear()
            self._times = []
            cpu = self._cpu_time()
            start = time.monotonic()
            self._stream(seconds, period)
            cpu = (self._cpu_time() - cpu) / (time.monotonic() - start)
            self._wait_until(time.perf_counter_ns() + round(LOST * 1e9))
        now = time.perf_counter_ns()  # for the states that were never answered
        times = [*self._times, *(now - sent for _, sent in self._pending)]
        return Answers(np.array(times) * 1e-9, cpu)

    def _stream(self, seconds: float, period: float) -> None:
        step = round(period * 1e9)
        due = time.perf_counter_ns()
        end = due + round(seconds * 1e9)
        while due < end:
            self._wait_until(due)
            self._send()
            self._pending.append((self._k, self._sent))
            due = max(due + step, self._sent)

    def _wait_until(self, due: int) -> None:
        """Receive commands until a time of the performance counter [ns]."""
        while (left := due - time.perf_counter_ns()) > 0:
            self._executor.spin_once(timeout_sec=left * 1e-9)

    def _note_answer(self, data: bytes, now: int) -> None:
        """Record the times from all pending states that this command answers or supersedes."""
        k = self._numbers.get(data[-self._size :])
        same = [i for i, (number, _) in enumerate(self._pending) if number == k]
        for _ in range(same[-1] + 1 if same else 0):
            self._times.append(now - self._pending.popleft()[1])

    def _on_command(self, data: bytes) -> None:
        now = time.perf_counter_ns()
        if self._pending:  # the node also sends commands after the states have stopped
            self._note_answer(data, now)

    def _send(self) -> None:
        self._k = (self._k + 1) % len(self._states)
        self._sent = time.perf_counter_ns()
        self._publisher.publish(self._states[self._k])

    def ticks(self, seconds: float, rate: float) -> Ticks:
        """Send states at a rate [Hz] for a time [s], and record the times of the commands."""
        period = round(1e9 / rate)
        with self._turn():
            self._send_at_rate(WARM_UP, period)
            cpu = self._cpu_time()
            start = time.monotonic()
            sent, received = self._send_at_rate(seconds, period)
            cpu = (self._cpu_time() - cpu) / (time.monotonic() - start)
        return Ticks(missed(received, period), missed(sent, period), len(sent), cpu)

    def _send_at_rate(self, seconds: float, period: int) -> tuple[list[int], list[int]]:
        """Return the times at which states and commands were sent [ns]."""
        sent: list[int] = []
        received: list[int] = []
        due = time.time_ns()
        for _ in range(round(seconds * 1e9) // period):
            due += period
            time.sleep(max(0, due - time.time_ns()) * 1e-9)
            sent.append(time.time_ns())
            self._send()
            while (
                taken := self._commands.handle.take_message(Float64MultiArray, True)
            ) is not None:
                received.append(taken[1]['source_timestamp'])
        return sent, received

    def interruption(
        self,
        rate: float,
        least: float,
        interrupt: Callable[[], Callable[[], bool]],
        is_slow: bool = False,
    ) -> float:
        """
        Return the longest time between two commands [s] while the process does other work.

        Send states at a rate [Hz] for at least ``least`` seconds. ``interrupt`` starts the work,
        and returns a function that checks whether the work is done. ``is_slow`` states that
        ``interrupt`` blocks this process for a while, and that the work starts later.
        """
        period = round(1e9 / rate)
        with self._turn():
            is_done = interrupt() if is_slow else None
            self._send_at_rate(WARM_UP, period)
            is_done = is_done or interrupt()
            received: list[int] = []
            deadline = time.monotonic() + LONGEST
            while len(received) < 2 or received[-1] - received[0] < least * 1e9 or not is_done():
                received += self._send_at_rate(0.1, period)[1]
                if time.monotonic() > deadline:
                    raise TimeoutError(f'not done within {LONGEST:g} s')
        return float(np.diff(received).max()) * 1e-9

    def publish_description(self, text: str) -> None:
        """Publish a robot description, also for processes that subscribe later."""
        self._description.publish(String(data=text))

    def fill(self, trajectory: bytes) -> Callable[[], bool]:
        """Publish a trajectory; return a function that checks whether the result has arrived."""
        while self._filled.handle.take_message(JointTrajectory, True) is not None:
            pass
        self._trajectories.publish(trajectory)
        return lambda: self._filled.handle.take_message(JointTrajectory, True) is not None

    def _take(self) -> bytes:
        """Return the latest serialized command, or empty bytes if there is no new command."""
        data = b''
        while (taken := self._commands.handle.take_message(Float64MultiArray, True)) is not None:
            data = taken[0]
        return data

    def _cpu_time(self) -> float:
        """Return the CPU time of all threads of the process [s]."""
        return time.clock_gettime((~self._process.pid << 3) | 2)  # clock_getcpuclockid(3)

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        self._process.send_signal(signal.SIGCONT)
        try:
            self._wait_for_answer()
            yield
        finally:
            self._process.send_signal(signal.SIGSTOP)

    def _wait_for_answer(self) -> None:
        """Wait until the process answers: after a long stop, it must be discovered again."""
        deadline = time.monotonic() + PATIENCE
        while self._take()[-self._size :] not in self._numbers:
            if time.monotonic() > deadline:
                raise TimeoutError(f'no answer within {PATIENCE:g} s after a pause')
            self._send()
            time.sleep(0.005)

    def close(self) -> None:
        """End the process."""
        self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        self._process.wait(PATIENCE)
        if self._executor is not None:
            self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _ignore(message: Any) -> None:
    pass


def _numbers(data: bytes) -> Floats:
    if not data:
        return np.array(math.nan)
    return np.array(deserialize_message(data, Float64MultiArray).data)


def _is_close(data: bytes, command: Floats) -> bool:
    return bool(np.allclose(_numbers(data), command, rtol=1e-9, atol=1e-12))
