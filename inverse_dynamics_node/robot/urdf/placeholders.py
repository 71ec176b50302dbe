"""Detection of masses and inertias that were filled in without measuring."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from ...errors import listed
from .elements import is_finite_decimal
from .problems import Problems
from .rules import MOMENTS
from .xml import Element

_FEWEST_ALIKE = 3
"""Number of links; two links may well be equal parts."""
_FRACTION_ALIKE = 0.8
"""Fraction of the links with mass that have the same values if nobody measured them."""


def warn_of_placeholders(links: Mapping[str, Element], problems: Problems) -> None:
    """Warn of equal masses and inertias that an exporter or a person filled in."""
    masses: dict[str, float] = {}
    tensors: dict[str, tuple[float, ...]] = {}
    for name, link in links.items():
        mass, tensor = _numbers_of(link, 'mass', ['value']), _numbers_of(link, 'inertia', MOMENTS)
        if mass and tensor and mass[0] > 0.0:
            masses[name], tensors[name] = mass[0], tensor
    count = len(masses)
    unit = [name for name in masses if tensors[name] == (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)]
    if len(unit) > 1:
        text = f'{len(unit)} of {count} links with mass have the inertia 1 1 1 kg m^2'
        _warn(links[unit[0]], f'{text}: {listed(unit, 4)}', problems)
    if count < _FEWEST_ALIKE:
        return
    alike = _with_most_common_value(tensors)
    # Equal modules of a chain have equal masses too, and different principal moments.
    ixx, ixy, ixz, iyy, iyz, izz = tensors[alike[0]]
    is_sphere = ixx == iyy == izz and not (ixy or ixz or iyz)
    are_different = len({masses[name] for name in alike}) > 1
    if len(alike) >= _FRACTION_ALIKE * count and not unit and (is_sphere or are_different):
        text = f'{len(alike)} of {count} links with mass have the same inertia'
        _warn(links[alike[0]], f'{text}, ixx {ixx:g} kg m^2', problems)
    heavy = [name for name, mass in masses.items() if mass == 1.0]
    if len(heavy) >= max(_FEWEST_ALIKE, _FRACTION_ALIKE * count):
        text = f'{len(heavy)} of {count} links with mass have a mass of 1 kg'
        _warn(links[heavy[0]], text, problems)


def _warn(link: Element, text: str, problems: Problems) -> None:
    hint = 'take mass, centre of mass and inertia from CAD'
    problems.warning(link, '', f'{text}: looks like a placeholder', hint)


def _with_most_common_value(values: Mapping[str, tuple[float, ...]]) -> list[str]:
    common = Counter(values.values()).most_common(1)[0][0]
    return [name for name, value in values.items() if value == common]


def _numbers_of(link: Element, kind: str, names: Sequence[str]) -> tuple[float, ...] | None:
    """Return attributes of the inertial of a link; None unless all of them are numbers."""
    part = link.find(f'inertial/{kind}')
    if part is None:
        return None
    texts = [part.get(name, '') for name in names]
    if not all(is_finite_decimal(text.strip()) for text in texts):
        return None
    return tuple(float(text) for text in texts)
