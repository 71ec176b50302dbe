"""Checks of the children and attributes of one element against the rules."""

from __future__ import annotations

from collections import defaultdict
import math
import re

from .problems import Problems, quoted
from .rules import READ_ONCE, RULES
from .xml import Element, is_xacro, shortened, tag

# Python's float() also accepts '1_000', 'nan', 'infinity' and the digits of other scripts.
_DECIMAL = re.compile(r'[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')
_SPELLING = 'correct the spelling, or remove it'


def check_children(
    element: Element, where: str, kinds: tuple[str, ...], problems: Problems
) -> dict[str, Element]:
    """
    Return the children of the given kinds; more than one of a kind is an error.

    Several origins are a warning only: urdfdom, and with it every ROS tool, reads the first one.

    """
    found: defaultdict[str, list[Element]] = defaultdict(list)
    for child in element:
        kind = tag(child)
        found[kind].append(child)
        if kind.startswith('xacro:'):
            text = f'unprocessed xacro element <{kind}>; run xacro first'
            problems.error(child, f'{where}: {text}')
        warn_if_misspelt(child, where, kinds, problems)
    for kind in kinds:
        if len(found[kind]) < 2:
            continue
        count = f'{len(found[kind])} <{kind}> elements'
        if kind == READ_ONCE:
            hint = 'remove the others; this is the one that ROS tools use'
            problems.warning(found[kind][1], where, f'{count}; only the first one is used', hint)
        else:
            problems.error(found[kind][1], f'{where}: {count}, at most one allowed')
    return {kind: found[kind][0] for kind in kinds if found[kind]}


def warn_if_misspelt(
    element: Element, where: str, kinds: tuple[str, ...], problems: Problems
) -> None:
    """Warn if only the case of an element's name is wrong."""
    kind = tag(element)
    if kind not in kinds and kind.lower() in kinds:
        text = f'<{kind}> ignored; URDF spells it <{kind.lower()}>'
        problems.warning(element, where, text, _SPELLING)


def check_attributes(
    element: Element, where: str, problems: Problems
) -> dict[str, tuple[float, ...]]:
    """Check an element by its rule; return the numbers of the valid attributes."""
    kind = tag(element)
    rule = RULES[kind]
    values: dict[str, tuple[float, ...]] = {}
    missing = [name for name in rule.required if name not in element.attrib]
    if missing:
        problems.error(element, f'{where}: {_missing(kind, missing)}')
    for name, text in element.attrib.items():
        # The value of <mass value="2"/> is called 'mass', not 'mass value'.
        what = kind if name == 'value' else f'{kind} {name}'
        if name not in rule.names and name not in rule.numbers:
            if not rule.is_open and not _is_prefixed(name):
                unknown = f"attribute '{name}' is unknown and ignored"
                problems.warning(element, f'{where} {kind}', unknown, _SPELLING)
        elif is_xacro(text):
            looks = f'{quoted(text)} looks like unprocessed xacro'
            problems.error(element, f'{where} {what}: {looks}; run xacro first')
        elif name in rule.numbers:
            numbers = _numbers(text, rule.numbers[name])
            if isinstance(numbers, str):
                problems.error(element, f'{where} {what}: {numbers}')
            elif name in rule.not_negative and numbers[0] < 0.0:
                negative = f'{shortened(text.strip())} is negative'
                hint = '; for no limit write a large number' if kind == 'limit' else ''
                problems.error(element, f'{where}: {what} {negative}{hint}')
            else:
                values[name] = numbers
    return values


def _is_prefixed(name: str) -> bool:
    return ':' in name or name.startswith('{')


def _missing(kind: str, names: list[str]) -> str:
    if kind in ('mass', 'parent', 'child'):
        return f'<{kind} {names[0]}="..."/> is missing'
    return f'<{kind}> lacks {", ".join(names)}' if kind != 'axis' else "<axis> lacks 'xyz'"


def _numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the numbers in a text, or a message if they are not valid."""
    words = text.split() if text.isascii() else [text]
    if count > 1 and len(words) != count:
        hint = ' (use spaces, not commas)' if ',' in text else ''
        return f'expected {count} numbers, got {len(words)} in {quoted(text)}{hint}'
    wrong = [word for word in words if not is_finite_decimal(word)]
    if wrong or len(words) != count:
        # Only the wrong word of several is quoted, which is found sooner.
        shown = wrong[0] if count > 1 else text
        return f'{quoted(shown)} is not a finite decimal number'
    return tuple(float(word) for word in words)


def is_finite_decimal(word: str) -> bool:
    """Return whether a word is a decimal number that a float can hold."""
    return bool(_DECIMAL.fullmatch(word)) and math.isfinite(float(word))


def written(element: Element, name: str) -> str:
    """Return the text of an attribute on one line."""
    return ' '.join(element.get(name, '').split())
