"""Writes identified values as node parameters in YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def node_parameters(
    title: Sequence[str],
    joint_names: Sequence[str],
    unknown: Mapping[str, str],
    values: Mapping[str, float | Sequence[float]],
) -> str:
    """
    Return the text of a file for ``--ros-args --params-file``.

    The title becomes a comment. `unknown` maps each joint whose friction is unknown to the
    reason. Each value is a number, or a list in the order of `joint_names`.

    """
    names = ', '.join("'" + name.replace("'", "''") + "'" for name in joint_names)
    lines = [
        *(f'# {line}' for line in title),
        *(
            f'# {name}: friction unknown, because {reason}. The value -1.0 selects URDF friction.'
            for name, reason in unknown.items()
        ),
        '/**:',
        '  ros__parameters:',
        f'    joints: [{names}]',
        '    include_friction: true',
    ]
    for name, value in values.items():
        if isinstance(value, float):
            lines.append(f'    {name}: {_decimal(value)}')
        else:
            lines.append(f'    {name}: [{", ".join(map(_decimal, value))}]')
    return '\n'.join(lines) + '\n'


def _decimal(value: float) -> str:
    """Format a number with a decimal point, because ROS would read `1` as an integer."""
    mantissa, e, exponent = f'{value:.10g}'.partition('e')
    return mantissa + ('' if '.' in mantissa else '.0') + e + exponent
