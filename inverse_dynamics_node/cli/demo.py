"""The command `demo`, which runs the node on a simulated robot and needs ROS."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
import math
import os
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory

import numpy as np

from ..analysis.excitation.limits import motion_limits, States, whole_states
from ..analysis.excitation.search import Excitation, find_excitation
from ..analysis.identification import IdentificationResult, identify_parameters
from ..analysis.identification.result import calibrated_urdf, identified_parameters
from ..analysis.recordings.measured_states import read_measured_states
from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import InverseDynamicsError
from ..report.tables import table
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from ..simulation.demo.commander import History
from ..simulation.demo.demo import run_demo
from ..simulation.demo.demo_setup import DemoSetup
from ..simulation.demo.identification import (
    check_identification,
    follow,
    rms_errors,
    SUMMARY,
    unknown_robot,
    UnknownRobot,
)
from ..simulation.demo.processes import stay_on_this_machine, unused_domain
from ..simulation.demo.results import excuse, ScenarioResult
from ..simulation.demo.scenarios import SCENARIOS
from .arguments import add_force, add_picture, new_parser
from .console import collected_signals, progress, say, show
from .output_files import check_outputs, output_path
from .pictures import demo as pictures
from .pictures.style import write_picture

EPILOG = """\
examples:
  inverse_dynamics demo my_arm.urdf
  inverse_dynamics demo my_arm.urdf --scenario payload --link tool0 --picture payload.png
  inverse_dynamics demo my_arm.urdf --friction --record run
  inverse_dynamics compare my_arm.urdf run

exit code: 0 the demo passed; 1 it failed, or could not run; 2 invalid arguments."""


CALIBRATE = 'calibrate'
"""The scenario that identifies the parameters of the robot between two runs of a motion."""
_FRACTION = 0.6
"""The motion uses only this fraction of the limits, to leave room for tracking errors."""

Draw = Callable[[Path], None]


def run(options: argparse.Namespace) -> int:
    """Run the demo; return the exit code."""
    _check(options)
    outputs = {'--picture': options.picture, '--record': options.record}
    check_outputs([options.urdf], outputs, options.force)
    stay_on_this_machine()
    reserved = unused_domain() if options.domain is None else nullcontext(options.domain)
    with collected_signals() as stops:
        try:
            with reserved as domain:
                os.environ['ROS_DOMAIN_ID'] = str(domain)
                play = _run_identification if options.scenario == CALIBRATE else _run_scenario
                outcome, draw = play(options, lambda: bool(stops))
                if options.picture:
                    write_picture(draw, options.picture)
                    print(f'picture: {options.picture}')
                print(outcome, flush=True)
                return 1 if outcome.failures else 0
        except KeyboardInterrupt:
            print('stopped')
            return 128 + stops[0]
        except (InverseDynamicsError, OSError) as error:
            print(f'inverse_dynamics: {error}', file=sys.stderr)
            return 1


def _new_folder(text: str) -> Path:
    if Path(text).exists():
        raise argparse.ArgumentTypeError(f"'{text}' already exists")
    return output_path(text)


def _check(options: argparse.Namespace) -> None:
    """Check the values of the options; if one is wrong, print an error and exit with code 2."""
    name, error = options.scenario, make_parser().error
    least = 5.0 if name == CALIBRATE else SCENARIOS[name].least_duration
    if not 50.0 <= options.rate <= 5000.0:
        error(f'--rate is {options.rate:g} Hz, expected 50 to 5000 Hz')
    if not least <= options.duration < math.inf:
        error(f'--duration is {options.duration:g} s, expected {least:g} s or more')
    if options.domain is not None and not 0 <= options.domain <= 232:
        error(f'--domain is {options.domain}, expected 0 to 232')


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    summaries = {name: scenario.summary for name, scenario in SCENARIOS.items()}
    summaries[CALIBRATE] = SUMMARY
    scenarios = '\n'.join(f'  {name:12} {summary}' for name, summary in summaries.items())
    parser = new_parser(
        'demo',
        'Run the node on a simulated robot in a scenario, and check the result.',
        f'scenarios:\n{scenarios}\n\n{EPILOG}',
    )
    parser.add_argument('urdf', type=Path, help='the robot description')
    _add_run(parser, summaries)
    _add_files(parser)
    return parser


def _add_run(parser: argparse.ArgumentParser, scenarios: Iterable[str]) -> None:
    """Add the options for the scenario and its conditions."""
    parser.add_argument(
        '--scenario',
        choices=scenarios,
        default='track',
        metavar='NAME',
        help='scenario from the list below (default: %(default)s)',
    )
    parser.add_argument(
        '--rate',
        type=float,
        default=500.0,
        metavar='HZ',
        help='rate of joint states [Hz] (default: %(default)g)',
    )
    parser.add_argument(
        '--duration',
        type=float,
        default=15.0,
        metavar='SECONDS',
        help='duration of the run [s] (default: %(default)g)',
    )
    parser.add_argument(
        '--domain',
        type=int,
        metavar='ID',
        help='ROS domain, from 0 to 232 (default: a domain that no other process on this machine '
        'uses; ROS_DOMAIN_ID is ignored)',
    )
    parser.add_argument(
        '--link',
        default='',
        help='link to load or push (default: a link at or near the end of the arm)',
    )
    parser.add_argument(
        '--friction',
        action='store_true',
        help='simulate the friction of the URDF, and let the node compensate it; Coulomb friction '
        'may hold a resting joint away from its reference',
    )


def _add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options for the files to write."""
    add_picture(parser)
    parser.add_argument(
        '--record',
        type=_new_folder,
        metavar='FOLDER',
        help='new folder for a rosbag2 recording',
    )
    parser.add_argument(
        '--storage',
        choices=('mcap', 'sqlite3'),
        default='mcap',
        help='storage format of the recording (default: %(default)s)',
    )
    add_force(parser)


def _run_scenario(
    options: argparse.Namespace, stopped: Callable[[], bool]
) -> tuple[ScenarioResult, Draw]:
    """Run a scenario; return the outcome, and a function that draws the picture."""
    result = run_demo(options, stopped)
    title = f'{result.title}. {result.outcome}'
    draw = partial(pictures.draw, result.robot, title, result.timeline, result.history)
    return result.outcome, draw


def _run_identification(
    options: argparse.Namespace, stopped: Callable[[], bool]
) -> tuple[ScenarioResult, Draw]:
    """Run a motion before and after an identification; return results as `_run_scenario` does."""
    urdf = str(options.urdf.resolve())
    robot = load_urdf(urdf)
    dynamics = InverseDynamics(robot)
    limits = motion_limits(robot, fraction=_FRACTION)
    print('searching for an excitation motion', flush=True)
    with progress('searching for an excitation motion') as report:
        excitation = find_excitation(dynamics, limits, options.duration, progress=report)
    motion = _ExcitationMotion(excitation)
    setup = DemoSetup(urdf, robot, motion.sample(0.0)[0], options.duration, options.link)
    truth = unknown_robot(setup)
    say(
        'The masses, centres of mass and friction of the simulated robot differ from those in the '
        'URDF. The robot also has rotor inertia, which a URDF does not contain.'
    )
    before, after, result = _runs(setup, motion, truth, options, stopped)
    errors = rms_errors(before, setup.duration), rms_errors(after, setup.duration)
    outcome = check_identification(setup, *errors, result.accepted)
    outcome = replace(outcome, excuse=excuse(after))
    print()
    show(_table(setup, truth, errors, result))
    title, names = f'{robot.name}: calibrate. {outcome}', robot.joint_names
    return outcome, partial(pictures.draw_identification, names, (before, after), errors, title)


class _ExcitationMotion:
    """An excitation motion; all joints are at rest before and after it."""

    def __init__(self, excitation: Excitation) -> None:
        self._series, self._limits = excitation.series, excitation.limits

    def sample(self, time: float) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and accelerations of all joints at the given time [s]."""
        times = np.array([min(max(time, 0.0), self._series.duration)])
        q, qd, qdd = whole_states(self._limits, States(*self._series.sample(times)))
        return q[0], qd[0], qdd[0]


def _runs(
    setup: DemoSetup,
    motion: _ExcitationMotion,
    truth: UnknownRobot,
    options: argparse.Namespace,
    stopped: Callable[[], bool],
) -> tuple[History, History, IdentificationResult]:
    """Run the motion, calibrate the URDF, and run the motion with the calibrated URDF."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        actual, recorded = folder / 'actual.urdf', folder / 'recorded'
        calibrated, parameters = folder / 'calibrated.urdf', folder / 'node.yaml'
        actual.write_bytes(truth.urdf)
        robot = [str(actual), '--friction', '--armature', *(f'{x:.9f}' for x in truth.armature)]

        def run(title: str, record: Path | None, urdf: str, *node: str) -> History:
            node_arguments = [*node, '-p', f"robot_description_file:='{urdf}'"]
            return follow(setup, motion, robot, node_arguments, record, options, stopped, title)

        before = run('with the URDF', recorded, setup.urdf)
        if options.record:
            shutil.copytree(recorded, options.record)
            print(f'recorded: {options.record}')
        recording, _ = read_measured_states(recorded, setup.robot.joint_names)
        print('identifying', flush=True)
        with progress('identifying') as report:
            result = identify_parameters(setup.robot, [recording], progress=report)
        say(f'{result.verdict}.')
        calibrated.write_bytes(calibrated_urdf(result, setup.urdf))
        parameters.write_text(identified_parameters(result), encoding='utf-8')
        file = '--params-file', str(parameters)
        after = run('with the calibrated URDF', None, str(calibrated), *file)
    return before, after, result


def _table(
    setup: DemoSetup,
    truth: UnknownRobot,
    errors: tuple[Floats, Floats],
    result: IdentificationResult,
) -> str:
    """Return a table of tracking errors, simulated parameters and identified parameters."""
    found = {joint.name: joint.terms for joint in result.joints}
    rows = []
    for k, name in enumerate(setup.robot.joint_names):
        is_slide, terms = setup.robot.is_prismatic_joint[k], found.get(name)
        units = ('mm  ', 'N  ', 'kg    ') if is_slide else ('mrad', 'N m', 'kg m^2')
        before, after = (1000.0 * float(error[k]) for error in errors)
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
    return table(
        'RMS tracking errors; friction and rotor inertia, simulated and identified',
        columns,
        rows,
    )
