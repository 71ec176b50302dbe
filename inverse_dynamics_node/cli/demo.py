"""The command `demo`: the node on a simulated robot."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from contextlib import nullcontext
import math
import os
from pathlib import Path
import signal
import sys
from typing import Any

from ..errors import InverseDynamicsError
from .arguments import add_force
from .output_files import check_outputs, new_file, output_path, picture_path

EPILOG = """

examples:
  inverse_dynamics demo my_arm.urdf
  inverse_dynamics demo my_arm.urdf --scenario payload --link tool0 --picture payload.png
  inverse_dynamics demo my_arm.urdf --friction --record run
  inverse_dynamics compare my_arm.urdf run

exit code: 0 passed; 1 failed, or cannot be run; 2 invalid arguments."""


CALIBRATE = 'calibrate'
"""The scenario that needs more than one run, and the analysis of a recording."""


def add_parser(subparsers: Any) -> None:
    """Add the command to the list; it parses its own arguments."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'demo', help='run the node on a simulated robot (needs ROS 2 and MuJoCo)', add_help=False
    )
    parser.set_defaults(run=lambda options: main([]))


def main(arguments: list[str] | None = None) -> int:
    """Run the demo from the command line; return the exit code."""
    # Imported here, because no other command needs ROS.
    from ..simulation.demo.demo import run_demo
    from ..simulation.demo.processes import stay_on_this_machine, unused_domain
    from .identification_demo import run_identification

    options = _parse(arguments)
    outputs = {'--picture': options.picture, '--record': options.record}
    check_outputs([options.urdf], outputs, options.force)
    stay_on_this_machine()
    stops: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: stops.append(number))
    try:
        with unused_domain() if options.domain is None else nullcontext(options.domain) as domain:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            run = run_identification if options.scenario == CALIBRATE else run_demo
            return 0 if run(options, lambda: bool(stops), new_file) else 1
    except KeyboardInterrupt:
        print('stopped')
        return 128 + stops[0]
    except (InverseDynamicsError, OSError) as error:
        print(f'inverse_dynamics: {error}', file=sys.stderr)
        return 1


def _new_folder(text: str) -> Path:
    if Path(text).exists():
        raise argparse.ArgumentTypeError(f'{text}: already exists')
    return output_path(text)


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    from ..simulation.demo.identification import SUMMARY
    from ..simulation.demo.scenarios import SCENARIOS

    summaries = {name: scenario.summary for name, scenario in SCENARIOS.items()}
    summaries[CALIBRATE] = SUMMARY

    parser = argparse.ArgumentParser(
        prog='inverse_dynamics demo',
        description='Run the node on a simulated robot in a scenario, and check the result.',
        epilog='scenarios:\n'
        + '\n'.join(f'  {name:12} {summary}' for name, summary in summaries.items())
        + EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('urdf', type=Path, help='the robot description')
    _add_run(parser, summaries)
    _add_files(parser)
    options = parser.parse_args(arguments)
    least = 5.0 if options.scenario == CALIBRATE else SCENARIOS[options.scenario].least_duration
    if not 50.0 <= options.rate <= 5000.0:
        parser.error(f'--rate {options.rate:g} is not from 50 to 5000 Hz')
    if not least <= options.duration < math.inf:
        parser.error(f'--duration {options.duration:g} is not {least:g} s or more')
    if options.domain is not None and not 0 <= options.domain <= 232:
        parser.error(f'--domain {options.domain} is not from 0 to 232')
    return options


def _add_run(parser: argparse.ArgumentParser, scenarios: Iterable[str]) -> None:
    """Add the options for the scenario and its conditions."""
    parser.add_argument(
        '--scenario', choices=scenarios, default='track', help='see below (default: %(default)s)'
    )
    parser.add_argument(
        '--rate',
        type=float,
        default=500.0,
        help='rate of joint states [Hz] (default: %(default)g)',
    )
    parser.add_argument(
        '--duration',
        type=float,
        default=15.0,
        help='duration of the run [s] (default: %(default)g)',
    )
    parser.add_argument(
        '--domain',
        type=int,
        metavar='ID',
        help='ROS domain, from 0 to 232 (default: one that no other process on this machine uses; '
        'ROS_DOMAIN_ID is ignored)',
    )
    parser.add_argument(
        '--link', default='', help='link that is loaded or pushed (default: one that is suitable)'
    )
    parser.add_argument(
        '--friction',
        action='store_true',
        help='simulate the friction of the URDF, and let the node compensate it; Coulomb friction '
        'may hold a joint at rest away from its reference',
    )


def _add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options for the files to write."""
    parser.add_argument(
        '--picture',
        type=picture_path,
        metavar='FILE',
        help='file for a picture: .png, .svg or .pdf',
    )
    parser.add_argument(
        '--record', type=_new_folder, metavar='FOLDER', help='folder for a rosbag2 recording'
    )
    parser.add_argument(
        '--storage',
        choices=('mcap', 'sqlite3'),
        default='mcap',
        help='storage of the recording (default: %(default)s)',
    )
    add_force(parser)
