"""The report of `identify` as values for JSON."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from ..analysis.identification import IdentificationResult, JointResult, Residuals
from .identification_tables import notes_of


def as_json(result: IdentificationResult) -> dict[str, Any]:
    """Return the report as values for JSON; lengths in m, masses in kg, efforts in N m or N."""
    report: dict[str, Any] = _plain(
        {
            'robot': result.robot.name,
            'accepted': result.accepted,
            'verdict': result.verdict,
            'unseen_data': result.unseen.description,
            'unseen_smoothing_window': result.unseen.smoothing,
            'joints': [_joint(joint) for joint in result.joints],
            'bodies': [
                {
                    'link': body.link,
                    'links': body.links,
                    'mass_before': body.mass_before,
                    'mass': body.mass if result.accepted else body.mass_before,
                    'mass_error': body.mass_error,
                    'com_before': body.com_before,
                    'com': body.com if result.accepted else body.com_before,
                    'com_error': body.com_error,
                    'data_fraction': body.data_fraction,
                }
                for body in result.bodies
            ],
            'base_parameters': [
                {'name': name, 'value': value, 'standard_error': error}
                for name, value, error in result.base_parameters
            ],
            'kept': result.fixed,
            'velocity_lags': result.signals[0].lags,
            'cut_off_frequency': result.signals[0].cut_off,
            'weight_of_urdf': result.urdf_weight,
            'tried_weights': [{'weight': weight, 'loss': loss} for weight, loss in result.trials],
            'effort_delay': result.delay,
            'effort_delay_error': result.delay_error,
            'effort_delay_removed': result.delay_removed,
            'smoothing_window': result.smoothing,
            'samples': result.sample_count,
            'duration': result.duration,
            'warnings': [f'{text}: {hint}' for text, hint in result.warnings],
            'notes': notes_of(result),
            'what_to_record_next': result.advice,
        }
    )
    return report


def _joint(joint: JointResult) -> dict[str, Any]:
    terms = joint.terms
    return {
        'name': joint.name,
        'unit': joint.unit,
        'measured': joint.measured,
        **_residuals(joint.unseen),
        'identified_unsmoothed': joint.unsmoothed,
        'noise': joint.noise,
        'training': _residuals(joint.training),
        'damping': terms.damping,
        'coulomb': terms.coulomb,
        'coulomb_width': terms.width,
        'load_friction': terms.load_friction,
        'sqrt_damping': terms.sqrt_damping,
        'armature': terms.armature,
        'coupling': terms.coupling,
        'stiffness': terms.stiffness,
        'rest': terms.rest,
        'offset': terms.offset,
        'standard_errors': terms.errors,
        'friction_unknown_because': joint.unknown_because,
        'coupled_with': joint.coupled_with,
        'gain': joint.gain,
    }


def _residuals(residuals: Residuals) -> dict[str, float]:
    return {
        'urdf': residuals.urdf,
        'friction': residuals.friction,
        'identified': residuals.identified,
    }


def _plain(value: Any) -> Any:
    """Convert to types that JSON has; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
