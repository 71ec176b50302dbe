"""
Identifies inertial parameters, friction and armature of a robot from recordings.

`identify_parameters` fits bodies that remain physical and close to the robot description. It
evaluates the fit on data that were not used for the fit.
"""

from .identify import identify_parameters
from .result import BodyResult, DriveTerms, IdentificationResult, JointResult, Residuals, Unseen

__all__ = [
    'BodyResult',
    'DriveTerms',
    'IdentificationResult',
    'JointResult',
    'Residuals',
    'Unseen',
    'identify_parameters',
]
