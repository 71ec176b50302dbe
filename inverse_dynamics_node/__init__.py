"""Joint efforts for the joint accelerations you ask for, from a URDF. No ROS is imported here."""

from .dynamics import InverseDynamics
from .errors import ConfigurationError, InverseDynamicsError, JointStateError, UrdfError
from .model import RobotModel
from .specialise import Specialised
from .urdf import load_urdf

__all__ = [
    'ConfigurationError',
    'InverseDynamics',
    'InverseDynamicsError',
    'JointStateError',
    'RobotModel',
    'Specialised',
    'UrdfError',
    'load_urdf',
]
