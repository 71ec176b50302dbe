"""Identified values, written as parameters of the node in YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def node_parameters(
    title: Sequence[str],
    joint_names: Sequence[str],
    unknown: Mapping[str, str],
    values: Mapping[str, float | Sequence[float]],
) -> str:
    """
    Write a file for ``--ros-args --params-file``.

    Parameters
    ----------
    title : sequence of str
        Lines of the comment at the top.
    joint_names : sequence of str
        The joints, in the order of the lists.
    unknown : mapping of str to str
        Joints whose friction is that of the URDF, with the reason.
    values : mapping of str to float or sequence of float
        The parameters by name.

    """
    names = ', '.join("'" + name.replace("'", "''") + "'" for name in joint_names)
    lines = [
        *(f'# {line}' for line in title),
        *(
            f'# {name}: unknown, {reason}; -1.0 selects the friction of the URDF.'
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
    """Write a number with a decimal point, so that ROS reads a list of numbers as decimals."""
    text = f'{value:.10g}'
    if 'e' in text:
        mantissa, exponent = text.split('e')
        return f'{mantissa if "." in mantissa else mantissa + ".0"}e{exponent}'
    return text if '.' in text else text + '.0'
