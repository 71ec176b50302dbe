"""
Compares a recording with the model, fits friction and diagnoses the differences.

`diagnose_recording` derives the motion from the recorded joint states, fits friction, and searches
for an explanation of the difference between measured and modelled efforts.
"""

from ..recordings.signals import Motion, Recording
from .fault import Change, Fault, FaultKind, GravityConvention
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
    'Motion',
    'Recording',
    'diagnose_recording',
    'friction_parameters',
]
