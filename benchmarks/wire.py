"""A process that answers joint states with commands, and the robot's side of the measurement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import math
import os
import signal
import struct
import subprocess
import sys
import time
from typing import Any, NamedTuple

from inverse_dynamics_node.robot.model import Floats
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from .timing import missed

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of joint states, equal to the node's."""
EVERY_ONE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Quality of service of commands, equal to the node's."""

PATIENCE = 60.0  # [s]; for a process to start, and to be found
LOST = 0.1  # [s]; a state without an answer after this time is lost
WARM_UP = 0.3  # [s]; at the start of a turn, not measured


class Trips(NamedTuple):
    """Round trips of one turn, in which each state waits for the previous command."""

    times: Floats
    """Times from state to command, shape (commands,) [s]."""
    cpu: float
    """CPU time of the process per command [s]."""
    lost: int
    """Number of states without an answer."""


class Ticks(NamedTuple):
    """Commands of one turn at a fixed rate, with states at the same rate."""

    missed: int
    """Number of periods without a command in their first half."""
    slept: int
    """The same for the states, whose loop does little except sleep."""
    periods: int
    cpu: float
    """CPU time of the process per second [s]."""


class Contender:
    """
    A process on a domain of its own, stopped while it is not its turn.

    Parameters
    ----------
    module : str
        What Python runs; its topics are ``joint_states`` and ``~/commands``.
    arguments : sequence of str
        For it, those for ROS last.
    domain : int
        A domain that no other process uses.

    """

    def __init__(self, module: str, arguments: Sequence[str], domain: int) -> None:
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
        self._executor: Any = None
        self._states: list[bytes] = []
        self._expected: list[float] = []
        self._k = 0
        self._sent = 0
        self._times: list[int] = []
        self._is_answered = False
        self._process = subprocess.Popen(
            [sys.executable, '-m', module, *arguments, '-r', '__node:=contender'],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
        )

    def start(
        self, states: Sequence[JointState], accelerations: Sequence[float], expected: Floats
    ) -> None:
        """
        Wait for the right command for every state, then let the process wait for its turn.

        Parameters
        ----------
        states : sequence of JointState
        accelerations : sequence of float
            Asked for in all of them.
        expected : array_like, shape (count, m)
            The command for each.

        Raises
        ------
        TimeoutError
            If one of them does not come, or the process ends.

        """
        deadline = time.monotonic() + PATIENCE
        for state, command in zip(states, expected, strict=True):
            data = serialize_message(state)
            while not np.allclose(self._take(), command, rtol=1e-9, atol=1e-12):
                if time.monotonic() > deadline or self._process.poll() is not None:
                    raise TimeoutError(f'expected command {command}, last was {self._take()}')
                self._accelerations.publish(Float64MultiArray(data=accelerations))
                self._publisher.publish(data)
                time.sleep(0.005)
            self._states.append(data)
            self._expected.append(float(command[-1]))
        self._process.send_signal(signal.SIGSTOP)

    def trips(self, seconds: float, period: float) -> Trips:
        """Send states for a time [s], one a period [s], none before the last is answered."""
        if self._executor is None:
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self._node)
        with self._turn():
            self._exchange(WARM_UP, period)
            self._times = []
            cpu = self._cpu_time()
            lost = self._exchange(seconds, period)
            cpu = self._cpu_time() - cpu
        times = np.array(self._times) * 1e-9
        return Trips(times, cpu / max(1, len(times)), lost)

    def _exchange(self, seconds: float, period: float) -> int:
        """Send states and receive commands; return the number of states without an answer."""
        lost = 0
        due = time.monotonic()
        deadline = due + seconds
        while due < deadline:
            time.sleep(max(0.0, due - time.monotonic()))
            self._is_answered = False
            self._send()
            while not self._is_answered and time.monotonic() < due + LOST:
                self._executor.spin_once(timeout_sec=LOST)
            lost += not self._is_answered
            due = max(due + period, time.monotonic())
        return lost

    def _on_command(self, data: bytes) -> None:
        now = time.perf_counter_ns()
        # The node also sends commands after the states have stopped.
        if math.isclose(_last_number(data), self._expected[self._k], rel_tol=1e-9, abs_tol=1e-12):
            self._times.append(now - self._sent)
            self._is_answered = True

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

    def _take(self) -> Floats:
        """Return the latest command, or NaN before the first."""
        numbers = np.array(math.nan)
        while (taken := self._commands.handle.take_message(Float64MultiArray, False)) is not None:
            numbers = np.array(taken[0].data)
        return numbers

    def _cpu_time(self) -> float:
        """Return the CPU time of all threads of the process [s]."""
        return time.clock_gettime((~self._process.pid << 3) | 2)  # clock_getcpuclockid(3)

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        self._process.send_signal(signal.SIGCONT)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGSTOP)

    def close(self) -> None:
        """End the process."""
        self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        self._process.wait(PATIENCE)
        if self._executor is not None:
            self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _last_number(data: bytes) -> float:
    return float(struct.unpack_from('<d', data, len(data) - 8)[0])
