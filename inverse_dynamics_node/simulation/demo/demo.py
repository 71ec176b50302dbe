"""
The demo: runs the node on a simulated robot, and prints, draws and records the result.

Three processes communicate over ROS topics on this machine: the robot, the node, and this one,
which sends references to the node and records the motion.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
import gc
import os
from pathlib import Path
from textwrap import fill

import numpy as np
import rclpy

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import unknown_name
from ...robot.urdf import load_urdf
from ...ros.middleware import start_ros
from ..mujoco.model import SimulationError
from ..trajectory import start_pose
from .demo_setup import DemoSetup
from .processes import running
from .results import check_tracking, excuse
from .run import DemoRun, topics_of
from .scenarios import Scenario, SCENARIOS, Timeline
from .view import View

MOST_LISTED = 7  # joints
NewFile = Callable[[Path], AbstractContextManager[Path]]


def run_demo(options: argparse.Namespace, stopped: Callable[[], bool], new_file: NewFile) -> bool:
    """Run the whole demo; return whether it passed. The picture is written within `new_file`."""
    scenario = SCENARIOS[options.scenario]
    urdf = str(options.urdf.resolve())
    robot = load_urdf(urdf)
    if options.link and options.link not in robot.link_names:
        raise SimulationError(unknown_name('link', options.link, robot.link_names))
    # This also compiles the dynamics, which the node then loads from the cache.
    start = start_pose(robot, InverseDynamics(robot))
    setup = DemoSetup(urdf, robot, start, options.duration, options.link, options.friction)
    timeline = scenario.prepare(setup)  # fails early if nothing can move
    view = View(robot, f'{robot.name}: {options.scenario}')
    log = view.log if view.is_live else None  # above the live table
    if np.any(setup.armature):
        print(describe_rotors(setup))
    if timeline.note:
        print(timeline.note)
    print(_environment_hint())
    with running(_commands(setup, scenario, options), log) as processes:
        start_ros([])
        run = DemoRun(robot, scenario, processes, stopped)
        try:
            return _perform(run, timeline, setup, view, options, new_file)
        finally:
            run.close()
            rclpy.shutdown()


def _perform(
    run: DemoRun,
    timeline: Timeline,
    setup: DemoSetup,
    view: View,
    options: argparse.Namespace,
    new_file: NewFile,
) -> bool:
    scenario, history = SCENARIOS[options.scenario], run.commander.history
    recorder = None
    if options.record:
        from .recorder import Recorder

        recorder = Recorder(run.commander, topics_of(scenario, timeline), latched=('brakes',))
    print(f'waiting for robot and node: {setup.urdf}', flush=True)
    # Exempt the objects of the libraries from garbage collection, which would take 0.1 s a time.
    # Commands that queue up during this are received in the wait below, before the measurement.
    gc.collect()
    gc.freeze()
    run.wait_until_ready()
    if recorder is not None:
        recorder.begin()  # until now the brakes held the arm, and the efforts had no effect
    with view.open():
        run.perform(timeline, setup.duration, view)
    if options.scenario == 'track':
        outcome = check_tracking(setup, history, options.rate)
    else:
        print()
        outcome = timeline.check(history)
    outcome = replace(outcome, excuse=excuse(history))
    if recorder is not None:
        count = recorder.write(options.record, options.storage)
        print(f'recorded: {count} messages in {options.record}')
    if options.picture:
        from .picture import draw

        with new_file(options.picture) as path:
            draw(path, setup.robot, f'{view.title}. {outcome}', timeline, history)
        print(f'picture: {options.picture}')
    print(outcome, flush=True)
    return not outcome.failures


def _environment_hint() -> str:
    names = 'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    settings = ' '.join(f'{name}={os.environ[name]}' for name in names)
    return f'to see its topics, in another terminal: export {settings}'


def describe_rotors(setup: DemoSetup) -> str:
    """Report the joints to which the demo adds rotor inertia, and why."""
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
        'The URDF gives friction to joints that have hardly any inertia: it leaves out the rotors '
        f'of their motors. The demo adds these to the robot and the node: {listed}. For your '
        "robot, determine the rotor inertias and set the parameter 'armature' of the node."
    )
    return fill(text, 100, break_on_hyphens=False)


def _commands(
    setup: DemoSetup, scenario: Scenario, options: argparse.Namespace
) -> dict[str, list[str]]:
    package = 'inverse_dynamics_node'
    urdf, armature = setup.urdf, setup.armature.tolist()
    friction = ['--friction', '--armature', *map(str, armature)] if options.friction else []
    parameters = {
        'robot_description_file': f"'{urdf}'",
        'update_rate': '0.0',
        'include_friction': str(options.friction).lower(),
        'armature': str(armature),
        **scenario.parameters,
    }
    return {
        'the simulated robot': [
            *(f'{package}.simulation.robot', urdf, '--rate', str(options.rate)),
            *friction,
            *scenario.robot,
            *('--ros-args', '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *(f'{package}.node.main', '--ros-args'),
            *(x for name, value in parameters.items() for x in ('-p', f'{name}:={value}')),
        ],
    }
