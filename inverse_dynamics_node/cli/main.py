"""`inverse_dynamics COMMAND ...`: the commands, and what becomes of their errors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
import os
import sys

from ..errors import InverseDynamicsError

COMMANDS = ('check', 'effort', 'compare', 'demo')
"""Modules here. Each has add_parser(subparsers), which sets `run`: from options to exit code."""

EPILOG = """\
examples:
  inverse_dynamics check my_arm.urdf
  inverse_dynamics effort my_arm.urdf trajectory.yaml --payload 1.5 --link tool0
  inverse_dynamics compare my_arm.urdf rosbag2_2026_11_21
  inverse_dynamics effort --help

The node itself is started by `inverse_dynamics_node`, or `ros2 run inverse_dynamics_node
inverse_dynamics_node`."""

_EXTRAS = {
    **dict.fromkeys(('matplotlib', 'rich', 'rosbags', 'yaml'), 'cli'),
    **dict.fromkeys(('rclpy', 'sensor_msgs', 'std_msgs', 'trajectory_msgs'), 'ros'),
    'mujoco': 'demo',
}
_HERE = 'in a virtual environment, in the folder of the sources: pip install'
_ADVICE = {
    'cli': f"{_HERE} '.[cli]'",
    'demo': f"{_HERE} '.[demo]'",
    'ros': f"source an installed ROS 2, or {_HERE} '.[ros,demo]'",
}
_INTERRUPTED, _BROKEN_PIPE = 130, 141  # what a shell says of SIGINT and SIGPIPE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(arguments)
        sys.stdout.flush()  # here, where a broken pipe can be caught
        return code
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # What is still to be flushed at exit goes nowhere, quietly.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package not in _EXTRAS:
            raise
        return _fail(f'{error}: {_ADVICE[_EXTRAS[package]]}')
    except OSError as error:
        named = error.filename is not None and error.strerror
        return _fail(f'{error.filename}: {error.strerror}' if named else str(error))
    except InverseDynamicsError as error:
        return _fail(str(error))


def _run(arguments: list[str]) -> int:
    if arguments[:1] == ['demo']:  # whose arguments are its own, --help too
        from .demo import main as run_demo

        return run_demo(arguments[1:])
    options = _parser().parse_args(arguments)
    code: int = options.run(options)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='inverse_dynamics',
        description='See what a robot description says of a robot, and what its joints must give.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    subparsers = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    for command in COMMANDS:
        # Here, for it takes most of a second: an interrupt in it is to end quietly too.
        import_module(f'.{command}', __package__).add_parser(subparsers)
    return parser


def _fail(message: str) -> int:
    print(f'inverse_dynamics: {message}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
