"""The scenario `calibrate` of the demo: excite, record, identify, and follow the motion again."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import shutil
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from ..analysis.excitation import Excitation, find_excitation, motion_limits, States, whole_states
from ..analysis.identification import IdentificationResult, identify_parameters
from ..analysis.identification.export import calibrated_urdf, node_parameters
from ..analysis.recordings.measured_states import read_measured_states
from ..dynamics.inverse_dynamics import InverseDynamics
from ..report.tables import Table
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from ..simulation.demo.commander import History
from ..simulation.demo.demo import NewFile
from ..simulation.demo.demo_setup import DemoSetup
from ..simulation.demo.identification import check_identification, follow, GivenMotion, rms_errors
from ..simulation.demo.results import excuse
from ..simulation.demo.unknown_robot import unknown_robot, UnknownRobot
from .console import progress, say, show

_FRACTION = 0.6
"""Fraction of the limits to use; the errors with the wrong URDF need the rest."""


class _Result(NamedTuple):
    """Both runs, and the identification between them."""

    histories: tuple[History, History]
    errors: tuple[Floats, Floats]
    """Root mean squares of the tracking errors, each of shape (n,) [rad or m]."""
    identified: IdentificationResult


def run_identification(
    options: argparse.Namespace, stopped: Callable[[], bool], new_file: NewFile
) -> bool:
    """Run the scenario; return whether it passed. The picture is written within `new_file`."""
    urdf = str(options.urdf.resolve())
    robot = load_urdf(urdf)
    dynamics = InverseDynamics(robot)
    limits = motion_limits(robot, fraction=_FRACTION)
    print('searching for an exciting motion', flush=True)
    with progress('searching for an exciting motion') as report:
        excitation = find_excitation(dynamics, limits, options.duration, progress=report)
    motion = _motion(excitation)
    setup = DemoSetup(urdf, robot, motion.start, options.duration, options.link)
    truth = unknown_robot(setup)
    say(
        'The simulated robot has other masses and centres of mass than the URDF, and friction '
        'and rotors that the URDF leaves out.'
    )
    result = _runs(setup, motion, truth, options, stopped)
    outcome = check_identification(setup, *result.errors, result.identified.accepted)
    outcome = replace(outcome, excuse=excuse(result.histories[1]))
    print()
    show(_table(setup, truth, result))
    if options.picture:
        from .pictures.identification_demo import draw

        title = f'{robot.name}: calibrate. {outcome}'
        with new_file(options.picture) as path:
            draw(robot.joint_names, result.histories, result.errors, title, path)
        print(f'picture: {options.picture}')
    print(outcome, flush=True)
    return not outcome.failures


def _motion(excitation: Excitation) -> GivenMotion:
    """Return an exciting motion as a motion of all joints."""

    def function(times: Floats) -> tuple[Floats, Floats, Floats]:
        states = States(*excitation.series.sample(times))
        q, qd, qdd = whole_states(excitation.limits, states)
        return q, qd, qdd

    q, _, _ = function(np.zeros(1))
    return GivenMotion(q[0], function, excitation.series.duration)


def _runs(
    setup: DemoSetup,
    motion: GivenMotion,
    truth: UnknownRobot,
    options: argparse.Namespace,
    stopped: Callable[[], bool],
) -> _Result:
    """Follow the motion with the URDF, identify the recording, and follow it again."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        actual, recorded = folder / 'actual.urdf', folder / 'recorded'
        calibrated, parameters = folder / 'calibrated.urdf', folder / 'node.yaml'
        actual.write_bytes(truth.urdf)
        robot = [str(actual), '--friction', '--armature', *(f'{x:.9f}' for x in truth.armature)]

        def run(title: str, record: Path | None, *node: str) -> tuple[History, Floats]:
            history = follow(setup, motion, robot, [*node], record, options, stopped, title)
            return history, rms_errors(history, motion.duration)

        before, errors_before = run('with the URDF', recorded, *_description(setup.urdf))
        if options.record:
            shutil.copytree(recorded, options.record)
            print(f'recorded: {options.record}')
        recording, _ = read_measured_states(recorded, setup.robot.joint_names)
        print('identifying', flush=True)
        with progress('identifying') as report:
            result = identify_parameters(setup.robot, [recording], progress=report)
        say(f'{result.verdict}.')
        calibrated.write_bytes(calibrated_urdf(result, setup.urdf))
        parameters.write_text(node_parameters(result), encoding='utf-8')
        after, errors_after = run(
            'with the calibrated URDF',
            None,
            *('--params-file', str(parameters)),
            *_description(str(calibrated)),
        )
    return _Result((before, after), (errors_before, errors_after), result)


def _description(urdf: str) -> list[str]:
    return ['-p', f"robot_description_file:='{urdf}'"]


def _table(setup: DemoSetup, truth: UnknownRobot, result: _Result) -> Table:
    """Return the errors of both runs, and the simulated and identified friction and rotors."""
    found = {joint.name: joint.terms for joint in result.identified.joints}
    rows = []
    for k, name in enumerate(setup.robot.joint_names):
        is_slide, terms = setup.robot.is_prismatic_joint[k], found.get(name)
        units = ('mm  ', 'N  ', 'kg    ') if is_slide else ('mrad', 'N m', 'kg m^2')
        before, after = (1000.0 * float(errors[k]) for errors in result.errors)
        coulomb = f'{terms.coulomb:.3g}' if terms else '-'
        armature = f'{terms.armature:.3g}' if terms else '-'
        rows.append(
            (
                name,
                f'{before:.3g}',
                f'{after:.3g} {units[0]}',
                f'{truth.coulomb[k]:.3g}',
                f'{coulomb} {units[1]}',
                f'{truth.armature[k]:.3g}',
                f'{armature} {units[2]}',
            )
        )
    columns = ('joint', 'error before', 'after', 'Coulomb', 'identified', 'rotor', 'identified')
    return Table(
        'Tracking errors (RMS), and simulated and identified values', columns, tuple(rows)
    )
