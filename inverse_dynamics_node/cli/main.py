"""The entry point `inverse_dynamics COMMAND ...`; prints errors in one line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import nullcontext
from importlib import import_module
import os
import sys

from ..errors import escaped, InverseDynamicsError, RecordingError, TrajectoryError
from .console import escaped_output
from .output_files import OutputError

COMMANDS = ('check', 'effort', 'compare', 'excite', 'identify', 'watch', 'demo', 'simulate')
"""Modules of this package; add_parser(subparsers) sets `run`, which returns the exit code."""

EPILOG = """\
examples:
  inverse_dynamics check my_arm.urdf
  inverse_dynamics effort my_arm.urdf trajectory.yaml --payload 1.5 --link tool0
  inverse_dynamics compare my_arm.urdf rosbag2_2026_11_21
  inverse_dynamics identify my_arm.urdf rosbag2_2026_11_21 --output calibrated.urdf
  inverse_dynamics watch --for 10
  inverse_dynamics effort --help

The node itself is started by `inverse_dynamics_node`, or `ros2 run inverse_dynamics_node
inverse_dynamics_node`."""

_ROS_COMMANDS = 'watch', 'simulate'  # accept arguments of ROS
_EXTRAS = {
    **dict.fromkeys(('matplotlib', 'rich', 'rosbags', 'yaml'), 'cli'),
    **dict.fromkeys(
        (
            'diagnostic_msgs',
            'rcl_interfaces',
            'rclpy',
            'sensor_msgs',
            'std_msgs',
            'trajectory_msgs',
        ),
        'ros',
    ),
    'mujoco': 'demo',
}
_HERE = 'in a virtual environment, in the folder of the sources: pip install'
_ADVICE = {
    'cli': f"{_HERE} '.[cli]'",
    'demo': f"{_HERE} '.[demo]'",
    'ros': f"source an installed ROS 2, or {_HERE} '.[ros,demo]'",
}
_INVALID_ARGUMENTS = 2
_INTERRUPTED, _BROKEN_PIPE = 130, 141  # as a shell reports SIGINT and SIGPIPE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    # The demo updates its table in place, with names of the local URDF only.
    with nullcontext() if arguments[:1] in (['demo'], ['simulate']) else escaped_output():
        return _code_of(arguments)


def _code_of(arguments: list[str]) -> int:
    """Run one command; print an error in one line."""
    try:
        code = _run(arguments)
        sys.stdout.flush()  # here, where a broken pipe can be caught
        return code
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # Prevents an error message when Python flushes the output at exit.
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
    except OutputError as error:
        return _fail(str(error), _INVALID_ARGUMENTS)
    except (RecordingError, TrajectoryError) as error:
        return _fail(escaped(str(error)))
    except InverseDynamicsError as error:
        return _fail(str(error))


def _run(arguments: list[str]) -> int:
    if arguments[:1] == ['identify']:
        # Its matrices are small: threads would take longer to start than to compute.
        os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    if arguments[:1] == ['demo']:  # parses its own arguments, including --help
        from .demo import main as run_demo

        return run_demo(arguments[1:])
    if '--ros-args' in arguments and arguments[0] not in _ROS_COMMANDS:
        print(
            f'inverse_dynamics: --ros-args is for {" and ".join(_ROS_COMMANDS)}, and for the '
            'node: ros2 run inverse_dynamics_node inverse_dynamics_node --ros-args ...',
            file=sys.stderr,
        )
        return 2
    if arguments == ['--version']:
        from ..ros.version import version

        print(f'inverse_dynamics {version()}')
        return 0
    arguments, ros_arguments = _split(arguments)
    options = _parser().parse_args(arguments)
    options.ros_arguments = ros_arguments
    code: int = options.run(options)
    return code


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Separate the arguments from those of ROS, which begin with --ros-args and end with --."""
    if '--ros-args' not in arguments:
        return arguments, []
    begin = arguments.index('--ros-args')
    rest = arguments[begin:]
    end = begin + (rest.index('--') if '--' in rest else len(rest))
    return arguments[:begin] + arguments[end + 1 :], arguments[begin:end]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='inverse_dynamics',
        description='Check robot descriptions, and compute the efforts that motions require.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    # Handled before: the parsers of the commands take most of a second.
    parser.add_argument('--version', action='store_true', help='show the version')
    subparsers = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    for command in COMMANDS:
        if command == 'demo':  # only listed here: it parses its own arguments, and needs ROS
            about = 'run the node on a simulated robot (needs ROS 2 and MuJoCo)'
            demo = subparsers.add_parser(command, help=about, add_help=False)
            demo.set_defaults(run=lambda options: _run(['demo']))
            continue
        # Imported here: this takes most of a second, and an interrupt must end it cleanly.
        import_module(f'.{command}', __package__).add_parser(subparsers)
    return parser


def _fail(message: str, code: int = 1) -> int:
    print(f'inverse_dynamics: {message}', file=sys.stderr)
    return code


if __name__ == '__main__':
    sys.exit(main())
