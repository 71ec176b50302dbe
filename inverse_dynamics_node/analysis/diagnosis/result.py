"""The results of a comparison between a recording and the model."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from ...robot.model import Floats
from ..recordings.signals import Motion
from .fault import Fault
from .friction import FrictionFit


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Measured and modelled effort of one joint, in N m or N."""

    name: str
    is_prismatic: bool
    rms_measured: float
    rms_modelled: float
    rms_residual: float
    """RMS of measured minus modelled effort."""
    rms_friction: float
    """The same with fitted friction, but without faults and offset."""
    rms_corrected: float
    """The same with fitted friction, offset and the faults."""
    noise: float
    """Standard deviation of the noise that smoothing leaves; a smaller residual is explained.

    NaN if the recording was filtered before.
    """
    scale: float
    """Measured effort is about ``scale * modelled + offset``, by least squares."""
    offset: float
    friction: FrictionFit
    is_varying: bool
    """Whether the measured effort varies."""

    @property
    def explained(self) -> float:
        """Fraction of the squares of the effort that the model explains; NaN if constant."""
        return self._explained(self.rms_residual)

    @property
    def explained_corrected(self) -> float:
        """The same with fitted friction and offset, and the faults."""
        return self._explained(self.rms_corrected)

    def _explained(self, residual: float) -> float:
        return 1.0 - (residual / self.rms_measured) ** 2 if self.is_varying else math.nan


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """The comparison of the K samples of a recording with the model."""

    motion: Motion
    """The derived motion of all recorded joints."""
    compared: tuple[int, ...]
    """Indices of the joints of the motion that have a measured effort; c of them."""
    joints: tuple[JointResidual, ...]
    """Residuals of these joints."""
    measured: Floats
    """Measured efforts, shape (K, c) [N m or N]."""
    modelled: Floats
    """Modelled efforts, shape (K, c) [N m or N]; with friction if the dynamics have friction."""
    corrected: Floats
    """
    Efforts of the corrected model, as they would be recorded, shape (K, c) [N m or N].

    The corrections are the fitted friction and the faults.
    """
    faults: tuple[Fault, ...]
    """Explanations of the difference, most important first; empty if none is needed."""
    width: float
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""
    is_too_short: bool
    """Whether there are too few samples to diagnose a difference."""
    moving: tuple[int, ...]
    """Indices in ``joints`` of those that the sums below contain: those that moved, if any."""

    @property
    def explained(self) -> float:
        """Explained fraction of the squares: mean of revolute and of prismatic joints."""
        return self._mean([joint.rms_residual for joint in self.joints])

    @property
    def explained_corrected(self) -> float:
        """The same with fitted friction and offset, and the faults."""
        return self._mean([joint.rms_corrected for joint in self.joints])

    def _mean(self, residuals: list[float]) -> float:
        measured, remaining = {False: 0.0, True: 0.0}, {False: 0.0, True: 0.0}
        for c in self.moving:
            joint = self.joints[c]
            measured[joint.is_prismatic] += joint.rms_measured**2
            remaining[joint.is_prismatic] += residuals[c] ** 2
        fractions = [1.0 - remaining[kind] / measured[kind] for kind in measured if measured[kind]]
        return float(np.mean(fractions)) if fractions else math.nan
