"""What is found wrong or odd in a URDF, and the words it is told in."""

from __future__ import annotations

import math

from .xml import Element, shortened, tag

_MAX_LINE = 65535
"""libxml2 keeps lines in 16 bits: this one stands for all that follow."""


class Findings:
    """What is wrong and what is odd, told in the order of the document."""

    def __init__(self) -> None:
        self._problems: list[tuple[float, str]] = []
        self._warnings: list[tuple[float, str]] = []

    @property
    def problems(self) -> list[str]:
        return [text for _, text in sorted(self._problems, key=lambda entry: entry[0])]

    @property
    def warnings(self) -> list[str]:
        return [text for _, text in sorted(self._warnings, key=lambda entry: entry[0])]

    def problem(self, element: Element, text: str) -> None:
        self._problems.append(_with_line(element, text))

    def problem_of_all(self, text: str) -> None:
        self._problems.append((math.inf, text))

    def warning(self, element: Element, text: str) -> None:
        self._warnings.append(_with_line(element, text))


def _with_line(element: Element, text: str) -> tuple[float, str]:
    line = element.sourceline
    return line, f'line {line}: {text}' if line < _MAX_LINE else text


def label(element: Element) -> str:
    """Name a link or joint in a message."""
    return f"{tag(element)} '{element.get('name', '')}'"


def quoted(text: str) -> str:
    """Quote a value as it was found, or the start of a long one."""
    return f"'{shortened(text)}'"
