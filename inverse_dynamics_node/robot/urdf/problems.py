"""Errors and warnings found in a URDF, and common parts of their messages."""

from __future__ import annotations

import math

from ..model_warning import ModelWarning
from .xml import Element, shortened, tag

_MAX_LINE = 65535
"""libxml2 keeps line numbers in 16 bits: this one stands for all later lines."""


class Problems:
    """The errors and warnings of one robot description, in the order of the document."""

    def __init__(self) -> None:
        self._errors: list[tuple[float, str]] = []
        self._warnings: list[tuple[float, ModelWarning]] = []

    @property
    def errors(self) -> list[str]:
        return [text for _, text in sorted(self._errors, key=lambda entry: entry[0])]

    @property
    def warnings(self) -> list[ModelWarning]:
        return [warning for _, warning in sorted(self._warnings, key=lambda entry: entry[0])]

    def error(self, element: Element, text: str) -> None:
        """Add an error at an element."""
        line = _line_of(element)
        text = text if line is None else f'line {line}: {text}'
        self._errors.append((element.sourceline, text))

    def error_of_all(self, text: str) -> None:
        """Add an error of the description as a whole; it follows all others."""
        self._errors.append((math.inf, text))

    def warning(self, element: Element, subject: str, text: str, hint: str) -> None:
        """Add a warning at an element."""
        warning = ModelWarning(text, hint, subject, _line_of(element))
        self._warnings.append((element.sourceline, warning))


def _line_of(element: Element) -> int | None:
    line: int = element.sourceline
    return line if line < _MAX_LINE else None


def label(element: Element) -> str:
    """Name a link or joint in a message."""
    return f"{tag(element)} '{element.get('name', '')}'"


def quoted(text: str) -> str:
    """Quote a value as it was found, or the start of a long one."""
    return f"'{shortened(text)}'"
