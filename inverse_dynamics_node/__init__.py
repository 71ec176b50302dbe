"""
Inverse dynamics of a robot described by a URDF, and a ROS 2 node that publishes joint efforts.

This module does not import ROS. The names below are imported on first use, because importing numpy
and numba takes half a second.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from .dynamics.inverse_dynamics import InverseDynamics
    from .errors import (
        ConfigurationError,
        InverseDynamicsError,
        JointStateError,
        TrajectoryError,
        UrdfError,
    )
    from .robot.model import RobotModel
    from .robot.urdf import load_urdf

_HOMES = {  # of names that are not in errors.py
    'InverseDynamics': 'dynamics.inverse_dynamics',
    'RobotModel': 'robot.model',
    'load_urdf': 'robot.urdf',
}

__all__ = [
    'ConfigurationError',
    'InverseDynamics',
    'InverseDynamicsError',
    'JointStateError',
    'RobotModel',
    'TrajectoryError',
    'UrdfError',
    'load_urdf',
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'.{_HOMES.get(name, "errors")}', __name__), name)
