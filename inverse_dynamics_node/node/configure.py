"""Makes the control loop, and applies parameter changes while the loop runs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..control.loop import ControlLoop
from ..control.stop_damping import TIMEOUT
from ..dynamics.inverse_dynamics import FRICTION_WIDTH
from ..errors import ConfigurationError
from ..robot.model import Floats, RobotModel
from .parameters import BaseMotion, Configuration

_LAUNCH_SIGTERM_TIMEOUT = 5.0  # [s]; default of ros2 launch


def make_loop(configuration: Configuration, robot: RobotModel, text: str) -> ControlLoop:
    """
    Build the control loop of a robot; `text` is the URDF of the robot.

    The first call compiles functions; later calls take less than a millisecond. Raise an
    InverseDynamicsError if the parameters do not fit the robot.
    """
    loop = ControlLoop(
        robot,
        configuration.joints,
        configuration,
        configuration.period,
        configuration.gravity,
        configuration.base_link,
        configuration.locked_positions,
        configuration.base_motion is BaseMotion.IMU,
    )
    loop.description = text
    apply_configuration(loop, configuration)
    if configuration.tool_link:
        robot.link_index(configuration.tool_link)  # raises an error if it does not exist
        loop.tool_link = configuration.tool_link
    zeros = np.zeros(len(robot.joint_names))
    loop.dynamics.gravity_efforts(zeros)  # compiles further functions
    loop.tool_wrench(zeros)
    return loop


def launch_warning(configuration: Configuration) -> str:
    """Return a warning of a stop that `ros2 launch` would cut short, or ''."""
    names, longest = 'stop_ramp', configuration.stop_ramp
    if configuration.stop_damping:
        names, longest = 'stop_ramp plus the time for stop_damping', longest + TIMEOUT
    if longest < _LAUNCH_SIGTERM_TIMEOUT:
        return ''
    return (
        f'{names} is {longest:g} s, but ros2 launch sends SIGTERM {_LAUNCH_SIGTERM_TIMEOUT:g} s '
        'after SIGINT, and SIGTERM ends the ramp: increase sigterm_timeout of the launch action'
    )


def check_configuration(loop: ControlLoop, configuration: Configuration) -> Mapping[str, Floats]:
    """
    Return the per-joint parameters by name, each with shape (m,) for m commanded joints.

    Raise a ConfigurationError if the values do not fit the robot.
    """
    of_joint = configuration.expanded(len(loop.joints))
    is_turning = loop.robot.is_continuous[loop.index]
    for k in np.flatnonzero(is_turning & (of_joint['spring_stiffness'] != 0.0)):
        raise ConfigurationError(
            f"spring_stiffness of joint '{loop.joints[k]}' is "
            f'{of_joint["spring_stiffness"][k]:g}, expected 0: the reported position of a '
            'continuous joint may omit full turns'
        )
    coupling = np.zeros(len(loop.robot.joint_names))
    coupling[loop.index] = of_joint['drive_coupling']
    loop.dynamics.checked_coupling(coupling)
    return of_joint


def apply_configuration(
    loop: ControlLoop, configuration: Configuration, before: Configuration | None = None
) -> None:
    """
    Apply the parameters that may change while the loop runs.

    `check_configuration` checks the values first. `before` is the old configuration. If `gravity`
    is unchanged, it is not applied, because a message on ~/gravity may have replaced it.
    """
    of_joint = check_configuration(loop, configuration)
    _apply_drives(loop, configuration, of_joint)
    loop.loads.include(gravity=configuration.include_gravity)
    loop.measured_gravity = configuration.measured_gravity
    loop.external_effort_estimator.scale[loop.index] = of_joint['measured_effort_scale']
    if before is not None and before.gravity != configuration.gravity and not loop.has_imu:
        loop.loads.set_gravity(configuration.gravity)
    # This call also blends in the changes above.
    loop.apply(configuration)


def _apply_drives(
    loop: ControlLoop, configuration: Configuration, of_joint: Mapping[str, Floats]
) -> None:
    """
    Set friction, armature, drive coupling and springs of the commanded joints.

    Other joints have the friction of the URDF, or no friction if `include_friction` is false.
    """
    robot, zeros = loop.robot, np.zeros(len(loop.robot.joint_names))

    def of_robot(name: str, others: Floats = zeros, least: float = -np.inf) -> Floats:
        chosen: Floats = others.copy()
        given = of_joint[name]
        chosen[loop.index] = np.where(given < least, others[loop.index], given)
        return chosen

    widths = configuration.coulomb_width
    width = FRICTION_WIDTH if isinstance(widths, tuple) else widths  # for the other joints
    factor = 1.0 if configuration.include_friction else 0.0
    dynamics = loop.dynamics
    dynamics.set_drive_coupling(of_robot('drive_coupling'))
    dynamics.set_friction(
        factor * of_robot('damping', robot.damping, 0.0),
        factor * of_robot('coulomb', robot.friction, 0.0),
        of_robot('coulomb_width', zeros + width),
        factor * of_robot('load_friction'),
    )
    dynamics.set_armature(of_robot('armature'))
    dynamics.set_springs(of_robot('spring_stiffness'), of_robot('spring_rest'))
