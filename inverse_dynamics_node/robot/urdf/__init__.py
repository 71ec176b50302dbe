"""Loads a `RobotModel` from a URDF: read, parse, check, strip, evaluate, merge."""

from .loader import load_urdf

__all__ = ['load_urdf']
