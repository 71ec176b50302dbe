"""Loads a `RobotModel` from a URDF in six steps: read, parse, check, strip, evaluate, merge."""

from .loader import load_urdf

__all__ = ['load_urdf']
