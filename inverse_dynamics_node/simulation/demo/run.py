"""One run: wait for robot and node, let a script happen, and keep an eye on everything."""

from __future__ import annotations

from collections.abc import Callable
import math
import time
from typing import Any

from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ...robot.model import Floats, RobotModel
from ..mujoco.model import SimulationError
from .commander import Commander
from .processes import Processes
from .scenarios import NODE, Scenario, Script
from .view import Snapshot, View

START_TIMEOUT = 60.0  # [s]: the first run on a machine compiles the dynamics
SILENCE_TIMEOUT = 5.0  # [s]


class Run:
    """
    A scenario with the processes that it takes.

    Parameters
    ----------
    robot : RobotModel
        The robot that all of them load.
    scenario : Scenario
        What to ask of the node.
    processes : dict of str to subprocess.Popen
        What must stay alive, by the name to print.
    stopped : callable
        Whether the user wants to end it.

    """

    def __init__(
        self,
        robot: RobotModel,
        scenario: Scenario,
        processes: Processes,
        stopped: Callable[[], bool],
    ) -> None:
        self.commander = Commander(robot.joint_names, scenario.asks_for)
        self.words = ''
        self._processes = processes
        self._stopped = stopped
        self._executor = EventsExecutor()
        self._executor.add_node(self.commander)

    def close(self) -> None:
        """Leave ROS."""
        self._executor.remove_node(self.commander)
        self._executor.shutdown()
        self.commander.destroy_node()

    def wait_until_ready(self) -> Floats:
        """Wait until the node holds the robot and the brakes are open; return where it is."""
        commander = self.commander
        self._wait(lambda: commander.state is not None, 'the robot sends no joint states')
        self._wait(lambda: commander.commands > 0, 'the node sends no commands')
        self._wait(lambda: not commander.brakes_on, 'the brakes stay on: commands do not flow')
        assert commander.state is not None
        return commander.state[0]

    def perform(self, script: Script, duration: float, view: View) -> None:
        """Run a script to its end."""
        commander = self.commander
        for event in script.events:
            commander.will_tell(event.messages)
        if script.expected is not None:
            commander.watch_external_efforts()
        self._wait(
            lambda: not commander.without_listener(),
            lambda: f'nobody listens to {", ".join(commander.without_listener())}',
        )
        self.words = script.begins
        view.tell(0.0, self.words)
        commander.follow(script.trajectory)
        events = list(script.events)
        last = time.monotonic()
        line = 1.0
        while commander.now < duration:
            self._spin()
            if commander.silence > SILENCE_TIMEOUT:
                raise SimulationError('joint states stopped coming')
            while events and commander.now >= events[0].time:
                event = events.pop(0)
                self.words = event.words
                for topic, message in event.messages.items():
                    commander.tell(topic, message)
                view.tell(event.time, event.words)
            is_second = commander.now >= min(line, duration)
            if is_second and not view.is_live:
                view.print_progress(self._moment(last))
            elif view.is_due:
                view.draw(self._moment(time.monotonic() - 1.0))
            if is_second:
                line = math.floor(commander.now) + 1.0
                last = time.monotonic()

    def _moment(self, since: float) -> Snapshot:
        commander = self.commander
        rate = commander.history.command_rate(since)
        assert commander.state is not None
        q, _, effort = commander.state
        return Snapshot(
            commander.now, rate, self.words, q, commander.desired, effort, commander.brakes_on
        )

    def _wait(self, condition: Callable[[], bool], otherwise: str | Callable[[], str]) -> None:
        deadline = time.monotonic() + START_TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                words = otherwise if isinstance(otherwise, str) else otherwise()
                raise SimulationError(f'{words} (waited {START_TIMEOUT:.0f} s)')
            self._spin()

    def _spin(self) -> None:
        """Do what is due, or wait a little; end where something or somebody has."""
        if self._stopped():
            raise KeyboardInterrupt
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise SimulationError(f'{name} ended early, with exit code {process.poll()}')
        self._executor.spin_once(timeout_sec=0.05)


def topics_of(scenario: Scenario, script: Script) -> dict[str, Any]:
    """List what is worth recording of a run: message classes by topic."""
    topics: dict[str, Any] = {
        'joint_states': JointState,
        'brakes': Bool,
        f'{NODE}/commands': Float64MultiArray,
        f'{NODE}/joint_efforts': JointState,
    }
    if scenario.asks_for == 'accelerations':
        topics[f'{NODE}/desired_accelerations'] = Float64MultiArray
    elif scenario.asks_for == 'reference':
        topics[f'{NODE}/reference'] = JointTrajectory
    if script.expected is not None:
        topics[f'{NODE}/external_efforts'] = JointState
    if 'base_motion' in scenario.parameters:
        topics['imu'] = Imu
    told = {topic: type(m) for event in script.events for topic, m in event.messages.items()}
    return topics | told
