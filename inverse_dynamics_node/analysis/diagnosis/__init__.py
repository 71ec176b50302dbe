"""Compares recorded efforts with the model, and diagnoses the differences."""

from .fault import Change, Fault, FaultKind, GravityConvention, is_usual
from .friction import friction_parameters, FrictionFit
from .recording import ComparisonResult, diagnose_recording, JointResidual

__all__ = [
    'Change',
    'ComparisonResult',
    'Fault',
    'FaultKind',
    'FrictionFit',
    'GravityConvention',
    'JointResidual',
    'diagnose_recording',
    'friction_parameters',
    'is_usual',
]
