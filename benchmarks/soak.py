"""
Runs the node for a long time while all its inputs change.

Joint states arrive without pause. References, payloads, wrenches, gravity, trajectories
and parameters change. The program reads all outputs, most of them in turn. For each
quarter of the time, it prints gaps, memory, threads and open files, as a table for
doc/evidence/reliability.md. It fails if

- a command is incomplete, not finite or beyond its limits;
- a message or a parameter is refused, or an output is missing;
- the node sends no command for much longer than this program had to wait for the machine;
- the memory grows, or threads or files accumulate;
- the node does not end with zeros and code 0.

"""

from __future__ import annotations

import argparse
import itertools
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from diagnostic_msgs.msg import DiagnosticArray
from domain_coordinator import domain_id
from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.ros.middleware import start_ros
import numpy as np
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from . import machine, processes

ROBOT = Path(__file__).parent.parent / 'test/robots/seven_dof.urdf'
NODE = 'inverse_dynamics'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
OUTPUTS = {
    f'{NODE}/external_efforts': JointState,
    f'{NODE}/joint_trajectory_out': JointTrajectory,
    f'{NODE}/robot_description': String,
    '/diagnostics': DiagnosticArray,
}
"""The outputs that are always read."""
IN_TURN = {
    f'{NODE}/joint_efforts': JointState,
    f'{NODE}/joint_commands': JointState,
}
"""The outputs that are read in turn: reading all at once takes more than a millisecond."""
TURN = 2.0  # [s]; time for which one of these outputs is read
MOST_GROWTH = 20.0  # [MB]; largest growth of memory, to the last quarter
GAP = 0.1  # [s]; longer times between commands are counted as gaps
LONGEST_GAP = 0.5  # [s]; largest excess of a gap over the longest gap of the joint states
PATIENCE = 60.0  # [s]; time limit for the start and the end of the node
FAULTS = 'message dropped', 'Traceback'
PARAMETERS = {
    'effort_scale': (1.0, 0.95),
    'include_friction': (True, False),
    'velocity_filter_cutoff': (0.0, 50.0),
    'armature': (0.0, 0.01),
    'start_ramp': (0.5, 0.2),
    'mode': ('inverse_dynamics', 'computed_torque', 'joint_impedance', 'gravity_compensation'),
}


HEAD = """\
| quarter | joint states | commands | gaps over 0.1 s \
| longest [ms] | longest of the driver [ms] | memory [MB] | of its child [MB] | threads | files |
|---|---|---|---|---|---|---|---|---|---|"""


class SoakError(Exception):
    """A check of the soak test failed."""


class Quarter(NamedTuple):
    """The measurements in a quarter of the time."""

    states: int
    commands: int
    gaps: int
    """Number of gaps between commands that are longer than `GAP`."""
    longest: float
    """Longest time between two commands [ms]."""
    longest_own: float
    """Longest time between two joint states that this program sent [ms]."""
    memory: float
    """Median of the resident memory of the node [MB]."""
    child_memory: float
    """Median memory of the process that reads trajectories [MB]."""
    threads: int
    """Median number of threads of the node; some threads exist only briefly."""
    files: int

    def __str__(self) -> str:
        cells = [str(each if isinstance(each, int) else round(each, 2)) for each in self]
        return f'{" | ".join(cells)} |'


class Robot:
    """Publishes joint states and all inputs, and checks every command."""

    def __init__(self, rate: float, pid: int) -> None:
        self.model = load_urdf(ROBOT)
        self.node = rclpy.create_node('robot')
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.random = np.random.default_rng(1)
        self.last: list[float] = []
        self.outputs = dict.fromkeys([*OUTPUTS, *IN_TURN], 0)
        self.changes = dict.fromkeys(('payloads', 'gravities', 'parameters', 'trajectories'), 0)
        self._pid = pid
        self._turn = 0
        self._sent = self._received = math.nan
        self._state = JointState(name=self.model.joint_names)
        self.begin_quarter()
        publish = self.node.create_publisher
        self._states = publish(JointState, 'joint_states', 1)
        self._descriptions = publish(String, 'robot_description', LATCHED)
        self._references = publish(JointTrajectory, f'{NODE}/reference', 1)
        self._trajectories = publish(JointTrajectory, f'{NODE}/joint_trajectory_in', 1)
        self._payloads = publish(InertiaStamped, f'{NODE}/payload', 1)
        self._wrenches = publish(WrenchStamped, f'{NODE}/external_wrench', 1)
        self._gravities = publish(Vector3Stamped, f'{NODE}/gravity', 1)
        self._set = self.node.create_client(SetParameters, f'{NODE}/set_parameters')
        self._answers: list[Any] = []
        self._descriptions.publish(String(data=ROBOT.read_text()))
        subscribe = self.node.create_subscription
        subscribe(Float64MultiArray, f'{NODE}/commands', self._on_command, 100)
        for name, kind in OUTPUTS.items():
            qos = LATCHED if kind is String else 10
            subscribe(kind, name, self._reader(name), qos, raw=True)
        # This node has no executor: an executor could crash when subscriptions come and go.
        self.reader = rclpy.create_node('reader')
        self._subscription: Any = None
        self._topics = itertools.cycle(IN_TURN)
        self._read_next()
        self.node.create_timer(TURN, self._read_next)
        self.node.create_timer(1.0 / rate, self._publish_state)
        self.node.create_timer(0.01, self._publish_inputs)
        self.node.create_timer(0.5, self._change)
        self.sampling = self.node.create_timer(1.0, self._sample)

    def begin_quarter(self) -> None:
        """Reset the gaps and samples for a new quarter."""
        self.states = self.commands = self.gaps = 0
        self.longest = self.longest_own = 0.0
        self.samples: list[tuple[float, float, int, int]] = []

    def _reader(self, name: str) -> Any:
        def count(data: bytes) -> None:
            self.outputs[name] += 1

        return count

    def _read_next(self) -> None:
        """Subscribe to the next of the outputs that are read in turn."""
        if self._subscription is not None:
            self.reader.destroy_subscription(self._subscription)
        self._topic = next(self._topics)
        self._subscription = self.reader.create_subscription(
            IN_TURN[self._topic], self._topic, lambda _: None, 100, raw=True
        )

    def _take(self) -> None:
        subscription = self._subscription.handle
        while subscription.take_message(IN_TURN[self._topic], True) is not None:
            self.outputs[self._topic] += 1

    def _motion(self) -> tuple[Any, Any]:
        phases = 0.7 * time.monotonic() + np.arange(7.0)
        return 0.5 * np.sin(phases), 0.35 * np.cos(phases)

    def _publish_state(self) -> None:
        q, qd = self._motion()
        self._state.position, self._state.velocity = q.tolist(), qd.tolist()
        self._state.effort = q.tolist()
        now = time.monotonic()
        if now - self._sent > self.longest_own:
            self.longest_own = now - self._sent
        self._sent = now
        self.states += 1
        self._states.publish(self._state)

    def _publish_inputs(self) -> None:
        self._take()
        q, qd = self._motion()
        accelerations = 0.2 * self.random.normal(size=7)
        point = JointTrajectoryPoint(positions=q, velocities=qd, accelerations=accelerations)
        names = self.model.joint_names
        self._references.publish(JointTrajectory(joint_names=names, points=[point]))
        wrench = WrenchStamped()
        wrench.header.frame_id = self.model.link_names[-1]
        wrench.wrench.force.z = float(self.random.normal())
        self._wrenches.publish(wrench)

    def _change(self) -> None:
        """Change one input of the node; each call changes another input."""
        self._turn += 1
        turn = self._turn % 4
        if turn == 0:
            load = InertiaStamped()
            load.header.frame_id = self.model.link_names[-1]
            load.inertia.m = float(self.random.choice([0.0, 0.5, 1.0]))
            self._payloads.publish(load)
            self.changes['payloads'] += 1
        elif turn == 1:
            gravity = Vector3Stamped()
            gravity.vector.x, gravity.vector.z = float(self.random.normal(scale=0.5)), -9.8
            self._gravities.publish(gravity)
            self.changes['gravities'] += 1
        elif turn == 2:
            self._set_parameters(str(self.random.choice(list(PARAMETERS))))
        elif self._turn % 20 == 11:
            self._publish_trajectory()

    def _publish_trajectory(self) -> None:
        message = JointTrajectory(joint_names=self.model.joint_names)
        for k in range(200):
            point = JointTrajectoryPoint(positions=0.5 * np.sin(0.02 * k + np.arange(7.0)))
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(10**7 * k, 10**9)
            message.points.append(point)
        self._trajectories.publish(message)
        self.changes['trajectories'] += 1

    def _set_parameters(self, name: str) -> None:
        choices = PARAMETERS[name]
        self.set(name, choices[int(self.random.integers(len(choices)))])
        self.changes['parameters'] += 1

    def set(self, name: str, value: Any) -> None:
        """Request a new value of a parameter; check the answers to earlier requests."""
        for answer in self._answers:
            if answer.done() and not answer.result().results[0].successful:
                raise SoakError(f'a parameter is refused: {answer.result().results[0].reason}')
        self._answers = [answer for answer in self._answers if not answer.done()]
        if len(self._answers) > 20:
            raise SoakError(f'{len(self._answers)} requests have no answer')
        message = Parameter(name, value=value).to_parameter_msg()
        self._answers.append(self._set.call_async(SetParameters.Request(parameters=[message])))

    def prepare(self) -> None:
        """Wait for commands and services, and count from then on."""
        self.spin(PATIENCE, lambda: any(self.last) and self._set.service_is_ready())
        if not any(self.last):
            raise SoakError(f'no command within {PATIENCE:g} s')
        self.spin(2.0)
        self.begin_quarter()

    def _on_command(self, message: Float64MultiArray) -> None:
        now = time.monotonic()
        self.commands += 1
        gap, self._received = now - self._received, now
        if gap > self.longest:
            self.longest = gap
        self.gaps += gap > GAP
        self.last = list(message.data)
        if len(self.last) != len(self.model.joint_names):
            raise SoakError(f'a command has {len(self.last)} efforts')
        if not np.isfinite(self.last).all():
            raise SoakError(f'a command is not finite: {self.last}')
        if (np.abs(self.last) > self.model.effort_limits).any():
            raise SoakError(f'a command exceeds the limits: {self.last}')

    def _sample(self) -> None:
        process = Path(f'/proc/{self._pid}')
        self.samples.append(
            (
                processes.resident(self._pid),
                sum(map(processes.resident, processes.children(self._pid))),
                len(list((process / 'task').iterdir())),
                len(list((process / 'fd').iterdir())),
            )
        )

    def spin(self, duration: float, is_over: Any = lambda: False) -> None:
        """Publish for a duration [s], or until ``is_over`` returns True."""
        end = time.monotonic() + duration
        while time.monotonic() < end and not is_over():
            self.executor.spin_once(timeout_sec=0.1)

    def measure(self) -> Quarter:
        """Return the measurements of the current quarter, and begin the next quarter."""
        self._sample()
        memory, child_memory, threads, files = np.median(self.samples, axis=0)
        quarter = Quarter(
            self.states,
            self.commands,
            self.gaps,
            1000.0 * self.longest,
            1000.0 * self.longest_own,
            float(memory),
            float(child_memory),
            round(threads),
            round(files),
        )
        self.begin_quarter()
        return quarter


def run(seconds: float, rate: float, log: Any) -> Robot:
    """Run the node and print the measurements of each quarter; raise a SoakError on failure."""
    node = processes.start(
        ['inverse_dynamics_node.node.main'], stdin=subprocess.DEVNULL, stdout=log, stderr=log
    )
    robot = None
    try:
        robot = Robot(rate, node.pid)
        robot.prepare()
        begin = os.fstat(log.fileno()).st_size  # earlier messages lack a robot
        print(HEAD)
        quarters: list[Quarter] = []
        for number in range(1, 5):
            robot.spin(0.25 * seconds, lambda: node.poll() is not None)
            if node.poll() is not None:
                raise SoakError(f'the node ended with code {node.returncode}')
            quarters.append(robot.measure())
            print(f'| {number} | {quarters[-1]}', flush=True)
        robot.sampling.cancel()  # the memory of an ended process cannot be read
        node.send_signal(signal.SIGTERM)
        robot.spin(PATIENCE, lambda: node.poll() is not None)
        robot.spin(0.2)
        log.seek(begin)
        check(robot, quarters, node.returncode, log.readlines())
    finally:
        processes.end([node])
        if robot:
            robot.executor.shutdown()
            robot.node.destroy_node()
            robot.reader.destroy_node()
    return robot


def check(robot: Robot, quarters: list[Quarter], code: int | None, lines: list[str]) -> None:
    """Raise a SoakError if the node failed, or if memory, threads or files accumulated."""
    first, second, _, last = quarters
    problems = [f'no message on {name}' for name, count in robot.outputs.items() if not count]
    if code != 0 or any(robot.last):
        problems.append(f'it ended with code {code}, and the last command was {robot.last}')
    for what, growth in (
        ('the node', last.memory - first.memory),
        # The child's memory grows in the first quarter: it uses more pages shared with the node.
        ('its child', last.child_memory - second.child_memory),
    ):
        if growth > MOST_GROWTH:
            problems.append(f'the memory of {what} grew by {growth:.0f} MB')
    if last.threads > first.threads or last.files > first.files:
        problems.append('threads or files have accumulated')
    for number, each in enumerate(quarters, start=1):
        if each.longest > 1000.0 * LONGEST_GAP + each.longest_own:
            problems.append(f'no command for {each.longest:.0f} ms in quarter {number}')
    problems += [line.strip() for line in lines if any(fault in line for fault in FAULTS)][:5]
    if problems:
        raise SoakError('; '.join(problems))


def main() -> int:
    """Run the node and print a table with a verdict; return the exit code."""
    parser = argparse.ArgumentParser(prog='make soak', description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0, help='at least 0.3')
    parser.add_argument('--rate', type=float, default=1000.0, help='of joint states [Hz]')
    options = parser.parse_args()
    processes.heed_signals()
    before = machine.describe(machine.ROS_PACKAGES)
    processes.raise_robot_side()
    with domain_id() as domain, tempfile.NamedTemporaryFile('w+', suffix='.log') as log:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        start_ros([])
        try:
            robot = run(60.0 * options.minutes, options.rate, log)
        except SoakError as failure:
            log.seek(0)
            print(f'{log.read()[-3000:]}\nFAILED: {failure}', file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print('interrupted', file=sys.stderr)
            return 130
        finally:
            rclpy.shutdown()
    print(f'\n{before} Load {machine.load()} at the end.')
    print(f'Changes: {", ".join(f"{n} {name}" for name, n in robot.changes.items())}.')
    print(f'Messages of the other outputs: {sum(robot.outputs.values())}.')
    print(
        f'Nothing accumulated in {options.minutes:g} minutes at {options.rate:g} Hz. Each command '
        'was complete, finite and within its limits; the node ended with zeros.'
    )
    return 0


if __name__ == '__main__':
    sys.exit(main())
