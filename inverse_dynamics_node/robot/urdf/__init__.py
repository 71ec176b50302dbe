"""Loads a `RobotModel` from a URDF, and writes inertials and friction into a URDF."""

from .loader import load_urdf

__all__ = ['load_urdf']
