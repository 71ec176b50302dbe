"""
What acts on the robot from outside as time passes: payloads, pushes, gravity, the base's motion.

Payloads and gravity change in the course of a ramp, so that the efforts do not jump; pushes and
the base's motion count as they come, and go in good order. No ROS, and no clock: time comes in as
an argument.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.arguments import read_inertial, read_vector
from ..dynamics.inverse_dynamics import InverseDynamics, STANDARD_GRAVITY
from ..errors import ConfigurationError
from ..robot.model import Floats, join_bodies
from .settings import LoadSettings

STRONGEST = 500.0  # [m/s^2], [rad/s]; beyond fifty times gravity a sensor is broken
_ROUNDING = 1e-3  # of the moments of a flat body, as in a robot description
_LARGEST = 1e9  # [kg], [m], [kg m^2], [N], [N m]; sums and products of what is less are finite


class Payload(NamedTuple):
    """A rigid load on a link."""

    mass: float
    """[kg]."""
    com: Floats
    """Centre of mass in the link's frame, shape (3,) [m]."""
    inertia: Floats
    """About that, along the link's axes, shape (3, 3) [kg m^2]."""


NO_PAYLOAD = Payload(0.0, np.zeros(3), np.zeros((3, 3)))


class ExternalLoads:
    """
    Keeps the dynamics told of everything that acts on the robot from outside.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot; nobody else sets its payloads, wrenches, gravity and base.
    settings : LoadSettings
        May be replaced at any time.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2], at first.
    base_link : str
        Whose frame the base frame is: any link that no joint moves; empty for the root link.

    Raises
    ------
    ConfigurationError
        If gravity is not three finite numbers, or a joint moves the base link.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        settings: LoadSettings | None = None,
        gravity: ArrayLike = STANDARD_GRAVITY,
        base_link: str = '',
    ) -> None:
        self.dynamics = dynamics
        self._R_0B, self._p_0B = _base_pose(dynamics, base_link)
        self.settings = settings or LoadSettings()
        self.payloads: dict[str, Payload] = {}
        """What every link is said to carry, ramps apart."""
        self.include_gravity = True
        """Whether gravity, and what accelerates the base, count."""
        self.imu_time = -math.inf
        """When the motion of the base was last heard of [s]."""
        self._ramps: dict[str, tuple[Payload, Payload, float]] = {}
        self._wrenches: dict[str, tuple[Floats, Floats, float, float]] = {}
        self._gravity = self._target = read_vector('gravity', gravity, 'm/s^2')
        self._angular_velocity: Floats = np.zeros(3)
        self._is_base_lost = True
        self._time = math.inf
        self._write_base()

    def set_payload(
        self, now: float, link: str, mass: float, com: ArrayLike, inertia: ArrayLike
    ) -> bool:
        """
        Fasten a rigid load to a link in the course of a ramp, in place of any that it had.

        Parameters
        ----------
        now : float
            The time [s].
        link, mass, com, inertia
            As for `InverseDynamics.set_payload`; a mass of 0 takes the load off.

        Returns
        -------
        is_new : bool
            Whether the link is not said to carry just that already.

        Raises
        ------
        ConfigurationError
            If there is no such link, or no body has such a mass and inertia, or not within reason.

        """
        self.dynamics.link_index(link)
        load = _read_payload(mass, com, inertia)
        if _is_same(load, self.payloads.get(link, NO_PAYLOAD)):
            return False
        self._ramps[link] = self._payload(link, now), load, now
        self.payloads.pop(link, None)
        if load is not NO_PAYLOAD:
            self.payloads[link] = load
        return True

    def set_external_wrench(
        self, now: float, link: str, force: ArrayLike, moment: ArrayLike
    ) -> None:
        """
        Let the world push or pull a link, for as long as this is renewed.

        Parameters
        ----------
        now : float
            The time [s].
        link, force, moment
            As for `InverseDynamics.set_external_wrench`.

        Raises
        ------
        ConfigurationError
            If there is no such link, or one is not three finite numbers, or beyond reason.

        """
        self.dynamics.link_index(link)
        F, N = _sane('force', force, 'N', _LARGEST), _sane('moment', moment, 'N m', _LARGEST)
        self._wrenches[link] = F, N, now, 1.0
        self.dynamics.set_external_wrench(link, F, N)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """
        Let things fall another way, in the course of a ramp.

        Parameters
        ----------
        gravity : array_like, shape (3,)
            Free-fall acceleration in the base frame [m/s^2].

        Raises
        ------
        ConfigurationError
            If gravity is not three finite numbers, or beyond reason.

        """
        self._target = _sane('gravity', gravity, 'm/s^2')

    def set_base_motion(
        self, now: float, specific_force: ArrayLike, angular_velocity: ArrayLike
    ) -> bool:
        """
        Take in what an inertial measurement unit on the base says, from now on instead of gravity.

        Parameters
        ----------
        now : float
            The time [s].
        specific_force : array_like, shape (3,)
            Acceleration of the base less gravity, v_dot_0 - g, in the base frame [m/s^2].
        angular_velocity : array_like, shape (3,)
            omega_0, in the base frame [rad/s].

        Returns
        -------
        is_new : bool
            Whether this is the first for a while, so that the efforts may jump.

        Raises
        ------
        ConfigurationError
            If one is not three finite numbers, or beyond reason.

        """
        force = _sane('specific force', specific_force, 'm/s^2')
        turning = _sane('angular velocity', angular_velocity, 'rad/s')
        elapsed = now - self.imu_time
        is_new = self._is_base_lost or not 0.0 <= elapsed <= self.settings.imu_timeout
        cutoff = self.settings.imu_filter_cutoff
        share = 1.0 if is_new or not cutoff else -math.expm1(-2.0 * math.pi * cutoff * elapsed)
        self._gravity = self._gravity + share * (-force - self._gravity)
        self._angular_velocity = self._angular_velocity + share * (
            turning - self._angular_velocity
        )
        self._target = self._gravity
        self.imu_time, self._is_base_lost = now, False
        self._write_base()
        return is_new

    def is_base_known(self, now: float) -> bool:
        """Tell whether the motion of the base was heard of lately."""
        return 0.0 <= now - self.imu_time <= self.settings.imu_timeout

    def update(self, now: float) -> bool:
        """
        Let time pass: ramps go on, wrenches fade, what is lost is let go.

        Parameters
        ----------
        now : float
            The time [s].

        Returns
        -------
        has_jumped : bool
            Whether the motion of the base was lost just now, so that the efforts may jump.

        """
        elapsed = max(0.0, now - self._time)
        self._time = now
        for link in list(self._ramps):
            self._carry(link, now)
        for link in list(self._wrenches):
            self._fade(link, now)
        if self._gravity is not self._target:
            self._turn(elapsed)
        if self._is_base_lost or self.is_base_known(now):
            return False
        # Where down is, is best known from the last time it was known; how fast it turned is not.
        self._is_base_lost = True
        self._angular_velocity = np.zeros(3)
        self._write_base()
        return True

    def apply(self, settings: LoadSettings, include_gravity: bool) -> None:
        """Change the settings, and whether gravity counts, from now on."""
        self.settings = settings
        if include_gravity is not self.include_gravity:
            self.include_gravity = include_gravity
            self._write_base()

    def at_base_link(self, force: Floats, moment: Floats) -> tuple[Floats, Floats]:
        """Express a wrench about the root's origin in and about that of the base link."""
        R_B0 = self._R_0B.T
        return R_B0 @ force, R_B0 @ (moment - np.cross(self._p_0B, force))

    def continue_from(self, other: ExternalLoads) -> list[str]:
        """
        Take over all that another was told, at once.

        Parameters
        ----------
        other : ExternalLoads
            On another description of the robot.

        Returns
        -------
        dropped : list of str
            Links with payloads that this robot does not have.

        """
        dropped = []
        for link, load in other.payloads.items():
            if link in self.dynamics.robot.link_names:
                self.payloads[link] = load
                self.dynamics.set_payload(link, *load)
            else:
                dropped.append(link)
        for link, (F, N, time, _) in other._wrenches.items():
            if link in self.dynamics.robot.link_names:
                self.set_external_wrench(time, link, F, N)
        self._gravity, self._target = other._gravity, other._target
        self._angular_velocity, self.imu_time = other._angular_velocity, other.imu_time
        self._is_base_lost, self._time = other._is_base_lost, other._time
        self._write_base()
        return dropped

    @property
    def gravity(self) -> Floats:
        """Free-fall acceleration in the base frame as it counts now [m/s^2]."""
        return self._gravity

    def _payload(self, link: str, now: float) -> Payload:
        """Blend what was carried into what is."""
        if link not in self._ramps:
            return self.payloads.get(link, NO_PAYLOAD)
        old, new, start = self._ramps[link]
        if now < start:  # the clock was put back
            self._ramps[link] = old, new, now
        share = _share(now - start, self.settings.load_ramp)
        return _blend(old, new, share)

    def _carry(self, link: str, now: float) -> None:
        load = self._payload(link, now)
        if _share(now - self._ramps[link][2], self.settings.load_ramp) == 1.0:
            load = self._ramps.pop(link)[1]
        self.dynamics.set_payload(link, *load)

    def _fade(self, link: str, now: float) -> None:
        F, N, time, last_share = self._wrenches[link]
        if now < time:  # the clock was put back
            self._wrenches[link] = F, N, now, last_share
            return
        lost = now - time - self.settings.wrench_timeout
        share = 1.0 - _share(lost, self.settings.load_ramp) if lost > 0.0 else 1.0
        if share != last_share:
            self.dynamics.set_external_wrench(link, share * F, share * N)
            self._wrenches[link] = F, N, time, share
        if not share:
            del self._wrenches[link]

    def _turn(self, elapsed: float) -> None:
        """Take gravity a step towards where it is to go."""
        way = self._target - self._gravity
        distance = float(np.linalg.norm(way))
        step = -STANDARD_GRAVITY[2] * _share(elapsed, self.settings.load_ramp)
        if distance <= step or not self.settings.load_ramp:
            self._gravity = self._target
        else:
            self._gravity = self._gravity + (step / distance) * way
        self._write_base()

    def _write_base(self) -> None:
        weight = 1.0 if self.include_gravity else 0.0
        self.dynamics.set_gravity(self._R_0B @ (weight * self._gravity))
        self.dynamics.set_base_motion(self._R_0B @ self._angular_velocity)


def _base_pose(dynamics: InverseDynamics, base_link: str) -> tuple[Floats, Floats]:
    """Return the rotation from the base link's frame to the root's, and where its origin is."""
    robot = dynamics.robot
    if not base_link:
        return np.eye(3), np.zeros(3)
    still = [
        name for name, body in zip(robot.link_names, robot.link_body, strict=True) if not body
    ]
    if base_link not in still:
        raise ConfigurationError(
            f"base_link is '{base_link}', expected a link that no joint moves: {', '.join(still)}"
        )
    k = robot.link_names.index(base_link)
    return robot.link_rotation[k], robot.link_position[k]


def rotation_of(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation matrix of fixed-axis angles about x, y, z, as URDF has them [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _share(elapsed: float, ramp: float) -> float:
    return min(1.0, max(0.0, elapsed / ramp)) if ramp > 0.0 else 1.0


def _blend(one: Payload, other: Payload, share: float) -> Payload:
    """Make one body of a share of another, and of what is left of the first."""
    shares = (1.0 - share, one), (share, other)
    return Payload(*join_bodies([(s * x.mass, x.com, s * x.inertia) for s, x in shares]))


def _read_payload(mass: float, com: ArrayLike, inertia: ArrayLike) -> Payload:
    load = Payload(*read_inertial(mass, com, inertia))
    largest = max(load.mass, float(np.abs(load.com).max()), float(np.abs(load.inertia).max()))
    if largest > _LARGEST:
        raise ConfigurationError(
            f'payload has {largest:g} for its mass, centre of mass or inertia, expected at most '
            f'{_LARGEST:g} kg, m, kg m^2'
        )
    if not load.mass:
        return NO_PAYLOAD
    principal = np.linalg.eigvalsh(load.inertia)
    if principal[0] + principal[1] < principal[2] - _ROUNDING * np.sum(principal):
        moments = ', '.join(f'{moment:.3g}' for moment in principal)
        raise ConfigurationError(
            f'no body has this inertia: of its principal moments {moments} kg m^2 one exceeds the '
            'sum of the others'
        )
    # None below zero by rounding, for the sum of two such would be further below.
    return load._replace(inertia=load.inertia + max(0.0, -float(principal[0])) * np.eye(3))


def _is_same(one: Payload, other: Payload) -> bool:
    return (
        one.mass == other.mass
        and np.array_equal(one.com, other.com)
        and np.array_equal(one.inertia, other.inertia)
    )


def _sane(name: str, values: ArrayLike, unit: str, most: float = STRONGEST) -> Floats:
    vector = read_vector(name, values, unit)
    if np.abs(vector).max() > most:
        raise ConfigurationError(
            f'{name} is {values!r}, expected at most {most:g} {unit} in any direction'
        )
    return vector
