"""Compares recorded efforts with the model, and diagnoses the differences."""

from .fault import Fault, FaultKind, GravityConvention, is_usual
from .friction import Friction, friction_parameters
from .recording import ComparisonResult, diagnose_recording, JointResidual

__all__ = [
    'ComparisonResult',
    'Fault',
    'FaultKind',
    'Friction',
    'GravityConvention',
    'JointResidual',
    'diagnose_recording',
    'friction_parameters',
    'is_usual',
]
