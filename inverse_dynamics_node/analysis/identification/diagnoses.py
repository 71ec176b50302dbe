"""What was found, by name and in words: what it is, how one knows, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .evidence import CREDIBLE, Explanation, Fit
from .loads import UNSURE

ALIKE = 1.1  # factors that differ by less are one factor


class Diagnosis(NamedTuple):
    """One explanation for measured efforts that are not the modelled ones."""

    kind: str
    """``sign``, ``scale``, ``gravity_compensated``, ``mounting``, ``payload``, ``order``,
    ``rotor_inertia``, ``offset``, ``constant`` or ``unexplained``."""
    joints: tuple[str, ...]
    """Whose efforts it explains; empty if it is about the whole robot."""
    headline: str
    evidence: str
    advice: str
    values: tuple[float, ...] = ()
    """A factor, inertia [kg m^2, kg] or offset [N m, N] for each joint; of a payload, mass [kg]
    and centre of mass [m]; of a mounting, gravity in the base frame [m/s^2]."""
    link: str = ''
    """What carries the payload."""


def describe(
    explanation: Explanation | None,
    names: Sequence[str],
    slides: Sequence[bool],
    gravity: Floats,
) -> list[Diagnosis]:
    """
    Put an explanation into words.

    Parameters
    ----------
    explanation : Explanation or None
        Of n joints.
    names : sequence of str
        Their names.
    slides : sequence of bool
        Which of them are prismatic.
    gravity : ndarray, shape (3,)
        What the model took for it, in the base frame [m/s^2].

    Returns
    -------
    diagnoses : list of Diagnosis
        Most important first; empty if the model explains the efforts as it is.

    """
    if explanation is None:
        return []
    found = [
        _order(explanation, names),
        _weightless(explanation),
        _mounting(explanation, gravity),
        _sign(explanation, names),
        _scale(explanation, names),
        _payload(explanation),
        _rotor(explanation, names, slides),
        _offset(explanation, names, slides),
        _unexplained(explanation, names),
    ]
    return [diagnosis for diagnosis in found if diagnosis is not None]


def constant(values: Mapping[str, float]) -> list[Diagnosis]:
    """Tell of joints whose measured effort is always the same, by their names."""
    if not values:
        return []
    told = ', '.join(f'{name} {value:g}' for name, value in values.items())
    return [
        Diagnosis(
            'constant',
            tuple(values),
            f'the measured effort of {listed(tuple(values))} never changes',
            f'it is always the same value ({told}), while the model asks for efforts that vary',
            'The driver does not measure or does not report it: look for the setting that turns '
            'it on, or leave these joints out of the comparison.',
            tuple(values.values()),
        )
    ]


def _of_whom(
    explanation: Explanation, names: Sequence[str], flag: str
) -> tuple[list[Fit], tuple[str, ...]]:
    """Return the fits with a twist, and whose they are."""
    pairs = [
        (fit, name)
        for fit, name in zip(explanation.fits, names, strict=True)
        if getattr(fit.twist, flag)
    ]
    return [fit for fit, _ in pairs], tuple(name for _, name in pairs)


def _is_all(explanation: Explanation, joints: Sequence[str], names: Sequence[str]) -> bool:
    """Tell whether these are several joints, and all those of which anything can be told."""
    telling = [name for fit, name in zip(explanation.fits, names, strict=True) if not fit.is_mute]
    return len(joints) > 1 and set(telling) <= set(joints)


def _telling(explanation: Explanation) -> list[Fit]:
    """Return the fits that say something about the whole robot."""
    return [fit for fit in explanation.fits if not fit.is_mute] or list(explanation.fits)


def _left(fits: Sequence[Fit]) -> str:
    """Say how much is explained now, of the joint that is explained worst."""
    share = 1.0 - max(fit.left for fit in fits)
    return f'{f"{share:.1%}" if share < 0.999 else "over 99.9%"} of the squared effort'


def _sign(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    fits, joints = _of_whom(explanation, names, 'is_swapped')
    if not fits:
        return None
    every = _is_all(explanation, joints, names)
    who = 'every joint' if every else listed(joints)
    has = 'has its sign' if every or len(joints) == 1 else 'have their signs'
    return Diagnosis(
        'sign',
        joints,
        f'{who} {has} swapped',
        f'with the opposite sign, the model explains {_left(fits)}',
        'The driver reports what the joint does to the drive (the reaction), for every joint: '
        'turn the sign of all efforts.'
        if every
        else 'Turn the sign in the driver, or of the <axis> in the URDF if positions run the '
        "other way too. Do not send the node's efforts to this joint before that: it would be "
        'driven the wrong way.',
        tuple(-1.0 for _ in fits),
    )


def _scale(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    fits, joints = _of_whom(explanation, names, 'is_scaled')
    if not fits:
        return None
    factors = [fit.scale for fit in fits]
    listed_factors = ', '.join(
        f'{name} {factor:.4g}' for name, factor in zip(joints, factors, strict=True)
    )
    is_all = _is_all(explanation, joints, names)
    mute = [name for fit, name in zip(explanation.fits, names, strict=True) if fit.is_mute]
    evidence = (
        f'the measured effort is the modelled one times {listed_factors}; with that, the model '
        f'explains {_left(fits)}'
    )
    if is_all and max(factors) < ALIKE * min(factors):
        factor = float(np.mean(factors))
        size = f'{float(f"{factor:.3g}"):g} times too large'
        if factor < 1.0:
            size = f'{float(f"{1.0 / factor:.3g}"):g} times too small'
        headline = f'the efforts are in another unit: all are {size}'
        advice = 'One factor for all joints is a unit (N mm for N m: 1000): convert it.'
    elif is_all:
        headline = 'the efforts are no torques or forces, but proportional to them'
        advice = (
            'Motor currents look like this, or torques before the gears: divide by these factors '
            '(torque constant times gear ratio is their inverse).'
        )
    else:
        headline = f'the effort of {listed(joints)} is in another unit'
        advice = 'Compare the torque constant, gear ratio and unit of these joints with others.'
    if mute:
        evidence += f'; of {listed(mute)} the unit cannot be told: next to nothing but friction'
    return Diagnosis('scale', joints, headline, evidence, advice, tuple(factors))


def _weightless(explanation: Explanation) -> Diagnosis | None:
    if not explanation.base.is_weightless:
        return None
    return Diagnosis(
        'gravity_compensated',
        (),
        'the measured efforts lack gravity: the driver compensates it already',
        f'without its gravity term, the model explains {_left(_telling(explanation))}',
        'Give the node include_gravity: false. With gravity counted twice, an arm would be driven '
        'upwards.',
    )


def _mounting(explanation: Explanation, gravity: Floats) -> Diagnosis | None:
    if explanation.base.kind != 'mounting':
        return None
    found = np.array(explanation.base.solution)
    cosine = found @ gravity / (np.linalg.norm(found) * np.linalg.norm(gravity))
    angle = math.degrees(math.acos(np.clip(cosine, -1.0, 1.0)))
    text = ', '.join(f'{x:.2f}' for x in found)
    return Diagnosis(
        'mounting',
        (),
        f'the base is mounted {angle:.0f} degrees from where the model has it',
        f'with gravity of {text} m/s^2 in the base frame, the model explains '
        f'{_left(_telling(explanation))}',
        f'Give the node gravity: [{text}].',
        tuple(found.tolist()),
    )


def _payload(explanation: Explanation) -> Diagnosis | None:
    base = explanation.base
    if base.kind != 'payload':
        return None
    mass, *com = base.solution
    com = [
        x if error < UNSURE else math.nan for x, error in zip(com, base.errors[1:], strict=True)
    ]
    where = ', '.join('cannot tell' if math.isnan(x) else f'{round(x, 3) + 0.0:.3f}' for x in com)
    carries = 'carries' if mass > 0.0 else 'lacks'
    return Diagnosis(
        'payload',
        (),
        f"link '{base.link}' {carries} {abs(mass):.2f} kg that the model "
        + ('does not know' if mass > 0.0 else 'has'),
        f'{mass:.3f} kg (standard error {base.errors[0]:.2g}) at ({where}) m in its frame, as a '
        f'point mass; with that, the model explains {_left(_telling(explanation))}',
        'Add it to the URDF. If nothing is fastened there, the masses or centres of mass of the '
        'last links are off by about as much.'
        if mass > 0.0
        else 'Take from the URDF what is not on the robot: a tool, a hand, a cable.',
        (mass, *com),
        base.link,
    )


def _order(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    moved = [(names[j], names[i]) for j, i in enumerate(explanation.source) if i != j]
    if not moved:
        return None
    whose = ', '.join(f'{theirs} has that of {ours}' for ours, theirs in moved)
    return Diagnosis(
        'order',
        tuple(ours for ours, _ in moved),
        f'the efforts of {listed([ours for ours, _ in moved])} are in another order',
        f'{whose}; so ordered, the model explains {_left(_telling(explanation))}',
        'Compare the order of names and efforts in the driver: lists of joints in two files '
        'often differ.',
    )


def _rotor(
    explanation: Explanation, names: Sequence[str], slides: Sequence[bool]
) -> Diagnosis | None:
    fits, joints = _of_whom(explanation, names, 'has_rotor')
    if not fits:
        return None
    units = dict(zip(names, ['kg' if slide else 'kg m^2' for slide in slides], strict=True))
    values = ', '.join(
        f'{name} {fit.rotor:.3g} {units[name]}' for name, fit in zip(joints, fits, strict=True)
    )
    return Diagnosis(
        'rotor_inertia',
        joints,
        f'{listed(joints)} {"moves" if len(joints) == 1 else "move"} more inertia than the model '
        'has: rotors and gears',
        f'an effort proportional to the acceleration of the joint itself, {values}; with that, '
        f'the model explains {_left(fits)}',
        "Give the node these as its parameter 'armature'.",
        tuple(fit.rotor for fit in fits),
    )


def _offset(
    explanation: Explanation, names: Sequence[str], slides: Sequence[bool]
) -> Diagnosis | None:
    fits, joints = _of_whom(explanation, names, 'has_offset')
    if not fits:
        return None
    units = dict(zip(names, ['N' if slide else 'N m' for slide in slides], strict=True))
    values = ', '.join(
        f'{name} {fit.offset:.3g} {units[name]}' for name, fit in zip(joints, fits, strict=True)
    )
    return Diagnosis(
        'offset',
        joints,
        f'the effort of {listed(joints)} is off by a constant',
        f'{values}; with that, the model explains {_left(fits)}',
        'Zero the torque sensors where the model says zero; or a spring or counterweight holds '
        'these joints, which a URDF has no element for.',
        tuple(fit.offset for fit in fits),
    )


def _unexplained(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    lost = [
        (fit, name)
        for fit, name in zip(explanation.fits, names, strict=True)
        # Dry friction holds a joint that rests against anything up to its full value.
        if fit.left > CREDIBLE and fit.moves
    ]
    if not lost:
        return None
    shares = ', '.join(f'{name} {fit.left:.0%}' for fit, name in lost)
    joints = tuple(name for _, name in lost)
    return Diagnosis(
        'unexplained',
        joints,
        f'the effort of {listed(joints)} is not what the model says, and nothing tried explains '
        'it',
        f'share of the squared effort that is left: {shares}',
        'Look at the picture. Contact with something, a wrong link inertia, a drive at its limit '
        'or an effort that is filtered or delayed would look like this.',
    )


def listed(names: Sequence[str]) -> str:
    """Join names as people do."""
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'
