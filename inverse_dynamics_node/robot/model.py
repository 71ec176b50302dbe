"""
A robot as flat, read-only arrays, parents before children.

Links that fixed joints hold together are one *body*. Body 0 is the base. Each other body is moved
by one joint and has the URDF frame of that joint, with its origin on the joint axis. Frames are
written in monogram notation: ``R_PL`` transforms vectors from body L to its parent P, ``p_PL`` is
the position of the origin of L in P.
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
    Something that looks wrong although the robot can be used.

    ``str(warning)`` is one line with the line number, the subject and the text.

    """

    text: str
    """The condition and the value that was found."""
    hint: str
    """How to correct it, or when it is harmless."""
    subject: str = ''
    """The part of the robot, such as ``link 'hand' inertial``; empty for the whole robot."""
    line: int | None = None
    """Line of the robot description; None if no single line is the cause."""

    def __str__(self) -> str:
        line = '' if self.line is None else f'line {self.line}'
        return ': '.join(part for part in (line, self.subject, self.text) if part)


@dataclass(frozen=True, eq=False)
class RobotModel:
    """
    A tree of rigid bodies joined by revolute and prismatic joints.

    Arrays of ``n`` rows follow ``joint_names``; arrays of ``b`` rows follow the bodies, base
    first. There are more moving bodies than joints where joints mimic others. All arrays are
    read-only.

    """

    name: str
    joint_names: tuple[str, ...]
    """The n movable, non-mimic joints, depth first, in file order among siblings."""

    lower: Floats
    """Lower position limit, shape (n,) [rad or m]; -inf if there is none."""
    upper: Floats
    """Upper position limit, shape (n,) [rad or m]; inf if there is none."""
    velocity_limits: Floats
    """Largest speed, shape (n,) [rad/s or m/s]; inf if there is none."""
    effort_limits: Floats
    """Largest effort, shape (n,) [N m or N]; inf if there is none."""
    damping: Floats
    """Viscous friction, shape (n,) [N m s/rad or N s/m]; including that of mimicking joints."""
    friction: Floats
    """Coulomb friction, shape (n,) [N m or N]; including that of mimicking joints."""
    is_continuous: Booleans
    """Whether positions that differ by a whole turn are the same, shape (n,)."""

    body_names: tuple[str, ...]
    """The base link's name, then the name of the joint that moves each body; length b."""
    parent: Integers
    """Parent body, shape (b,); always smaller than the body's own index, -1 for the base."""
    is_prismatic: Booleans
    """Whether the body slides along its axis instead of turning about it, shape (b,)."""
    joint_index: Integers
    """Index in ``joint_names`` of the joint that moves the body, shape (b,); -1 for the base."""
    multiplier: Floats
    """Body position is ``multiplier * q[joint_index] + offset``, shape (b,); 1 without mimic."""
    offset: Floats
    """See ``multiplier``, shape (b,) [rad or m]."""
    R_PL: Floats
    """Rotation from the body's frame to its parent's at position 0, shape (b, 3, 3)."""
    p_PL: Floats
    """Origin of the body in its parent's frame at position 0, shape (b, 3) [m]."""
    axis: Floats
    """Unit vector of the joint axis in the body's frame, shape (b, 3); zero for the base."""
    mass: Floats
    """Mass of each body, shape (b,) [kg]."""
    com: Floats
    """Centre of mass in the body's frame, shape (b, 3) [m]."""
    inertia: Floats
    """About the centre of mass, along the body's axes, shape (b, 3, 3) [kg m^2]."""

    link_names: tuple[str, ...]
    """All URDF links, including merged ones, in file order; length k."""
    link_body: Integers
    """The body that a link is part of, shape (k,)."""
    link_rotation: Floats
    """Rotation from the link's frame to its body's, shape (k, 3, 3)."""
    link_position: Floats
    """Origin of the link in its body's frame, shape (k, 3) [m]."""
    link_mass: Floats
    """Mass of the link alone, shape (k,) [kg]; 0 if it has no inertial."""
    link_com: Floats
    """Centre of mass of the link alone in the link's frame, shape (k, 3) [m]."""
    link_inertia: Floats
    """
    Inertia of the link alone about its centre of mass, shape (k, 3, 3) [kg m^2].

    It is expressed along the axes of the link's frame.
    """

    warnings: tuple[ModelWarning, ...] = ()
    """What looks wrong although it could be loaded, in file order."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def is_prismatic_joint(self) -> Booleans:
        """Whether each joint is prismatic instead of revolute, shape (n,)."""
        # Skip the first name: it is that of the base link, which may also be the name of a joint.
        bodies = [self.body_names.index(name, 1) for name in self.joint_names]
        found: Booleans = self.is_prismatic[bodies]
        found.setflags(write=False)
        return found

    @property
    def mimic_names(self) -> tuple[str, ...]:
        """Names of the joints that mimic others, which are not in ``joint_names``."""
        return tuple(name for name in self.body_names[1:] if name not in self.joint_names)

    def joint_indices(self, names: Iterable[str]) -> list[int]:
        """
        Return the indices of joints in ``joint_names``.

        Raises
        ------
        ConfigurationError
            If the robot does not have one of the joints; the message lists those that it has.

        """
        return [_index('joint', name, self.joint_names) for name in names]

    def link_index(self, name: str) -> int:
        """
        Return the index of a link in ``link_names``.

        Raises
        ------
        ConfigurationError
            If the robot does not have the link; the message lists those that it has.

        """
        return _index('link', name, self.link_names)

    def __repr__(self) -> str:
        return f'RobotModel({self.name!r}, joints={", ".join(self.joint_names)})'


def _index(kind: str, name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise ConfigurationError(unknown_name(kind, name, names))
    return names.index(name)
