"""Designs a motion whose recording determines masses and friction as well as possible."""

from .fourier import FourierSeries
from .information import expected_errors, ExpectedErrors
from .limits import (
    Extent,
    FRACTION,
    motion_limits,
    MotionLimits,
    States,
    swept_box,
    whole_states,
)
from .search import (
    DURATION,
    Excitation,
    find_excitation,
    HARMONICS,
    NOISE,
    SAMPLES_PER_SECOND,
)

__all__ = [
    'DURATION',
    'FRACTION',
    'HARMONICS',
    'NOISE',
    'SAMPLES_PER_SECOND',
    'Excitation',
    'ExpectedErrors',
    'Extent',
    'FourierSeries',
    'MotionLimits',
    'States',
    'expected_errors',
    'find_excitation',
    'motion_limits',
    'swept_box',
    'whole_states',
]
