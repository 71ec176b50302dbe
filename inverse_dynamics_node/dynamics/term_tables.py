"""Tables that leave one of the terms of the efforts."""

from __future__ import annotations

from typing import Any

from ..robot.model import Floats
from . import columns

_NO_BODIES = (columns.MASS, columns.INERTIA_COLUMNS, columns.BASE_MOTION_COLUMNS)
_NO_JOINT_TERMS = (columns.JOINT_TERM_COLUMNS, columns.HAS_JOINT_TERMS)
TERMS: dict[str, tuple[int | slice, ...]] = {
    'inertial': (
        columns.BASE_MOTION_COLUMNS,
        columns.EXTERNAL_COLUMNS,
        columns.DAMPING,
        columns.COULOMB,
        columns.LOAD_FRICTION,
    ),
    'velocity': (
        columns.BASE_ACCELERATION_COLUMNS,
        columns.EXTERNAL_COLUMNS,
        *_NO_JOINT_TERMS,
    ),
    'gravity': (columns.EXTERNAL_COLUMNS, *_NO_JOINT_TERMS),
    'external': (*_NO_BODIES, *_NO_JOINT_TERMS),
}
"""Terms of the efforts, and the columns that are zero in the table that computes each of them."""


class TermTables:
    """
    Robot tables that leave one of the `TERMS`, kept until the loads change.

    Parameters
    ----------
    table : ndarray, shape (b, COLUMNS)
        The table with all terms.

    """

    def __init__(self, table: Floats) -> None:
        self._table = table
        self._kept: dict[str, tuple[int, Any]] = {}
        self._of_kernel: tuple[Any, ...] = ()
        self._revision = -1

    def only(self, term: str, revision: int) -> Any:
        """
        Return the table of a term.

        Parameters
        ----------
        term : str
            One of the `TERMS`.
        revision : int
            Changes with every change of the table with all terms.

        """
        last, table = self._kept.get(term, (-1, None))
        if last != revision:
            reduced = self._table.copy()
            for part in TERMS[term]:
                reduced[:, part] = 0.0
            table = reduced
            self._kept[term] = revision, table
        return table

    def of_kernel(self, revision: int) -> tuple[Any, ...]:
        """Return the tables that `effort_terms.effort_terms` takes."""
        if self._revision != revision:
            terms = ('inertial', 'velocity', 'gravity', 'external')
            self._of_kernel = tuple(self.only(term, revision) for term in terms)
            self._revision = revision
        return self._of_kernel
