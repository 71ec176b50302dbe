"""Formats the results of `inverse_dynamics payload` as text, tables and JSON."""

from __future__ import annotations

import math
from typing import Any

from ..analysis.payload import PayloadEstimate
from ..analysis.recordings.signals import rms
from ..robot.model import RobotModel
from .diagnosis_text import amount, joined
from .tables import table, with_error


def verdict(result: PayloadEstimate) -> str:
    """Describe the payload in one or two sentences."""
    mass = f'{with_error(result.body.mass, result.mass_error)} kg'
    if not result.is_certain:
        return (
            f"No payload can be seen on link '{result.link}': the measured mass is {mass}, "
            'which is not larger than three standard errors.'
        )
    text = f"Link '{result.link}' carries {mass}"
    if not result.unknown:
        com = ', '.join(f'{1e3 * x:.0f}' for x in result.body.com)
        error = 1e3 * float(max(result.com_error))
        text += f', with its centre of mass at ({com}) ± {max(error, 1.0):.0f} mm.'
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
    for name, measured, left in zip(
        result.joint_names, rms(result.fitted), rms(result.residuals), strict=True
    ):
        slides = bool(robot.is_prismatic_joint[robot.joint_names.index(name)])
        rows.append((name, amount(measured, slides), amount(left, slides)))
    compared = f'{result.poses} poses' if result.poses else f'{result.duration:.1f} s of motion'
    what = 'these poses' if result.poses else 'this motion'
    notes = [f'Measured from {compared}; the empty run covers {result.matched:.0%} of {what}.']
    if not result.shows_inertia:
        notes.append('The inertia is assumed, because the recordings do not show it.')
    columns = ('joint', 'payload', 'residual')
    title = 'RMS efforts of the payload and RMS residuals'
    return table(title, columns, rows, notes)


def inertia_table(result: PayloadEstimate) -> str:
    """Return the mass and the centre of mass, with standard errors."""
    rows = [('mass [kg]', with_error(result.body.mass, result.mass_error))]
    rows += [
        (f'{axis} [mm]', 'unknown' if axis in result.unknown else with_error(1e3 * x, 1e3 * error))
        for axis, x, error in zip('xyz', result.body.com, result.com_error, strict=True)
    ]
    return table(f'Payload in the frame of {result.link}', ('', 'value'), rows)


def topic_command(result: PayloadEstimate) -> str:
    """Return the command that publishes the payload to a node."""
    mass, com, inertia = result.body
    x, y, z = com
    numbers = [f'm: {mass:.4g}', f'com: {{x: {x:.4f}, y: {y:.4f}, z: {z:.4f}}}']
    numbers += [f'{name}: {value:.4g}' for name, value in _moments(inertia)]
    message = f'{{header: {{frame_id: {result.link}}}, inertia: {{{", ".join(numbers)}}}}}'
    topic = '/inverse_dynamics/payload'
    return f"ros2 topic pub --once {topic} geometry_msgs/msg/InertiaStamped '{message}'"


def inertial_element(result: PayloadEstimate) -> str:
    """Return the payload as an <inertial> element for a URDF, in the frame of the link."""
    mass, com, inertia = result.body
    origin = ' '.join(f'{x:.4f}' for x in com)
    moments = ' '.join(f'{name}="{value:.4g}"' for name, value in _moments(inertia))
    return (
        f'<inertial><origin xyz="{origin}"/><mass value="{mass:.4g}"/><inertia {moments}/>'
        '</inertial>'
    )


def as_json(result: PayloadEstimate) -> dict[str, Any]:
    """Return the result as values for JSON; unknown coordinates are null."""
    return {
        'link': result.link,
        'mass': result.body.mass,
        'mass_error': result.mass_error,
        'com': [
            None if axis in result.unknown else x
            for axis, x in zip('xyz', result.body.com, strict=True)
        ],
        'com_error': result.com_error.tolist(),
        'inertia': result.body.inertia.tolist(),
        'shows_inertia': result.shows_inertia,
        'is_certain': result.is_certain,
        'poses': result.poses,
        'duration': result.duration,
        'matched': result.matched,
        'ratio': None if math.isnan(result.ratio_error) else result.ratio,
        'ratio_error': None if math.isnan(result.ratio_error) else result.ratio_error,
        'joints': [
            {'name': name, 'payload': measured, 'left': left}
            for name, measured, left in zip(
                result.joint_names,
                rms(result.fitted).tolist(),
                rms(result.residuals).tolist(),
                strict=True,
            )
        ],
    }


def _moments(inertia: Any) -> list[tuple[str, float]]:
    return [
        (f'i{a}{b}', float(inertia['xyz'.index(a), 'xyz'.index(b)]))
        for a, b in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')
    ]
