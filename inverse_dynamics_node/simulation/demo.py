"""
The demo: the node moves a simulated robot, whose behaviour is then judged.

Three processes communicate over ROS topics: the command ``inverse_dynamics simulate``, the node,
and this process, the commander. The arm follows a reference under computed torque, and holds its
pose. Then it gets a load, which the node does not know at first and later receives as a payload.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
import math
import os
import signal
import subprocess
import sys
import time
from typing import Any, NamedTuple

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
import numpy as np
from numpy.typing import ArrayLike
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.kinematics import last_link, path_to
from ..robot.model import Floats, RobotModel
from ..robot.urdf import load_urdf
from ..ros.middleware import BEST_EFFORT, LATCHED
from .mujoco import require_inertia, SimulationError
from .robot import executing
from .trajectory import Oscillation, plan, start_pose

HOLDS, LOADED, TOLD, END = 6.0, 8.0, 10.5, 13.0
"""
Times at which the reference comes to rest, the robot gets the load, the node is told of the load,
and the run ends [s].
"""
SETTLED = 1.0  # [s]: time after a change in which errors decay
KP, KD = 400.0, 40.0  # [1/s^2], [1/s]: gains, which are critically damped at 20 rad/s
MOVING_LIMIT, REST_LIMIT = 10.0, 1.0  # [mrad or mm]: largest errors in motion and at rest
LEAST_DEFLECTION = 0.5  # smallest deflection by the unknown load, relative to the computed one
STEP_LIMIT = 0.1  # largest step of a command, relative to the effort that the load needs
LEAST_SHARE = 0.05  # least effort in place of that of the load, relative to the largest command
RATE_LIMIT = 0.98  # smallest number of commands per joint state
HARMLESS = 0.03  # [s]: longest gap between commands that does not affect the verdict
HEAVIEST, LIGHTEST = 0.25, 0.05  # bounds of the load, relative to the mass of the robot
DEFLECTION = (0.1, 0.03)  # [rad], [m]: largest deflections by the load that the node does not know
BOX, GRIP = 0.1, (0.0, 0.0, 0.05)  # [m]: side and centre of the load, a cube
TIMEOUT, STOP_TIMEOUT = 60.0, 5.0  # [s]: to start the processes or end a phase, and to stop

LENGTHS, EFFORTS = ('mrad', 'mm'), ('N m', 'N')  # units of revolute and prismatic joints
Units = tuple[str, str]
Processes = dict[str, 'subprocess.Popen[bytes]']


class Load(NamedTuple):
    """A load for a robot with n joints."""

    link: str
    """Link that carries the load."""
    mass: float
    """Mass [kg]."""
    efforts: Floats
    """Efforts that hold the load in the start pose, shape (n,) [N m or N]."""
    deflection: Floats
    """Position errors that the load causes until the node knows it, shape (n,) [rad or m]."""

    def message(self, stamp: object) -> InertiaStamped:
        """Return the message that attaches the load to the link."""
        moment = self.mass * BOX**2 / 6.0
        x, y, z = GRIP
        inertia = Inertia(m=self.mass, com=Vector3(x=x, y=y, z=z))
        inertia.ixx = inertia.iyy = inertia.izz = moment
        return InertiaStamped(header=Header(stamp=stamp, frame_id=self.link), inertia=inertia)


class DemoRun(NamedTuple):
    """What was recorded in a run; times start with the motion."""

    robot: RobotModel
    load: Load
    times: Floats
    """Times of the joint states, shape (k,) [s]."""
    positions: Floats
    """Measured positions, shape (k, n) [rad or m]."""
    desired: Floats
    """Desired positions, shape (k, n) [rad or m]."""
    command_times: Floats
    """Time of the latest joint state when a command arrived, shape (m,) [s]."""
    commands: Floats
    """Efforts commanded by the node, shape (m, n) [N m or N]."""
    pause: float
    """Longest time between two joint states on the steady clock [s]."""


class Check(NamedTuple):
    """One line of the verdict."""

    name: str
    value: float
    limit: float
    unit: str
    is_least: bool = False
    """Whether ``limit`` is the smallest value that passes, instead of the largest."""

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        return self.value >= self.limit if self.is_least else self.value <= self.limit


# Preparation


def choose_load(robot: RobotModel, start: Floats) -> Load:
    """
    Choose a load that deflects a joint visibly and leaves every drive some effort.

    The load is on the outermost link that can carry 5 % of the mass of the robot, because even a
    few grams may be too much for a wrist without rotor inertia. If no link can carry so much, the
    load is on the link that can carry the most.
    """
    mass_matrix = InverseDynamics(robot).mass_matrix(start)
    require_inertia(robot, mass_matrix)
    alone = InverseDynamics(robot).gravity_efforts(start)
    largest = np.where(robot.is_prismatic_joint, DEFLECTION[1], DEFLECTION[0])
    best = Load('', 0.0, alone, alone)
    for link in _links_towards_base(robot):
        dynamics = InverseDynamics(robot)
        dynamics.set_payload(link, 1.0, GRIP)
        effort = dynamics.gravity_efforts(start) - alone  # of 1 kg
        deflection = np.linalg.solve(mass_matrix, effort) / KP
        bears = abs(effort) > 1e-9
        spare = 0.5 * np.maximum(robot.effort_limits - alone * np.sign(effort), 0.0)
        mass = min(
            HEAVIEST * float(robot.mass.sum()),
            float(np.min(spare[bears] / abs(effort[bears]), initial=math.inf)),
            float(np.min(largest / np.maximum(abs(deflection), 1e-9))),
        )
        mass = float(f'{mass:.2g}')  # a round number
        if mass > best.mass:
            best = Load(link, mass, mass * effort, np.asarray(mass * deflection))
        if best.mass >= LIGHTEST * robot.mass.sum():
            break
    if not best.mass:
        raise SimulationError('the drives are too weak to hold any load in the start pose')
    return best


def _links_towards_base(robot: RobotModel) -> list[str]:
    """Return one link per joint, from the hand towards the base."""
    link = last_link(robot)
    body = int(robot.link_body[robot.link_index(link)])
    inner = reversed(path_to(robot, body)[:-1])
    return [link, *(robot.link_names[np.flatnonzero(robot.link_body == b)[-1]] for b in inner)]


# Processes


@contextmanager
def running(commands: Mapping[str, Sequence[str]]) -> Iterator[Processes]:
    """
    Run child processes within a context; on exit, end the processes.

    ``commands`` maps the name of each process to the arguments of ``python -m`` that start the
    process.
    """
    processes: Processes = {}
    try:
        for name, command in commands.items():
            # Each child has its own session, so that Ctrl-C reaches only the parent.
            processes[name] = subprocess.Popen(
                [sys.executable, '-m', *command], start_new_session=True
            )
        yield processes
    finally:
        # All at once: without the node, the simulated robot would fall and report it.
        for process in processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in processes.values():
            try:
                process.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


# The run


class Commander(Node):
    """
    Sends the node a reference for every joint state, and records the motion.

    The reference rests until ``begins`` is True.
    """

    def __init__(self, robot: RobotModel, motion: Oscillation, load: Load, namespace: str) -> None:
        super().__init__('commander', namespace=namespace)
        self.begins = False
        """Whether the motion starts at the next joint state, or has started."""
        self.time = -math.inf
        """Time since the start of the motion [s]."""
        self._robot, self._motion, self._load = robot, motion, load
        self._began: int | None = None
        self._is_held = True
        self._states: list[tuple[float, Floats, Floats]] = []
        self._arrivals: list[float] = []  # of the joint states, on the steady clock
        self._commands: list[tuple[float, Floats]] = []
        self._reference = self.create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
        self._payloads = [
            (due, self.create_publisher(InertiaStamped, f'{node}/payload', 10))
            for due, node in ((LOADED, 'simulated_robot'), (TOLD, 'inverse_dynamics'))
        ]
        self.create_subscription(Bool, 'brakes', self._on_brakes, LATCHED)
        self.create_subscription(JointState, 'joint_states', self._on_state, BEST_EFFORT)
        # The queue is deep, because the commands are counted.
        self.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 1000
        )

    def is_ready(self) -> bool:
        """Return whether the robot follows the commands, and both processes receive loads."""
        publishers = [self._reference, *(publisher for _, publisher in self._payloads)]
        return not self._is_held and all(map(_is_heard, publishers))

    def has_reached(self, time: float) -> bool:
        """Return whether a joint state of this time or later has arrived [s]."""
        return self.time >= time

    def recorded(self) -> DemoRun:
        """Return what was recorded since the start of the motion."""
        times, positions, desired = map(np.array, zip(*self._states, strict=True))
        command_times, commands = map(np.array, zip(*self._commands, strict=True))
        recorded = times, positions, desired, command_times, commands
        pause = float(np.max(np.diff(self._arrivals)))
        return DemoRun(self._robot, self._load, *recorded, pause)

    def _on_brakes(self, message: Bool) -> None:
        self._is_held = message.data

    def _on_state(self, message: JointState) -> None:
        stamp = message.header.stamp
        if self.begins:
            now = Time.from_msg(stamp).nanoseconds
            self._began = now if self._began is None else self._began
            self.time = 1e-9 * (now - self._began)
        while self._payloads and self.time >= self._payloads[0][0]:
            self._payloads.pop(0)[1].publish(self._load.message(stamp))
        sample = self._motion.sample(max(self.time, 0.0))
        q, qd, qdd = (x.tolist() for x in sample)
        point = JointTrajectoryPoint(positions=q, velocities=qd, accelerations=qdd)
        names = self._robot.joint_names
        header = Header(stamp=stamp)
        self._reference.publish(JointTrajectory(header=header, joint_names=names, points=[point]))
        if self.begins:
            order = [message.name.index(name) for name in names]
            self._arrivals.append(time.monotonic())
            self._states.append((self.time, np.array(message.position)[order], sample[0]))

    def _on_command(self, message: Float64MultiArray) -> None:
        if self._began is not None:
            self._commands.append((self.time, np.array(message.data)))


def _is_heard(publisher: Any) -> bool:
    return bool(publisher.get_subscription_count())


def phases(load: Load) -> dict[float, str]:
    """Return what happens from which time on [s]."""
    return {
        0.0: 'the arm follows a reference',
        HOLDS: 'the arm holds its pose',
        LOADED: f'the arm gets {load.mass:g} kg, unknown to the node',
        TOLD: 'the payload is published',
    }


def run_demo(urdf: str, stopped: Callable[[], bool], say: Callable[[str], None]) -> DemoRun:
    """
    Run robot and node, and return what was recorded.

    ``stopped`` returns True if the user wants to stop; then raise KeyboardInterrupt. ``say`` is
    called with a sentence about each phase. Raise a `SimulationError` if the robot cannot be
    simulated, or if a process ends early.
    """
    robot = load_urdf(urdf)
    # The dynamics are compiled here, and the processes then load the code from the cache.
    dynamics = InverseDynamics(robot)
    start = start_pose(robot, dynamics)
    load = choose_load(robot, start)
    motion = plan(robot, dynamics, start, HOLDS)
    # In a namespace of its own, the demo reaches neither another demo nor a real robot.
    namespace = f'/demo_{os.getpid()}'
    with (
        running(_commands(urdf, namespace)) as processes,
        executing([], lambda: Commander(robot, motion, load, namespace)) as (commander, executor),
    ):

        def spin_until(is_done: Callable[[], bool]) -> None:
            deadline = time.monotonic() + TIMEOUT
            while not is_done():
                if stopped():
                    raise KeyboardInterrupt
                for name, process in processes.items():
                    if process.poll() is not None:
                        code = process.poll()
                        raise SimulationError(f'{name} ended early, with exit code {code}')
                if time.monotonic() > deadline:
                    raise SimulationError(
                        f'the simulated robot does not follow the node after {TIMEOUT:.0f} s'
                    )
                executor.spin_once(timeout_sec=0.05)

        spin_until(commander.is_ready)
        commander.begins = True
        for begin, text in phases(load).items():
            spin_until(partial(commander.has_reached, begin))
            say(f'{begin:4.1f} s: {text}')
        spin_until(partial(commander.has_reached, END))
    return commander.recorded()


def _commands(urdf: str, namespace: str) -> dict[str, list[str]]:
    """Map the name of each process to the arguments of ``python -m`` that start the process."""
    parameters = {
        'robot_description_file': f"'{urdf}'",
        'mode': 'computed_torque',
        'kp': str(KP),
        'kd': str(KD),
        'include_friction': 'false',
        # The simulated robot shares the machine with other processes, and may pause for a while.
        'state_timeout': '0.5',
    }
    ros = ['--ros-args', '-r', f'__ns:={namespace}']
    return {
        'the simulated robot': [
            *('inverse_dynamics_node.cli.main', 'simulate', urdf),
            *(*ros, '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *('inverse_dynamics_node.node.main', *ros),
            *(x for name, value in parameters.items() for x in ('-p', f'{name}:={value}')),
        ],
    }


# The verdict


def judge(run: DemoRun) -> list[Check]:
    """Compare a run with its limits."""
    robot, load = run.robot, run.load
    slides, errors = robot.is_prismatic_joint, 1e3 * abs(run.desired - run.positions)

    def largest(begin: float, end: float) -> Floats:
        return np.asarray(_between(errors, run.times, begin, end).max(axis=0))

    held = 1e3 * _between(run.positions, run.times, HOLDS + SETTLED, LOADED)
    deflected, expected = largest(LOADED + SETTLED, TOLD), 1e3 * abs(load.deflection)
    k = int(np.argmax(expected))
    arriving = _between(run.commands, run.command_times, TOLD, TOLD + SETTLED)
    steps = abs(np.diff(arriving, axis=0)).max(axis=0)
    # Joints of the same kind share a limit, because the load may bear on only one of them.
    needed = np.maximum(abs(load.efforts), LEAST_SHARE * abs(run.commands).max(axis=0))
    allowed = STEP_LIMIT * np.array([needed[slides == slide].max() for slide in slides])
    state_rate = 1.0 / np.median(np.diff(run.times))
    return [
        _worst(robot, 'error while the arm moves', largest(0.0, HOLDS), MOVING_LIMIT),
        _worst(robot, 'drift while the arm holds its pose', np.ptp(held, axis=0), REST_LIMIT),
        Check(
            'error with the load, before the payload is published',
            *(float(deflected[k]), LEAST_DEFLECTION * float(expected[k])),
            LENGTHS[int(slides[k])],
            is_least=True,
        ),
        _worst(
            robot,
            'error with the load, after the payload is published',
            largest(TOLD + SETTLED, END),
            REST_LIMIT,
        ),
        _worst(robot, 'step of an effort when the payload arrives', steps, allowed, EFFORTS),
        Check(
            'commands per second',
            len(run.commands) / float(run.times[-1]),
            RATE_LIMIT * float(state_rate),
            '',
            is_least=True,
        ),
    ]


def _worst(
    robot: RobotModel, name: str, values: Floats, limits: ArrayLike, units: Units = LENGTHS
) -> Check:
    """Return the check of the joint that is nearest to its limit, or farthest beyond it."""
    most = np.broadcast_to(np.asarray(limits, dtype=float), values.shape)
    k = int(np.argmax(values / most))
    return Check(name, float(values[k]), float(most[k]), units[int(robot.is_prismatic_joint[k])])


def _between(rows: Floats, times: Floats, begin: float, end: float) -> Floats:
    """Return the rows from ``begin`` to ``end`` [s]."""
    chosen = rows[(times >= begin) & (times < end)]
    if len(chosen) < 2:
        raise SimulationError(f'no messages arrived from {begin:g} to {end:g} s')
    return chosen


def longest_gap(run: DemoRun) -> float:
    """Return the longest time between two commands or two joint states [s]."""
    return float(np.max(np.diff(run.command_times), initial=run.pause))
