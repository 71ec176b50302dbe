"""Shortened names that remain distinguishable."""

from __future__ import annotations

from collections.abc import Sequence

SHORTEST_NAME = 12
"""Names are not shortened to fewer characters than this."""


def all_shortened(names: Sequence[str], size: int) -> list[str]:
    """Shorten names so that they remain distinct; a common prefix is dropped first."""
    short = [shortened(name, size) for name in names]
    if len(set(short)) == len(set(names)):
        return short
    head = _common_prefix(names)
    tail = _common_prefix([name[head:][::-1] for name in names])
    # Keep the part in which the names differ.
    parts = [name[head : len(name) - tail] for name in names]
    short = [f'…{shortened(part, size - 1)}' if head else shortened(part, size) for part in parts]
    for first in (size // 3, size // 4, 2 * size // 3, 1):
        if len(set(short)) == len(set(names)):
            break
        # Names of several branches differ at both ends: keep more of one of them.
        rest = size - 1 - first
        short = [n if len(n) <= size else f'{n[:first]}…{n[len(n) - rest :]}' for n in names]
    return short


def shortened(text: str, size: int) -> str:
    """Shorten a text in its middle, because joint names differ at their start or end."""
    if len(text) <= size:
        return text
    stem = text.removesuffix('_joint')
    if stem != text and size >= SHORTEST_NAME:  # the suffix carries no information
        return f'{shortened(stem, size - 1)}…'
    head = (size - 1) // 2
    return f'{text[:head]}…{text[len(text) - (size - 1 - head) :]}'


def _common_prefix(names: Sequence[str]) -> int:
    """Return the length of the common prefix of the names."""
    letters = list(zip(*names, strict=False))
    return next((i for i, each in enumerate(letters) if len(set(each)) > 1), len(letters))
