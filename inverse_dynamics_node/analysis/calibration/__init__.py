"""
Identifies inertial parameters, friction and armature of a robot from recordings.

`calibrate` fits bodies that remain physical and close to the robot description, and evaluates them
on data that the fit has not seen.
"""

from .calibration import calibrate
from .result import BodyResult, Calibration, JointResult, JointTerms, Residuals, Unseen

__all__ = [
    'BodyResult',
    'Calibration',
    'JointResult',
    'JointTerms',
    'Residuals',
    'Unseen',
    'calibrate',
]
