"""
A recorded run against the model: how much of the efforts it explains, and what the rest tells.

Arrays in, findings out: `identify` derives the motion from what was recorded, fits friction, and
names what would explain the difference between modelled and measured efforts.
"""

from .diagnoses import Diagnosis
from .findings import Findings, identify, JointFinding
from .friction import friction_parameters, FrictionFit
from .signals import Motion, Recording

__all__ = [
    'Diagnosis',
    'Findings',
    'FrictionFit',
    'JointFinding',
    'Motion',
    'Recording',
    'friction_parameters',
    'identify',
]
