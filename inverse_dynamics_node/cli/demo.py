"""The command `demo`, which runs the node on a simulated robot and needs ROS."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from ..report.tables import table
from ..ros.middleware import stay_on_this_machine
from ..simulation.demo import Check, DemoRun, HARMLESS, judge, longest_gap, run_demo
from .arguments import add_force, add_picture, new_parser
from .console import check_outputs, collected_signals, say, show
from .pictures import demo as picture
from .pictures.style import write_picture

EPILOG = """\
The arm follows a reference and holds its pose. Then the simulated arm gets a load, which the node
does not know. At last, the load is published on the topic ~/payload of the node. The demo takes
about 20 s. Its topics are in a namespace of their own.

examples:
  inverse_dynamics demo my_arm.urdf
  inverse_dynamics demo my_arm.urdf --picture closed_loop.png

exit code: 0 the demo passed; 1 it failed, or could not run; 2 invalid arguments."""
PASSED = (
    'PASSED: the arm followed, held its pose, and took the payload without a step of an effort'
)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = new_parser('demo', 'Run the node on a simulated robot, and judge the motion.', EPILOG)
    parser.add_argument('urdf', type=Path, help='the robot description')
    add_picture(parser)
    add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the demo; return the exit code."""
    check_outputs([options.urdf], {'--picture': options.picture}, options.force)
    stay_on_this_machine()
    with collected_signals() as stops:
        try:
            urdf = str(options.urdf.resolve())
            result = run_demo(urdf, lambda: bool(stops), partial(print, flush=True))
            return _report(result, options.picture)
        except KeyboardInterrupt:
            print('stopped')
            return 128 + stops[0]


def _report(result: DemoRun, path: Path | None) -> int:
    """Print the checks and the verdict, and write the picture; return the exit code."""
    checks = judge(result)
    print()
    show(_table(checks))
    if path:
        write_picture(partial(picture.draw, result, verdict(checks)), path)
        print(f'picture: {path}')
    gap = longest_gap(result)
    if gap > HARMLESS:
        say(
            f'The machine was busy: no command or joint state came for {1e3 * gap:.0f} ms, too '
            'long for any control loop. Close other programs.'
        )
    print(verdict(checks), flush=True)
    return 0 if all(check.passed for check in checks) else 1


def verdict(checks: list[Check]) -> str:
    """Return the last line of the output."""
    failed = [check.name for check in checks if not check.passed]
    return f'FAILED: {"; ".join(failed)}' if failed else PASSED


def _table(checks: list[Check]) -> str:
    rows = [
        (
            check.name,
            f'{round(check.value, 3):.3g} {check.unit}',
            'at least' if check.is_least else 'at most',
            f'{round(check.limit, 3):.3g} {check.unit}',
        )
        for check in checks
    ]
    return table('Largest values of all joints', ('', 'value', '', 'limit'), rows)
