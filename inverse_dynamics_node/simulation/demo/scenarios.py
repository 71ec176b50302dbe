"""
The scenarios of the demo, by name.

A scenario defines the settings of the node and the kind of reference that it gets. A timeline,
prepared for one robot, defines the trajectory, the events with their times, and the verdict.
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
from numpy.typing import ArrayLike
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
IMU_ORIENTATION = (0.2, -0.3, 1.1)  # [rad]: askew, as on a real robot
LOST = 2.0  # [s] without joint states
SIMULATED_PERIOD = 0.002  # [s] of the calculation without an IMU


@dataclass(frozen=True)
class Event:
    """An event: its time [s], its description, and the messages that cause it, by topic."""

    time: float
    words: str
    messages: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Timeline:
    """
    A scenario prepared for one robot.

    Attributes
    ----------
    trajectory : Reference
        Desired motion of the joints.
    check : callable
        Returns the `ScenarioResult` for a `History`.
    events : tuple of Event
        Events, sorted by time.
    begins : str
        Description of the time before the first event.
    note : str
        A line to print before the start.
    expected : callable or None
        Returns the external efforts that the node should find, for times of shape (k,) and
        positions of shape (k, n).
    without : tuple of two ndarrays, or None
        Times [s], shape (k,), and simulated errors without the IMU, shape (k, n).

    """

    trajectory: Reference
    check: Callable[[History], ScenarioResult]
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
        Description for the help text.
    prepare : callable
        Returns the `Timeline` for a `DemoSetup`.
    sends : str
        Message that the commander sends: 'accelerations', 'reference', or '' for none.
    parameters : mapping of str to str
        Parameters of the node.
    robot : tuple of str
        Options of the simulated robot.
    least_duration : float
        Shortest duration that is long enough for all events [s].

    """

    summary: str
    prepare: Callable[[DemoSetup], Timeline]
    sends: str = 'reference'
    parameters: Mapping[str, str] = field(default_factory=dict)
    robot: tuple[str, ...] = ()
    least_duration: float = 10.0


def standing(setup: DemoSetup) -> Oscillation:
    """Return the motion of an arm that stands in its start pose."""
    zeros = np.zeros(len(setup.start))
    return Oscillation(setup.start, zeros, zeros + 1.0, setup.duration)


def hold(setup: DemoSetup) -> Timeline:
    """Hold the start pose without a reference."""
    return Timeline(
        standing(setup),
        lambda history: results.check_hold(setup, history),
        begins='no reference: gravity compensation',
    )


def track(setup: DemoSetup) -> Timeline:
    """Move, then rest."""
    moving = (1.0 - REST_FRACTION) * setup.duration
    trajectory = plan(setup.robot, setup.dynamics(), setup.start, moving)
    return Timeline(
        trajectory,
        lambda history: results.check_tracking(setup, history),
        begins='the arm follows a trajectory',
    )


def payload(setup: DemoSetup) -> Timeline:
    """Pick up a load during the motion, and send it to the node later."""
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
    """Push a link for a while."""
    link, force = setup.push()
    began, ended = 0.3 * setup.duration, 0.6 * setup.duration
    x, y, z = force.tolist()
    header = Header(frame_id=link)
    pushed = WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=x, y=y, z=z)))

    def expected(times: Floats, q: Floats) -> Floats:
        is_pushed = (times >= began) & (times < ended)
        efforts: Floats = is_pushed[:, np.newaxis] * setup.external_efforts(link, force, q)
        return efforts

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
    """Tilt the base, and keep it tilted."""
    began = 0.25 * setup.duration
    settled = began + TILT_DURATION + results.SETTLED
    without = held_without_imu(setup, TILT, began)
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


def held_without_imu(setup: DemoSetup, attitude: ArrayLike, began: float) -> tuple[Floats, Floats]:
    """
    Hold an arm by computed torque on a tilting base without an IMU.

    Parameters
    ----------
    setup : DemoSetup
        The robot, its pose and the duration.
    attitude : array_like, shape (3,)
        Final rotation vector of the base from level [rad].
    began : float
        Time at which the base begins to tilt [s].

    Returns
    -------
    times : ndarray, shape (k,)
        Times [s].
    errors : ndarray, shape (k, n)
        Position errors of the joints [rad or m].

    """
    simulated = MujocoRobot(setup.urdf, setup.robot, setup.start, friction=False)
    simulated.brakes_on = False
    dynamics = InverseDynamics(setup.robot)
    order = [simulated.state_names.index(name) for name in setup.robot.joint_names]
    tilt = Tilt()
    tilt.turn_to(attitude, began)
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
    """Stop the joint states, and resume them later."""
    lost = 0.3 * setup.duration
    back = lost + LOST
    sensors = f'{ROBOT}/sensors'
    return Timeline(
        standing(setup),
        lambda history: results.check_sensor_lost(setup, history, lost, back),
        (
            Event(lost, 'joint states stop, brakes go on', {sensors: Bool(data=False)}),
            Event(back, 'joint states resume', {sensors: Bool(data=True)}),
        ),
        'the arm stands still',
    )


COMPUTED_TORQUE = {'mode': 'computed_torque', 'kp': str(KP), 'kd': str(KD)}
# The simulated hardware shares the machine with other processes and may pause for longer than real
# hardware does.
PATIENT = {'state_timeout': '0.5'}
SCENARIOS = {
    'track': Scenario(
        'follow a trajectory by resolved accelerations', track, 'accelerations', least_duration=2.0
    ),
    'hold': Scenario(
        'gravity compensation: the arm stays where it is',
        hold,
        '',
        {'mode': 'gravity_compensation', **PATIENT},
        least_duration=2.0,
    ),
    'payload': Scenario(
        'pick up a load: the error vanishes when the node receives it on ~/payload',
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
        'stop the joint states for a while: efforts ramp to zero',
        sensor_lost,
        parameters=COMPUTED_TORQUE,
    ),
}
