"""
The loop from joint state to command, in the node and in a relay that computes nothing.

`make bench-loop` runs this benchmark and writes doc/evidence/loop.md. Contenders take turns, with
and without real-time priority, on an idle machine and beside busy processes. While one contender
runs, the other contenders are stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
from pathlib import Path
import sys
from typing import Any

from domain_coordinator import domain_id
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.robot.model import Floats
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from robot_files import ROOT
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from . import interruptions, loop_tables, machine, processes
from .loop_tables import BUSY, IDLE, OURS, RELAY, Task
from .wire import Answers, Contender, EVERY_ONE, NEWEST, Ticks

HERE = Path(__file__).resolve().parent
ROBOT = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
SEED = 1979
STATES = 128
RATE = 1000.0  # [Hz]; rate of the joint states, and `update_rate` of the node
BUSY_PROCESSES = 4
TURN = 1.0  # [s]; duration of a turn
LONG_TURN = 5.0  # [s]; duration of a turn with `update_rate`

NODE = 'inverse_dynamics_node.node.main'
RELAY_MODULE = 'benchmarks.loop'  # with the argument of `relay_process`


def main() -> None:
    """Run all measurements, then print and write the page."""
    parser = argparse.ArgumentParser(prog='make bench-loop', description=__doc__)
    parser.add_argument('--rounds', type=int, default=10, help='number of turns of each contender')
    parser.add_argument(
        '--duration', type=float, default=15.0, help='time of each contender at a fixed rate [s]'
    )
    parser.add_argument('--doc', type=Path, help='folder of the page')
    arguments = parser.parse_args()
    before = machine.describe(machine.ROS_PACKAGES)
    is_permitted = processes.raise_robot_side()
    busy = processes.BusyProcesses(BUSY_PROCESSES)
    try:
        answers = at_once(arguments.rounds, is_permitted, busy)
        turns = max(1, round(arguments.duration / LONG_TURN))
        ticks = at_a_rate(turns, min(LONG_TURN, arguments.duration), is_permitted, busy)
        gaps = interrupted(max(1, arguments.rounds // 5), is_permitted, busy)
    finally:
        busy.close()
    page = (
        (HERE / 'loop.md')
        .read_text()
        .format(
            machine=before,
            load=machine.load(),
            rounds=arguments.rounds,
            duration=arguments.duration,
            busy=BUSY_PROCESSES,
            permission=loop_tables.permission(is_permitted),
            idle_answers=loop_tables.answers_table(answers, IDLE, 1.0 / RATE),
            busy_answers=loop_tables.answers_table(answers, BUSY, 1.0 / RATE),
            ratios=loop_tables.ratios_table(answers),
            ticks=loop_tables.ticks_table(ticks),
            gaps=loop_tables.gaps_table(gaps),
        )
    )
    print('\n' + page)
    if arguments.doc:
        (arguments.doc / 'loop.md').write_text(page)


def at_once(
    rounds: int, is_permitted: bool, busy: processes.BusyProcesses
) -> dict[Task, list[Answers]]:
    """Measure, in turns, answers to joint states at a fixed rate."""
    with contextlib.ExitStack() as stack:
        contenders = {}
        for has_priority in (False, True) if is_permitted else (False,):
            contenders |= {
                (OURS, has_priority): node(stack, has_priority),
                (RELAY, has_priority): relay(stack, has_priority, 0.0),
            }
        answers: dict[Task, list[Answers]] = {
            Task(*who, load): [] for load in (IDLE, BUSY) for who in contenders
        }
        for k in range(rounds):
            for task, turns in answers.items():
                with busy.running(task.load == BUSY):
                    turns.append(contenders[task[:2]].answers(TURN, 1.0 / RATE))
            print(f'round {k + 1}: load {machine.load()}', flush=True)
            for task, turns in answers.items():
                late = np.percentile(turns[-1].times, 99)
                print(f'  {task}: 99 % within {loop_tables.duration(float(late))}', flush=True)
    return answers


def at_a_rate(
    turns: int, seconds: float, is_permitted: bool, busy: processes.BusyProcesses
) -> dict[Task, list[Ticks]]:
    """Measure, in turns, the node and the relay with commands at a fixed rate."""
    with contextlib.ExitStack() as stack:
        contenders = {}
        for has_priority in (False, True) if is_permitted else (False,):
            contenders |= {
                (OURS, has_priority): node(stack, has_priority, update_rate=RATE),
                (RELAY, has_priority): relay(stack, has_priority, RATE),
            }
        found: dict[Task, list[Ticks]] = {
            Task(*who, load): [] for load in (IDLE, BUSY) for who in contenders
        }
        for _ in range(turns):
            for task, ticks in found.items():
                with busy.running(task.load == BUSY):
                    ticks.append(contenders[task[:2]].ticks(seconds, RATE))
                print(f'{RATE:.0f} Hz: {task}, {ticks[-1]}', flush=True)
    return found


def interrupted(
    rounds: int, is_permitted: bool, busy: processes.BusyProcesses
) -> dict[Task, dict[str, list[float]]]:
    """Measure the longest time without a command while the node does other work."""
    found: dict[Task, dict[str, list[float]]] = {}
    for has_priority in (False, True) if is_permitted else (False,):
        with contextlib.ExitStack() as stack:
            contender = node(stack, has_priority)
            for load in (IDLE, BUSY):
                task = Task(OURS, has_priority, load)
                found[task] = interruptions.measure(contender, ROBOT, rounds, load == BUSY, busy)
                print(f'longest gaps: {task}, {found[task]}', flush=True)
    return found


def node(stack: contextlib.ExitStack, has_priority: bool, **parameters: Any) -> Contender:
    """Start the node in inverse dynamics mode."""
    settings = {
        'start_ramp': 0.0,
        'reference_timeout': 0.0,
        'state_timeout': 10.0,  # busy processes may delay the joint states, too
        **parameters,
    }
    ours = [argument for name, x in settings.items() for argument in ('-p', f'{name}:={x}')]
    q, qd, qdd = states()
    efforts = InverseDynamics(load_urdf(ROBOT)).efforts(q, qd, np.broadcast_to(qdd, q.shape))
    # The node raises its priority itself.
    prepare = processes.normal if has_priority else processes.forbidden
    arguments = ['--ros-args', '--log-level', 'fatal', *ours]
    return _started(stack, NODE, arguments, efforts, prepare)


def relay(stack: contextlib.ExitStack, has_priority: bool, rate: float) -> Contender:
    """Start the relay; with ``rate`` 0, it sends a command for every joint state."""
    prepare = processes.realtime if has_priority else processes.normal
    return _started(stack, RELAY_MODULE, [f'{RELAY}={rate}', '--ros-args'], states()[0], prepare)


def relay_process(rate: float) -> None:
    """Forward positions as commands and compute nothing, as a plain node with rclpy does."""
    rclpy.init(args=sys.argv)
    node = rclpy.create_node('relay')
    commands = node.create_publisher(Float64MultiArray, '~/commands', EVERY_ONE)
    latest = []

    def forward(message: JointState) -> None:
        commands.publish(Float64MultiArray(data=list(message.position)))

    def keep(message: JointState) -> None:
        latest[:] = [message]

    node.create_subscription(JointState, 'joint_states', keep if rate else forward, NEWEST)
    if rate:
        node.create_timer(1.0 / rate, lambda: [forward(message) for message in latest])
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


def _started(
    stack: contextlib.ExitStack,
    module: str,
    arguments: Sequence[str],
    expected: Floats,
    prepare: Any,
) -> Contender:
    domain = domain_id()
    contender = Contender(module, arguments, domain.__enter__(), prepare)
    stack.callback(domain.__exit__, None, None, None)  # it must not swallow exceptions
    stack.callback(contender.close)
    contender.publish_description(ROBOT.read_text())
    q, qd, qdd = states()
    names = load_urdf(ROBOT).joint_names
    messages = [
        JointState(name=names, position=x, velocity=v, effort=x)
        for x, v in zip(q, qd, strict=True)
    ]
    for k, message in enumerate(messages):
        message.header.frame_id = 'base_link'
        message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, 1_000_000 * k
    contender.start(messages, qdd.tolist(), expected)
    return contender


def states() -> tuple[Floats, Floats, Floats]:
    """
    Draw positions and velocities, shape (count, 7), and accelerations, shape (7,).

    Successive states differ by less than an arm moves between two messages, and the joints are so
    slow that positions which hardly change do not contradict the velocities. Otherwise, the motion
    limits of the node would stop the arm.
    """
    rng = np.random.default_rng(SEED)
    q, qd, qdd = rng.uniform(-0.5, 0.5, (3, 7))
    qd *= 0.02
    # All states differ, because the joints move along circles.
    phase = 2.0 * np.pi * np.arange(STATES)[:, np.newaxis] / STATES
    vibration = 1e-4 * np.sin(phase + 0.5 * np.pi * (np.arange(7) % 2))
    return q + vibration, qd + vibration, qdd


if __name__ == '__main__':
    if sys.argv[1:] and sys.argv[1].startswith(f'{RELAY}='):
        relay_process(float(sys.argv[1].split('=')[1]))
    else:
        main()
