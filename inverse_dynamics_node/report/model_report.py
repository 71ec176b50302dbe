"""The description of a robot as plain text."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics
from .robot_tables import model_tables
from .tables import as_text
from .warnings import warnings_about, warnings_as_text


def model_report(
    dynamics: InverseDynamics,
    joints: Sequence[str] = (),
    q: ArrayLike | None = None,
    effort_limits: ArrayLike | None = None,
) -> str:
    """
    Describe the robot in plain text, at most 100 columns wide.

    Parameters
    ----------
    dynamics, joints, q, effort_limits
        As for `model_tables`.

    Returns
    -------
    text : str
        Several lines, without a line end after the last.

    Raises
    ------
    ConfigurationError, JointStateError
        As for `model_tables`.

    """
    tables = model_tables(dynamics, joints, q, effort_limits)
    warnings = warnings_about(dynamics.robot)
    return '\n\n'.join([*map(as_text, tables), warnings_as_text(warnings)])
