"""
A robot as flat, read-only arrays; parents come before their children.

Links connected by fixed joints form one *body*. Body 0 is the base. Every other body has one joint
that moves it. The URDF frame of this joint is the frame of the body. The origin of the frame is on
the axis of the joint. Frames are written in monogram notation: ``R_PL`` rotates vectors from body
L to its parent P, and ``p_PL`` is the position of the origin of L in P.
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
    """Description of the problem, with the value that was found."""
    hint: str
    """How to correct the problem, or when it is harmless."""
    subject: str = ''
    """
    The element with the problem, such as ``link 'hand' inertial``; empty for the whole robot.
    """
    line: int | None = None
    """Line of the robot description; None if no single line is the cause."""

    def __str__(self) -> str:
        line = '' if self.line is None else f'line {self.line}'
        return ': '.join(part for part in (line, self.subject, self.text) if part)


@dataclass(frozen=True, eq=False)
class RobotModel:
    """
    A tree of rigid bodies that are connected by revolute and prismatic joints.

    Arrays with ``n`` rows have one row per joint, in the order of ``joint_names``. Arrays with
    ``b`` rows have one row per body, the base first. If joints mimic others, there are more moving
    bodies than joints. All arrays are read-only.

    """

    name: str
    joint_names: tuple[str, ...]
    """
    Names of the n moving joints that do not mimic others; depth first, siblings in file order.
    """

    lower: Floats
    """Lower position limits of the n joints, shape (n,) [rad or m]; -inf if there is none."""
    upper: Floats
    """Upper position limits of the n joints, shape (n,) [rad or m]; inf if there is none."""
    velocity_limits: Floats
    """Largest speeds of the n joints, shape (n,) [rad/s or m/s]; inf if there is no limit."""
    effort_limits: Floats
    """Largest efforts of the n joints, shape (n,) [N m or N]; inf if there is no limit."""
    damping: Floats
    """
    Viscous friction of the n joints and their mimic joints, shape (n,) [N m s/rad or N s/m].
    """
    friction: Floats
    """Coulomb friction of the n joints and their mimic joints, shape (n,) [N m or N]."""
    is_continuous: Booleans
    """Whether each of n joints turns without limits (whole turns do not matter), shape (n,)."""

    body_names: tuple[str, ...]
    """Name of the base link, then the names of the joints that move the other bodies; length b."""
    parent: Integers
    """
    Index of each body's parent, shape (b,); -1 for the base. Parents come before their children.
    """
    is_prismatic: Booleans
    """Whether each of the b bodies slides along its axis instead of turning, shape (b,)."""
    joint_index: Integers
    """Index in ``joint_names`` of each body's joint, shape (b,); -1 for the base."""
    multiplier: Floats
    """
    Multipliers of the b bodies, shape (b,); 1 unless the joint of the body mimics another.

    The position of a body is ``multiplier * q[joint_index] + offset``.
    """
    offset: Floats
    """Position offsets of the b bodies, shape (b,) [rad or m]; see ``multiplier``."""
    R_PL: Floats
    """Rotations from the b body frames to the parents' frames at position 0, shape (b, 3, 3)."""
    p_PL: Floats
    """Origins of the b bodies in their parents' frames at position 0, shape (b, 3) [m]."""
    axis: Floats
    """
    Unit vectors of the joint axes in the frames of the b bodies, shape (b, 3); zero for the base.
    """
    mass: Floats
    """Masses of the b bodies, shape (b,) [kg]."""
    com: Floats
    """Centres of mass in the frames of the b bodies, shape (b, 3) [m]."""
    inertia: Floats
    """Inertias of b bodies about the centre of mass, in body axes, shape (b, 3, 3) [kg m^2]."""

    link_names: tuple[str, ...]
    """Names of all k links of the URDF, including merged ones, in file order; length k."""
    link_body: Integers
    """Index of the body that contains each of the k links, shape (k,)."""
    link_rotation: Floats
    """Rotations from the frames of the k links to the body frames, shape (k, 3, 3)."""
    link_position: Floats
    """Origins of the k links in the frames of their bodies, shape (k, 3) [m]."""
    link_mass: Floats
    """Masses of the k individual links, shape (k,) [kg]; 0 for a link without ``<inertial>``."""
    link_com: Floats
    """Centres of mass of the k individual links in their frames, shape (k, 3) [m]."""
    link_inertia: Floats
    """Inertias of the k links about the centre of mass, in link axes, shape (k, 3, 3) [kg m^2]."""

    warnings: tuple[ModelWarning, ...] = ()
    """Warnings about the robot description, in file order."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def is_prismatic_joint(self) -> Booleans:
        """Whether each of the n joints is prismatic instead of revolute, shape (n,)."""
        # Skip the first name, because a joint may have the same name as the base link.
        bodies = [self.body_names.index(name, 1) for name in self.joint_names]
        found: Booleans = self.is_prismatic[bodies]
        found.setflags(write=False)
        return found

    @property
    def mimic_names(self) -> tuple[str, ...]:
        """Names of the joints that mimic others; ``joint_names`` does not contain them."""
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
