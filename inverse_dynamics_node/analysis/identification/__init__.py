"""
Identifies inertial parameters, friction and armature of a robot from recordings.

The function `identify_parameters` fits inertial parameters that are physically possible and stay
close to the robot description. The result is evaluated on data that were not used for the fit.
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
