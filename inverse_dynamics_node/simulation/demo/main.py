"""
The node at work on a simulated robot: start both, let something happen, judge it, and print.

Three processes, as on a real machine: the robot, the node, and this one, which asks the node to
move the robot and watches. They talk over ROS topics, on this machine only.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
import gc
import math
import os
from textwrap import fill

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import unknown_name
from ...robot.urdf import load_urdf
from ..mujoco.model import SimulationError
from ..trajectory import slides, start_pose
from .history import History
from .processes import running
from .run import Run, topics_of
from .scenarios import (
    REST,
    Scenario,
    SCENARIOS,
    Script,
)
from .stage import Stage
from .verdicts import (
    excuse,
    find_failures,
    tracking_limits,
    tracking_words,
    Verdict,
)
from .view import name_width, View

MOST_TOLD = 7  # joints listed


def judge_tracking(stage: Stage, history: History, asked: float) -> Verdict:
    """Print the errors and the rate; hold them against their limits."""
    robot, duration, rate = stage.robot, stage.duration, history.command_rate()
    moving = history.largest_error(0.0, (1.0 - REST) * duration)
    rest = history.largest_error((1.0 - 0.5 * REST) * duration, math.inf)
    wide = name_width(robot)
    limits = tracking_limits(stage.slack)
    # Without friction all limits are the same: the verdict names them.
    head = ('moving', 'limit', 'at rest', 'limit') if stage.friction else ('moving', 'at rest')
    widths = (13, 14, 15, 15) if stage.friction else (13, 15)
    columns = ''.join(f'{word:>{width}}' for word, width in zip(head, widths, strict=True))
    print(f'\n{"largest error":{wide}}{columns}')
    rows = zip(robot.joint_names, slides(robot), moving, rest, *limits, strict=True)
    for name, slide, moving_error, rest_error, moving_limit, rest_limit in rows:
        unit = 'mm' if slide else 'mrad'
        cells = [f'{1000.0 * moving_error:8.3f} {unit:4}', f'{1000.0 * rest_error:10.4f} {unit:4}']
        if stage.friction:
            cells.insert(1, f'{1000.0 * moving_limit:9.3f} {unit:4}')
            cells.append(f'{1000.0 * rest_limit:10.4f} {unit:4}')
        print(f'{name:{wide}}{"".join(cells)}')
    print(f'rate: {rate:.1f} of {asked:.1f} commands/s ({rate / asked - 1.0:+.1%})')
    return Verdict(
        tracking_words(stage.slack),
        tuple(find_failures(robot.joint_names, moving, rest, rate, asked, stage.slack)),
    )


def run(options: argparse.Namespace, stopped: Callable[[], bool]) -> bool:
    """Run the whole demo; return whether it passed."""
    scenario = SCENARIOS[options.scenario]
    urdf = str(options.urdf.resolve())
    robot = load_urdf(urdf)
    if options.link and options.link not in robot.link_names:
        raise SimulationError(unknown_name('link', options.link, robot.link_names))
    # The node needs the same compiled dynamics: made here first, it finds them ready.
    start = start_pose(robot, InverseDynamics(robot))
    stage = Stage(urdf, robot, start, options.duration, options.link, options.friction)
    script = scenario.prepare(stage)  # fails early if nothing can move
    view = View(robot, f'{robot.name}: {options.scenario}')
    log = view.log if view.is_live else None  # or lines would go through the table
    if np.any(stage.armature):
        print(told_of_rotors(stage))
    if script.note:
        print(script.note)
    print(_how_to_look_inside())
    with running(_commands(stage, scenario, options), log) as processes:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        act = Run(robot, scenario, processes, stopped)
        try:
            return _perform(act, script, stage, view, options)
        finally:
            act.close()
            rclpy.shutdown()


def _perform(
    act: Run, script: Script, stage: Stage, view: View, options: argparse.Namespace
) -> bool:
    scenario, history = SCENARIOS[options.scenario], act.commander.history
    recorder = None
    if options.record:
        from .recorder import Recorder

        recorder = Recorder(act.commander, topics_of(scenario, script), latched=('brakes',))
    print(f'waiting for robot and node: {stage.urdf}', flush=True)
    # Objects of the libraries stay: a collection that visits them all takes 0.1 s. Here, before
    # the wait, commands that queue up meanwhile are received before anything is measured.
    gc.collect()
    gc.freeze()
    act.wait_until_ready()
    if recorder is not None:
        recorder.begin()  # until now brakes held the arm, and what the drives did was no matter
    with view.open():
        act.perform(script, stage.duration, view)
    if options.scenario == 'track':
        verdict = judge_tracking(stage, history, options.rate)
    else:
        print()
        verdict = script.judge(history)
    verdict = replace(verdict, excuse=excuse(history))
    if recorder is not None:
        count = recorder.write(options.record, options.storage)
        print(f'recorded: {count} messages in {options.record}')
    if options.picture:
        from .picture import draw

        draw(options.picture, stage.robot, f'{view.title}. {verdict}', script, history)
        print(f'picture: {options.picture}')
    print(verdict, flush=True)
    return not verdict.failures


def _how_to_look_inside() -> str:
    names = 'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    settings = ' '.join(f'{name}={os.environ[name]}' for name in names)
    return f'to see its topics, in another terminal: export {settings}'


def told_of_rotors(stage: Stage) -> str:
    """Say which joints have rotors here that the URDF does not know, and why."""
    robot = stage.robot
    rotors = [
        f'{name} {armature:.2g} {"kg" if slide else "kg m^2"}'
        for name, armature, slide in zip(
            robot.joint_names, stage.armature, slides(robot), strict=True
        )
        if armature > 0.0
    ]
    rest = f' and {len(rotors) - MOST_TOLD} more' if len(rotors) > MOST_TOLD else ''
    listed = ', '.join(rotors[:MOST_TOLD]) + rest
    text = (
        'The URDF has friction for joints of hardly any inertia: of motors and gears, without '
        f'their rotors. Robot and node have these here: {listed}. Find out those of your robot, '
        "and give them to the node: parameter 'armature'."
    )
    return fill(text, 100, break_on_hyphens=False)


def _commands(
    stage: Stage, scenario: Scenario, options: argparse.Namespace
) -> dict[str, list[str]]:
    package = 'inverse_dynamics_node'
    urdf, armature = stage.urdf, stage.armature.tolist()
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
