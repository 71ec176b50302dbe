"""Judges a running node: whether every commanded joint was checked, and agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .live import Agreement, Check, Obstacle, Outcome


class Gate:
    """
    Collects the results of a whole run.

    A joint that was checked once stays checked. A difference stays a difference. `accepted` are
    joints that need no check.
    """

    def __init__(self, accepted: Sequence[str] = ()) -> None:
        self.accepted = tuple(accepted)
        self._done: set[str] = set()
        self._difference: Agreement | None = None

    def add(self, agreement: Agreement) -> Agreement:
        """Return the result of the run so far, given the latest result of the window."""
        self._done |= {name for name, check in agreement.checks.items() if check is Check.DONE}
        checks = {
            name: Check.DONE if name in self._done else check
            for name, check in agreement.checks.items()
            if name not in self.accepted
        }
        agreement = replace(agreement, checks=checks)
        if agreement.outcome is Outcome.DIFFER and agreement.faults:
            self._difference = agreement
        elif self._difference is not None:
            return replace(self._difference, is_past=True)
        if agreement.outcome is Outcome.AGREE and agreement.unchecked:
            return replace(agreement, obstacle=Obstacle.NOT_CHECKED)
        return agreement
