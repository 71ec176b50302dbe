"""
Lists the topics and services of the node, and writes an SROS 2 policy for them.

The policy also covers the driver, `inverse_dynamics watch` and operators. This module does not
import ROS.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

from .remaps import LIFECYCLE_SERVICES, NodeNames, PUBLISHED_BY_ROS

SUBSCRIBED = {
    'joint_states': ('sensor_msgs/JointState', 'measured state'),
    'robot_description': ('std_msgs/String', 'URDF, unless a parameter sets it'),
    '~/desired_accelerations': ('std_msgs/Float64MultiArray', 'accelerations in joint order'),
    '~/reference': ('trajectory_msgs/JointTrajectory', 'reference by joint name'),
    '~/joint_trajectory_in': ('trajectory_msgs/JointTrajectory', 'trajectory to add efforts to'),
    '~/payload': ('geometry_msgs/InertiaStamped', 'rigid load on a link'),
    '~/external_wrench': ('geometry_msgs/WrenchStamped', 'wrench exerted on the robot'),
    '~/gravity': ('geometry_msgs/Vector3Stamped', 'free-fall acceleration'),
    'imu': ('sensor_msgs/Imu', 'base motion (if base_motion is imu)'),
}
PUBLISHED = {
    '~/commands': ('std_msgs/Float64MultiArray', 'efforts in joint order'),
    '~/joint_efforts': ('sensor_msgs/JointState', 'efforts by joint name'),
    '~/joint_commands': ('sensor_msgs/JointState', 'efforts and reference motion'),
    '~/terms/inertial': ('sensor_msgs/JointState', 'the five terms of the efforts'),
    '~/terms/velocity': ('sensor_msgs/JointState', ''),
    '~/terms/gravity': ('sensor_msgs/JointState', ''),
    '~/terms/friction': ('sensor_msgs/JointState', ''),
    '~/terms/external': ('sensor_msgs/JointState', ''),
    '~/external_efforts': ('sensor_msgs/JointState', 'measured minus modelled efforts'),
    '~/base_wrench': ('geometry_msgs/WrenchStamped', 'wrench of the mount on the base link'),
    '~/joint_trajectory_out': ('trajectory_msgs/JointTrajectory', 'trajectory with efforts'),
    '~/robot_description': ('std_msgs/String', 'the robot description in use'),
    '/diagnostics': ('diagnostic_msgs/DiagnosticArray', 'state of the node, every second'),
}
SERVICES = {
    '~/enable': ('std_srvs/SetBool', 'ramp efforts up (true) or down (false)'),
    '~/check_model': ('std_srvs/Trigger', 'report on the robot and its limits'),
}

_HEADER = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- Permissions for topics and services. doc/security.md describes how to use this file, and
     how to make one for other node and topic names. A node that lacks permission for a topic
     does not start. -->
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
    subscribe: tuple[str, ...]
    publish: tuple[str, ...]
    reply: tuple[str, ...] = ()
    """Services that the processes offer."""
    request: tuple[str, ...] = ()
    """Services that the processes call."""


def enclaves(arguments: Sequence[str]) -> tuple[Enclave, ...]:
    """
    Return the enclaves of the node, its driver, `inverse_dynamics watch` and an operator.

    `arguments` is the command line of the node.
    """
    names = NodeNames(arguments)
    parent = names.namespace.rstrip('/')

    def resolved(given: Iterable[str]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(map(names.resolve, given)))

    clock = ('/clock',) * names.uses_sim_time
    own = (f'~/{name}' for name in _SERVICES_OF_EVERY_NODE)
    offered = resolved((*SERVICES, *LIFECYCLE_SERVICES, *own))
    simulated = f'{parent}/simulated_robot'
    node = Enclave(
        names.full_name,
        subscribe=resolved((*SUBSCRIBED, *clock)),
        publish=resolved((*PUBLISHED, *PUBLISHED_BY_ROS)),
        reply=offered,
    )
    driver = Enclave(
        f'{parent}/driver',
        subscribe=(*resolved(_COMMANDS), *(f'{simulated}/{topic}' for topic in _SIMULATED)),
        publish=(*resolved((*_ROBOT, *clock, 'brakes')), '/rosout', _EVENTS),
        reply=tuple(f'{simulated}/{name}' for name in ('hold', *_SERVICES_OF_EVERY_NODE)),
    )
    watch = Enclave(f'{parent}/watch', subscribe=resolved(_WATCHED), publish=(_EVENTS,))
    inputs = [topic for topic in SUBSCRIBED if topic not in _ROBOT]
    operator = Enclave(
        f'{parent}/operator',
        subscribe=resolved((*PUBLISHED, *PUBLISHED_BY_ROS, *_ROBOT, *clock)),
        publish=(*resolved(inputs), '/rosout', _EVENTS),
        # The nodes of `ros2` and of user programs may have any name.
        reply=tuple(f'/*/{name}' for name in _SERVICES_OF_EVERY_NODE),
        request=offered,
    )
    return node, driver, watch, operator


def policy(arguments: Sequence[str]) -> str:
    """Return the text of an SROS 2 policy file for a node that is started with these arguments."""
    lines = ['<policy version="0.2.0">', '  <enclaves>']
    for enclave in enclaves(arguments):
        # The name of the node has no effect, because all other names are absolute.
        namespace, _, node = enclave.path.rpartition('/')
        lines += [
            f'    <enclave path={quoteattr(enclave.path)}>',
            '      <profiles>',
            f'        <profile ns={quoteattr(namespace or "/")} node={quoteattr(node)}>',
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
