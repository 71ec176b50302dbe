"""
The model of a robot as read-only arrays.

Links connected by fixed joints form one *body*. Body 0 is the base. Every other body is moved by
one joint, and the URDF frame of this joint is the frame of the body. Two arrays have names in
monogram notation: ``R_PL`` rotates vectors from the frame of body L to the frame of its parent P,
and ``p_PL`` is the origin of L in the frame of P.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigurationError, unknown_name

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class ModelWarning:
    """
    A problem that does not prevent the use of a robot description.

    ``str(warning)`` contains the line number, the subject and the text, separated by colons.

    """

    text: str
    """Description of the problem."""
    hint: str
    """How to correct the problem, or when the problem is harmless."""
    subject: str = ''
    """Element with the problem, such as ``link 'hand' inertial``; empty for the whole robot."""
    line: int | None = None
    """Line number in the robot description, or None."""

    def __str__(self) -> str:
        line = '' if self.line is None else f'line {self.line}'
        return ': '.join(part for part in (line, self.subject, self.text) if part)


@dataclass(frozen=True, eq=False)
class RobotModel:
    """
    A tree of rigid bodies, connected by revolute and prismatic joints.

    Arrays with ``n`` rows have one row per joint, in the order of ``joint_names``. Arrays with
    ``b`` rows have one row per body, and the base comes first. Arrays with ``k`` rows have one row
    per link. A mimic joint moves a body, but is not one of the n joints. All arrays are read-only.

    """

    name: str
    joint_names: tuple[str, ...]
    """Names of the n movable joints, without mimic joints; depth first, siblings in file order."""

    lower: Floats
    """Lower position limit of each joint, shape (n,) [rad or m]; -inf without a limit."""
    upper: Floats
    """Upper position limit of each joint, shape (n,) [rad or m]; inf without a limit."""
    velocity_limits: Floats
    """Velocity limit of each joint, shape (n,) [rad/s or m/s]; inf without a limit."""
    effort_limits: Floats
    """Effort limit of each joint, shape (n,) [N m or N]; inf without a limit."""
    damping: Floats
    """
    Viscous friction of each joint and its mimic joints, shape (n,) [N m s/rad or N s/m].
    """
    friction: Floats
    """Coulomb friction of each joint and its mimic joints, shape (n,) [N m or N]."""
    is_continuous: Booleans
    """Whether each joint has the URDF type ``continuous``, shape (n,)."""

    body_names: tuple[str, ...]
    """Name of the base link, then the names of the joints of the other bodies; length b."""
    parent: Integers
    """
    Index of the parent of each body, shape (b,); -1 for the base.

    Parents come before their children.
    """
    is_prismatic: Booleans
    """Whether the joint of each body is prismatic, shape (b,); False for the base."""
    joint_index: Integers
    """
    Index in ``joint_names`` of the joint that moves each body, shape (b,); -1 for the base.

    For a mimic joint, this is the index of the mimicked joint.
    """
    multiplier: Floats
    """
    Multiplier of each body, shape (b,); 0 for the base, and 1 unless the joint is a mimic joint.

    The joint of a body has the position ``multiplier * q[joint_index] + offset``.
    """
    offset: Floats
    """Position offset of each body, shape (b,) [rad or m]; see ``multiplier``."""
    R_PL: Floats
    """Rotation from each body frame to the parent frame at joint position 0, shape (b, 3, 3)."""
    p_PL: Floats
    """Origin of each body at joint position 0, in the parent frame, shape (b, 3) [m]."""
    axis: Floats
    """Unit vector of each joint axis, in the body frame, shape (b, 3); zero for the base."""
    mass: Floats
    """Mass of each body, shape (b,) [kg]."""
    com: Floats
    """Centre of mass of each body, in the body frame, shape (b, 3) [m]."""
    inertia: Floats
    """Inertia of each body about its centre of mass, in body axes, shape (b, 3, 3) [kg m^2]."""

    link_names: tuple[str, ...]
    """Names of all k links of the URDF, in file order."""
    link_body: Integers
    """Index of the body that contains each link, shape (k,)."""
    link_rotation: Floats
    """Rotation from each link frame to the body frame, shape (k, 3, 3)."""
    link_position: Floats
    """Origin of each link in the body frame, shape (k, 3) [m]."""
    link_mass: Floats
    """Mass of each link, shape (k,) [kg]; 0 for a link without ``<inertial>``."""
    link_com: Floats
    """Centre of mass of each link, in the link frame, shape (k, 3) [m]."""
    link_inertia: Floats
    """Inertia of each link about its centre of mass, in link axes, shape (k, 3, 3) [kg m^2]."""

    warnings: tuple[ModelWarning, ...] = ()
    """Warnings about the robot description."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def is_prismatic_joint(self) -> Booleans:
        """Whether each joint is prismatic, shape (n,)."""
        # Skip the first name, because a joint may have the same name as the base link.
        bodies = [self.body_names.index(name, 1) for name in self.joint_names]
        found: Booleans = self.is_prismatic[bodies]
        found.setflags(write=False)
        return found

    @property
    def mimic_names(self) -> tuple[str, ...]:
        """Names of the mimic joints, which ``joint_names`` does not contain."""
        return tuple(name for name in self.body_names[1:] if name not in self.joint_names)

    def joint_indices(self, names: Iterable[str]) -> list[int]:
        """
        Return the indices of joints in ``joint_names``.

        Raises
        ------
        ConfigurationError
            If a joint does not exist; the message lists the names that exist.

        """
        return [_index('joint', name, self.joint_names) for name in names]

    def link_index(self, name: str) -> int:
        """
        Return the index of a link in ``link_names``.

        Raises
        ------
        ConfigurationError
            If the link does not exist; the message lists the names that exist.

        """
        return _index('link', name, self.link_names)

    def __repr__(self) -> str:
        return f'RobotModel({self.name!r}, joints={", ".join(self.joint_names)})'


def _index(kind: str, name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise ConfigurationError(unknown_name(kind, name, names))
    return names.index(name)
