"""Makes the control loop from the parameters, and applies changes while it runs."""

from __future__ import annotations

import numpy as np

from ..control.loop import ControlLoop
from ..control.settings import expand_per_joint, PerJoint
from ..dynamics.inverse_dynamics import FRICTION_WIDTH
from ..dynamics.trajectory import complete, Trajectory
from ..errors import ConfigurationError, shortened
from ..robot.model import Floats, RobotModel
from ..robot.urdf import load_urdf
from .description_file import load_file
from .parameters import BaseMotion, Configuration, PER_JOINT


def make_loop(configuration: Configuration, description: str) -> ControlLoop:
    """
    Load the robot description and make its control loop.

    Parameters
    ----------
    configuration : Configuration
        The parameters.
    description : str
        The URDF from the topic, used if no parameter gives one.

    Returns
    -------
    loop : ControlLoop
        The compiled loop. Slow first calls have been made.

    Raises
    ------
    InverseDynamicsError
        If the description or the parameters cannot be used.

    """
    loop = build_loop(configuration, *load_robot(configuration, description))
    loop.dynamics.gravity_efforts(np.zeros(len(loop.robot.joint_names)))
    complete(Trajectory(('x',), np.arange(2.0), np.zeros((2, 1))))  # imports the splines
    return loop


def build_loop(configuration: Configuration, robot: RobotModel, text: str) -> ControlLoop:
    """
    Make the control loop of a robot; takes less than a millisecond once `make_loop` has compiled.

    Parameters
    ----------
    configuration : Configuration
        The parameters.
    robot : RobotModel
        The robot.
    text : str
        Its URDF.

    Returns
    -------
    loop : ControlLoop
        The loop.

    Raises
    ------
    InverseDynamicsError
        If the parameters do not fit the robot.

    """
    loop = ControlLoop(
        robot,
        configuration.joints,
        configuration.settings,
        configuration.period,
        configuration.load_settings,
        configuration.gravity,
        configuration.base_link,
        configuration.locked_positions,
        configuration.base_motion is BaseMotion.IMU,
    )
    loop.description = text
    apply_configuration(loop, configuration)
    return loop


def apply_configuration(
    loop: ControlLoop, configuration: Configuration, before: Configuration | None = None
) -> None:
    """
    Apply the parameters that may change while the loop runs.

    Parameters
    ----------
    loop : ControlLoop
        The loop for the same robot description and joints.
    configuration : Configuration
        The new values.
    before : Configuration, optional
        The previous values. Gravity is applied only if it differs from these, so that a change of
        another parameter does not undo a message on ~/gravity.

    Raises
    ------
    ConfigurationError
        If a list does not have one number for each commanded joint. Nothing has been changed.

    """
    m, n = len(loop.controller.joints), len(loop.robot.joint_names)

    def of_robot(name: str, values: PerJoint, others: Floats) -> Floats:
        given = expand_per_joint(name, values, m)
        chosen: Floats = others.copy()
        chosen[loop.index] = np.where(given < 0.0, others[loop.index], given)
        return chosen

    damping = of_robot('damping', configuration.damping, loop.robot.damping)
    coulomb = of_robot('coulomb', configuration.coulomb, loop.robot.friction)
    load_friction = of_robot('load_friction', configuration.load_friction, np.zeros(n))
    armature = of_robot('armature', configuration.armature, np.zeros(n))
    widths = configuration.coulomb_width
    width = FRICTION_WIDTH if isinstance(widths, tuple) else widths  # of the other joints
    speeds = of_robot('coulomb_width', widths, np.full(n, width))
    configuration.settings.expanded(m)
    factor = 1.0 if configuration.include_friction else 0.0
    loop.dynamics.set_friction(factor * damping, factor * coulomb, speeds, factor * load_friction)
    loop.dynamics.set_armature(armature)
    loop.loads.apply(configuration.load_settings, configuration.include_gravity)
    loop.external_effort_estimator.filter.cutoff = configuration.external_efforts_cutoff
    is_new = before is not None and before.gravity != configuration.gravity
    if is_new and not loop.has_imu:
        loop.loads.set_gravity(configuration.gravity)
    loop.controller.apply(configuration.settings)  # blends the effect of the changes above, too


def check_configuration(loop: ControlLoop, configuration: Configuration) -> None:
    """
    Check lists against the number of commanded joints.

    Parameters
    ----------
    loop : ControlLoop
        The loop that would use the configuration.
    configuration : Configuration
        The new values.

    Raises
    ------
    ConfigurationError
        If a list does not have one number for each commanded joint.

    """
    for name in PER_JOINT:
        expand_per_joint(name, getattr(configuration, name), len(loop.controller.joints))


def load_robot(configuration: Configuration, description: str) -> tuple[RobotModel, str]:
    """
    Load the robot description.

    Parameters
    ----------
    configuration : Configuration
        The parameters.
    description : str
        The URDF from the topic, used if no parameter gives one.

    Returns
    -------
    robot : RobotModel
        The robot.
    text : str
        Its URDF.

    Raises
    ------
    InverseDynamicsError
        If there is no description, or it cannot be used.

    """
    missing = configuration.on_missing_inertial.value
    if configuration.robot_description_file:
        return load_file(configuration.robot_description_file, missing)
    text = configuration.robot_description or description
    if not text:
        raise ConfigurationError(
            'no robot description: none on the topic, and neither robot_description nor '
            'robot_description_file is set'
        )
    if not text.lstrip('\ufeff \t\r\n').startswith('<'):  # load_urdf would open it as a file
        is_parameter = bool(configuration.robot_description)
        where = "parameter 'robot_description'" if is_parameter else 'the robot description'
        hint = '; for a file, set robot_description_file' if is_parameter else ''
        raise ConfigurationError(
            f"{where} is '{shortened(text)}', expected the URDF as XML text{hint}"
        )
    return load_urdf(text, missing), text
