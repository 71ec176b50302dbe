"""
Lets the node run for a long time while everything that may change does.

Joint states arrive without pause; references, payloads, wrenches, gravity, robot descriptions and
parameters change, and all outputs are read. The program prints memory, threads, open files,
latencies and gaps for each quarter of the time. It fails if a command is incomplete, not finite or
beyond its limits, if the memory grows, if threads or files accumulate, or if the node does not end
with zeros.

"""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from domain_coordinator import domain_id
from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
from inverse_dynamics_node import load_urdf
import numpy as np
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ROBOT = Path(__file__).parent.parent / 'test/robots/seven_dof.urdf'
NODE = 'inverse_dynamics'
OUTPUTS = ('joint_efforts', 'external_efforts', 'terms/gravity', 'terms/external')
MOST_GROWTH = 20.0  # [MB]; from the first quarter to the last
GAP = 0.1  # [s]; a longer time between commands is counted
PATIENCE = 60.0  # [s]
PARAMETERS = {
    'effort_scale': (1.0, 0.95),
    'include_friction': (True, False),
    'velocity_filter_cutoff': (0.0, 50.0),
    'mode': ('inverse_dynamics', 'computed_torque', 'joint_impedance'),
}


HEAD = """\
| quarter | commands | median latency [ms] | 99 % [ms] | gaps over 0.1 s | of the driver itself | \
memory [MB] | threads | files |
|---|---|---|---|---|---|---|---|---|"""


class SoakError(Exception):
    """An invariant that did not hold."""


class Quarter(NamedTuple):
    """What was measured in a quarter of the time."""

    commands: int
    latency: float
    """Median from a joint state to the command [ms]."""
    late: float
    """99 % of them [ms]."""
    gaps: int
    """Times of more than `GAP` between commands."""
    own_gaps: int
    """The same between the joint states that this program sent."""
    memory: float
    """Resident memory of the node [MB]."""
    threads: int
    files: int


class Robot:
    """Publishes joint states and all inputs, and checks every command."""

    def __init__(self, rate: float) -> None:
        self.model = load_urdf(ROBOT)
        self.text = ROBOT.read_text()
        self.node = rclpy.create_node('robot')
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.random = np.random.default_rng(1)
        self.last: list[float] = []
        self.outputs = dict.fromkeys(OUTPUTS, 0)
        self.changes = 0
        self.begin_quarter()
        self._sent = self._received = math.nan
        self._state = JointState(name=self.model.joint_names, effort=[0.0] * 7)
        publish = self.node.create_publisher
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._states = publish(JointState, 'joint_states', 1)
        self._descriptions = publish(String, 'robot_description', latched)
        self._references = publish(JointTrajectory, f'{NODE}/reference', 1)
        self._payloads = publish(InertiaStamped, f'{NODE}/payload', 1)
        self._wrenches = publish(WrenchStamped, f'{NODE}/external_wrench', 1)
        self._gravities = publish(Vector3Stamped, f'{NODE}/gravity', 1)
        self._set = self.node.create_client(SetParameters, f'{NODE}/set_parameters')
        self._answers: list[Any] = []
        self._descriptions.publish(String(data=self.text))
        subscribe = self.node.create_subscription
        subscribe(Float64MultiArray, f'{NODE}/commands', self._on_command, 100)
        for name in OUTPUTS:
            subscribe(JointState, f'{NODE}/{name}', lambda _, name=name: self._count(name), 10)
        self.node.create_timer(1.0 / rate, self._publish_state)
        self.node.create_timer(0.01, self._publish_inputs)
        self.node.create_timer(0.5, self._change)

    def begin_quarter(self) -> None:
        """Forget the latencies and gaps."""
        self.latencies: list[float] = []
        self.gaps = self.own_gaps = 0

    def _count(self, name: str) -> None:
        self.outputs[name] += 1

    def _motion(self) -> tuple[Any, Any]:
        phases = 0.7 * time.monotonic() + np.arange(7.0)
        return 0.5 * np.sin(phases), 0.35 * np.cos(phases)

    def _publish_state(self) -> None:
        q, qd = self._motion()
        self._state.position, self._state.velocity = q.tolist(), qd.tolist()
        now = time.monotonic()
        self.own_gaps += now - self._sent > GAP
        self._sent = now
        self._states.publish(self._state)

    def _publish_inputs(self) -> None:
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
        """Change one thing after the other."""
        self.changes += 1
        turn = self.changes % 4
        if turn == 0:
            load = InertiaStamped()
            load.header.frame_id = self.model.link_names[-1]
            load.inertia.m = float(self.random.choice([0.0, 0.5, 1.0]))
            self._payloads.publish(load)
        elif turn == 1:
            gravity = Vector3Stamped()
            gravity.vector.x, gravity.vector.z = float(self.random.normal(scale=0.5)), -9.8
            self._gravities.publish(gravity)
        elif turn == 2:
            self._set_parameter()
        elif self.changes % 20 == 3:
            factor = self.random.uniform(0.9, 1.1)
            text = re.sub(
                r'<mass value="([\d.]+)"',
                lambda found: f'<mass value="{factor * float(found[1]):.6f}"',
                self.text,
            )
            self._descriptions.publish(String(data=text))

    def _set_parameter(self) -> None:
        name = str(self.random.choice(list(PARAMETERS)))
        choices = PARAMETERS[name]
        value = choices[int(self.random.integers(len(choices)))]
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        self._answers = [answer for answer in self._answers if not answer.done()]
        self._answers.append(self._set.call_async(request))
        if len(self._answers) > 20:
            raise SoakError(f'{len(self._answers)} requests have no answer')

    def _on_command(self, message: Float64MultiArray) -> None:
        now = time.monotonic()
        self.gaps += now - self._received > GAP
        self._received = now
        self.latencies.append(now - self._sent)
        self.last = list(message.data)
        if len(self.last) != len(self.model.joint_names):
            raise SoakError(f'a command has {len(self.last)} efforts')
        if not np.isfinite(self.last).all():
            raise SoakError(f'a command is not finite: {self.last}')
        if (np.abs(self.last) > self.model.effort_limits).any():
            raise SoakError(f'a command exceeds the limits: {self.last}')

    def spin(self, duration: float, is_over: Any = lambda: False) -> None:
        """Publish for some time [s], or until something is true."""
        end = time.monotonic() + duration
        while time.monotonic() < end and not is_over():
            self.executor.spin_once(timeout_sec=0.1)

    def measure(self, pid: int) -> Quarter:
        """Return what was measured since the begin of the quarter, and begin another."""
        latencies = 1000.0 * np.array(self.latencies or [math.nan])
        process = Path(f'/proc/{pid}')
        pages = int((process / 'statm').read_text().split()[1])
        quarter = Quarter(
            len(self.latencies),
            float(np.median(latencies)),
            float(np.quantile(latencies, 0.99)),
            self.gaps,
            self.own_gaps,
            pages * os.sysconf('SC_PAGE_SIZE') / 2**20,
            len(list((process / 'task').iterdir())),
            len(list((process / 'fd').iterdir())),
        )
        self.begin_quarter()
        return quarter


def run(seconds: float, rate: float, output: Any) -> list[Quarter]:
    """Run the node; return the measurements of each quarter."""
    node = subprocess.Popen(
        [sys.executable, '-m', 'inverse_dynamics_node.node.main'], stdout=output, stderr=output
    )
    robot = Robot(rate)
    try:
        robot.spin(PATIENCE, lambda: any(robot.last))
        if not any(robot.last):
            raise SoakError(f'no command within {PATIENCE:g} s')
        robot.spin(2.0)
        robot.begin_quarter()
        quarters = []
        for _ in range(4):
            robot.spin(0.25 * seconds, lambda: node.poll() is not None)
            if node.poll() is not None:
                raise SoakError(f'the node ended with code {node.returncode}')
            quarters.append(robot.measure(node.pid))
        node.send_signal(signal.SIGTERM)
        robot.spin(PATIENCE, lambda: node.poll() is not None)
        robot.spin(0.2)
        check(robot, quarters, node.returncode)
    finally:
        node.terminate()
        node.wait(PATIENCE)
        robot.executor.shutdown()
        robot.node.destroy_node()
    return quarters


def check(robot: Robot, quarters: list[Quarter], code: int | None) -> None:
    """Raise a SoakError unless the node has ended well, and nothing has accumulated."""
    first, last = quarters[0], quarters[-1]
    problems = [f'no message on {name}' for name, count in robot.outputs.items() if not count]
    if code != 0 or any(robot.last):
        problems.append(f'it ended with code {code}, and the last command was {robot.last}')
    if last.memory - first.memory > MOST_GROWTH:
        problems.append(f'the memory grew by {last.memory - first.memory:.0f} MB')
    if last.threads > first.threads or last.files > first.files:
        problems.append('threads or files have accumulated')
    if problems:
        raise SoakError('; '.join(problems))


def main() -> int:
    """Run the node and print a table with a verdict; return the exit code."""
    parser = argparse.ArgumentParser(prog='make soak', description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--rate', type=float, default=1000.0, help='of joint states [Hz]')
    options = parser.parse_args()
    with domain_id() as domain, tempfile.NamedTemporaryFile('w+', suffix='.log') as log:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        rclpy.init(args=[])
        try:
            quarters = run(60.0 * options.minutes, options.rate, log)
        except SoakError as failure:
            log.seek(0)
            print(f'{log.read()[-3000:]}\nFAILED: {failure}', file=sys.stderr)
            return 1
        finally:
            rclpy.shutdown()
    print(HEAD)
    for number, each in enumerate(quarters, start=1):
        values = [str(value if isinstance(value, int) else round(value, 2)) for value in each]
        print(f'| {number} | {" | ".join(values)} |')
    print(f'Nothing accumulated in {options.minutes:g} minutes, and the node ended with zeros.')
    return 0


if __name__ == '__main__':
    sys.exit(main())
