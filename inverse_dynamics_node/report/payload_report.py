"""Formats the results of `inverse_dynamics payload` as text, a table and JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..analysis.payload import PayloadEstimate
from ..analysis.recordings.signals import rms
from ..robot.model import RobotModel
from .diagnosis_text import amount, joined
from .tables import table, with_error


def verdict(result: PayloadEstimate) -> str:
    """Describe the payload in a few sentences."""
    mass = f'{with_error(result.body.mass, result.mass_error)} kg'
    if not result.is_certain:
        return (
            f"No payload can be seen on link '{result.link}': the measured mass is {mass}, "
            'which is not larger than three standard errors.'
        )
    text = f"Link '{result.link}' carries {mass}"
    if not result.unknown:
        com = ', '.join(
            with_error(1e3 * x, 1e3 * error)
            for x, error in zip(result.body.com, result.com_error, strict=True)
        )
        text += f', with its centre of mass at ({com}) mm.'
    else:
        text += (
            f'. The recordings do not determine {joined(result.unknown)} of the centre of mass: '
            'record poses or a motion that turn the payload about two horizontal axes.'
        )
    if result.is_scaled:
        ratio = with_error(result.ratio, result.ratio_error)
        text += (
            f' The efforts of the empty arm are {ratio} of those of its description. If the '
            f'description is right, the payload is {result.body.mass / result.ratio:.3g} kg.'
        )
    return text


def payload_table(result: PayloadEstimate, robot: RobotModel) -> str:
    """Return the RMS efforts of the payload and the RMS residuals, one row per joint."""
    rows = []
    for name, *values in zip(
        result.joint_names, rms(result.fitted), rms(result.residuals), strict=True
    ):
        slides = bool(robot.is_prismatic_joint[robot.joint_names.index(name)])
        rows.append((name, *(amount(value, slides) for value in values)))
    seconds = float(np.ptp(result.times))
    notes = [f'The empty run covers {result.matched:.0%} of {seconds:.1f} s of motion.']
    if not result.shows_inertia:
        notes.append('The inertia is assumed, because the recordings do not show it.')
    columns = ('joint', 'payload', 'residual')
    title = 'RMS efforts of the payload and RMS residuals'
    return table(title, columns, rows, notes)


def inertial_element(result: PayloadEstimate) -> str:
    """Return the payload as an <inertial> element for a URDF, in the frame of the link."""
    mass, com, inertia = result.body
    origin = ' '.join(f'{x:.4f}' for x in com)
    moments = ' '.join(
        f'i{"xyz"[i]}{"xyz"[j]}="{inertia[i, j]:.4g}"'
        for i, j in zip(*np.triu_indices(3), strict=True)
    )
    return (
        f'<inertial><origin xyz="{origin}"/><mass value="{mass:.4g}"/><inertia {moments}/>'
        '</inertial>'
    )


def as_json(result: PayloadEstimate) -> dict[str, Any]:
    """Return the result as values for JSON; unknown coordinates are NaN."""
    is_unknown = [axis in result.unknown for axis in 'xyz']
    has_ratio = not math.isnan(result.ratio_error)
    return {
        'link': result.link,
        'mass': result.body.mass,
        'mass_error': result.mass_error,
        'com': np.where(is_unknown, math.nan, result.body.com),
        'com_error': result.com_error,
        'inertia': result.body.inertia,
        'shows_inertia': result.shows_inertia,
        'is_certain': result.is_certain,
        'matched': result.matched,
        'ratio': result.ratio if has_ratio else math.nan,
        'ratio_error': result.ratio_error,
    }
