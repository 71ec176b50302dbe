"""
Runs several arms on one machine; each arm has its own node in its own namespace.

Two processes simulate the drivers: they send the joint states of all arms and receive the
commands. The program prints a table for doc/evidence/reliability.md: for each node its CPU load,
its memory, the percentage of joint states that were answered, and the gaps between commands. It
then raises the rate until a node answers less than 99 % of the joint states. It fails if a node
answers less than 99 % at the first rate, or does not end with code 0.

"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
import os
from pathlib import Path
import struct
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from domain_coordinator import domain_id
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.ros.middleware import start_ros
import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from . import machine, priorities, processes

ROBOT = Path(__file__).parent.parent / 'test/robots/seven_dof.urdf'
DRIVERS = 2
PERIOD = 0.64  # [s]; period of the motion of the arms
AMPLITUDE = 0.05  # [rad]; amplitude of this motion
LAST = 0.03  # [s]; time to wait for the answers to the last joint states
WARM_UP = 2.0  # [s]; time in which the efforts rise, not measured
PATIENCE = 120.0  # [s]; longest time until all nodes have started
LEAST = 0.99  # smallest fraction of joint states that must be answered
STEPS = 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0  # factors by which the rate is raised
STEP = 10.0  # [s]; duration of the measurement at each of these rates
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
HEAD = """\
| node | CPU [%] | memory [MB] | share of it [MB] | its own [MB] | joint states \
| answered [%] | median gap [ms] | largest gap [ms] |
|---|---|---|---|---|---|---|---|---|"""
LIMIT_HEAD = """
| rate [Hz] | joint states of each arm per second | lowest share answered [%] | largest gap [ms] \
| CPU of all nodes [%] | CPU of the drivers [%] |
|---|---|---|---|---|---|"""


class ArmsError(Exception):
    """A node did not keep up, or ended too early."""


class Arm(NamedTuple):
    """The measurements of a driver for one arm."""

    name: str
    sent: int
    """Number of joint states that were sent."""
    answered: float
    """Fraction of the joint states to which the node sent a command."""
    median: float
    """Median of the times between commands when the node sent them [s]."""
    longest: float
    own: float
    """The longest time between two joint states [s]."""


class Driver:
    """
    Sends the joint states of some arms and receives their commands, without an executor.

    ``names`` are the namespaces of the nodes.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._model = load_urdf(ROBOT)
        self._dynamics = InverseDynamics(self._model)
        node = rclpy.create_node(f'driver_of_{names[0]}', enable_rosout=False)
        self._states = [node.create_publisher(JointState, f'{n}/joint_states', 1) for n in names]
        self._commands = [
            node.create_subscription(
                Float64MultiArray, f'{n}/inverse_dynamics/commands', lambda _: None, 100, raw=True
            ).handle
            for n in names
        ]
        self._node = node

    def run(self, rate: float, seconds: float) -> list[Arm]:
        """Send joint states of one arm after the other at a rate [Hz]; measure after warm-up."""
        self._prepare(round(PERIOD * rate))
        self._exchange(rate, WARM_UP)
        return self._exchange(rate, seconds)

    def wait(self, rate: float) -> None:
        """Send joint states until all nodes send commands."""
        self._prepare(round(PERIOD * rate))
        deadline = time.monotonic() + PATIENCE
        while late := [arm for arm in self._exchange(rate, 1.0) if not arm.answered]:
            if time.monotonic() > deadline:
                raise ArmsError(f'not all nodes command within {PATIENCE:g} s: {late}')

    def _prepare(self, count: int) -> None:
        """Serialize the joint states of one period, and compute the expected commands."""
        angles = 2.0 * np.pi * np.arange(count)[:, np.newaxis] / count + np.arange(7.0)
        q = np.array([0.2, 0.6, 0.1, 0.9, 0.2, 0.5, 0.1]) + AMPLITUDE * np.sin(angles)
        qd = AMPLITUDE * 2.0 * np.pi / PERIOD * np.cos(angles)
        names = self._model.joint_names
        self._messages = [
            serialize_message(JointState(name=names, position=p.tolist(), velocity=v.tolist()))
            for p, v in zip(q, qd, strict=True)
        ]
        efforts = self._dynamics.efforts(q, qd, np.zeros_like(q))
        self._numbers = {_key(row): k for k, row in enumerate(efforts.tolist())}
        if len(self._numbers) != count:
            raise ArmsError('the commands for several states are equal')

    def _exchange(self, rate: float, seconds: float) -> list[Arm]:
        arms = [_Record(len(self._messages)) for _ in self._names]
        step = 1.0 / (rate * len(arms))
        due = time.monotonic()
        end = due + seconds
        turn = 0
        while due < end:
            time.sleep(max(0.0, due - time.monotonic()))
            i = turn % len(arms)
            self._take(i, arms[i])
            k = arms[i].next()
            self._states[i].publish(self._messages[k])
            turn += 1
            due = max(due + step, time.monotonic() - step)  # late states are skipped
        time.sleep(LAST)
        for i, arm in enumerate(arms):
            self._take(i, arm)
        return [arm.result(name) for name, arm in zip(self._names, arms, strict=True)]

    def _take(self, i: int, arm: _Record) -> None:
        while (taken := self._commands[i].take_message(Float64MultiArray, True)) is not None:
            data, info = taken
            number = self._numbers.get(_key(struct.unpack_from('<7d', data, len(data) - 56)))
            arm.note(number, info['source_timestamp'])


class _Record:
    """The joint states and commands of one arm."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pending: set[int] = set()
        self._answered = self._sent = 0
        self._stamps: list[int] = []
        self._own = 0.0
        self._last = time.monotonic()

    def next(self) -> int:
        """Return the number of the next joint state."""
        now = time.monotonic()
        self._own, self._last = max(self._own, now - self._last), now
        k = self._sent % self._count
        self._sent += 1
        self._pending.add(k)  # no answer since the last period: it is lost
        return k

    def note(self, number: int | None, stamp: int) -> None:
        """Record a command, and the number of the joint state that it answers."""
        self._stamps.append(stamp)
        if number in self._pending:
            self._pending.remove(number)
            self._answered += 1

    def result(self, name: str) -> Arm:
        gaps = np.diff(self._stamps) * 1e-9 if len(self._stamps) > 1 else np.array([np.inf])
        share = self._answered / max(1, self._sent)
        return Arm(name, self._sent, share, float(np.median(gaps)), float(gaps.max()), self._own)


def _key(efforts: Sequence[float]) -> tuple[float, ...]:
    return tuple(round(each, 6) for each in efforts)


def drive(names: Sequence[str]) -> int:
    """Simulate the driver of some arms: read rate and duration of each run; write the results."""
    processes.heed_signals()
    priorities.raise_robot_side()
    start_ros([])
    driver = Driver(names)
    try:
        for line in sys.stdin:
            rate, seconds = map(float, line.split())
            if seconds:
                print(json.dumps(driver.run(rate, seconds)), flush=True)
            else:
                driver.wait(rate)
                print('[]', flush=True)
    except KeyboardInterrupt:
        pass
    except ArmsError as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        rclpy.shutdown()
    return 0


class Rig:
    """The nodes and the drivers of all arms."""

    def __init__(self, arms: int, log: Any) -> None:
        self.nodes: dict[str, subprocess.Popen[str]] = {}
        self.drivers: list[subprocess.Popen[str]] = []
        self._log = log
        self._names = [f'arm_{k}' for k in range(arms)]

    def start(self, rate: float) -> None:
        """Start all processes; return when all nodes send commands."""
        for name in self._names:
            arguments = ['-r', f'__ns:=/{name}', '-p', f'robot_description_file:={ROBOT}']
            self.nodes[name] = processes.start(
                ['inverse_dynamics_node.node.main', '--ros-args', *arguments],
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
            )
        for k in range(min(DRIVERS, len(self._names))):
            self.drivers.append(
                processes.start(
                    ['benchmarks.arms', '--drive', *self._names[k::DRIVERS]],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            )
        self.begin(rate, 0.0)
        self.results()

    def begin(self, rate: float, seconds: float) -> None:
        """Make all drivers send joint states; do not wait for the end."""
        for driver in self.drivers:
            assert driver.stdin
            driver.stdin.write(f'{rate} {seconds}\n')
            driver.stdin.flush()

    def results(self) -> list[Arm]:
        """Wait for the drivers; return their measurements in the order of the arms."""
        found: list[Arm] = []
        for driver in self.drivers:
            assert driver.stdout
            line = driver.stdout.readline()
            if not line:
                raise ArmsError('a driver has ended')
            found += [Arm(*each) for each in json.loads(line)]
        ended = {name: node.returncode for name, node in self.nodes.items() if node.poll()}
        if ended:
            raise ArmsError(f'nodes have ended, with codes {ended}')
        return sorted(found, key=lambda arm: self._names.index(arm.name))

    def end(self) -> list[int | None]:
        """End all processes; return the exit codes of the nodes."""
        processes.end([*self.drivers, *self.nodes.values()])
        return [node.returncode for node in self.nodes.values()]


class Use(NamedTuple):
    """CPU time per second [s] of each node, and of all drivers together."""

    nodes: list[float]
    drivers: float


def measure(rig: Rig, rate: float, seconds: float) -> tuple[list[Arm], Use]:
    """Move the arms with joint states at a rate [Hz] for some seconds; return measurements."""
    rig.begin(rate, seconds)
    time.sleep(WARM_UP)
    groups = [node.pid for node in rig.nodes.values()], [each.pid for each in rig.drivers]
    before = [[processes.cpu_time(pid) for pid in pids] for pids in groups]
    began = time.monotonic()
    time.sleep(seconds)
    nodes, drivers = (
        [(processes.cpu_time(pid) - start) / (time.monotonic() - began) for pid, start in pairs]
        for pairs in map(zip, groups, before)
    )
    return rig.results(), Use(nodes, sum(drivers))


def table(rig: Rig, arms: list[Arm], use: Use) -> str:
    """Return the table of all nodes."""
    lines = [HEAD]
    for arm, cpu in zip(arms, use.nodes, strict=True):
        memory = processes.memory(rig.nodes[arm.name].pid)
        lines.append(
            f'| {arm.name} | {100.0 * cpu:.0f} | {memory.resident:.0f} '
            f'| {memory.proportional:.0f} | {memory.unique:.0f} | {arm.sent} '
            f'| {100.0 * arm.answered:.2f} | {1e3 * arm.median:.1f} | {1e3 * arm.longest:.1f} |'
        )
    total = processes.total([processes.memory(node.pid) for node in rig.nodes.values()])
    lines.append(
        f'\nAll nodes: {100.0 * sum(use.nodes):.0f} % of a CPU, {total.proportional:.0f} MB; '
        f'the drivers: {100.0 * use.drivers:.0f} % of a CPU, their longest pause '
        f'{1e3 * max(arm.own for arm in arms):.1f} ms.'
    )
    return '\n'.join(lines)


def find_limit(rig: Rig, rate: float) -> str:
    """Raise the rate until a node does not keep up; print a line per rate, return the result."""
    print(LIMIT_HEAD)
    last = rate
    for factor in STEPS:
        tried = factor * rate
        arms, use = measure(rig, tried, STEP)
        share = min(arm.answered for arm in arms)
        sent = min(arm.sent for arm in arms) / STEP
        print(
            f'| {tried:.0f} | {sent:.0f} | {100.0 * share:.2f} '
            f'| {1e3 * max(arm.longest for arm in arms):.1f} | {100.0 * sum(use.nodes):.0f} '
            f'| {100.0 * use.drivers:.0f} |',
            flush=True,
        )
        if sent < LEAST * tried:
            return f'At {tried:.0f} Hz, the drivers did not send all joint states.'
        if share < LEAST:
            return f'All nodes kept up at {last:.0f} Hz, but not at {tried:.0f} Hz.'
        last = tried
    return f'All nodes kept up at {last:.0f} Hz.'


def run(rig: Rig, options: argparse.Namespace) -> None:
    """Start the arms, measure and print; raise an ArmsError if a node does not keep up."""
    rig.start(options.rate)
    arms, use = measure(rig, options.rate, options.seconds)
    print(f'{options.arms} arms at {options.rate:g} Hz for {options.seconds:g} s\n')
    print(table(rig, arms, use), flush=True)
    late = [f'{arm.name} {100.0 * arm.answered:.1f} %' for arm in arms if arm.answered < LEAST]
    sent = min(arm.sent for arm in arms) / options.seconds
    if sent < LEAST * options.rate:
        raise ArmsError(f'the drivers sent {sent:.0f} joint states per second: not judged')
    if late:
        raise ArmsError(f'less than {100.0 * LEAST:g} % answered: {", ".join(late)}')
    if options.limit:
        print(f'\n{find_limit(rig, options.rate)}')


def main() -> int:
    """Run all arms and print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog='make arms', description=__doc__)
    parser.add_argument('--arms', type=int, default=10)
    parser.add_argument('--rate', type=float, default=200.0, help='of joint states [Hz]')
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument(
        '--no-limit', dest='limit', action='store_false', help='do not raise the rate'
    )
    parser.add_argument('--drive', nargs='+', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.drive:
        return drive(options.drive)
    processes.heed_signals()
    before = machine.describe(machine.ROS_PACKAGES)
    with domain_id() as domain, tempfile.NamedTemporaryFile('w+', suffix='.log') as log:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        rig = Rig(options.arms, log)
        failure = ''
        try:
            run(rig, options)
        except ArmsError as error:
            failure = str(error)
        except KeyboardInterrupt:
            failure = 'interrupted'
        finally:
            codes = rig.end()
        print(f'\n{before}')
        if any(codes):
            failure = failure or f'the nodes ended with codes {codes}'
        if failure:
            log.seek(0)
            print(f'{log.read()[-2000:]}\nFAILED: {failure}', file=sys.stderr)
            return 1
    print(
        f'Every node answered at least {100.0 * LEAST:g} % of the joint states at '
        f'{options.rate:g} Hz, and ended with code 0.'
    )
    return 0


if __name__ == '__main__':
    sys.exit(main())
