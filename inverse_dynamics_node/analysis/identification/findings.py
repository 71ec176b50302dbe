"""The results of a comparison between a recording and the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robot.model import Floats
from .diagnoses import Diagnosis
from .friction import FrictionFit
from .signals import Motion


@dataclass(frozen=True, eq=False)
class JointFinding:
    """Measured and modelled effort of one joint, in N m or N."""

    name: str
    is_prismatic: bool
    rms_measured: float
    rms_modelled: float
    rms_residual: float
    """RMS of measured minus modelled effort."""
    explained: float
    """Explained fraction of the variance of the measured effort; NaN if it is constant."""
    explained_with_mean: float
    """Explained fraction of the squares of the measured effort; NaN if it is zero."""
    scale: float
    """Measured effort is about ``scale * modelled + offset``, by least squares."""
    offset: float
    friction: FrictionFit
    explained_corrected: float
    """
    Like ``explained``, for the model corrected by fitted friction, offset and diagnoses.

    If the friction was identified, only while the joint moves: dry friction at rest can have any
    value up to its maximum.
    """


@dataclass(frozen=True, eq=False)
class Findings:
    """The comparison of the K samples of a recording with the model."""

    motion: Motion
    """The derived motion of all recorded joints."""
    compared: tuple[int, ...]
    """Indices of the joints of the motion that have a measured effort; c of them."""
    joints: tuple[JointFinding, ...]
    """Findings for these joints."""
    measured: Floats
    """Measured efforts, shape (K, c) [N m or N]."""
    modelled: Floats
    """Modelled efforts, shape (K, c) [N m or N]; with friction if the dynamics have friction."""
    corrected: Floats
    """
    Efforts of the corrected model, as they would be recorded, shape (K, c) [N m or N].

    The corrections are the fitted friction and the diagnoses.
    """
    diagnoses: tuple[Diagnosis, ...]
    """Explanations of the difference, most important first; empty if none is needed."""
    explained: float
    """Explained fraction of the variance: mean of revolute and of prismatic joints."""
    explained_corrected: float
    """The same for the corrected model and the joints whose friction could be identified."""
    width: float
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""


def explained_fraction(measured: Floats, modelled: Floats) -> float:
    """Return the explained fraction of the variance; NaN if the measured effort is constant."""
    variance = float(np.var(measured))
    if variance <= (1e-6 * float(np.max(np.abs(measured)))) ** 2:
        return np.nan
    return 1.0 - float(np.var(measured - modelled)) / variance
