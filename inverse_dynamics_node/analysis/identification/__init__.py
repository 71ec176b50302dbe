"""
Compares a recording with the model, fits friction and diagnoses the differences.

`identify` derives the motion from the recorded joint states, fits friction, and searches for an
explanation of the difference between measured and modelled efforts.
"""

from .comparison import identify
from .diagnoses import Change, Diagnosis
from .findings import Findings, JointFinding
from .friction import friction_parameters, FrictionFit
from .recorded_column import Recording
from .signals import Motion

__all__ = [
    'Change',
    'Diagnosis',
    'Findings',
    'FrictionFit',
    'JointFinding',
    'Motion',
    'Recording',
    'friction_parameters',
    'identify',
]
