"""Declares, reads and checks the parameters of the node with rclpy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from ..errors import ConfigurationError, did_you_mean, plain, shortened
from .parameter_types import INTEGER, Parameter
from .parameters import (
    Configuration,
    LOCKED,
    LOCKED_POSITION,
    PARAMETERS,
    VALUE_OF_URDF,
)
from .scheduling import available_cpus

_QOS = 'qos_overrides'  # prefix of parameters that rclpy declares
_RENAMED = {'payload_transition_time': 'load_ramp'}


def declare_parameters(node: Node) -> None:
    """
    Declare every parameter, with the values from the command line and parameter files.

    Parameters
    ----------
    node : Node
        The node that gets the parameters.

    Raises
    ------
    ConfigurationError
        Naming every parameter that is unknown or has an invalid value.

    """
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    locked = [name for name in given if name.startswith(f'{LOCKED}.')]
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update({name: given[name] for name in (*PARAMETERS, *locked) if name in given})
    problems = _problems(values)
    if values['allow_unknown_parameters'] is not True:
        unknown = unknown_overrides(node)
        problems += unknown
        if unknown:
            problems.append(
                'to ignore unknown parameters, for example in a file that several nodes share, '
                'set allow_unknown_parameters to true'
            )
    if problems:
        # Checked before anything is declared: rclpy would stop at the first value out of range.
        raise ConfigurationError(*problems)
    for name, parameter in PARAMETERS.items():
        try:
            node.declare_parameter(name, parameter.default, _descriptor(parameter))
        except Exception as error:
            raise ConfigurationError(f"parameter '{name}': {error}") from None
    # The joints are known only after a robot description has been loaded, so any name is accepted.
    for name in locked:
        node.declare_parameter(name, 0.0, _descriptor(LOCKED_POSITION))


def values_of(node: Node) -> dict[str, Any]:
    """Return the values of all parameters, by name."""
    locked = node.get_parameters_by_prefix(LOCKED)
    names = [*PARAMETERS, *(f'{LOCKED}.{joint}' for joint in locked)]
    return {name: node.get_parameter(name).value for name in names}


def read_configuration(node: Node) -> Configuration:
    """
    Read all parameters.

    Parameters
    ----------
    node : Node
        The node with the declared parameters.

    Returns
    -------
    configuration : Configuration
        The checked values.

    Raises
    ------
    ConfigurationError
        Naming every parameter with an invalid value.

    """
    return checked_configuration(values_of(node))


def checked_configuration(values: dict[str, Any]) -> Configuration:
    """
    Check all values together.

    Parameters
    ----------
    values : dict
        Values of all parameters, by name.

    Returns
    -------
    configuration : Configuration
        The checked values.

    Raises
    ------
    ConfigurationError
        Naming every parameter with an invalid value.

    """
    problems = _problems(values)
    if problems:
        raise ConfigurationError(*problems)
    checked = {name: parameter.check(values[name]) for name, parameter in PARAMETERS.items()}
    locked = {
        name.removeprefix(f'{LOCKED}.'): LOCKED_POSITION.check(value)
        for name, value in values.items()
        if name not in PARAMETERS
    }
    return Configuration(**checked, locked_positions=locked)


def unknown_parameters(node: Node, names: Iterable[str]) -> list[str]:
    """Describe each name that is not a parameter of a node, with the closest one."""
    known = [*PARAMETERS, *node._parameters]
    return [_describe_unknown(name, known) for name in names if name not in known]


def unknown_overrides(node: Node) -> list[str]:
    """Describe each name given at the start that is not a parameter of the node."""
    later = f'{LOCKED}.', f'{_QOS}.'  # may be declared later
    return unknown_parameters(
        node, (name for name in node._parameter_overrides if not name.startswith(later))
    )


def _describe_unknown(name: str, known: Iterable[str]) -> str:
    if not name:
        return 'a parameter without a name'
    if name in _RENAMED:
        return f"unknown parameter '{name}'; it is now called '{_RENAMED[name]}'"
    head, _, tail = name.partition('.')
    known = [*known, LOCKED]
    hint = did_you_mean(name, known) or did_you_mean(head, known)
    if LOCKED in hint:
        hint = f"; did you mean '{LOCKED}.{tail or '<joint>'}'?"
    if head in (LOCKED, _QOS):
        hint = ': it is set when the process starts'
    return f"unknown parameter '{shortened(name)}'{hint}"


def unused_qos_overrides(node: Node) -> list[str]:
    """Describe each QoS override that no publisher or subscription of the node has declared."""
    declared = [name for name in node._parameters if name.startswith(f'{_QOS}.')]
    return [
        f"parameter '{name}' matches no publisher or subscription of this node"
        + did_you_mean(name, declared)
        for name in node._parameter_overrides
        if name.startswith(f'{_QOS}.') and name not in declared
    ]


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    # Dynamic typing, because rclpy would reject 500 for 500.0. Parameter.check() checks the type
    # instead, and the range of integers and lists, which rclpy checks for single doubles only.
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=f'expected {parameter.kind.expected}; {parameter.applies}',
        dynamic_typing=True,
        read_only=parameter.is_read_only,
    )
    if parameter.range:
        lowest, highest = parameter.range
        if parameter.kind is INTEGER:
            descriptor.integer_range = [
                IntegerRange(from_value=int(lowest), to_value=int(highest))
            ]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=lowest, to_value=highest)
            ]
    return descriptor


def _problems(values: dict[str, Any]) -> list[str]:
    """Describe each invalid value and each invalid combination of values."""
    checked: dict[str, Any] = {}
    problems = []
    for name, value in values.items():
        try:
            checked[name] = PARAMETERS.get(name, LOCKED_POSITION).check(value)
        except ConfigurationError as error:
            problems.append(f"parameter '{name}' {error}")
    if checked.get('robot_description') and checked.get('robot_description_file'):
        problems.append('parameters robot_description and robot_description_file are both set')
    if 0.0 < checked.get('update_rate', 0.0) < 1.0:
        problems.append(
            f"parameter 'update_rate' is {checked['update_rate']:g}, expected 0 or at least 1"
        )
    unknown = sorted(set(checked.get('cpu_affinity', ())) - available_cpus())
    if unknown:
        expected = ', '.join(map(str, sorted(available_cpus())))
        problems.append(
            f"parameter 'cpu_affinity' contains {unknown[0]}, expected CPUs of this process: "
            f'{expected}'
        )
    # The range includes -1 for the value in the URDF; other negative numbers are invalid.
    for name in ('damping', 'coulomb'):
        numbers = np.atleast_1d(checked.get(name, 0.0))
        if ((numbers < 0.0) & (numbers != VALUE_OF_URDF)).any():
            problems.append(
                f"parameter '{name}' is {plain(values[name])}, expected -1 or numbers from 0"
            )
    return problems
