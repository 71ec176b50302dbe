"""One run of the scenario `calibrate`: the node follows a given motion on an unknown robot."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
import gc
from pathlib import Path

import numpy as np
import rclpy

from ...robot.model import Floats
from ...ros.middleware import start_ros
from ..trajectory import Oscillation
from .commander import History
from .demo_setup import DemoSetup
from .processes import running
from .results import LEAST_FACTOR, result_of, ScenarioResult
from .run import DemoRun, topics_of
from .scenarios import COMPUTED_TORQUE, hold, PATIENT, Scenario, Timeline
from .view import View

SUMMARY = 'identify masses, friction and rotors from an exciting motion; follow it again'
# `follow` makes the timeline itself, because its motion depends on an analysis of the robot.
_SCENARIO = Scenario(SUMMARY, hold, parameters={**COMPUTED_TORQUE, **PATIENT})


@dataclass(frozen=True, eq=False)
class GivenMotion:
    """
    A motion as the commander needs it; after its end the robot rests.

    Attributes
    ----------
    start : ndarray, shape (n,)
        Pose at the start [rad or m].
    function : callable
        Returns positions, velocities and accelerations, each of shape (k, n), for times of shape
        (k,) from 0 to ``duration``.
    duration : float
        Duration [s].

    """

    start: Floats
    function: Callable[[Floats], tuple[Floats, Floats, Floats]]
    duration: float

    def sample(self, time: float) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and accelerations at one time, each of shape (n,)."""
        q, qd, qdd = self.function(np.array([min(max(time, 0.0), self.duration)]))
        return q[0], qd[0], qdd[0]


def follow(
    setup: DemoSetup,
    motion: GivenMotion,
    robot_arguments: list[str],
    node_arguments: list[str],
    record: Path | None,
    options: argparse.Namespace,
    stopped: Callable[[], bool],
    title: str,
) -> History:
    """
    Let a new node follow a motion on a new simulated robot, and record it.

    Parameters
    ----------
    setup : DemoSetup
        The robot as in its URDF.
    motion : GivenMotion
        The motion, from the pose in which the robot starts.
    robot_arguments : list of str
        Path of the URDF and further arguments of the simulated robot.
    node_arguments : list of str
        Arguments of the node that follow ``--ros-args``.
    record : pathlib.Path or None
        Folder to create for a recording.
    options : argparse.Namespace
        Options of the demo.
    stopped : callable
        Returns whether the user has asked to stop.
    title : str
        Title of the live table, and description of the run.

    """
    from .recorder import Recorder

    view = View(setup.robot, f'{setup.robot.name}: {title}')
    log = view.log if view.is_live else None  # above the live table
    package = 'inverse_dynamics_node'
    parameters = {'update_rate': '0.0', **_SCENARIO.parameters}
    commands = {
        'the simulated robot': [
            *(f'{package}.simulation.robot', *robot_arguments, '--rate', str(options.rate)),
            *('--start', *(f'{x:.9f}' for x in motion.start)),  # argparse knows no -1e-5
            *('--ros-args', '-r', 'commands:=inverse_dynamics/commands'),
        ],
        'the node': [
            *(f'{package}.node.main', '--ros-args', *node_arguments),
            *(x for name, value in parameters.items() for x in ('-p', f'{name}:={value}')),
        ],
    }
    zeros = np.zeros_like(motion.start)
    timeline = Timeline(motion, lambda history: ScenarioResult(title), begins=title)
    with running(commands, log) as processes:
        start_ros([])
        run = DemoRun(setup.robot, _SCENARIO, processes, stopped)
        try:
            recorder = None
            if record is not None:
                topics = topics_of(_SCENARIO, timeline)
                recorder = Recorder(run.commander, topics, latched=('brakes',))
            gc.collect()
            gc.freeze()  # see `demo`
            # The wrong model lets the robot sink as soon as the brakes open, unless it is held.
            run.wait_until_ready(Oscillation(motion.start, zeros, zeros + 1.0, motion.duration))
            if recorder is not None:
                recorder.begin()
            with view.open():
                run.perform(timeline, motion.duration, view)
            if recorder is not None and record is not None:
                recorder.write(record, options.storage)
            return run.commander.history
        finally:
            run.close()
            rclpy.shutdown()


def rms_errors(history: History, duration: float) -> Floats:
    """Return the root mean square of the position error of each joint, shape (n,)."""
    rows = history.states.between(0.0, duration)
    errors: Floats = np.sqrt(np.mean((rows[:, 1] - rows[:, 0]) ** 2, axis=0))
    return errors


def check_identification(
    setup: DemoSetup, before: Floats, after: Floats, accepted: bool
) -> ScenarioResult:
    """
    Compare the tracking errors with the URDF and with the calibrated one.

    Parameters
    ----------
    setup : DemoSetup
        The robot as in its URDF.
    before, after : ndarray, shape (n,)
        Root mean square errors of the joints [rad or m].
    accepted : bool
        Whether the identified model is better than the URDF on unseen data.

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
            f'{LEAST_FACTOR:g}',
        ),
    )
