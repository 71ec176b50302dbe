"""
The node at work on a simulated robot: start both, track a motion, judge it, and print.

Three processes, as on a real machine: the robot, the node, and this one, which asks for
accelerations and watches. They talk over ROS topics, on this machine only.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import math
from pathlib import Path
import signal
import sys
import time

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ..dynamics import InverseDynamics
from ..errors import InverseDynamicsError
from ..model import Floats, RobotModel
from ..urdf import load_urdf
from .commander import Commander, Tracking
from .mujoco_model import SimulationError
from .processes import Processes, running, stay_on_this_machine
from .trajectory import plan, slides, start_pose, Trajectory

START_TIMEOUT = 60.0  # [s]: the first run on a machine compiles the dynamics
SILENCE_TIMEOUT = 5.0  # [s]
REST = 0.2  # share of the duration; its second half is judged
MOVING_LIMIT, REST_LIMIT = 0.010, 0.001  # [rad or m]
RATE_LIMIT = 0.02  # share of the rate asked for


class Demo:
    """
    One run: waits for robot and node, tracks a trajectory, and keeps an eye on everything.

    Parameters
    ----------
    robot : RobotModel
        The robot that both of them load.
    processes : dict of str to subprocess.Popen
        What must stay alive, by the name to print.
    stopped : callable
        Whether the user wants to end it.

    """

    def __init__(
        self, robot: RobotModel, processes: Processes, stopped: Callable[[], bool]
    ) -> None:
        self.commander = Commander(robot.joint_names)
        self._robot = robot
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

    def track(self, trajectory: Trajectory, duration: float) -> tuple[Tracking, float]:
        """Follow a trajectory; return the errors, and the rate at which commands came [Hz]."""
        commander = self.commander
        tracking = commander.follow(trajectory, settled=0.5 * (trajectory.moving + duration))
        began = last = time.monotonic(), commander.commands
        while commander.time < duration:
            target = min(math.floor(commander.time) + 1.0, duration)
            self._wait(
                lambda target=target: commander.time >= target,  # type: ignore[misc]
                'joint states stopped coming',
                1.0 + SILENCE_TIMEOUT,
            )
            now = time.monotonic(), commander.commands
            print_progress(self._robot, commander, _rate(last, now))
            last = now
        return tracking, _rate(began, last)

    def _wait(
        self, condition: Callable[[], bool], otherwise: str, timeout: float = START_TIMEOUT
    ) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if self._stopped():
                raise KeyboardInterrupt
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise SimulationError(f'{name} ended early, with exit code {process.poll()}')
            if time.monotonic() > deadline:
                raise SimulationError(f'{otherwise} (waited {timeout:.0f} s)')
            self._executor.spin_once(timeout_sec=0.05)


def _rate(before: tuple[float, int], after: tuple[float, int]) -> float:
    return (after[1] - before[1]) / (after[0] - before[0])


def print_progress(robot: RobotModel, commander: Commander, rate: float) -> None:
    """Print where the joints are, where they should be, and the efforts that take them there."""
    assert commander.state is not None
    print(f'\nt = {commander.time:.1f} s   {rate:.1f} commands/s')
    print(f'{"joint":24}{"position":>15}{"desired":>15}{"error":>13}{"effort":>14}')
    q, _, effort = commander.state
    rows = zip(robot.joint_names, slides(robot), q, commander.desired, effort, strict=True)
    for name, slide, position, desired, force in rows:
        unit, small, force_unit = ('m', 'mm', 'N') if slide else ('rad', 'mrad', 'N m')
        print(
            f'{name:24}{position:11.4f} {unit:3}{desired:11.4f} {unit:3}'
            f'{1000.0 * (desired - position):8.3f} {small:4}{force:10.3f} {force_unit:3}'
        )
    sys.stdout.flush()


def print_verdict(robot: RobotModel, tracking: Tracking, rate: float, asked: float) -> bool:
    """Print the errors and the rate against their limits; return whether all are within."""
    print(f'\n{"largest error":24}{"moving":>13}{"at rest":>15}')
    rows = zip(
        robot.joint_names,
        slides(robot),
        tracking.moving_error,
        tracking.rest_error,
        strict=True,
    )
    for name, slide, moving, rest in rows:
        unit = 'mm' if slide else 'mrad'
        print(f'{name:24}{1000.0 * moving:8.3f} {unit:4}{1000.0 * rest:10.4f} {unit:4}')
    print(f'rate: {rate:.1f} of {asked:.1f} commands/s ({rate / asked - 1.0:+.1%})')
    failures = find_failures(robot.joint_names, tracking, rate, asked)
    for failure in failures:
        print(f'FAILED: {failure}')
    if not failures:
        print(
            f'PASSED: every joint within {1000 * MOVING_LIMIT:g} mrad (mm) moving and '
            f'{1000 * REST_LIMIT:g} at rest, rate within {RATE_LIMIT:.0%}'
        )
    sys.stdout.flush()
    return not failures


def find_failures(
    joint_names: tuple[str, ...], tracking: Tracking, rate: float, asked: float
) -> list[str]:
    """List what missed its limit, in words."""
    failures = []
    for when, errors, limit in (
        ('moving', tracking.moving_error, MOVING_LIMIT),
        ('at rest', tracking.rest_error, REST_LIMIT),
    ):
        failures += [
            f'joint {name!r} was {1000 * error:.2f} mrad or mm off {when}, limit {1000 * limit:g}'
            for name, error in zip(joint_names, errors, strict=True)
            if not error <= limit  # NaN is a failure: nothing was measured
        ]
    if not abs(rate / asked - 1.0) <= RATE_LIMIT:
        failures.append(f'{rate:.1f} commands/s came, {asked:.1f} were asked for')
    return failures


def run(options: argparse.Namespace, stopped: Callable[[], bool]) -> bool:
    """Run the whole demo; return whether it passed."""
    urdf = str(options.robot.resolve())
    robot = load_urdf(urdf)
    # The node needs the same compiled dynamics: made here first, it finds them ready.
    dynamics = InverseDynamics(robot)
    moving = (1.0 - REST) * options.duration
    plan(robot, dynamics, start_pose(robot, dynamics), moving)  # fails early if nothing can move
    with running(_commands(urdf, options)) as processes:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        demo = Demo(robot, processes, stopped)
        try:
            print(f'waiting for robot and node: {urdf}', flush=True)
            trajectory = plan(robot, dynamics, demo.wait_until_ready(), moving)
            tracking, rate = demo.track(trajectory, options.duration)
            return print_verdict(robot, tracking, rate, options.rate)
        finally:
            demo.close()
            rclpy.shutdown()


def _commands(urdf: str, options: argparse.Namespace) -> dict[str, list[str]]:
    package = 'inverse_dynamics_node'
    friction = ['--friction'] if options.friction else []
    return {
        'the simulated robot': [
            *(f'{package}.simulation.robot', urdf, '--rate', str(options.rate)),
            *friction,
            *('--ros-args', '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *(f'{package}.node.main', '--ros-args'),
            *('-p', f"robot_description_file:='{urdf}'", '-p', 'update_rate:=0.0'),
            *('-p', f'include_friction:={str(options.friction).lower()}'),
        ],
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the demo from the command line; return the exit code."""
    options = _parse(arguments)
    stay_on_this_machine()
    stops: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: stops.append(number))
    try:
        return 0 if run(options, lambda: bool(stops)) else 1
    except KeyboardInterrupt:
        print('stopped')
        return 128 + stops[0]
    except (InverseDynamicsError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='demo', description='Run the node on a simulated robot and judge how it tracks.'
    )
    parser.add_argument('robot', type=Path, help='a URDF')
    parser.add_argument('--rate', type=float, default=500.0, help='of joint states [Hz]')
    parser.add_argument('--duration', type=float, default=15.0, help='of motion and rest [s]')
    parser.add_argument(
        '--friction',
        action='store_true',
        help='give the simulated joints the friction of the URDF, and have the node overcome it: '
        'well where it is viscous, while Coulomb friction holds a joint at rest off its place',
    )
    options = parser.parse_args(arguments)
    if not 50.0 <= options.rate <= 5000.0:
        parser.error(f'--rate {options.rate:g} is not from 50 to 5000 Hz')
    if not 2.0 <= options.duration < math.inf:
        parser.error(f'--duration {options.duration:g} is not 2 s or more')
    return options


if __name__ == '__main__':
    sys.exit(main())
