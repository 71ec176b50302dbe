"""A robot and everything that acts on it, as the table that the passes read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..robot.model import Floats, RobotModel
from ..robot.rigid_body import combine, RigidBody
from . import columns
from .jit import IS_COMPILED

_NO_BODIES = (columns.MASS, columns.INERTIA_COLUMNS, columns.BASE_MOTION_COLUMNS)
_NO_JOINT_TERMS = (columns.JOINT_TERM_COLUMNS, columns.FLAG_COLUMNS)
TERMS: dict[str, tuple[int | slice, ...]] = {
    'inertial': (
        columns.BASE_MOTION_COLUMNS,
        columns.EXTERNAL_COLUMNS,
        columns.DAMPING,
        columns.COULOMB,
        columns.LOAD_FRICTION,
        columns.HAS_LOAD_FRICTION,
    ),
    'velocity': (
        columns.BASE_ACCELERATION_COLUMNS,
        columns.EXTERNAL_COLUMNS,
        *_NO_JOINT_TERMS,
    ),
    'gravity': (columns.EXTERNAL_COLUMNS, *_NO_JOINT_TERMS),
    'constant friction': (
        *_NO_BODIES,
        columns.EXTERNAL_COLUMNS,
        columns.ARMATURE,
        columns.LOAD_FRICTION,
        columns.HAS_LOAD_FRICTION,
    ),
    'external': (*_NO_BODIES, *_NO_JOINT_TERMS),
    'load on gears': _NO_JOINT_TERMS,
}
"""Terms of the efforts, and the columns that are zero in the table that computes each of them."""


class LoadedRobot:
    """
    Robot table with payloads, external wrenches, base motion, gravity and joint terms.

    Values are not checked here; see `InverseDynamics`.

    Parameters
    ----------
    robot : RobotModel
        Tree of n joints and b bodies.

    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self.numbers = columns.robot_table(robot)
        """Table of shape (b, COLUMNS); to be modified by the methods only."""
        self.table = runnable(self.numbers)
        """The same as the passes expect it: an array, or lists without numba."""
        self.revision = 0
        """Changes with every change of the table."""
        self.R_ZL = columns.rotations_to_z(robot)
        self.base_motion: Floats = np.zeros((3, 3))
        """Angular velocity, angular acceleration and linear acceleration, by rows."""
        self.is_rotating = False
        """Whether the base has an angular velocity or acceleration."""
        self.gravity: Floats = np.zeros(3)
        self._payloads: dict[str, RigidBody] = {}
        self._wrenches: dict[str, tuple[Floats, Floats]] = {}
        self._reduced: dict[str, tuple[int, Any]] = {}

    def set_gravity(self, gravity: Floats) -> None:
        self.gravity = gravity
        self._write_base()

    def set_base_motion(self, motion: Floats) -> None:
        self.base_motion = motion
        self.is_rotating = bool(motion[:2].any())
        self._write_base()

    def set_payload(self, link: str, mass: float, com: Floats, inertia: Floats) -> None:
        k = self.robot.link_index(link)
        self._payloads.pop(link, None)
        if mass > 0.0:
            payload = RigidBody(mass, com, inertia).rotate(self.robot.link_rotation[k])
            self._payloads[link] = payload.shift(self.robot.link_position[k])
        self._write_inertial(int(self.robot.link_body[k]))

    def set_external_wrench(self, link: str, force: Floats, moment: Floats) -> None:
        k = self.robot.link_index(link)
        rotation = self.robot.link_rotation[k]
        force, moment = rotation @ force, rotation @ moment
        self._wrenches[link] = force, moment + np.cross(self.robot.link_position[k], force)
        self._write_external(int(self.robot.link_body[k]))

    def set_joints(self, column: int, values: Floats) -> None:
        """Set a column of all joints."""
        rows = self.numbers[1 : 1 + len(values)]
        rows[:, column] = values
        terms = [columns.ARMATURE, columns.DAMPING, columns.COULOMB, columns.LOAD_FRICTION]
        self.numbers[0, columns.HAS_JOINT_TERMS] = float(rows[:, terms].any())
        self.numbers[0, columns.HAS_LOAD_FRICTION] = float(rows[:, columns.LOAD_FRICTION].any())
        for i in range(1 + len(values)):
            self._update(i)

    def only(self, term: str) -> Any:
        """Return a table that leaves one of the `TERMS`; kept until the table changes."""
        revision, table = self._reduced.get(term, (-1, None))
        if revision != self.revision:
            numbers = self.numbers.copy()
            for part in TERMS[term]:
                numbers[:, part] = 0.0
            table = runnable(numbers)
            self._reduced[term] = self.revision, table
        return table

    def rigid_body(self, body: int) -> RigidBody:
        """Combine a body of the robot with the payloads on it."""
        robot = self.robot
        own = RigidBody(robot.mass[body], robot.com[body], robot.inertia[body])
        return combine([own, *self._on_body(self._payloads, body)])

    def _write_base(self) -> None:
        self.numbers[0, columns.BASE_MOTION_COLUMNS] = self.base_motion.ravel()
        self.numbers[0, columns.ACCEL : columns.ACCEL + 3] -= self.gravity  # LWP (31)
        self._update(0)

    def _write_inertial(self, body: int) -> None:
        columns.write_inertial(self.numbers[body], self.R_ZL[body], *self.rigid_body(body))
        self._update(body)

    def _write_external(self, body: int) -> None:
        wrenches = self._on_body(self._wrenches, body)
        row, R_ZL = self.numbers[body], self.R_ZL[body]
        force = sum((f for f, _ in wrenches), np.zeros(3))
        moment = sum((n for _, n in wrenches), np.zeros(3))
        columns.store(row, columns.EXTERNAL_FORCE, R_ZL @ force)
        columns.store(row, columns.EXTERNAL_MOMENT, R_ZL @ moment)
        self._update(body)

    def _on_body(self, loads: dict[str, Any], body: int) -> Sequence[Any]:
        robot = self.robot
        return [
            load
            for link, load in loads.items()
            if robot.link_body[robot.link_names.index(link)] == body
        ]

    def _update(self, body: int) -> None:
        self.revision += 1
        if not IS_COMPILED:
            self.table[body] = self.numbers[body].tolist()


def runnable(numbers: Floats) -> Any:
    """Return a table as the passes expect it: an array for numba, lists of floats for Python."""
    return numbers if IS_COMPILED else numbers.tolist()
