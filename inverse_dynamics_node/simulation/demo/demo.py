"""
The demo: runs the node on a simulated robot, and records the motion.

Three processes communicate over ROS topics: the robot, the node, and this process. This process
sends the desired motion to the node, and records the measured motion.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
import gc
import math
import os
from pathlib import Path
from textwrap import fill
import time
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import unknown_name
from ...robot.model import RobotModel
from ...robot.urdf import load_urdf
from ...ros.middleware import start_ros
from ..mujoco.model import SimulationError
from ..trajectory import Reference, start_pose
from .commander import Commander, History
from .demo_setup import DemoSetup
from .processes import Processes, running
from .results import excuse, ScenarioResult
from .scenarios import NODE, Scenario, SCENARIOS, Timeline
from .view import Snapshot, View

MOST_LISTED = 7  # largest number of joints in a list
START_TIMEOUT = 60.0  # [s]: the first run on a machine compiles the dynamics
SILENCE_TIMEOUT = 5.0  # [s]: longest time without joint states


class DemoResult(NamedTuple):
    """The results of a run: the verdict, and the data for a picture."""

    outcome: ScenarioResult
    title: str
    robot: RobotModel
    timeline: Timeline
    history: History


def run_demo(options: argparse.Namespace, stopped: Callable[[], bool]) -> DemoResult:
    """Run a scenario, print its progress, and record it if ``options.record`` is set."""
    scenario = SCENARIOS[options.scenario]
    urdf = str(options.urdf.resolve())
    robot = load_urdf(urdf)
    if options.link and options.link not in robot.link_names:
        raise SimulationError(unknown_name('link', options.link, robot.link_names))
    # InverseDynamics compiles the dynamics, and the node then loads the code from the cache.
    start = start_pose(robot, InverseDynamics(robot))
    setup = DemoSetup(
        urdf, robot, start, options.duration, options.link, options.friction, options.rate
    )
    timeline = scenario.prepare(setup)  # fails early if nothing can move
    view = View(robot, f'{robot.name}: {options.scenario}')
    if np.any(setup.armature):
        print(describe_rotors(setup))
    if timeline.note:
        print(timeline.note)
    print(_environment_hint())
    print(f'waiting for the simulated robot and the node ({urdf})', flush=True)
    armature = setup.armature.tolist()
    friction = ['--friction', '--armature', *map(str, armature)] if options.friction else []
    parameters = {
        'robot_description_file': f"'{urdf}'",
        'include_friction': str(options.friction).lower(),
        'armature': str(armature),
    }
    commands = commands_of(
        scenario, options.rate, [urdf, *friction, *scenario.robot], [], parameters
    )
    history, recorded = perform(
        scenario, timeline, view, commands, options, stopped, options.record
    )
    print()
    outcome = replace(timeline.check(history), excuse=excuse(history))
    if options.record:
        print(f'recorded: {recorded} messages in {options.record}')
    return DemoResult(outcome, view.title, robot, timeline, history)


def _environment_hint() -> str:
    names = 'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    settings = ' '.join(f'{name}={os.environ[name]}' for name in names)
    return f'to see the topics of the demo, run in another terminal: export {settings}'


def describe_rotors(setup: DemoSetup) -> str:
    """List the joints to which the demo adds rotor inertia, and explain why."""
    robot = setup.robot
    rotors = [
        f'{name} {armature:.2g} {"kg" if slide else "kg m^2"}'
        for name, armature, slide in zip(
            robot.joint_names, setup.armature, robot.is_prismatic_joint, strict=True
        )
        if armature > 0.0
    ]
    rest = f' and {len(rotors) - MOST_LISTED} more' if len(rotors) > MOST_LISTED else ''
    listed = ', '.join(rotors[:MOST_LISTED]) + rest
    text = (
        'Some joints of the URDF have friction but hardly any inertia, because the URDF lacks the '
        'rotors of the motors. The demo adds rotor inertias to the simulated robot and to the '
        f'model in the node: {listed}. For your robot, determine the rotor inertias '
        "and set the parameter 'armature' of the node."
    )
    return fill(text, 100, break_on_hyphens=False)


def commands_of(
    scenario: Scenario,
    rate: float,
    robot: list[str],
    node: list[str],
    parameters: Mapping[str, str],
) -> dict[str, list[str]]:
    """Map the name of each process to the arguments of ``python -m`` that start the process."""
    package = 'inverse_dynamics_node'
    parameters = {'update_rate': '0.0', **parameters, **scenario.parameters}
    return {
        'the simulated robot': [
            *(f'{package}.simulation.robot', *robot, '--rate', str(rate)),
            *('--ros-args', '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *(f'{package}.node.main', '--ros-args', *node),
            *(x for name, value in parameters.items() for x in ('-p', f'{name}:={value}')),
        ],
    }


def perform(
    scenario: Scenario,
    timeline: Timeline,
    view: View,
    commands: Mapping[str, list[str]],
    options: argparse.Namespace,
    stopped: Callable[[], bool],
    record: Path | None,
    standing: Reference | None = None,
) -> tuple[History, int]:
    """
    Start robot and node, follow the timeline, and end the processes.

    ``commands`` come from `commands_of`. ``stopped`` returns True if the user wants to stop. If
    ``record`` is not None, the topics from `topics_of` are recorded to the folder ``record``. For
    ``standing``, see `DemoRun.perform`. Return the history and the number of recorded messages.
    """
    with running(commands, view.log if view.is_live else None) as processes:
        start_ros([])
        run = DemoRun(scenario, timeline, view, processes, stopped, record is not None)
        try:
            run.perform(options.duration, standing)
            recorded = run.recorder.write(record, options.storage) if record else 0
        finally:
            run.close()
            rclpy.shutdown()
    return run.commander.history, recorded


class DemoRun:
    """One run of the demo."""

    def __init__(
        self,
        scenario: Scenario,
        timeline: Timeline,
        view: View,
        processes: Processes,
        stopped: Callable[[], bool],
        records: bool,
    ) -> None:
        self.commander = Commander(view.robot.joint_names, scenario.sends)
        self._timeline, self._view = timeline, view
        self._words = timeline.begins
        self._processes, self._stopped = processes, stopped
        self._executor = EventsExecutor()
        self._executor.add_node(self.commander)
        self.recorder: Any = None
        if records:
            from .recorder import Recorder  # needs rosbags

            topics = topics_of(scenario, timeline)
            self.recorder = Recorder(self.commander, topics, latched=('brakes',))

    def close(self) -> None:
        """Shut down the executor, and destroy the ROS node of this process."""
        self._executor.remove_node(self.commander)
        self._executor.shutdown()
        self.commander.destroy_node()

    def perform(self, duration: float, standing: Reference | None) -> None:
        """
        Wait for robot and node, and follow the timeline for a duration [s].

        As soon as joint states arrive, the reference ``standing`` is sent to the node. If
        ``standing`` is None, the node holds the robot without a reference until the timeline
        starts.
        """
        # Garbage collection of the objects of the libraries would take 0.1 s each time.
        gc.collect()
        gc.freeze()
        self._wait_until_ready(standing)
        if self.recorder is not None:
            self.recorder.begin()  # efforts have no effect while the brakes are on
        with self._view.open():
            self._wait_for_topics()
            self._follow(duration)

    def _wait_until_ready(self, standing: Reference | None) -> None:
        """Wait until the node sends commands and the brakes are released."""
        commander = self.commander
        self._wait(lambda: commander.state is not None, 'the robot sends no joint states')
        if standing is not None:
            commander.follow(standing, records=False)
        self._wait(lambda: commander.commands > 0, 'the node sends no commands')
        self._wait(
            lambda: not commander.brakes_on,
            'the brakes stay on, because commands reach the robot with gaps or not at all',
        )

    def _wait_for_topics(self) -> None:
        """Wait for subscribers to the events' topics, and for external efforts if expected."""
        commander = self.commander
        for event in self._timeline.events:
            commander.advertise(event.messages)
        self._wait(
            lambda: not commander.topics_without_subscriber(),
            lambda: f'no node subscribes to {", ".join(commander.topics_without_subscriber())}',
        )
        if self._timeline.expected is not None:
            commander.record_external_efforts()
            self._wait(
                lambda: commander.external_efforts > 0, 'the node publishes no external efforts'
            )

    def _follow(self, duration: float) -> None:
        commander, timeline, view = self.commander, self._timeline, self._view
        view.announce(0.0, timeline.begins)
        commander.follow(timeline.trajectory)
        events = list(timeline.events)
        last = time.monotonic()
        line = 1.0
        while commander.now < duration:
            self._spin()
            if commander.silence > SILENCE_TIMEOUT:
                raise SimulationError('the robot has stopped sending joint states')
            while events and commander.now >= events[0].time:
                event = events.pop(0)
                self._words = event.words
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
            commander.now, rate, self._words, q, commander.desired, effort, commander.brakes_on
        )

    def _wait(self, condition: Callable[[], bool], otherwise: str | Callable[[], str]) -> None:
        deadline = time.monotonic() + START_TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                words = otherwise if isinstance(otherwise, str) else otherwise()
                raise SimulationError(f'{words} (waited {START_TIMEOUT:.0f} s)')
            self._spin()

    def _spin(self) -> None:
        """Spin once; raise if a process has ended or the user wants to stop."""
        if self._stopped():
            raise KeyboardInterrupt
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise SimulationError(f'{name} ended early, with exit code {process.poll()}')
        self._executor.spin_once(timeout_sec=0.05)


def topics_of(scenario: Scenario, timeline: Timeline) -> dict[str, Any]:
    """Return the topics to record during a run, with their message classes."""
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
