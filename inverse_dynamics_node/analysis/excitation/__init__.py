"""Designs a motion whose recording determines masses and friction as well as possible."""

from .clearance import CLEARANCE, Clearance, Extent, Nearest
from .fourier import FourierSeries
from .information import expected_errors, ExpectedErrors
from .limits import (
    FRACTION,
    keep_clear,
    motion_limits,
    MotionLimits,
    States,
    whole_positions,
    whole_states,
)
from .search import (
    CANDIDATES,
    DURATION,
    Excitation,
    find_excitation,
    HARMONICS,
    NOISE,
    SAMPLES_PER_SECOND,
)

__all__ = [
    'CANDIDATES',
    'CLEARANCE',
    'DURATION',
    'FRACTION',
    'HARMONICS',
    'NOISE',
    'SAMPLES_PER_SECOND',
    'Clearance',
    'Excitation',
    'ExpectedErrors',
    'Extent',
    'FourierSeries',
    'MotionLimits',
    'Nearest',
    'States',
    'expected_errors',
    'find_excitation',
    'keep_clear',
    'motion_limits',
    'whole_positions',
    'whole_states',
]
