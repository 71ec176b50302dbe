"""The friction that the regression finds, and node parameters with its values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..node_parameters import node_parameters
from .regression import Fit
from .rows import COULOMB

SURELY_MOVING = 3.0  # multiple of the smoothing width; tanh(3) is 0.995
NOT_SHOWN = (
    'the efforts of this joint do not distinguish damping, Coulomb friction and an offset: move '
    'it in both directions, at different speeds'
)
ACCURATE = 0.1  # largest standard error of known friction, as a fraction of the RMS effort


class Value(NamedTuple):
    """A fitted value, and its standard error."""

    value: float = 0.0
    error: float = math.nan


class Friction(NamedTuple):
    """
    Friction and offset of a joint.

    The effort is ``damping * qd + (coulomb + load_friction * |effort|) * tanh(qd / width) +
    offset``, for speeds above the smoothing width. `effort` is the modelled effort of the links.
    """

    damping: Value = Value()
    """Damping [N m s/rad or N s/m]."""
    coulomb: Value = Value()
    """Coulomb friction [N m or N]."""
    load_friction: Value = Value()
    """Additional Coulomb friction per unit of the effort."""
    offset: Value = Value()
    """Constant offset of the effort [N m or N]."""
    unknown_because: str = ''
    """Reason why all values are unknown, or ''."""


def is_moving(qd: Floats, width: float) -> Booleans:
    """Return a mask of the samples with enough speed for full Coulomb friction."""
    return np.asarray(np.abs(qd) > SURELY_MOVING * width)


def frictions(fit: Fit, moves: Booleans) -> list[Friction]:
    """Return the friction of each joint; `fit` should have offsets, which look like friction."""
    found = []
    for j, moving in enumerate(moves.tolist()):
        values, errors = fit.drives[j], fit.drive_errors[j]
        is_known = (errors * fit.columns.sizes[j])[: COULOMB + 1].max() < ACCURATE * fit.rms[j]
        if moving and is_known:
            damping, coulomb, per_load, _, offset = map(Value, values.tolist(), errors.tolist())
            friction = Friction(damping, coulomb, per_load, offset)
        else:
            friction = Friction(unknown_because=NOT_SHOWN if moving else 'this joint rested')
        found.append(friction)
    return found


def friction_parameters(fits: Mapping[str, Friction], armature: Sequence[float] = ()) -> str:
    """
    Return node parameters with the fitted friction of each joint, as YAML text.

    The node uses the friction of the URDF for joints with unknown friction. `armature` contains
    the rotor inertia of each joint [kg m^2 or kg], or is empty.
    """
    every = fits.values()
    values: dict[str, float | Sequence[float]] = {
        'damping': [-1.0 if fit.unknown_because else fit.damping.value for fit in every],
        'coulomb': [-1.0 if fit.unknown_because else fit.coulomb.value for fit in every],
        'load_friction': [fit.load_friction.value for fit in every],
    }
    if armature:
        values['armature'] = armature
    title = (
        'Friction fitted to a recording: damping [N m s/rad, N s/m] and Coulomb friction [N m, N].'
    )
    unknown = {name: fit.unknown_because for name, fit in fits.items() if fit.unknown_because}
    return node_parameters([title], [*fits], unknown, values)
