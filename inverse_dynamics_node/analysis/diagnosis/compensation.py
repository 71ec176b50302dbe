"""Recognizes robots whose drivers compensate gravity, which no measurement shows."""

from __future__ import annotations

from collections.abc import Iterable
import re

MAKERS = {
    'Franka': r'franka|panda|fr3|fer',
    'KUKA FRI': r'lbr|iiwa',
    'UR': r'ur|ur(3|5|7|8|10|12|15|16|18|20|30)e?|ur_robot_driver|urcl',
}
"""Words in names of robots and nodes; doc/robots.md has the sources."""


def compensating_driver(names: Iterable[str]) -> str:
    """
    Return the maker of a robot whose driver compensates gravity, or '' if no name says so.

    `names` are those of the robot and of all nodes. Words are separated by anything but letters
    and digits, as in ``left_fr3``.
    """
    for maker, pattern in MAKERS.items():
        words = re.compile(rf'(?:^|[^a-z0-9])(?:{pattern})(?:$|[^a-z0-9])')
        if any(words.search(name.lower()) for name in names):
            return maker
    return ''
