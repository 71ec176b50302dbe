"""Settings of the controller and of the external loads."""

from __future__ import annotations

from dataclasses import dataclass, fields
import enum
import math

import numpy as np

from ..errors import ConfigurationError
from ..robot.model import Floats


class Mode(enum.Enum):
    """How the commanded accelerations are chosen."""

    INVERSE_DYNAMICS = 'inverse_dynamics'
    """Accelerations of the reference."""
    COMPUTED_TORQUE = 'computed_torque'
    """Accelerations of the reference, with feedback of its positions and velocities."""
    GRAVITY_COMPENSATION = 'gravity_compensation'
    """Zero accelerations at zero velocity; the reference is ignored."""


class StalePolicy(enum.Enum):
    """What to do with the efforts when the joint state is lost."""

    ZERO = 'zero'
    """Ramp them down to zero."""
    HOLD = 'hold'
    """Keep the last ones: for an arm that would fall, if its sensors can be trusted."""


PerJoint = float | tuple[float, ...]
"""One number for all commanded joints, or one for each."""


@dataclass(frozen=True)
class Settings:
    """How the controller treats its inputs and outputs. Times in [s]."""

    mode: Mode = Mode.INVERSE_DYNAMICS
    state_timeout: float = 0.1
    """A state of a commanded joint older than this is lost."""
    uncommanded_state_timeout: float = 1.0
    """A joint that is not commanded and was last reported longer ago is taken to be at rest."""
    reference_timeout: float = 0.5
    """A reference older than this is ignored; 0: a reference holds until the next."""
    on_stale_state: StalePolicy = StalePolicy.ZERO
    start_ramp: float = 0.5
    """Time for the efforts to rise from zero to their full values, and for blends."""
    stop_ramp: float = 0.5
    """Time for the efforts to fall from their full values to zero."""
    stop_damping: float = 0.0
    """Rate at which motion decays during a stop [1/s]; 0: not damped. See `StopDamping`."""
    stop_timeout: float = 20.0
    """Longest time of this damping, which fades within `stop_ramp` then."""
    kp: PerJoint = 100.0
    """Position gain of computed torque [1/s^2]."""
    kd: PerJoint = 20.0
    """Velocity gain of computed torque [1/s]."""
    max_position_jump: float = 0.5
    """
    Computed torque: largest distance of a new reference from the measured position, and largest
    step of a reference [rad or m]; 0: unlimited.
    """
    velocity_filter_cutoff: float = 0.0
    """Cutoff of the first-order low-pass for measured velocities [Hz]; 0: no filter."""
    effort_scale: PerJoint = 1.0
    """Factor for the computed efforts."""
    effort_offset: PerJoint = 0.0
    """Added after scaling [N m or N]."""
    use_urdf_effort_limits: bool = True
    """Whether the efforts stay within the limits in the robot description."""
    effort_limits: PerJoint = math.inf
    """Tighter limits [N m or N]."""
    effort_rate_limits: PerJoint = math.inf
    """Fastest change of an effort [N m/s or N/s]."""

    def expanded(self, m: int) -> dict[str, Floats]:
        """Return the settings per joint by name, each of shape (m,); see `expand_per_joint`."""
        return {
            field.name: expand_per_joint(field.name, getattr(self, field.name), m)
            for field in fields(self)
            if field.type == 'PerJoint'
        }


LARGEST_GRAVITY = 100.0
"""[m/s^2]; ten times that of the earth."""


@dataclass(frozen=True)
class LoadSettings:
    """How fast external loads change. Times in [s]."""

    load_ramp: float = 0.5
    """
    Time in which a payload is ramped in, gravity changes by 9.8 m/s^2, or a lost external wrench
    fades out.
    """
    wrench_timeout: float = 0.1
    """An external wrench that is not renewed for this long fades out."""
    imu_timeout: float = 0.2
    """A motion of the base older than this is lost."""
    imu_filter_cutoff: float = 20.0
    """Cutoff of the first-order low-pass for the motion of the base [Hz]; 0: no filter."""


def expand_per_joint(name: str, values: PerJoint, m: int) -> Floats:
    """
    Return one number per commanded joint.

    Parameters
    ----------
    name : str
        Name of the setting, for the message.
    values : float or tuple of float
        One number for all joints, or one for each.
    m : int
        Number of commanded joints.

    Returns
    -------
    numbers : ndarray, shape (m,)

    Raises
    ------
    ConfigurationError
        If the number of values is neither 1 nor m.

    """
    numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if numbers.shape not in ((1,), (m,)):
        raise ConfigurationError(
            f'{name} has {numbers.size} numbers, expected one, or one for each of {m} joints'
        )
    return np.array(np.broadcast_to(numbers, (m,)))
