"""Writes an SROS 2 policy for the node and related programs, without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

from .remaps import LIFECYCLE_SERVICES, NodeNames, PUBLISHED_BY_ROS

_HEADER = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- Permissions for topics and services. doc/security.md describes how to use this file, and
     how to make one for other names. A node that lacks permission for a topic does not start. -->
"""
_SERVICES_OF_EVERY_NODE = (
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
    'get_type_description',
)
_ROBOT = 'joint_states', 'robot_description', 'imu'  # published by the robot, not by the user
_COMMANDS = '~/commands', '~/joint_commands', '~/joint_efforts'
_WATCHED = (
    '/diagnostics',
    '/rosout',
    '~/robot_description',
    'joint_states',
    '~/joint_efforts',
    '~/external_efforts',
)
_EVENTS = '/parameter_events'  # every rclpy node publishes on this topic
_SIMULATED = 'payload', 'push', 'tilt', 'sensors'  # topics of `inverse_dynamics simulate`


class Enclave(NamedTuple):
    """Permissions of the processes that share a certificate; all names are absolute."""

    path: str
    namespace: str
    node: str
    """Name of the node; has no effect, because all other names are absolute."""
    subscribe: tuple[str, ...]
    publish: tuple[str, ...]
    reply: tuple[str, ...] = ()
    """Services that the processes offer."""
    request: tuple[str, ...] = ()
    """Services that the processes call."""


def enclaves(
    arguments: Sequence[str],
    subscribed: Iterable[str],
    published: Iterable[str],
    services: Iterable[str],
) -> tuple[Enclave, ...]:
    """
    Return the enclaves of the node, its driver, `inverse_dynamics watch` and an operator.

    `arguments` is the command line of the node. The topics and services are those of the node,
    before remapping.
    """
    names = NodeNames(arguments)
    subscribed, published, services = tuple(subscribed), tuple(published), tuple(services)
    parent = names.namespace.rstrip('/')

    def resolved(given: Iterable[str]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(map(names.resolve, given)))

    clock = ('/clock',) * names.uses_sim_time
    own = (f'~/{name}' for name in _SERVICES_OF_EVERY_NODE)
    offered = resolved((*services, *LIFECYCLE_SERVICES, *own))
    simulated = f'{parent}/simulated_robot'
    node = Enclave(
        names.full_name,
        names.namespace,
        names.node,
        subscribe=resolved((*subscribed, *clock)),
        publish=resolved((*published, *PUBLISHED_BY_ROS)),
        reply=offered,
    )
    driver = Enclave(
        f'{parent}/driver',
        names.namespace,
        'driver',
        subscribe=(*resolved(_COMMANDS), *(f'{simulated}/{topic}' for topic in _SIMULATED)),
        publish=(*resolved((*_ROBOT, *clock, 'brakes')), '/rosout', _EVENTS),
        reply=tuple(f'{simulated}/{name}' for name in ('hold', *_SERVICES_OF_EVERY_NODE)),
    )
    watch = Enclave(
        f'{parent}/watch',
        names.namespace,
        'watch',
        subscribe=resolved(_WATCHED),
        publish=(_EVENTS,),
    )
    inputs = [topic for topic in subscribed if topic not in _ROBOT]
    operator = Enclave(
        f'{parent}/operator',
        names.namespace,
        'operator',
        subscribe=resolved((*published, *PUBLISHED_BY_ROS, *_ROBOT, *clock)),
        publish=(*resolved(inputs), '/rosout', _EVENTS),
        # The nodes of `ros2` and of user programs may have any name.
        reply=tuple(f'/*/{name}' for name in _SERVICES_OF_EVERY_NODE),
        request=offered,
    )
    return node, driver, watch, operator


def policy(found: Iterable[Enclave]) -> str:
    """Return the text of an SROS 2 policy file with these enclaves."""
    lines = ['<policy version="0.2.0">', '  <enclaves>']
    for enclave in found:
        lines += [
            f'    <enclave path={quoteattr(enclave.path)}>',
            '      <profiles>',
            f'        <profile ns={quoteattr(enclave.namespace)} node={quoteattr(enclave.node)}>',
            *_rules('topic', 'subscribe', enclave.subscribe),
            *_rules('topic', 'publish', enclave.publish),
            *_rules('service', 'reply', enclave.reply),
            *_rules('service', 'request', enclave.request),
            '        </profile>',
            '      </profiles>',
            '    </enclave>',
        ]
    return _HEADER + '\n'.join([*lines, '  </enclaves>', '</policy>']) + '\n'


def _rules(kind: str, permission: str, names: Sequence[str]) -> list[str]:
    if not names:
        return []
    entries = [f'            <{kind}>{escape(name)}</{kind}>' for name in names]
    return [f'          <{kind}s {permission}="ALLOW">', *entries, f'          </{kind}s>']
