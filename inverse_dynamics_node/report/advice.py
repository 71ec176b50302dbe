"""What to do about what looks wrong in a robot description."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Concern(NamedTuple):
    """What looks wrong, and what to do about it."""

    advice: str
    findings: tuple[str, ...]
    """Where, and the value found; one or more."""


_TENSOR = (
    'take the inertia from CAD: about the centre of mass, in kg m^2; gravity efforts are right '
    'all the same, those of accelerations are not'
)
ADVICE = (
    ('looks like a placeholder', 'take mass, centre of mass and inertia from CAD'),
    ('with zero inertia', _TENSOR),
    ('inertia is not positive', _TENSOR),
    ('no body has this inertia', _TENSOR),
    ('zero mass with inertia', 'fine for the rotor of a motor; else write the mass'),
    ('has a shape', 'write <inertial>, from CAD: the weight of this link is not held otherwise'),
    (
        'radius of gyration',
        'convert the inertia to kg m^2; CAD often exports g mm^2, 1e9 times that',
    ),
    ('angles are in radians', 'convert the angles from degrees'),
    ('no <axis>', 'write <axis xyz="..."/>, in the frame of the joint'),
    ('normalised', 'harmless; write an axis of length 1'),
    (
        'limit effort is 0',
        'write the effort that the joint can give: unlimited efforts reach the robot',
    ),
    ('limit velocity is 0', 'write the speed that the joint can reach'),
    ('<limit> has no', 'write both ends, in rad or m'),
    ('it cannot move', 'write a range, or make the joint fixed'),
    ('moves no mass', 'write <inertial> for the links that it moves, unless they are frames only'),
    ('moves any mass', 'write <inertial>: without masses there is nothing to compute'),
    ('no joint can move', 'is this the whole robot? every joint is fixed'),
    ('ignored', 'correct the spelling, or take it out'),
)
"""Words of a warning, and what helps; the first that fits counts."""
_ELSE = 'look at that line of the description'


def advise(warnings: Iterable[str]) -> tuple[Concern, ...]:
    """
    Sort warnings by what to do about them.

    Parameters
    ----------
    warnings : iterable of str
        As in ``RobotModel.warnings``.

    Returns
    -------
    concerns : tuple of Concern
        In the order of their first warnings.

    """
    found: dict[str, list[str]] = {}
    for text in warnings:
        advice = next((advice for words, advice in ADVICE if words in text), _ELSE)
        found.setdefault(advice, []).append(text)
    return tuple(Concern(advice, tuple(texts)) for advice, texts in found.items())
