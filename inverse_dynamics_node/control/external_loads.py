"""
Applies payloads, wrenches, gravity and the motion of the base to the dynamics.

All loads take effect at once. `ExternalLoads.update` says whether the efforts may jump, so that
the caller can blend the change in. A wrench ends when its messages stop. When the messages about
the base stop, gravity keeps its last value.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.arguments import read_payload, read_vector
from ..dynamics.inverse_dynamics import InverseDynamics, STANDARD_GRAVITY
from ..errors import ConfigurationError, plain
from ..robot.model import Floats
from ..robot.rigid_body import RigidBody
from .filters import LowPass
from .settings import LARGEST_GRAVITY, Settings

IMU_TIMEOUT = 0.2
"""Time without IMU data after which the motion of the base counts as lost [s]."""
_IMU_CUTOFF = 20.0  # [Hz]; wheels vibrate
STRONGEST = 500.0  # [m/s^2], [rad/s]; an IMU that measures more is broken
# Gravity that a base turns at up to 2 rad/s, in messages at 20 Hz or faster, changes continuously.
_GRAVITY_RATE = 20.0  # [m/s^3]
_GRAVITY_PERIOD = 0.05  # [s]
_LARGEST_WRENCH = 1e9  # [N], [N m]; sums and products of smaller numbers are finite
NO_PAYLOAD = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


class ExternalLoads:
    """
    Tracks external loads, and applies the loads to the dynamics of a robot.

    Only this object may set the payloads, wrenches, gravity and base motion of ``dynamics``.
    ``gravity`` is the initial free-fall acceleration in the base frame, shape (3,) [m/s^2]. The
    base frame is the frame of ``base_link``, or of the root link if this name is empty. A
    ConfigurationError is raised unless gravity consists of three finite numbers. A
    ConfigurationError is also raised if the base link does not exist, or if a joint moves the base
    link.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        settings: Settings | None = None,
        gravity: ArrayLike = STANDARD_GRAVITY,
        base_link: str = '',
    ) -> None:
        self.dynamics = dynamics
        self._R_0B = _base_rotation(dynamics, base_link)
        self.settings = settings or Settings()
        self.payloads: dict[str, RigidBody] = {}
        """Payload of each loaded link."""
        self.include_gravity = True
        """Whether the efforts include gravity and the acceleration of the base."""
        self.imu_time = -math.inf
        """Time at which the motion of the base was last measured [s]."""
        self._wrench_times: dict[str, float] = {}  # arrival of the last wrench on each link [s]
        self._gravity_time = -math.inf  # arrival of the last message about gravity [s]
        self.gravity = read_vector('gravity', gravity, 'm/s^2')
        """Current free-fall acceleration in the base frame [m/s^2]."""
        self._angular_velocity: Floats = np.zeros(3)
        self._imu_filter = LowPass(np.zeros((2, 3)), _IMU_CUTOFF)  # gravity and angular velocity
        self._has_jumped = False  # whether a load that was set since `update` may move efforts
        self.needs_update = False
        """Whether a load was set, or may have to end, so that `update` has anything to do."""
        self._is_base_lost = True
        self._write_base()

    def set_payload(self, link: str, mass: float, com: ArrayLike, inertia: ArrayLike) -> bool:
        """
        Set the payload of a link; return False if the link already has this payload.

        The arguments are those of `InverseDynamics.set_payload`. A mass of 0 removes the payload.
        A ConfigurationError is raised if the link does not exist, if no rigid body can have this
        mass and inertia, or if a number is larger than 1e9.

        """
        self.dynamics.robot.link_index(link)
        payload = read_payload(mass, com, inertia)
        if not payload.mass:
            payload = NO_PAYLOAD
        last = self.payloads.get(link, NO_PAYLOAD)
        pairs: Any = zip(payload, last, strict=True)
        if all(np.array_equal(one, other) for one, other in pairs):
            return False
        self._note(may_jump=True)
        self.dynamics.set_payload(link, *payload)
        self.payloads.pop(link, None)
        if payload is not NO_PAYLOAD:
            self.payloads[link] = payload
        return True

    def set_external_wrench(
        self, now: float, link: str, force: ArrayLike, moment: ArrayLike
    ) -> bool:
        """
        Apply an external wrench to a link; a wrench that is not renewed ends.

        ``now`` is the time [s]. The other arguments are those of
        `InverseDynamics.set_external_wrench`. The result is true if the link had no recent wrench,
        so that efforts may jump. A ConfigurationError is raised unless the link exists and each
        vector consists of three numbers from -1e9 to 1e9.

        """
        self.dynamics.robot.link_index(link)
        F = _read_bounded('force', force, 'N', _LARGEST_WRENCH)
        N = _read_bounded('moment', moment, 'N m', _LARGEST_WRENCH)
        self.dynamics.set_external_wrench(link, F, N)
        age = now - self._wrench_times.get(link, -math.inf)
        self._wrench_times[link] = now
        is_new = not 0.0 <= age <= self.settings.wrench_timeout
        self._note(may_jump=is_new)
        return is_new

    def set_gravity(self, gravity: ArrayLike, now: float = -math.inf) -> None:
        """
        Set the free-fall acceleration in the base frame, shape (3,) [m/s^2].

        ``now`` is the time of a message about gravity [s]. Efforts do not jump if the change is as
        small as that between two messages while the base turns. A ConfigurationError is raised
        unless gravity consists of three numbers from -100 to 100.

        """
        last, elapsed = self.gravity, now - self._gravity_time
        self.gravity = _read_bounded('gravity', gravity, 'm/s^2', LARGEST_GRAVITY)
        self._gravity_time = now
        self._write_base()
        is_stream = 0.0 <= elapsed <= _GRAVITY_PERIOD
        largest = _GRAVITY_RATE * elapsed if is_stream else 0.0
        self._note(may_jump=float(np.linalg.norm(self.gravity - last)) > largest)

    def set_base_motion(
        self, now: float, specific_force: ArrayLike, angular_velocity: ArrayLike
    ) -> None:
        """
        Set the motion of the base from IMU data; the specific force replaces gravity.

        ``specific_force`` is v_dot_0 - g, the acceleration of the base minus gravity [m/s^2].
        ``angular_velocity`` is omega_0 [rad/s]. Both vectors are in the base frame. Efforts may
        jump if the motion was unknown or the filter restarted. A ConfigurationError is raised
        unless each vector consists of three numbers from -500 to 500.

        """
        force = _read_bounded('specific force', specific_force, 'm/s^2')
        turning = _read_bounded('angular velocity', angular_velocity, 'rad/s')
        was_lost = self._is_base_lost or not self.is_base_known(now)
        self._imu_filter.value = np.array([self.gravity, self._angular_velocity])
        sample = np.array([-force, turning])
        self.gravity, self._angular_velocity = self._imu_filter.update(
            now, sample, restarts=was_lost
        )
        self.imu_time, self._is_base_lost = now, False
        self._write_base()
        self._note(may_jump=was_lost)

    def is_base_known(self, now: float) -> bool:
        """Return whether the motion of the base was measured within the timeout."""
        return 0.0 <= now - self.imu_time <= IMU_TIMEOUT

    def update(self, now: float) -> bool:
        """
        End stale wrenches, and check whether the motion of the base is known.

        The result is true if efforts may jump because of a load that was set since the last call,
        a wrench that has ended, or the motion of the base if it has just become unknown.

        """
        has_jumped, self._has_jumped = self._has_jumped, False
        for link, time in list(self._wrench_times.items()):
            if now < time:  # the clock was set back
                self._wrench_times[link] = now
            elif now - time > self.settings.wrench_timeout:
                del self._wrench_times[link]
                self.dynamics.set_external_wrench(link, np.zeros(3), np.zeros(3))
                has_jumped = True
        self.needs_update = bool(self._wrench_times) or not self._is_base_lost
        if self._is_base_lost or self.is_base_known(now):
            return has_jumped
        # Keep the last known gravity, but assume that the base has stopped rotating.
        self._is_base_lost = True
        self._angular_velocity = np.zeros(3)
        self._write_base()
        return True

    def include(self, *, gravity: bool) -> None:
        """Include or exclude gravity and the acceleration of the base from now on."""
        if gravity is not self.include_gravity:
            self.include_gravity = gravity
            self._note(may_jump=True)
            self._write_base()

    @contextmanager
    def gravity_included(self, is_included: bool) -> Iterator[None]:
        """Include or exclude gravity and the acceleration of the base within this context."""
        if is_included is self.include_gravity:
            yield
            return
        self._write_gravity(is_included)
        try:
            yield
        finally:
            self._write_gravity(self.include_gravity)

    @property
    def gravity_at_root(self) -> Floats:
        """Current free-fall acceleration in the root frame [m/s^2]."""
        at_root: Floats = self._R_0B @ self.gravity
        return at_root

    def _note(self, *, may_jump: bool) -> None:
        self._has_jumped |= may_jump
        self.needs_update = True

    def _write_base(self) -> None:
        self._write_gravity(self.include_gravity)
        self.dynamics.set_base_motion(self._R_0B @ self._angular_velocity)

    def _write_gravity(self, is_included: bool) -> None:
        self.dynamics.set_gravity(float(is_included) * self.gravity_at_root)


def _base_rotation(dynamics: InverseDynamics, base_link: str) -> Floats:
    """Return the rotation from the base frame to the root frame."""
    robot = dynamics.robot
    if not base_link:
        return np.eye(3)
    fixed = [
        name for name, body in zip(robot.link_names, robot.link_body, strict=True) if not body
    ]
    if base_link not in fixed:
        raise ConfigurationError(
            f"base_link is '{base_link}', expected a link that no joint moves: {', '.join(fixed)}"
        )
    rotation: Floats = robot.link_rotation[robot.link_index(base_link)]
    return rotation


def _read_bounded(name: str, values: ArrayLike, unit: str, largest: float = STRONGEST) -> Floats:
    vector = read_vector(name, values, unit)
    if np.abs(vector).max() > largest:
        raise ConfigurationError(
            f'{name} is {plain(values)!r}, expected at most {largest:g} {unit} along each axis'
        )
    return vector
