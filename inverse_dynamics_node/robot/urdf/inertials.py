"""Checks of the masses and inertias of links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .elements import check_attributes, check_children
from .origins import check_rotation
from .problems import label, Problems
from .rules import CHILDREN, MOMENTS
from .xml import Element, tag

_MOMENT_TOLERANCE = 1e-3
"""Rounded moments of a flat part miss the triangle inequality by this fraction of their sum."""
_MAX_GYRATION = 10.0
"""Largest plausible radius of gyration [m]; above, the inertia is not in kg m^2."""

_TENSOR_HINT = (
    'take the inertia about the centre of mass from CAD, in kg m^2; it affects only efforts of '
    'accelerations, not gravity efforts'
)


def check_link(link: Element, problems: Problems) -> None:
    """Check the <inertial> of a link, if it has one."""
    where = label(link)
    inertial = check_children(link, where, CHILDREN['link'], problems).get('inertial')
    if inertial is None:
        return
    where += ' inertial'
    parts = check_children(inertial, where, CHILDREN['inertial'], problems)
    values: dict[str, tuple[float, ...]] = {}
    for part in parts.values():
        values |= check_attributes(part, where, problems)
    if 'mass' not in parts:
        problems.error(inertial, f'{where}: <mass value="..."/> is missing')
    if 'inertia' not in parts:
        problems.error(inertial, f'{where}: <inertia> is missing')
    if 'origin' in parts:
        check_rotation(parts['origin'], f'{where} origin', values, problems)
    if 'value' in values and all(moment in values for moment in MOMENTS):
        mass = values['value'][0]
        _warn_of_odd_inertia(inertial, where, mass, [values[m][0] for m in MOMENTS], problems)


def _warn_of_odd_inertia(
    inertial: Element, where: str, mass: float, moments: Sequence[float], problems: Problems
) -> None:
    """Warn of an inertia that no rigid body of this mass can have."""
    largest = max(abs(moment) for moment in moments)
    if largest == 0.0:
        if mass > 0.0:
            text = f'mass {mass:g} kg with zero inertia'
            problems.warning(inertial, where, text, _TENSOR_HINT)
        return
    if mass == 0.0:
        text = 'zero mass with inertia; the inertia is kept'
        hint = 'correct for the rotor of a motor; otherwise write the mass'
        problems.warning(inertial, where, text, hint)
    ixx, ixy, ixz, iyy, iyz, izz = (moment / largest for moment in moments)
    principal = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    slack = _MOMENT_TOLERANCE * float(np.abs(principal).sum())
    small, middle, large = (float(moment) for moment in principal)
    values = ', '.join(f'{moment * largest:.3g}' for moment in (small, middle, large))
    if small < -slack:
        text = f'inertia is not positive (principal moments {values} kg m^2)'
        problems.warning(inertial, where, text, _TENSOR_HINT)
    elif small + middle < large - slack:
        text = (
            f'impossible inertia: of its principal moments {values} kg m^2 one exceeds the sum '
            'of the others'
        )
        problems.warning(inertial, where, text, _TENSOR_HINT)
    if mass > 0.0 and large * largest > _MAX_GYRATION**2 * mass:
        text = f'radius of gyration is more than {_MAX_GYRATION:g} m; inertias are in kg m^2'
        hint = 'convert the inertia to kg m^2; CAD often exports g mm^2, 1e9 times that'
        problems.warning(inertial, where, text, hint)


def check_missing_inertials(
    links: Mapping[str, Element],
    joints: Mapping[str, Element],
    problems: Problems,
    are_required: bool,
) -> None:
    """
    Find links with a shape but without an inertial: an error if they are required.

    Links without a shape are frames. The root link is left out, because it may be the ground.

    """
    children = {
        child.get('link') for joint in joints.values() for child in joint if tag(child) == 'child'
    }
    text = 'has a shape but no <inertial>; it is treated as massless'
    hint = 'write <inertial>, from CAD; without it the weight of this link is not compensated'
    for name, link in links.items():
        parts = {tag(part) for part in link}
        if name not in children or 'inertial' in parts or not parts & {'visual', 'collision'}:
            continue
        if are_required:
            problems.error(link, f'{label(link)}: {text}')
        else:
            problems.warning(link, label(link), text, hint)
