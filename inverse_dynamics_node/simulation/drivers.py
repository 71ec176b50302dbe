"""The conventions of robot drivers, from the sources in doc/robots.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import enum
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from ..robot.model import Floats

if TYPE_CHECKING:
    from .mujoco import MujocoRobot


class Form(enum.Enum):
    """What a driver takes as a command."""

    EFFORTS = 'efforts in the order of the joints'
    """std_msgs/Float64MultiArray, as received by effort controllers of ros2_control."""
    NAMED_EFFORTS = 'efforts by name'
    """sensor_msgs/JointState."""
    MOTION = 'positions, velocities and efforts by name'
    """sensor_msgs/JointState, for drives with their own gains."""
    NONE = 'no commands'


_FIELDS = {
    Form.NAMED_EFFORTS: ('effort',),
    Form.MOTION: ('effort', 'position', 'velocity'),
}


@dataclass(frozen=True)
class Driver:
    """
    The conventions of a driver.

    By default, efforts are in N m or N, and the robot does not compensate gravity by itself.
    """

    form: Form = Form.EFFORTS
    compensates_gravity: bool = False
    """Whether the robot adds gravity efforts, and nothing else, to the commanded efforts."""
    measures_gravity: bool = True
    """Whether the measured efforts include the gravity efforts."""
    command_unit: float = 1.0
    """Commanded value that produces 1 N m or 1 N."""
    measured_unit: float = 1.0
    """Value that the driver reports for 1 N m or 1 N."""
    gains: tuple[float, float] = (0.0, 0.0)
    """
    Position and velocity gains of the drives, for an inertia of 1 kg m^2 or 1 kg.

    The simulation multiplies ``gains`` by the inertia of each joint in the start pose.
    """
    has_position_loop: bool = False
    """Whether the drives follow positions of their own, and add the efforts to that."""
    commands: str = 'forward_effort_controller/commands'
    """Topic of the commands."""
    joint_states: str = 'joint_states'
    """Topic of the joint states."""
    rate: float = 500.0
    """Rate of the joint states [Hz]."""
    has_clock: bool = False
    """Whether the driver belongs to a simulator, which publishes ``/clock``."""


IDEAL = Driver()
"""The driver of an ideal robot."""
_COMPLETE = 'inverse_dynamics/joint_commands'  # topic on which the node sends `Form.MOTION`
_AMPERE = 0.1  # [A/N m]; an example, because UR does not publish the value
_MILLIAMPERE = 1000.0 / 1.793  # [mA/N m]; for the large motors of an Interbotix wx250s

DRIVERS = {
    'franka_ros2': Driver(
        compensates_gravity=True, joint_states='franka/joint_states', rate=1000.0
    ),
    'ur': Driver(compensates_gravity=True, measured_unit=_AMPERE),
    'ur_torques': Driver(compensates_gravity=True, measures_gravity=False),
    'lbr_fri': Driver(
        Form.MOTION,
        compensates_gravity=True,
        gains=(150.0, 0.0),
        commands=_COMPLETE,
        joint_states='lbr/joint_states',
    ),
    'ros2_kortex': Driver(Form.NONE, measured_unit=-1.0, rate=1000.0),
    'openarm': Driver(Form.MOTION, gains=(150.0, 10.0), commands=_COMPLETE, rate=100.0),
    'dynamixel_current': Driver(command_unit=_MILLIAMPERE, measured_unit=_MILLIAMPERE, rate=100.0),
    'mujoco_ros2_control': Driver(rate=200.0, has_clock=True),
    'gz_ros2_control': Driver(commands='effort_controller/commands', rate=1000.0, has_clock=True),
    'beside_a_position_controller': Driver(
        gains=(150.0, 10.0), has_position_loop=True, rate=200.0
    ),
    'isaac_sim': Driver(Form.NAMED_EFFORTS, commands='joint_command', rate=100.0, has_clock=True),
}
"""
The simulated drivers, by the names of their parameter files in ``config/robots``.

Only ``ur_torques`` has no file of its own. It is a newer version of ``ur`` with
``use_currents_as_efforts: false``.
"""


class Command(NamedTuple):
    """A command to a driver; each array has one value per commanded joint, shape (m,)."""

    efforts: Floats
    """Commanded efforts [N m or N]."""
    positions: Floats | None = None
    """Commanded positions [rad or m] with `Form.MOTION` or a position loop, otherwise None."""
    velocities: Floats | None = None
    """Commanded velocities [rad/s or m/s] with `Form.MOTION` or a position loop, or None."""


def read_command(driver: Driver, joints: Sequence[str], message: Any) -> Command:
    """
    Convert a ROS message to a command for the given joints.

    `Driver.form` decides which type of message is expected. Raise a ValueError if a value is
    missing or not finite.
    """
    if driver.form is Form.EFFORTS:
        if len(message.data) != len(joints):
            raise ValueError(
                f'the message has {len(message.data)} efforts, expected {len(joints)}; to command '
                'some joints only, set the parameter joints of the simulated robot'
            )
        return Command(_finite('effort', message.data) / driver.command_unit)
    efforts, *motion = (_by_name(message, field, joints) for field in _FIELDS[driver.form])
    return Command(efforts / driver.command_unit, *motion)


def read_motion(joints: Sequence[str], message: Any) -> tuple[Floats, Floats]:
    """Return the positions and velocities of joints in a JointState, or raise a ValueError."""
    return _by_name(message, 'position', joints), _by_name(message, 'velocity', joints)


def _by_name(message: Any, field: str, joints: Sequence[str]) -> Floats:
    values = dict(zip(message.name, getattr(message, field), strict=False))
    missing = [joint for joint in joints if joint not in values]
    if missing:
        raise ValueError(f'the message has no {field} for {", ".join(missing)}')
    return _finite(field, [values[joint] for joint in joints])


def _finite(field: str, values: Any) -> Floats:
    array = np.array(values, float)
    if not np.isfinite(array).all():
        article = 'an' if field == 'effort' else 'a'
        raise ValueError(f'{article} {field} in the message is not finite')
    return array


class Actuation:
    """Applies commands and reports efforts according to the conventions of a driver."""

    def __init__(self, robot: MujocoRobot, driver: Driver) -> None:
        self.robot, self.driver = robot, driver
        self._index = robot.command_index
        self._state_index = [robot.state_names.index(name) for name in robot.command_names]
        inertia = robot.mass_matrix().diagonal()[self._index]
        self._kp, self._kd = (gain * inertia for gain in driver.gains)
        self.command = Command(np.zeros(len(self._index)))
        """The latest command, which `act` applies."""

    def with_gravity(self, efforts: Floats) -> Floats:
        """Return commanded efforts, shape (m,), plus gravity if the robot compensates it."""
        return efforts + self._gravity() if self.driver.compensates_gravity else efforts

    def act(self) -> None:
        """Apply the efforts that result from the latest command and the state of the robot."""
        efforts, positions, velocities = self.command
        efforts = self.with_gravity(efforts)
        if positions is not None and velocities is not None:
            efforts = efforts + self._kp * (positions - self.robot.positions()[self._index])
            efforts += self._kd * (velocities - self.robot.velocities()[self._index])
        self.robot.command(efforts)

    def measured(self, efforts: Floats) -> Floats:
        """Convert efforts, ordered as ``robot.state_names``, to values that the driver reports."""
        measured = efforts * self.driver.measured_unit
        if not self.driver.measures_gravity:
            measured[self._state_index] -= self.driver.measured_unit * self._gravity()
        return measured

    def _gravity(self) -> Floats:
        return self.robot.gravity_efforts()[self._index]
