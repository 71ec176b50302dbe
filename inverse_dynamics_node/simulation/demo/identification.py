"""
The scenario `calibrate`: a robot that differs from its URDF follows a given motion.

The masses of the robot differ from the masses in the URDF. The robot also has friction and rotors,
which are unknown to the node at first. The friction and the rotor inertia scale with the inertia
of the joints, so that a robot of any size can still move.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...robot.model import Floats
from ...robot.rigid_body import RigidBody
from ...robot.urdf.writer import Friction, rewrite
from ..trajectory import Reference
from .commander import History
from .demo import commands_of, perform
from .demo_setup import DemoSetup
from .results import LEAST_FACTOR, result_of, ScenarioResult
from .scenarios import COMPUTED_TORQUE, hold, PATIENT, Scenario, standing, Timeline
from .view import View

SUMMARY = 'identify masses, friction and rotor inertias from a motion, then repeat the motion'
# `follow` creates the timeline instead of `hold`.
_SCENARIO = Scenario(SUMMARY, hold, parameters={**COMPUTED_TORQUE, **PATIENT})
MASS = (0.75, 1.35)
"""Smallest and largest ratio of the true mass of a link to the mass in the URDF."""
PLACE = (0.85, 1.15)
"""Smallest and largest ratio of a true centre-of-mass coordinate to its value in the URDF."""
ROTOR = 0.4
"""Inertia of the rotor divided by the inertia of the joint without the rotor."""
COULOMB = 3.0
"""Coulomb friction divided by the inertia of joint and rotor [rad/s^2 or m/s^2]."""
DAMPING_SPEED = 1.5
"""Speed [rad/s or m/s] at which viscous friction is as large as Coulomb friction."""
LARGEST_FRICTION = 0.05
"""Largest Coulomb friction as a fraction of the effort limit."""
_SEED = 1979


@dataclass(frozen=True, eq=False)
class UnknownRobot:
    """The true properties of a robot whose URDF is wrong."""

    urdf: bytes
    """The URDF with the true inertials and friction."""
    armature: Floats
    """Inertia of the rotors, shape (n,) [kg m^2 or kg]."""
    damping: Floats
    """Viscous friction, shape (n,) [N m s/rad or N s/m]."""
    coulomb: Floats
    """Coulomb friction, shape (n,) [N m or N]."""


def unknown_robot(setup: DemoSetup) -> UnknownRobot:
    """Draw the true properties of a robot at random, from a generator with a fixed seed."""
    robot, rng = setup.robot, np.random.default_rng(_SEED)
    inertials = {}
    for k, name in enumerate(robot.link_names):
        factor, place = rng.uniform(*MASS), rng.uniform(*PLACE, 3)
        if robot.link_mass[k] > 0.0:
            inertials[name] = RigidBody(
                factor * robot.link_mass[k],
                place * robot.link_com[k],
                factor * robot.link_inertia[k],
            )
    armature = ROTOR * setup.inertia
    coulomb = np.minimum(
        COULOMB * (setup.inertia + armature), LARGEST_FRICTION * robot.effort_limits
    )
    damping = coulomb / DAMPING_SPEED
    friction = dict.fromkeys(robot.mimic_names, Friction(0.0, 0.0))
    for name, *values in zip(robot.joint_names, damping, coulomb, strict=True):
        friction[name] = Friction(*map(float, values))
    return UnknownRobot(rewrite(setup.urdf, inertials, friction), armature, damping, coulomb)


def follow(
    setup: DemoSetup,
    motion: Reference,
    robot_arguments: list[str],
    node_arguments: list[str],
    record: Path | None,
    options: argparse.Namespace,
    stopped: Callable[[], bool],
    title: str,
) -> History:
    """
    Start a node and a simulated robot, let the robot follow a motion, and return the history.

    ``robot_arguments`` are the path of the URDF and further arguments of the simulated robot.
    ``node_arguments`` are the node's arguments after ``--ros-args``. ``record`` is a new folder
    for a recording, or None. ``title`` describes the run. For the other arguments, see `perform`.
    """
    view = View(setup.robot, f'{setup.robot.name}: {title}')
    timeline = Timeline(motion, lambda history: ScenarioResult(title), begins=title)
    start = ['--start', *(f'{x:.9f}' for x in setup.start)]  # argparse rejects -1e-5
    commands = commands_of(_SCENARIO, options.rate, [*robot_arguments, *start], node_arguments, {})
    # The node holds the robot from the start, because the model is wrong and the robot would sink.
    held = standing(setup)
    return perform(_SCENARIO, timeline, view, commands, options, stopped, record, held)[0]


def rms_errors(history: History, duration: float) -> Floats:
    """Return the RMS position error of each joint, shape (n,) [rad or m]."""
    rows = history.states.between(0.0, duration)
    return np.asarray(np.sqrt(np.mean((rows[:, 1] - rows[:, 0]) ** 2, axis=0)))


def check_identification(
    setup: DemoSetup, before: Floats, after: Floats, accepted: bool
) -> ScenarioResult:
    """
    Compare the RMS tracking errors, shape (n,), before and after the calibration.

    ``accepted`` is True if the identified model is better than the URDF on unseen data.
    """
    slides = setup.robot.is_prismatic_joint
    unit = 'mm' if slides.all() else 'mrad (mm)' if slides.any() else 'mrad'
    first, second = (1000.0 * float(np.sqrt(np.mean(x**2))) for x in (before, after))
    factor = first / second
    words = f'from {first:.3g} to {second:.3g} {unit} (RMS)'
    return result_of(
        f'with the calibrated URDF, the tracking error fell {words}: {factor:.3g} times better',
        (accepted, 'the identified model is not better than the URDF on unseen data'),
        (
            factor >= LEAST_FACTOR,
            f'the tracking error changed {words}: {factor:.2g} times better, expected '
            f'at least {LEAST_FACTOR:g}',
        ),
    )
