"""
What can happen to the robot in a demo: scenarios by name, as data.

A scenario says how the node is set up and what to ask of it. Its script, made for one robot, says
what happens when, and how to judge the outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from geometry_msgs.msg import (
    Inertia,
    InertiaStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
import numpy as np
from std_msgs.msg import Bool, Header

from ...robot.model import Floats
from .. import tilt
from ..trajectory import plan, Trajectory
from . import verdicts
from .history import History
from .stage import (
    GRIP,
    KD,
    KP,
    Stage,
)
from .verdicts import Verdict
from .without_imu import held_without_imu

NODE, ROBOT = 'inverse_dynamics', 'simulated_robot'  # whose topics
TILT = math.radians(30.0) * np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)  # [rad]
IMU_ORIENTATION = (0.2, -0.3, 1.1)  # [rad]: nobody mounts one straight
LOST = 2.0  # [s] without joint states
REST = 0.2  # share of the duration; its second half is judged


@dataclass(frozen=True)
class Event:
    """Something that happens: when [s], in words, and the messages by topic that make it so."""

    time: float
    words: str
    messages: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Script:
    """
    What happens to one robot.

    Attributes
    ----------
    trajectory : Trajectory
        Where the joints should be.
    judge : callable
        Takes what happened, returns a `Verdict`.
    events : tuple of Event
        In the order of their times.
    begins : str
        What is going on at first.
    note : str
        A line to print before the start.
    expected : callable or None
        External efforts that should be found, for times and positions of shapes (k,) and (k, n).
    without : tuple of two ndarrays, or None
        Times [s], shape (k,), and errors that a lesser node would have made, shape (k, n).

    """

    trajectory: Trajectory
    judge: Callable[[History], Verdict]
    events: tuple[Event, ...] = ()
    begins: str = ''
    note: str = ''
    expected: Callable[[Floats, Floats], Floats] | None = None
    without: tuple[Floats, Floats] | None = None


@dataclass(frozen=True)
class Scenario:
    """
    One kind of run.

    Attributes
    ----------
    summary : str
        What it shows.
    prepare : callable
        Makes a `Script` for a `Stage`.
    asks_for : str
        What the commander sends: 'accelerations', 'reference' or nothing.
    parameters : mapping of str to str
        Of the node.
    robot : tuple of str
        Options of the simulated robot.
    least_duration : float
        Shorter it makes no sense [s].

    """

    summary: str
    prepare: Callable[[Stage], Script]
    asks_for: str = 'reference'
    parameters: Mapping[str, str] = field(default_factory=dict)
    robot: tuple[str, ...] = ()
    least_duration: float = 10.0


def _standing(stage: Stage) -> Trajectory:
    zeros = np.zeros(len(stage.start))
    return Trajectory(stage.start, zeros, zeros + 1.0, stage.duration)


def hold(stage: Stage) -> Script:
    """Nothing happens at all."""
    return Script(
        _standing(stage),
        lambda history: verdicts.judge_hold(stage, history),
        begins='nobody asks for anything: gravity is compensated',
    )


def track(stage: Stage) -> Script:
    """Move, and rest; judged by the demo, joint by joint."""
    moving = (1.0 - REST) * stage.duration
    trajectory = plan(stage.robot, stage.dynamics(), stage.start, moving)
    return Script(
        trajectory,
        lambda history: verdicts.judge_hold(stage, history),
        begins='the arm follows a trajectory',
    )


def payload(stage: Stage) -> Script:
    """Pick up a load on the way, and tell the node later."""
    link, mass, inertia = stage.load()
    loaded = stage.dynamics()
    loaded.set_payload(link, mass, GRIP, inertia)
    load = InertiaStamped(
        header=Header(frame_id=link),
        inertia=Inertia(
            m=mass,
            com=Vector3(x=GRIP[0], y=GRIP[1], z=GRIP[2]),
            ixx=float(inertia[0, 0]),
            iyy=float(inertia[1, 1]),
            izz=float(inertia[2, 2]),
        ),
    )
    capacity = stage.capacity(link)
    most = f'{capacity:.2g} kg' if math.isfinite(capacity) else 'any mass'
    picked_up, told = 0.3 * stage.duration, 0.6 * stage.duration
    return Script(
        plan(stage.robot, loaded, stage.start, stage.duration),
        lambda history: verdicts.judge_payload(stage, history, picked_up, told),
        (
            Event(
                picked_up,
                f'{mass:g} kg at {link!r}; the node does not know',
                {f'{ROBOT}/payload': load},
            ),
            Event(told, 'the node is told of the load', {f'{NODE}/payload': load}),
        ),
        'the arm follows a trajectory',
        note=f'load: {mass:g} kg at {link!r}, where the drives could hold {most}',
    )


def push(stage: Stage) -> Script:
    """Push for a while."""
    link, force = stage.push()
    began, ended = 0.3 * stage.duration, 0.6 * stage.duration
    x, y, z = force.tolist()
    header = Header(frame_id=link)
    pushed = WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=x, y=y, z=z)))

    def expected(times: Floats, q: Floats) -> Floats:
        is_pushed = (times >= began) & (times < ended)
        efforts: Floats = is_pushed[:, np.newaxis] * stage.external_efforts(link, force, q)
        return efforts

    return Script(
        _standing(stage),
        lambda history: verdicts.judge_push(stage, history, link, force, began, ended),
        (
            Event(
                began,
                f'somebody pushes {link!r} with {np.linalg.norm(force):.3g} N',
                {f'{ROBOT}/push': pushed},
            ),
            Event(ended, 'nobody pushes', {f'{ROBOT}/push': WrenchStamped(header=header)}),
        ),
        'the arm stands',
        expected=expected,
    )


def tilted(stage: Stage) -> Script:
    """Tilt the base, and leave it so."""
    began = 0.25 * stage.duration
    settled = began + tilt.DURATION + verdicts.SETTLED
    without = held_without_imu(stage, TILT, began)
    attitude = Vector3Stamped(vector=Vector3(x=TILT[0], y=TILT[1], z=TILT[2]))
    return Script(
        _standing(stage),
        lambda history: verdicts.judge_tilt(stage, history, settled, without),
        (
            Event(began, 'the base tilts by 30 degrees', {f'{ROBOT}/tilt': attitude}),
            Event(began + tilt.DURATION, 'the base stands tilted', {}),
        ),
        'the arm stands on level ground',
        without=without,
    )


def sensor_lost(stage: Stage) -> Script:
    """Joint states stop, and come back."""
    lost = 0.3 * stage.duration
    back = lost + LOST
    sensors = f'{ROBOT}/sensors'
    return Script(
        _standing(stage),
        lambda history: verdicts.judge_sensor_lost(stage, history, lost, back),
        (
            Event(lost, 'joint states stop, brakes go on', {sensors: Bool(data=False)}),
            Event(back, 'joint states are back', {sensors: Bool(data=True)}),
        ),
        'the arm stands',
    )


_COMPUTED_TORQUE = {'mode': 'computed_torque', 'kp': str(KP), 'kd': str(KD)}
# The simulated hardware shares the machine with all else that runs there: it may stall for longer
# than real hardware does.
_PATIENT = {'state_timeout': '0.5'}
SCENARIOS = {
    'track': Scenario(
        'follow a trajectory by resolved accelerations', track, 'accelerations', least_duration=2.0
    ),
    'hold': Scenario(
        'gravity compensation: the arm stays where it is',
        hold,
        '',
        {'mode': 'gravity_compensation', **_PATIENT},
        least_duration=2.0,
    ),
    'payload': Scenario(
        'pick up a load: an error that goes when the node is told',
        payload,
        parameters={**_COMPUTED_TORQUE, **_PATIENT},
    ),
    'push': Scenario(
        'a push by hand, and how the node feels it',
        push,
        parameters={**_COMPUTED_TORQUE, **_PATIENT},
    ),
    'tilt': Scenario(
        'the base tilts, an IMU tells the node',
        tilted,
        parameters={
            **_COMPUTED_TORQUE,
            **_PATIENT,
            'base_motion': 'imu',
            'imu_orientation': str(list(IMU_ORIENTATION)),
        },
        robot=('--imu-orientation', *map(str, IMU_ORIENTATION)),
    ),
    'sensor-lost': Scenario(
        'joint states stop for a while', sensor_lost, parameters=_COMPUTED_TORQUE
    ),
}
