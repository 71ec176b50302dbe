"""Designs a motion whose recording determines masses and friction as well as possible."""

from .expected import expected_errors, ExpectedErrors
from .extent import Extent, swept_box
from .fourier import FourierSeries
from .limits import FRACTION, motion_limits, MotionLimits
from .search import (
    DURATION,
    Excitation,
    find_excitation,
    HARMONICS,
    NOISE,
    SAMPLES_PER_SECOND,
)
from .states import States, whole_states

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
