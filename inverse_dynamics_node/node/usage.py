"""The text of ``--help`` and ``--version``, without ROS."""

from __future__ import annotations

from textwrap import fill

from .parameter_types import Parameter
from .parameters import LOCKED, LOCKED_POSITION, PARAMETERS

_WIDTH = 90

USAGE = """\
usage: inverse_dynamics_node [-h] [--version]
       inverse_dynamics_node --ros-args [-p NAME:=VALUE]... [--params-file FILE]...
                                        [-r NAME:=NAME]..."""

_INTRODUCTION = """\
Publishes the joint efforts that produce the requested joint accelerations of a robot given by its
URDF. A managed node: with autostart it configures and activates itself."""

_EXAMPLE = """\
example:
  inverse_dynamics_node --ros-args -p robot_description_file:=my_arm.urdf \\
      -r '~/commands:=/forward_effort_controller/commands'"""

SUBSCRIBED = {
    'joint_states': ('sensor_msgs/JointState', 'measured state'),
    'robot_description': ('std_msgs/String', 'URDF, if no parameter gives it'),
    '~/desired_accelerations': ('std_msgs/Float64MultiArray', 'in the order of joints'),
    '~/reference': ('trajectory_msgs/JointTrajectory', 'reference by joint name'),
    '~/joint_trajectory_in': ('trajectory_msgs/JointTrajectory', 'to be filled with efforts'),
    '~/payload': ('geometry_msgs/InertiaStamped', 'rigid load on a link'),
    '~/external_wrench': ('geometry_msgs/WrenchStamped', 'wrench exerted on the robot'),
    '~/gravity': ('geometry_msgs/Vector3Stamped', 'free-fall acceleration'),
    'imu': ('sensor_msgs/Imu', 'motion of the base (base_motion: imu)'),
}
PUBLISHED = {
    '~/commands': ('std_msgs/Float64MultiArray', 'efforts in the order of joints'),
    '~/joint_efforts': ('sensor_msgs/JointState', 'the same with names'),
    '~/joint_commands': (
        'sensor_msgs/JointState',
        'the same with the reference motion',
    ),
    '~/terms/inertial': ('sensor_msgs/JointState', 'the parts of the efforts'),
    '~/terms/velocity': ('sensor_msgs/JointState', ''),
    '~/terms/gravity': ('sensor_msgs/JointState', ''),
    '~/terms/friction': ('sensor_msgs/JointState', ''),
    '~/terms/external': ('sensor_msgs/JointState', ''),
    '~/external_efforts': ('sensor_msgs/JointState', 'measured minus modelled effort'),
    '~/base_wrench': ('geometry_msgs/WrenchStamped', 'exerted by the mount on the base'),
    '~/joint_trajectory_out': ('trajectory_msgs/JointTrajectory', 'filled with efforts'),
    '~/robot_description': ('std_msgs/String', 'the robot description in use'),
    '/diagnostics': ('diagnostic_msgs/DiagnosticArray', 'state of the node, every second'),
}
SERVICES = {
    '~/enable': ('std_srvs/SetBool', 'false: ramp the efforts down to zero'),
    '~/check_model': ('std_srvs/Trigger', 'report on the robot and its limits'),
}


def help_text() -> str:
    """Describe the command line, topics, services and parameters of the node."""
    return '\n\n'.join(
        [
            USAGE,
            fill(_INTRODUCTION, _WIDTH),
            'options:\n'
            '  -h, --help  show this text\n'
            '  --version   show the version\n'
            '  --ros-args  parameters (-p, --params-file) and other names of topics (-r)',
            _EXAMPLE,
            _table('subscribed topics', SUBSCRIBED),
            _table('published topics', PUBLISHED),
            _table('services', SERVICES),
            'parameters, with defaults ("live": a change applies at once; "per joint": one number '
            'for all\ncommanded joints, or a list with one for each):',
            *(_parameter(name, parameter) for name, parameter in PARAMETERS.items()),
            _parameter(f'{LOCKED}.<joint>', LOCKED_POSITION),
        ]
    )


def _table(title: str, rows: dict[str, tuple[str, str]]) -> str:
    lines = [f'  {name:<24} {kind:<31} {words}'.rstrip() for name, (kind, words) in rows.items()]
    return '\n'.join([f'{title}:', *lines])


def _parameter(name: str, parameter: Parameter) -> str:
    default = parameter.default_text
    if parameter.default in ('', [''], None):
        default = '(none)' if parameter.default is None else '(empty)'
    remarks = [parameter.range_text] if parameter.range and parameter.range_text else []
    if parameter.is_per_joint:
        remarks.append('per joint')
    if parameter.is_live:
        remarks.append('live')
    notes = f'  ({", ".join(remarks)})' if remarks else ''
    indent = ' ' * 6
    text = fill(
        f'{parameter.description}.', _WIDTH, initial_indent=indent, subsequent_indent=indent
    )
    return f'  {name}: {default}{notes}\n{text}'
