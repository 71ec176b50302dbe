"""The command `demo`: the node on a simulated robot."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
import math
import os
from pathlib import Path
import signal
import sys
from typing import Any

from ..errors import InverseDynamicsError
from .arguments import output_path, picture_path

EPILOG = """

examples:
  inverse_dynamics demo my_arm.urdf
  inverse_dynamics demo my_arm.urdf --scenario payload --link tool0 --picture payload.png
  inverse_dynamics demo my_arm.urdf --friction --record run
  inverse_dynamics compare my_arm.urdf run

exit code: 0 it went as it should; 1 it did not, or cannot be done; 2 wrong arguments."""


def add_parser(subparsers: Any) -> None:
    """List the command; it parses its own arguments."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'demo', help='run the node on a simulated robot (needs ROS 2 and MuJoCo)', add_help=False
    )
    parser.set_defaults(run=lambda options: main([]))


def main(arguments: list[str] | None = None) -> int:
    """Run the demo from the command line; return the exit code."""
    # Imported here, because no other command needs ROS.
    from ..simulation.demo.demo import run_demo
    from ..simulation.demo.processes import stay_on_this_machine, unused_domain

    options = _parse(arguments)
    stay_on_this_machine()
    stops: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: stops.append(number))
    try:
        with unused_domain() if options.domain is None else nullcontext(options.domain) as domain:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            return 0 if run_demo(options, lambda: bool(stops)) else 1
    except KeyboardInterrupt:
        print('stopped')
        return 128 + stops[0]
    except (InverseDynamicsError, OSError) as error:
        print(f'inverse_dynamics: {error}', file=sys.stderr)
        return 1


def _new_folder(text: str) -> Path:
    if Path(text).exists():
        raise argparse.ArgumentTypeError(f'{text}: exists already')
    return output_path(text)


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    from ..simulation.demo.scenarios import SCENARIOS

    parser = argparse.ArgumentParser(
        prog='inverse_dynamics demo',
        description='Run the node on a simulated robot, let something happen, and judge it.',
        epilog='scenarios:\n'
        + '\n'.join(f'  {name:12} {value.summary}' for name, value in SCENARIOS.items())
        + EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('urdf', type=Path, help='the robot description')
    parser.add_argument('--scenario', choices=SCENARIOS, default='track', help='see below')
    parser.add_argument('--rate', type=float, default=500.0, help='of joint states [Hz]')
    parser.add_argument('--duration', type=float, default=15.0, help='of it all [s]')
    parser.add_argument(
        '--domain',
        type=int,
        metavar='ID',
        help='ROS domain, from 0 to 232; without it, one that no other process on this machine '
        'uses, whatever ROS_DOMAIN_ID is',
    )
    parser.add_argument(
        '--link', default='', help='what is loaded or pushed; without it, what will do'
    )
    parser.add_argument(
        '--friction',
        action='store_true',
        help='give the simulated joints the friction of the URDF, and have the node overcome it: '
        'well where it is viscous, while Coulomb friction holds a joint at rest off its place',
    )
    parser.add_argument('--picture', type=picture_path, metavar='FILE', help='draw what happened')
    parser.add_argument(
        '--record', type=_new_folder, metavar='FOLDER', help='write a bag that ROS 2 tools read'
    )
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='of the bag'
    )
    options = parser.parse_args(arguments)
    least = SCENARIOS[options.scenario].least_duration
    if not 50.0 <= options.rate <= 5000.0:
        parser.error(f'--rate {options.rate:g} is not from 50 to 5000 Hz')
    if not least <= options.duration < math.inf:
        parser.error(f'--duration {options.duration:g} is not {least:g} s or more')
    if options.domain is not None and not 0 <= options.domain <= 232:
        parser.error(f'--domain {options.domain} is not from 0 to 232')
    return options
