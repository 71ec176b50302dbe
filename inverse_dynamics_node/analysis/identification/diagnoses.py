"""Explanations of measured efforts in words, with evidence and advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .evidence import Explanation
from .joint_samples import CREDIBLE, Fit
from .loads import MAX_COM_ERROR

SAME_FACTOR = 1.1  # factors with a smaller ratio are regarded as equal


class Diagnosis(NamedTuple):
    """One explanation of a difference between measured and modelled efforts."""

    kind: str
    """``sign``, ``scale``, ``gravity_compensated``, ``mounting``, ``payload``, ``order``,
    ``rotor_inertia``, ``offset``, ``constant`` or ``unexplained``."""
    joints: tuple[str, ...]
    """Joints whose efforts it explains; empty if it concerns the whole robot."""
    headline: str
    evidence: str
    advice: str
    values: tuple[float, ...] = ()
    """
    Factor, inertia [kg m^2, kg] or offset [N m, N] of each joint; mass [kg] and centre of mass [m]
    of a payload; gravity in the frame of the base link [m/s^2] of a mounting.
    """
    link: str = ''
    """Link that carries the payload."""


def describe(
    explanation: Explanation | None,
    names: Sequence[str],
    is_prismatic: Sequence[bool],
    gravity: Floats,
) -> list[Diagnosis]:
    """
    Describe an explanation.

    Parameters
    ----------
    explanation : Explanation or None
        Explanation of the efforts of n joints.
    names : sequence of str
        Names of the joints.
    is_prismatic : sequence of bool
        Whether each joint is prismatic.
    gravity : ndarray, shape (3,)
        Gravity of the model in the frame of the base link [m/s^2].

    Returns
    -------
    diagnoses : list of Diagnosis
        Most important first; empty if the model explains the efforts without changes.

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
        _rotor(explanation, names, is_prismatic),
        _offset(explanation, names, is_prismatic),
        _unexplained(explanation, names),
    ]
    return [diagnosis for diagnosis in found if diagnosis is not None]


def diagnose_constant(values: Mapping[str, float]) -> list[Diagnosis]:
    """Return the diagnosis for joints whose measured effort is constant, given their efforts."""
    if not values:
        return []
    shown = ', '.join(f'{name} {value:g}' for name, value in values.items())
    return [
        Diagnosis(
            'constant',
            tuple(values),
            f'the measured effort of {listed(tuple(values))} never changes',
            f'it is always the same value ({shown}), while the modelled effort varies',
            'The driver does not measure or does not report it: look for a setting that enables '
            'it, or leave these joints out of the comparison.',
            tuple(values.values()),
        )
    ]


def _distorted(
    explanation: Explanation, names: Sequence[str], flag: str
) -> tuple[list[Fit], tuple[str, ...]]:
    """Return the fits with a distortion, and the names of their joints."""
    pairs = [
        (fit, name)
        for fit, name in zip(explanation.fits, names, strict=True)
        if getattr(fit.distortion, flag)
    ]
    return [fit for fit, _ in pairs], tuple(name for _, name in pairs)


def _is_all(explanation: Explanation, joints: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether these are several joints, and all those that show more than friction."""
    relevant = [
        name for fit, name in zip(explanation.fits, names, strict=True) if not fit.is_friction_only
    ]
    return len(joints) > 1 and set(relevant) <= set(joints)


def _relevant_fits(explanation: Explanation) -> list[Fit]:
    """Return the fits of the joints that show more than friction, if there are any."""
    relevant = [fit for fit in explanation.fits if not fit.is_friction_only]
    return relevant or list(explanation.fits)


def _explained(fits: Sequence[Fit]) -> str:
    """Return how much is explained of the effort of the joint that is explained worst."""
    fraction = 1.0 - max(fit.remaining for fit in fits)
    return f'{f"{fraction:.1%}" if fraction < 0.999 else "over 99.9%"} of the squared effort'


def _sign(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    fits, joints = _distorted(explanation, names, 'is_swapped')
    if not fits:
        return None
    every = _is_all(explanation, joints, names)
    subject = 'every joint' if every else listed(joints)
    has = 'has its sign' if every or len(joints) == 1 else 'have their signs'
    return Diagnosis(
        'sign',
        joints,
        f'{subject} {has} swapped',
        f'with the opposite sign, the model explains {_explained(fits)}',
        'The driver reports the reaction of the joint on the drive: change the sign of all '
        'efforts.'
        if every
        else 'Change the sign in the driver, or of the <axis> in the URDF if positions have the '
        'wrong sign too. Do not send efforts of the node to this joint before that: they would '
        'drive it in the wrong direction.',
        tuple(-1.0 for _ in fits),
    )


def _scale(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    fits, joints = _distorted(explanation, names, 'is_scaled')
    if not fits:
        return None
    factors = [fit.scale for fit in fits]
    listed_factors = ', '.join(
        f'{name} {factor:.4g}' for name, factor in zip(joints, factors, strict=True)
    )
    is_all = _is_all(explanation, joints, names)
    unknown = [
        name for fit, name in zip(explanation.fits, names, strict=True) if fit.is_friction_only
    ]
    evidence = (
        f'the measured effort is the modelled one times {listed_factors}; with that, the model '
        f'explains {_explained(fits)}'
    )
    if is_all and max(factors) < SAME_FACTOR * min(factors):
        factor = float(np.mean(factors))
        size = f'{float(f"{factor:.3g}"):g} times too large'
        if factor < 1.0:
            size = f'{float(f"{1.0 / factor:.3g}"):g} times too small'
        headline = f'the efforts are in another unit: all are {size}'
        advice = 'The same factor for all joints is a different unit (1000: N mm): convert it.'
    elif is_all:
        headline = 'the efforts are not torques or forces, but proportional to them'
        advice = (
            'They may be motor currents, or torques before the gears: divide by these factors '
            '(torque constant times gear ratio is their inverse).'
        )
    else:
        headline = f'the effort of {listed(joints)} is in another unit'
        advice = 'Compare torque constant, gear ratio and unit with those of the other joints.'
    if unknown:
        evidence += f'; the unit of {listed(unknown)} is unknown, because friction dominates'
    return Diagnosis('scale', joints, headline, evidence, advice, tuple(factors))


def _weightless(explanation: Explanation) -> Diagnosis | None:
    if not explanation.hypothesis.is_weightless:
        return None
    return Diagnosis(
        'gravity_compensated',
        (),
        'the measured efforts lack gravity: the driver compensates it already',
        f'without its gravity term, the model explains {_explained(_relevant_fits(explanation))}',
        'Set include_gravity: false in the node. If gravity were compensated twice, the arm would '
        'move upwards.',
    )


def _mounting(explanation: Explanation, gravity: Floats) -> Diagnosis | None:
    if explanation.hypothesis.kind != 'mounting':
        return None
    found = np.array(explanation.hypothesis.solution)
    cosine = found @ gravity / (np.linalg.norm(found) * np.linalg.norm(gravity))
    angle = math.degrees(math.acos(np.clip(cosine, -1.0, 1.0)))
    text = ', '.join(f'{x:.2f}' for x in found)
    return Diagnosis(
        'mounting',
        (),
        f'the base is tilted by {angle:.0f} degrees from its mounting in the model',
        f'with gravity of {text} m/s^2 in the frame of the base link, the model explains '
        f'{_explained(_relevant_fits(explanation))}',
        f'Set gravity: [{text}] in the node.',
        tuple(found.tolist()),
    )


def _payload(explanation: Explanation) -> Diagnosis | None:
    hypothesis = explanation.hypothesis
    if hypothesis.kind != 'payload':
        return None
    mass, *com = hypothesis.solution
    com = [
        x if error < MAX_COM_ERROR else math.nan
        for x, error in zip(com, hypothesis.errors[1:], strict=True)
    ]
    where = ', '.join('unknown' if math.isnan(x) else f'{round(x, 3) + 0.0:.3f}' for x in com)
    carries = 'carries' if mass > 0.0 else 'lacks'
    return Diagnosis(
        'payload',
        (),
        f"link '{hypothesis.link}' {carries} {abs(mass):.2f} kg that the model "
        + ('does not have' if mass > 0.0 else 'has'),
        f'{mass:.3f} kg (standard error {hypothesis.errors[0]:.2g}) at ({where}) m in its frame, '
        'as a point mass; with that, the model explains '
        f'{_explained(_relevant_fits(explanation))}',
        'Add it to the URDF. If nothing is attached there, the masses or centres of mass of the '
        'last links are wrong by about as much.'
        if mass > 0.0
        else 'Remove from the URDF all parts that the robot does not have, such as a tool or a '
        'hand.',
        (mass, *com),
        hypothesis.link,
    )


def _order(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    moved = [(names[j], names[i]) for j, i in enumerate(explanation.source) if i != j]
    if not moved:
        return None
    swapped = ', '.join(f'{other} has the effort of {name}' for name, other in moved)
    return Diagnosis(
        'order',
        tuple(name for name, _ in moved),
        f'the efforts of {listed([name for name, _ in moved])} are in another order',
        f'{swapped}; in this order, the model explains {_explained(_relevant_fits(explanation))}',
        'Compare the order of names and efforts in the driver, and the lists of joints in all of '
        'its files.',
    )


def _rotor(
    explanation: Explanation, names: Sequence[str], is_prismatic: Sequence[bool]
) -> Diagnosis | None:
    fits, joints = _distorted(explanation, names, 'has_rotor')
    if not fits:
        return None
    units = dict(zip(names, ['kg' if each else 'kg m^2' for each in is_prismatic], strict=True))
    values = ', '.join(
        f'{name} {fit.rotor:.3g} {units[name]}' for name, fit in zip(joints, fits, strict=True)
    )
    return Diagnosis(
        'rotor_inertia',
        joints,
        f'{listed(joints)} {"moves" if len(joints) == 1 else "move"} more inertia than the model '
        'has: rotors and gears',
        f'an effort is proportional to the acceleration of the joint, {values}; with that, '
        f'the model explains {_explained(fits)}',
        "Set these values as the parameter 'armature' of the node.",
        tuple(fit.rotor for fit in fits),
    )


def _offset(
    explanation: Explanation, names: Sequence[str], is_prismatic: Sequence[bool]
) -> Diagnosis | None:
    fits, joints = _distorted(explanation, names, 'has_offset')
    if not fits:
        return None
    units = dict(zip(names, ['N' if each else 'N m' for each in is_prismatic], strict=True))
    values = ', '.join(
        f'{name} {fit.offset:.3g} {units[name]}' for name, fit in zip(joints, fits, strict=True)
    )
    return Diagnosis(
        'offset',
        joints,
        f'the effort of {listed(joints)} has a constant offset',
        f'{values}; with that, the model explains {_explained(fits)}',
        'Zero the torque sensors in a pose in which the modelled effort is zero. A spring or a '
        'counterweight, which a URDF cannot describe, is another possible cause.',
        tuple(fit.offset for fit in fits),
    )


def _unexplained(explanation: Explanation, names: Sequence[str]) -> Diagnosis | None:
    unexplained = [
        (fit, name)
        for fit, name in zip(explanation.fits, names, strict=True)
        # The effort of a joint at rest also contains an unknown dry friction.
        if fit.remaining > CREDIBLE and fit.moves
    ]
    if not unexplained:
        return None
    fractions = ', '.join(f'{name} {fit.remaining:.0%}' for fit, name in unexplained)
    joints = tuple(name for _, name in unexplained)
    return Diagnosis(
        'unexplained',
        joints,
        f'the effort of {listed(joints)} differs from the model, and no known cause explains it',
        f'unexplained fraction of the squared effort: {fractions}',
        'Look at the picture. Possible causes are contact, a wrong link inertia, a drive at its '
        'limit, and an effort that is filtered or delayed.',
    )


def listed(names: Sequence[str]) -> str:
    """Join names by commas, and the last one by 'and'."""
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'
