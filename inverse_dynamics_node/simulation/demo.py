"""
The demo: the node moves a simulated robot, whose behaviour is then judged.

Three processes communicate over ROS topics: the command ``inverse_dynamics simulate``, the node,
and this process, the commander. The arm follows a reference under computed torque, and holds its
pose. Then it gets a load, which the node does not know at first and later receives as a payload.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import ctypes
import gc
import math
import random
import signal
import socket
import subprocess
import sys
import time
from typing import NamedTuple

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
import numpy as np
from numpy.typing import ArrayLike
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.kinematics import last_link, path_to
from ..robot.model import Floats, RobotModel
from ..robot.urdf import load_urdf
from ..ros.middleware import BEST_EFFORT, start_ros
from .mujoco import require_inertia, SimulationError
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
NUDGE = 0.003  # [rad or m]: distance of the held robot from the reference
BOX, GRIP = 0.1, (0.0, 0.0, 0.05)  # [m]: side and centre of the load, a cube
START_TIMEOUT, SILENCE_TIMEOUT, STOP_TIMEOUT = 60.0, 5.0, 5.0  # [s]
LOCK_PORT = 32768  # domain_coordinator reserves a domain by binding to the port LOCK_PORT + domain
PR_SET_PDEATHSIG = 1  # option of Linux's prctl(2)

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


def nudge(robot: RobotModel) -> Floats:
    """
    Return the distances from the pose of the held robot to the reference, shape (n,) [rad or m].

    When the robot has moved to the reference, it follows the commands of the node.
    """
    return np.minimum(NUDGE, 0.01 * (robot.upper - robot.lower))


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
    process. The kernel ends the processes if this process is killed.
    """
    processes: Processes = {}
    try:
        for name, command in commands.items():
            # Each child has its own session, so that Ctrl-C reaches only the parent.
            processes[name] = subprocess.Popen(
                [sys.executable, '-m', *command],
                start_new_session=True,
                preexec_fn=_end_with_parent if sys.platform == 'linux' else None,
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


def _end_with_parent() -> None:
    """Let the kernel end this process when the parent ends, even if the parent is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


@contextmanager
def unused_domain() -> Iterator[int]:
    """
    Reserve a ROS domain from 1 to 100 that no other process on this machine uses.

    Within the context, other demos avoid this domain, and so do tests with domain_coordinator.
    The messages of the demo must not reach the nodes of a real robot.
    """
    for domain in random.sample(range(1, 101), 100):
        participant = 7400 + 250 * domain + 10  # unicast discovery port by DDSI-RTPS 9.6.1
        with (
            socket.socket(socket.AF_INET, socket.SOCK_STREAM) as reservation,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
        ):
            try:
                reservation.bind(('', LOCK_PORT + domain))
                probe.bind(('127.0.0.1', participant))
            except OSError:
                continue
            probe.close()
            yield domain
            return
    raise SimulationError('all ROS domains from 1 to 100 are in use')


# The run


class Commander(Node):
    """
    Sends the node a reference for every joint state, and records the motion.

    The reference rests until `begin` is called.
    """

    def __init__(self, robot: RobotModel, motion: Oscillation, load: Load) -> None:
        super().__init__('commander')
        self.time = -math.inf
        """Time since the start of the motion [s]."""
        self.last_state = math.inf
        """Time of the latest joint state on the steady clock [s]."""
        self.pause = 0.0
        """Longest time between two joint states since the start of the motion [s]."""
        self.is_followed = False
        """Whether the robot has left the pose in which it was held, and reached the reference."""
        self._robot, self._motion, self._load = robot, motion, load
        self._began: int | None = None
        self._begins = False
        self._states: list[tuple[float, Floats, Floats]] = []
        self._commands: list[tuple[float, Floats]] = []
        self._reference = self.create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
        self._point = JointTrajectoryPoint()
        self._message = JointTrajectory(joint_names=robot.joint_names, points=[self._point])
        self._payloads = [
            (due, self.create_publisher(InertiaStamped, f'{node}/payload', 10))
            for due, node in ((LOADED, 'simulated_robot'), (TOLD, 'inverse_dynamics'))
        ]
        self.create_subscription(JointState, 'joint_states', self._on_state, BEST_EFFORT)
        # The queue is deep, because the commands are counted.
        self.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 1000
        )

    def begin(self) -> None:
        """Start the motion at the next joint state."""
        self._begins = True

    def is_connected(self) -> bool:
        """Return whether the simulated robot and the node receive loads and references."""
        publishers = [self._reference, *(publisher for _, publisher in self._payloads)]
        return all(publisher.get_subscription_count() for publisher in publishers)

    def recorded(self) -> DemoRun:
        """Return what was recorded since the start of the motion."""
        times, positions, desired = map(np.array, zip(*self._states, strict=True))
        command_times, commands = map(np.array, zip(*self._commands, strict=True))
        recorded = times, positions, desired, command_times, commands
        return DemoRun(self._robot, self._load, *recorded, self.pause)

    def _on_state(self, message: JointState) -> None:
        steady = time.monotonic()
        if self._begins:
            self.pause = max(self.pause, steady - self.last_state)
        self.last_state = steady
        order = [message.name.index(name) for name in self._robot.joint_names]
        q = np.array(message.position)[order]
        stamp = message.header.stamp
        if self._begins:
            now = Time.from_msg(stamp).nanoseconds
            self._began = now if self._began is None else self._began
            self.time = 1e-9 * (now - self._began)
        while self._payloads and self.time >= self._payloads[0][0]:
            self._payloads.pop(0)[1].publish(self._load.message(stamp))
        sample = self._motion.sample(max(self.time, 0.0))
        point = self._point
        point.positions, point.velocities, point.accelerations = (x.tolist() for x in sample)
        self._message.header.stamp = stamp
        self._reference.publish(self._message)
        self.is_followed |= bool((abs(q - sample[0]) <= 0.3 * nudge(self._robot)).all())
        if self._begins:
            self._states.append((self.time, q, sample[0]))

    def _on_command(self, message: Float64MultiArray) -> None:
        if self._began is not None:
            self._commands.append((self.time, np.array(message.data)))


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
    motion = plan(robot, dynamics, start + nudge(robot), HOLDS)
    with running(_commands(urdf)) as processes:
        start_ros([])
        commander = Commander(robot, motion, load)
        executor = EventsExecutor()
        executor.add_node(commander)
        try:
            _perform(commander, load, executor, processes, stopped, say)
        finally:
            executor.remove_node(commander)
            executor.shutdown()
            commander.destroy_node()
            rclpy.shutdown()
    return commander.recorded()


def _commands(urdf: str) -> dict[str, list[str]]:
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
    return {
        'the simulated robot': [
            *('inverse_dynamics_node.cli.main', 'simulate', urdf),
            *('--ros-args', '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *('inverse_dynamics_node.node.main', '--ros-args'),
            *(x for name, value in parameters.items() for x in ('-p', f'{name}:={value}')),
        ],
    }


def _perform(
    commander: Commander,
    load: Load,
    executor: EventsExecutor,
    processes: Processes,
    stopped: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Wait until the robot follows the commands, and run the motion."""

    def spin() -> None:
        if stopped():
            raise KeyboardInterrupt
        for name, process in processes.items():
            if process.poll() is not None:
                raise SimulationError(f'{name} ended early, with exit code {process.poll()}')
        executor.spin_once(timeout_sec=0.05)

    # Garbage collection of the objects of the libraries would take 0.1 s each time.
    gc.collect()
    gc.freeze()
    deadline = time.monotonic() + START_TIMEOUT
    while not (commander.is_followed and commander.is_connected()):
        if time.monotonic() > deadline:
            raise SimulationError(
                f'the simulated robot does not follow the node after {START_TIMEOUT:.0f} s'
            )
        spin()
    phases = [
        (0.0, 'the arm follows a reference'),
        (HOLDS, 'the reference rests, and the arm holds its pose'),
        (
            LOADED,
            f'the arm gets {load.mass:g} kg on {load.link!r}; the node does not know the load',
        ),
        (TOLD, 'the load is published on the topic ~/payload of the node'),
    ]
    commander.begin()
    while commander.time < END:
        spin()
        while phases and commander.time >= phases[0][0]:
            say('{:4.1f} s: {}'.format(*phases.pop(0)))
        if time.monotonic() > commander.last_state + SILENCE_TIMEOUT:
            raise SimulationError('the simulated robot has stopped sending joint states')


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
