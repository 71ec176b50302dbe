"""Which joints of a robot the messages of a publisher name, and in which order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
import difflib

import numpy as np

from ..errors import JointStateError
from ..robot.model import Floats, Integers

_MOST_LAYOUTS = 16  # more than this mean that names change with every message
_MOST_FOREIGN_NAMES = 64  # names to remember that are not joints of this robot
_LONGEST_NAME = 100  # of them [characters]; comparing longer ones takes time


@dataclass
class Layout:
    """The names in the messages of one publisher."""

    places: Integers
    """Indices of the k named joints in the robot and in the message, shape (2, k)."""
    received: Floats
    """Positions, velocities and efforts of the last message, shape (3, names)."""
    has_joints: bool
    """Whether it names any joint of this robot."""
    has_velocities: bool = False
    """Whether each of its joints has had a velocity."""


class Layouts:
    """
    Finds the layout of a message; a publisher repeats its names in every message.

    Parameters
    ----------
    joint_names : sequence of str
        The joints of the robot.

    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._index = {name: i for i, name in enumerate(joint_names)}
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._foreign_names: list[str] = []

    def find(self, names: tuple[str, ...]) -> Layout:
        """
        Return the layout of messages with these names.

        Parameters
        ----------
        names : tuple of str
            Names in the message.

        Raises
        ------
        JointStateError
            If a joint is named twice.

        """
        layout = self._layouts.get(names)
        if layout is None:
            layout = self._make(names)
            self._remember_foreign_names(names)
            if len(self._layouts) >= _MOST_LAYOUTS:
                self._layouts.clear()
            self._layouts[names] = layout
        return layout

    def forget_velocities(self) -> None:
        """Check the velocities in the next message of every layout."""
        for layout in self._layouts.values():
            layout.has_velocities = False

    def similar_names(self, missing: Sequence[str]) -> list[str]:
        """Return received names that are not joints of this robot, but resemble missing ones."""
        closest: list[str] = []
        for name in missing:
            closest += difflib.get_close_matches(name, self._foreign_names, 1)
        return list(dict.fromkeys(closest))

    def _make(self, names: tuple[str, ...]) -> Layout:
        in_message = [k for k, name in enumerate(names) if name in self._index]
        in_robot = [self._index[names[k]] for k in in_message]
        if len(set(in_robot)) != len(in_robot):
            [(joint, _)] = Counter(names[k] for k in in_message).most_common(1)
            raise JointStateError(f"joint '{joint}' is named twice")
        places = np.array([in_robot, in_message], np.int64)
        return Layout(places, np.zeros((3, len(names))), len(in_robot) > 0)

    def _remember_foreign_names(self, names: tuple[str, ...]) -> None:
        for name in names:
            if len(self._foreign_names) >= _MOST_FOREIGN_NAMES:
                return
            is_known = name in self._index or name in self._foreign_names
            if not is_known and len(name) <= _LONGEST_NAME:
                self._foreign_names.append(name)
