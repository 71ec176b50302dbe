"""Declares the parameters of the node in rclpy, and reads and checks their values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rcl_interfaces.srv import ListParameters
from rclpy.node import Node

from ..errors import ConfigurationError, did_you_mean, shortened
from ..ros.private import overrides_of
from .parameter_types import INTEGER, Parameter
from .parameters import Configuration, LOCKED, LOCKED_POSITION, PARAMETERS

_QOS = 'qos_overrides'  # prefix of parameters that rclpy declares
_REMOVED = {
    'max_position_jump': 'set max_tracking_error, which also limits how far the arm falls behind',
    'allow_description_file_changes': 'robot_description_file is only read at the start',
    'cpu_affinity': 'start the node with a launch prefix, such as taskset --cpu-list 2',
    'effort_offset': 'correct a constant offset in the driver',
    'executor': 'the node always uses the EventsExecutor',
    'external_efforts_cutoff': '~/external_efforts are filtered at 10 Hz',
    'imu_filter_cutoff': 'the motion of the base is filtered at 20 Hz',
    'imu_timeout': 'the motion of the base counts as lost after 0.2 s',
    'load_ramp': 'loads are blended in over start_ramp',
    'lock_memory': 'on a robot, switch swap off (swapoff -a)',
    'on_missing_inertial': 'the node always warns',
    'payload_transition_time': 'a new payload is blended in over start_ramp',
    'stop_timeout': 'a stop is damped for at most 20 s',
    'uncommanded_state_timeout': 'a joint that is not commanded counts as late after 1 s',
    'sqrt_damping': 'use damping and coulomb, which identify fits instead',
}
"""Parameters of earlier versions, and what to do instead."""


def declare_parameters(node: Node) -> Configuration:
    """
    Declare all parameters, and return their values from the command line, files or defaults.

    Raise a ConfigurationError that names every unknown parameter and every invalid value.
    """
    given = overrides_of(node)
    locked = [name for name in given if name.startswith(f'{LOCKED}.')]
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update({name: given[name] for name in (*PARAMETERS, *locked) if name in given})
    checked, problems = _checked(values)
    problems += _contradiction(checked)
    if values['allow_unknown_parameters'] is not True:
        unknown = unknown_overrides(node)
        problems += unknown
        if unknown:
            problems.append(
                'to ignore unknown parameters, for example in a file that several nodes share, '
                'set allow_unknown_parameters to true'
            )
    if problems:
        # All values are checked first: rclpy would stop at the first out-of-range value.
        raise ConfigurationError(*problems)
    for name, parameter in PARAMETERS.items():
        try:
            node.declare_parameter(name, parameter.default, _descriptor(parameter))
        except Exception as error:
            raise ConfigurationError(f"parameter '{name}': {error}") from None
    # The joints are known only after a robot description has been loaded, so any name is accepted.
    for name in locked:
        node.declare_parameter(name, 0.0, _descriptor(LOCKED_POSITION))
    return Configuration(**checked)


def is_own_parameter(name: str) -> bool:
    """Return whether a parameter belongs to this node rather than to rclpy."""
    return name in PARAMETERS or name.startswith(f'{LOCKED}.')


def changed_configuration(before: Configuration, values: dict[str, Any]) -> Configuration:
    """
    Check new values together with the other parameters, and return all parameters.

    Raise a ConfigurationError that names every parameter with an invalid value.
    """
    checked, problems = _checked(values)
    locked = {**before.locked_positions, **checked.pop('locked_positions')}
    after = replace(before, **checked, locked_positions=locked)
    problems += _contradiction(vars(after))
    if problems:
        raise ConfigurationError(*problems)
    return after


def unknown_parameters(node: Node, names: Iterable[str]) -> list[str]:
    """Describe each unknown parameter name, and suggest the closest known name."""
    others = [name for name in names if name not in PARAMETERS]
    if not others:
        return []
    known = [*PARAMETERS, *_declared(node)]
    return [_describe_unknown(name, known) for name in others if name not in known]


def unknown_overrides(node: Node) -> list[str]:
    """Describe each unknown parameter on the command line or in parameter files."""
    later = f'{LOCKED}.', f'{_QOS}.'  # may be declared later
    return unknown_parameters(
        node, (name for name in overrides_of(node) if not name.startswith(later))
    )


def _describe_unknown(name: str, known: Iterable[str]) -> str:
    if not name:
        return 'a parameter without a name'
    if name in _REMOVED:
        return f"parameter '{name}' was removed: {_REMOVED[name]}"
    head, _, tail = name.partition('.')
    if tail and head in (LOCKED, _QOS):
        return f"parameter '{shortened(name)}' can only be set when the process starts"
    known = [*known, LOCKED]
    hint = did_you_mean(name, known) or did_you_mean(head, known)
    if LOCKED in hint:
        hint = f"; did you mean '{LOCKED}.{tail or '<joint>'}'?"
    return f"unknown parameter '{shortened(name)}'{hint}"


def _declared(node: Node) -> list[str]:
    names: list[str] = node.list_parameters([], ListParameters.Request.DEPTH_RECURSIVE).names
    return names


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    # Without dynamic typing, rclpy would reject 500 in place of 500.0. Parameter.check() checks
    # types and ranges, because rclpy does not check the ranges of lists.
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


def _checked(values: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the valid values as arguments for `Configuration`, and describe the invalid ones."""
    locked: dict[str, float] = {}
    checked: dict[str, Any] = {'locked_positions': locked}
    problems = []
    for name, value in values.items():
        try:
            if name in PARAMETERS:
                checked[name] = PARAMETERS[name].check(value)
            else:
                locked[name.removeprefix(f'{LOCKED}.')] = LOCKED_POSITION.check(value)
        except ConfigurationError as error:
            problems.append(f"parameter '{name}' {error}")
    return checked, problems


def _contradiction(checked: dict[str, Any]) -> list[str]:
    if checked.get('robot_description') and checked.get('robot_description_file'):
        return [
            'parameters robot_description and robot_description_file are both set, expected one'
        ]
    return []
