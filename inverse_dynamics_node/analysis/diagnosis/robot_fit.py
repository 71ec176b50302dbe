"""An explanation of measured efforts: a model of the robot, and a fit of every joint."""

from __future__ import annotations

from typing import NamedTuple

from ...robot.model import Floats
from .fault import FaultKind
from .joint_samples import JointFit, PARAMETER_COST

UNIT_PARAMETERS = 2  # a unit has the weight of two parameters, because it is rarely wrong


class CandidateModel(NamedTuple):
    """A composition of the efforts of the whole robot."""

    kind: FaultKind | None
    """Gravity that is compensated, a mounting or a payload; None for the model as it is."""
    weights: Floats
    """Factors of the first columns of the samples."""
    parameters: int
    """Number of parameters."""
    is_gravity_compensated: bool = False
    """Whether the gravity efforts of the model are left out."""
    link: str = ''
    """Link that carries the payload."""
    solution: tuple[float, ...] = ()
    """Fitted gravity [m/s^2]; or mass [kg] and centre of mass [m]."""
    errors: tuple[float, ...] = ()
    """Standard errors of the solution."""


class RobotFit(NamedTuple):
    """A candidate model, and the fit of every joint to it."""

    candidate: CandidateModel
    fits: tuple[JointFit, ...]
    source: tuple[int, ...]
    """Index of the measured effort that belongs to each joint."""
    unit: float = 1.0
    """Factor of the measured efforts of all joints."""

    @property
    def cost(self) -> float:
        """Logarithm of the remaining squares, plus the cost of all parameters."""
        moved = sum(i != j for i, j in enumerate(self.source))
        parameters = self.candidate.parameters + moved + UNIT_PARAMETERS * (self.unit != 1.0)
        return sum(fit.cost for fit in self.fits) + PARAMETER_COST * parameters

    @property
    def is_scaled(self) -> bool:
        """Whether the effort of a joint has another unit."""
        return self.unit != 1.0 or any(fit.sensor_fault.is_scaled for fit in self.fits)

    @property
    def changes_nothing(self) -> bool:
        """Whether the model with friction is all that there is."""
        return (
            self.candidate.kind is None
            and self.unit == 1.0
            and self.source == tuple(range(len(self.source)))
            and not any(any(fit.sensor_fault) for fit in self.fits)
        )

    def factor(self, joint: int) -> float:
        """Return the measured effort of a joint divided by its actual effort, without sign."""
        return self.unit * self.fits[joint].scale
