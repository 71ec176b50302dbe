"""One run: wait for robot and node, follow a timeline, and supervise both processes."""

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
from ..trajectory import Reference
from .commander import Commander
from .processes import Processes
from .scenarios import NODE, Scenario, Timeline
from .view import Snapshot, View

START_TIMEOUT = 60.0  # [s]: the first run on a machine compiles the dynamics
SILENCE_TIMEOUT = 5.0  # [s]


class DemoRun:
    """
    A scenario, and the processes that it needs.

    Parameters
    ----------
    robot : RobotModel
        The robot that all processes load.
    scenario : Scenario
        The scenario to perform.
    processes : dict of str to subprocess.Popen
        Processes that must not end before the run does, by the name to print.
    stopped : callable
        Returns whether the user has asked to stop.

    """

    def __init__(
        self,
        robot: RobotModel,
        scenario: Scenario,
        processes: Processes,
        stopped: Callable[[], bool],
    ) -> None:
        self.commander = Commander(robot.joint_names, scenario.sends)
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

    def wait_until_ready(self, standing: Reference | None = None) -> Floats:
        """
        Wait until the node holds the robot and the brakes are open; return the positions.

        Parameters
        ----------
        standing : Reference, optional
            Reference for the node from the first joint state on. Without it, the node holds the
            robot by its model alone.

        """
        commander = self.commander
        self._wait(lambda: commander.state is not None, 'the robot sends no joint states')
        if standing is not None:
            commander.follow(standing, records=False)
        self._wait(lambda: commander.commands > 0, 'the node sends no commands')
        self._wait(lambda: not commander.brakes_on, 'the brakes stay on: commands do not flow')
        assert commander.state is not None
        return commander.state[0]

    def perform(self, timeline: Timeline, duration: float, view: View) -> None:
        """Follow a timeline from start to end."""
        commander = self.commander
        for event in timeline.events:
            commander.advertise(event.messages)
        self._wait(
            lambda: not commander.topics_without_subscriber(),
            lambda: f'no subscriber on {", ".join(commander.topics_without_subscriber())}',
        )
        if timeline.expected is not None:
            commander.record_external_efforts()
            self._wait(
                lambda: commander.external_efforts > 0, 'the node sends no external efforts'
            )
        self.words = timeline.begins
        view.announce(0.0, self.words)
        commander.follow(timeline.trajectory)
        events = list(timeline.events)
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
                    commander.publish(topic, message)
                view.announce(event.time, event.words)
            is_second = commander.now >= min(line, duration)
            if is_second and not view.is_live:
                view.print_progress(self._snapshot(last))
            elif view.is_due:
                view.draw(self._snapshot(time.monotonic() - 1.0))
            if is_second:
                line = math.floor(commander.now) + 1.0
                last = time.monotonic()

    def _snapshot(self, since: float) -> Snapshot:
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
        """Handle pending events for a moment; raise if a process ended or the user stopped."""
        if self._stopped():
            raise KeyboardInterrupt
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise SimulationError(f'{name} ended early, with exit code {process.poll()}')
        self._executor.spin_once(timeout_sec=0.05)


def topics_of(scenario: Scenario, timeline: Timeline) -> dict[str, Any]:
    """Return the topics of a run that are worth recording, with their message classes."""
    topics: dict[str, Any] = {
        'joint_states': JointState,
        'brakes': Bool,
        f'{NODE}/commands': Float64MultiArray,
        f'{NODE}/joint_efforts': JointState,
    }
    if scenario.sends == 'accelerations':
        topics[f'{NODE}/desired_accelerations'] = Float64MultiArray
    elif scenario.sends == 'reference':
        topics[f'{NODE}/reference'] = JointTrajectory
    if timeline.expected is not None:
        topics[f'{NODE}/external_efforts'] = JointState
    if 'base_motion' in scenario.parameters:
        topics['imu'] = Imu
    events = {topic: type(m) for event in timeline.events for topic, m in event.messages.items()}
    return topics | events
