"""
The loop of the node, from joint state to command, and of relays that compute nothing.

`make bench-loop` runs it and writes doc/loop.md. Contenders take turns; the other processes are
stopped meanwhile.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
from pathlib import Path
from typing import Any

from domain_coordinator import domain_id
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.robot.model import Floats
import numpy as np
from robot_files import ROOT
from sensor_msgs.msg import JointState

from . import machine
from .report import duration, figures, grid
from .timing import compare
from .wire import Contender, Ticks, Trips

HERE = Path(__file__).resolve().parent
ROBOT = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
SEED = 1979
STATES = 64
RATE = 1000.0  # [Hz]; `update_rate` of the node
PACED, HURRIED = 1.0 / RATE, 0.0  # [s]; least time between states
TURN = 1.0  # [s]
LONG_TURN = 10.0  # [s]; with `update_rate`

OURS = 'this node'
USUAL = 'usual relay'
LEAN = 'lean relay'
NODE = 'inverse_dynamics_node.node.main'
RELAYS = 'benchmarks.relays'
PACKAGES = ('inverse_dynamics_node', 'numpy', 'numba', 'ros-jazzy-rclpy', 'ros-rmw-fastrtps-cpp')
QUANTITIES = ('round trip, median', 'round trip, 99 %', 'CPU per command')


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog='make bench-loop', description=__doc__)
    parser.add_argument('--rounds', type=int, default=20, help='number of turns of round trips')
    parser.add_argument(
        '--duration', type=float, default=60.0, help='time of each contender at a fixed rate [s]'
    )
    parser.add_argument('--doc', type=Path, help='folder of the page')
    arguments = parser.parse_args()
    before = machine.describe(PACKAGES)
    trips = round_trips(arguments.rounds)
    turns = max(1, round(arguments.duration / LONG_TURN))
    ticks = at_a_rate(turns, min(LONG_TURN, arguments.duration))
    page = (
        (HERE / 'loop.md')
        .read_text()
        .format(
            machine=before,
            load=machine.load(),
            rounds=arguments.rounds,
            duration=arguments.duration,
            paced=trips_table(trips[PACED]),
            hurried=trips_table(trips[HURRIED]),
            ticks=ticks_table(ticks),
        )
    )
    print('\n' + page)
    if arguments.doc:
        (arguments.doc / 'loop.md').write_text(page)


def round_trips(rounds: int) -> dict[float, dict[str, list[Trips]]]:
    """Measure round trips in turns, both at a fixed rate and as fast as possible."""
    with contextlib.ExitStack() as stack:
        contenders = {
            OURS: node(stack),
            USUAL: relay(stack, 'usual'),
            LEAN: relay(stack, 'lean'),
        }
        found: dict[float, dict[str, list[Trips]]] = {
            pace: {name: [] for name in contenders} for pace in (PACED, HURRIED)
        }
        for k in range(rounds):
            for pace, turns in found.items():
                for name, contender in contenders.items():
                    turns[name].append(contender.trips(TURN, pace))
            times = ', '.join(f'{n} {duration(t[-1].cpu)}' for n, t in found[PACED].items())
            print(f'round {k + 1}: CPU {times}; load {machine.load()}', flush=True)
    return found


def at_a_rate(turns: int, seconds: float) -> dict[str, list[Ticks]]:
    """Measure the ticks of the node and of the usual relay at a fixed rate, in turns."""
    with contextlib.ExitStack() as stack:
        contenders = {
            OURS: node(stack, update_rate=RATE),
            USUAL: relay(stack, 'usual', f'{RATE}'),
        }
        found: dict[str, list[Ticks]] = {name: [] for name in contenders}
        for _ in range(turns):
            for name, contender in contenders.items():
                found[name].append(contender.ticks(seconds, RATE))
                print(f'{RATE:.0f} Hz: {name}, {found[name][-1]}', flush=True)
    return found


def node(stack: contextlib.ExitStack, **parameters: Any) -> Contender:
    """Start the node in inverse dynamics mode."""
    settings = {
        'robot_description_file': ROBOT,
        'start_ramp': 0.0,
        'reference_timeout': 0.0,
        **parameters,
    }
    ours = [argument for name, x in settings.items() for argument in ('-p', f'{name}:={x}')]
    q, qd, qdd = states()
    efforts = InverseDynamics(load_urdf(ROBOT)).efforts(q, qd, np.broadcast_to(qdd, q.shape))
    return _started(stack, NODE, ['--ros-args', '--log-level', 'fatal', *ours], efforts)


def relay(stack: contextlib.ExitStack, *arguments: str) -> Contender:
    """Start a relay."""
    return _started(stack, RELAYS, [*arguments, '--ros-args'], states()[0])


def _started(
    stack: contextlib.ExitStack, module: str, arguments: Sequence[str], expected: Floats
) -> Contender:
    domain = domain_id()
    contender = Contender(module, arguments, domain.__enter__())
    stack.callback(domain.__exit__, None, None, None)  # it would swallow an exception
    stack.callback(contender.close)
    q, qd, qdd = states()
    names = load_urdf(ROBOT).joint_names
    messages = [
        JointState(name=names, position=x, velocity=v, effort=x)
        for x, v in zip(q, qd, strict=True)
    ]
    for k, message in enumerate(messages):
        message.header.frame_id = 'base_link'
        message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, 10_000_000 * k
    contender.start(messages, qdd.tolist(), expected)
    return contender


def states() -> tuple[Floats, Floats, Floats]:
    """
    Draw positions and velocities, shape (count, 7), and accelerations, shape (7,).

    Neighbouring states differ by less than an arm moves between two messages: the node would take
    larger steps for two publishers that contradict each other, and stop.

    """
    rng = np.random.default_rng(SEED)
    q, qd, qdd = rng.uniform(-0.5, 0.5, (3, 7))
    vibration = 1e-4 * np.sin(2.0 * np.pi * np.arange(STATES) / STATES)[:, np.newaxis]
    return q + vibration, qd + vibration, qdd


def trips_table(found: dict[str, list[Trips]]) -> str:
    """Format medians over the rounds, and the ratios of the node to each relay."""
    rows = []
    for k, quantity in enumerate(QUANTITIES):
        of = {name: [quantities(turn)[k] for turn in turns] for name, turns in found.items()}
        times = [duration(float(np.median(values))) for values in of.values()]
        ratios = [figures(compare(of, name)[OURS]) for name in (USUAL, LEAN)]
        rows.append([quantity, *times, *ratios])
    counts = [str(sum(len(turn.times) for turn in turns)) for turns in found.values()]
    lost = [str(sum(turn.lost for turn in turns)) for turns in found.values()]
    rows += [['commands', *counts, '', ''], ['states without an answer', *lost, '', '']]
    return grid(['', *found, f'{OURS} / {USUAL}', f'{OURS} / {LEAN}'], rows)


def quantities(turn: Trips) -> tuple[float, float, float]:
    """Return median, 99th percentile and CPU of a turn [s]."""
    median, late = np.percentile(turn.times, (50, 99))
    return float(median), float(late), turn.cpu


def ticks_table(found: dict[str, list[Ticks]]) -> str:
    """Format the fractions of late ticks, and the CPU load."""
    rows = []
    for name, turns in found.items():
        periods = sum(turn.periods for turn in turns)
        counts = [sum(getattr(turn, field) for turn in turns) for field in ('missed', 'slept')]
        cpu = np.mean([turn.cpu for turn in turns])
        rows.append([name, *(f'{100 * n / periods:.2f} %' for n in counts), f'{100 * cpu:.1f} %'])
    return grid(['', 'late or missed', 'late or missed states', 'CPU of one core'], rows)


if __name__ == '__main__':
    main()
