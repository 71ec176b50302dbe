"""The phases of the controller."""

from __future__ import annotations

import enum


class Phase(enum.Enum):
    """State of the controller."""

    WAITING = 'waiting for the first complete joint state'
    RUNNING = 'following the reference'
    HOLDING = 'holding position'
    TOO_FAR = 'holding position: the reference is too far away'
    STATE_LOST = 'joint states lost'
    NO_SOLUTION = 'no finite efforts for this joint state and reference'
    STOPPED = 'stopped'


COMPUTING_PHASES = (Phase.RUNNING, Phase.HOLDING, Phase.TOO_FAR)
"""Phases in which efforts are computed from a fresh state."""
