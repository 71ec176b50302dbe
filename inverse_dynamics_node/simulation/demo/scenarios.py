"""
The scenarios of the demo, by name.

A scenario consists of settings for the node and for the simulated robot. A timeline is a scenario
prepared for one robot: a trajectory, events, and a function that judges the run.
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

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats
from ..mujoco.hardware import MujocoRobot
from ..mujoco.world import Tilt, TILT_DURATION
from ..trajectory import Oscillation, plan, Reference
from . import results
from .commander import History
from .demo_setup import DemoSetup, GRIP, KD, KP
from .results import REST_FRACTION, ScenarioResult

NODE, ROBOT = 'inverse_dynamics', 'simulated_robot'  # prefixes of topics
TILT = math.radians(30.0) * np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)  # [rad]
IMU_ORIENTATION = (0.2, -0.3, 1.1)  # [rad]: not aligned with the base, as on many real robots
LOST = 2.0  # [s]: time without joint states
SIMULATED_PERIOD = 0.002  # [s]: control period of the simulation without an IMU


@dataclass(frozen=True)
class Event:
    """An event of a run."""

    time: float
    """Time since the start of the motion [s]."""
    words: str
    """Description of the event."""
    messages: Mapping[str, Any]
    """Messages that cause the event, by topic."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """A scenario prepared for one robot."""

    trajectory: Reference
    """Desired motion of the joints."""
    check: Callable[[History], ScenarioResult]
    """Judges the history of a run."""
    events: tuple[Event, ...] = ()
    """Events, sorted by time."""
    begins: str = ''
    """Description of what happens before the first event."""
    note: str = ''
    """Line to print before the start."""
    expected: Callable[[Floats, Floats], Floats] | None = None
    """Maps times, shape (k,) [s], and positions, shape (k, n), to the true external efforts."""
    without: tuple[Floats, Floats] | None = None
    """Times, shape (k,) [s], and position errors, shape (k, n), simulated without an IMU."""


@dataclass(frozen=True)
class Scenario:
    """One kind of run."""

    summary: str
    """Description for the help text."""
    prepare: Callable[[DemoSetup], Timeline]
    """Prepares the scenario for one robot."""
    sends: str = 'reference'
    """Message that the commander sends: 'accelerations', 'reference', or '' for no message."""
    parameters: Mapping[str, str] = field(default_factory=dict)
    """Parameters of the node."""
    robot: tuple[str, ...] = ()
    """Options of the simulated robot."""
    least_duration: float = 10.0
    """Shortest permitted duration [s]."""


def standing(setup: DemoSetup) -> Oscillation:
    """Return a reference that keeps the arm still in its start pose."""
    zeros = np.zeros(len(setup.start))
    return Oscillation(setup.start, zeros, zeros + 1.0, setup.duration)


def hold(setup: DemoSetup) -> Timeline:
    """Prepare a run in which gravity compensation holds the start pose without a reference."""
    return Timeline(
        standing(setup),
        lambda history: results.check_hold(setup, history),
        begins='no reference: gravity compensation',
    )


def track(setup: DemoSetup) -> Timeline:
    """Prepare a run in which the arm moves and then rests."""
    moving = (1.0 - REST_FRACTION) * setup.duration
    trajectory = plan(setup.robot, setup.dynamics(), setup.start, moving)
    return Timeline(
        trajectory,
        lambda history: results.check_tracking(setup, history),
        begins='the arm follows a trajectory',
    )


def payload(setup: DemoSetup) -> Timeline:
    """Prepare a run in which the arm picks up a load before the node knows the load."""
    link, mass, inertia = setup.load()
    loaded = setup.dynamics()
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
    capacity = setup.capacity(link)
    most = f'{capacity:.2g} kg' if math.isfinite(capacity) else 'any mass'
    picked_up, sent = 0.3 * setup.duration, 0.6 * setup.duration
    return Timeline(
        plan(setup.robot, loaded, setup.start, setup.duration),
        lambda history: results.check_payload(setup, history, picked_up, sent),
        (
            Event(
                picked_up,
                f'{mass:g} kg at {link!r}, unknown to the node',
                {f'{ROBOT}/payload': load},
            ),
            Event(sent, 'the node receives the load', {f'{NODE}/payload': load}),
        ),
        'the arm follows a trajectory',
        note=f'load: {mass:g} kg at {link!r}, where the drives could hold {most}',
    )


def push(setup: DemoSetup) -> Timeline:
    """Prepare a run in which a force pushes a link for a while."""
    link, force = setup.push()
    began, ended = 0.3 * setup.duration, 0.6 * setup.duration
    x, y, z = force.tolist()
    header = Header(frame_id=link)
    pushed = WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=x, y=y, z=z)))

    def expected(times: Floats, q: Floats) -> Floats:
        is_pushed = (times >= began) & (times < ended)
        return np.asarray(is_pushed[:, np.newaxis] * setup.external_efforts(link, force, q))

    return Timeline(
        standing(setup),
        lambda history: results.check_push(setup, history, link, force, began, ended),
        (
            Event(
                began,
                f'a push of {np.linalg.norm(force):.3g} N on {link!r}',
                {f'{ROBOT}/push': pushed},
            ),
            Event(ended, 'the push ends', {f'{ROBOT}/push': WrenchStamped(header=header)}),
        ),
        'the arm stands still',
        expected=expected,
    )


def tilted(setup: DemoSetup) -> Timeline:
    """Prepare a run in which the base tilts and stays tilted."""
    began = 0.25 * setup.duration
    settled = began + TILT_DURATION + results.SETTLED
    without = held_without_imu(setup, began)
    attitude = Vector3Stamped(vector=Vector3(x=TILT[0], y=TILT[1], z=TILT[2]))
    return Timeline(
        standing(setup),
        lambda history: results.check_tilt(setup, history, settled, without),
        (
            Event(began, 'the base tilts by 30 degrees', {f'{ROBOT}/tilt': attitude}),
            Event(began + TILT_DURATION, 'the base stays tilted', {}),
        ),
        'the base is level',
        without=without,
    )


def held_without_imu(setup: DemoSetup, began: float) -> tuple[Floats, Floats]:
    """
    Simulate computed-torque control on a tilting base without an IMU; return times and errors.

    The base begins to tilt at the time ``began`` [s]. Times have shape (k,) [s], and position
    errors have shape (k, n) [rad or m].
    """
    simulated = MujocoRobot(setup.urdf, setup.robot, setup.start, friction=False)
    simulated.brakes_on = False
    dynamics = InverseDynamics(setup.robot)
    order = [simulated.state_names.index(name) for name in setup.robot.joint_names]
    tilt = Tilt()
    tilt.turn_to(TILT, began)
    times = np.arange(0.0, setup.duration, SIMULATED_PERIOD)
    errors = np.zeros((len(times), len(setup.start)))
    for time, error in zip(times, errors, strict=True):
        q, qd = (values[order] for values in simulated.state()[:2])
        error[:] = setup.start - q
        simulated.command(dynamics.efforts(q, qd, KP * error - KD * qd))
        simulated.world.set_base_motion(*tilt.motion(float(time)))
        simulated.advance(SIMULATED_PERIOD)
    return times, errors


def sensor_lost(setup: DemoSetup) -> Timeline:
    """Prepare a run in which the joint states stop and resume later."""
    lost = 0.3 * setup.duration
    back = lost + LOST
    sensors = f'{ROBOT}/sensors'
    return Timeline(
        standing(setup),
        lambda history: results.check_sensor_lost(setup, history, lost, back),
        (
            Event(lost, 'joint states stop, and the brakes engage', {sensors: Bool(data=False)}),
            Event(back, 'joint states resume', {sensors: Bool(data=True)}),
        ),
        'the arm stands still',
    )


COMPUTED_TORQUE = {'mode': 'computed_torque', 'kp': str(KP), 'kd': str(KD)}
# The simulated hardware shares the machine with other processes, and may pause for a while.
PATIENT = {'state_timeout': '0.5'}
SCENARIOS = {
    'track': Scenario(
        'follow a trajectory with resolved-acceleration control',
        track,
        'accelerations',
        least_duration=2.0,
    ),
    'hold': Scenario(
        'gravity compensation: the arm stays where it is',
        hold,
        '',
        {'mode': 'gravity_compensation', **PATIENT},
        least_duration=2.0,
    ),
    'payload': Scenario(
        'pick up a load: the error vanishes when the node receives the load on ~/payload',
        payload,
        parameters={**COMPUTED_TORQUE, **PATIENT},
    ),
    'push': Scenario(
        'push a link: the push appears in ~/external_efforts',
        push,
        parameters={**COMPUTED_TORQUE, **PATIENT},
    ),
    'tilt': Scenario(
        'tilt the base: the node uses an IMU to hold the arm still',
        tilted,
        parameters={
            **COMPUTED_TORQUE,
            **PATIENT,
            'base_motion': 'imu',
            'imu_orientation': str(list(IMU_ORIENTATION)),
        },
        robot=('--imu-orientation', *map(str, IMU_ORIENTATION)),
    ),
    'sensor-lost': Scenario(
        'stop the joint states for a while: the efforts ramp down to zero',
        sensor_lost,
        parameters=COMPUTED_TORQUE,
    ),
}
