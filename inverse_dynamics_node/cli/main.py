"""Runs `inverse_dynamics COMMAND ...`, and prints each error on one line."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
import os
import sys

from ..errors import (
    did_you_mean,
    escaped,
    InverseDynamicsError,
    RecordingError,
    shortened,
    TrajectoryError,
)
from .console import OutputError

_COMMANDS = {
    'without a robot': {
        'check': 'report on a URDF: masses, limits, warnings, gravity efforts, payload capacity',
        'effort': 'efforts, speeds and powers along a trajectory, compared with the limits',
        'excite': 'plan the motion to record for `identify`',
    },
    'with recordings of a robot': {
        'compare': 'compare a recording with the model, fit friction, diagnose differences',
        'identify': 'calibrate a URDF: masses, friction and armature from recordings',
        'payload': 'measure a payload: its mass and centre of mass, from recordings',
    },
    'with ROS 2': {
        'watch': 'watch a running node: do model and robot agree?',
        'probe': 'push the joints of a live arm: do they move as commanded?',
        'simulate': 'simulate a robot, to try the node without hardware (needs MuJoCo)',
        'demo': 'run the node on a simulated robot, and judge the result (needs MuJoCo)',
    },
}
COMMANDS = tuple(name for group in _COMMANDS.values() for name in group)
"""Each command is a module with make_parser() and run(options), which returns the exit code."""

_USAGE = """\
usage: inverse_dynamics COMMAND [ARGUMENT]...
       inverse_dynamics [-h] [--version]"""

_HELP = f"""\
{_USAGE}

Check a URDF, compare it with the robot, calibrate it, and watch the node.

{{commands}}

options:
  -h, --help  show this text; `inverse_dynamics COMMAND --help` describes a command
  --version   show the version

examples:
  inverse_dynamics check my_arm.urdf
  inverse_dynamics effort my_arm.urdf trajectory.yaml --payload 1.5 --link tool0
  inverse_dynamics compare my_arm.urdf rosbag2_2026_11_21
  inverse_dynamics identify my_arm.urdf rosbag2_2026_11_21 --output calibrated.urdf
  inverse_dynamics payload my_arm.urdf loaded.mcap --empty empty.mcap
  inverse_dynamics watch --for 10

exit code: 0 for success, 1 if an input cannot be read or used, 2 for invalid arguments; the help
of a command lists its other codes. `inverse_dynamics_node --help` describes the node itself."""

_ROS_COMMANDS = (
    'excite',
    'payload',
    'watch',
    'probe',
    'simulate',
)  # commands that accept --ros-args
# Ubuntu 24.04 refuses `pip install` outside of a virtual environment, and its scipy needs numpy 1.
_IS_VENV = sys.prefix != sys.base_prefix
_PIP = 'run pip install' if _IS_VENV else 'run pip install --break-system-packages'
_ADVICE = {
    'matplotlib': f'{_PIP} matplotlib, or sudo apt install python3-matplotlib',
    'rich': f'{_PIP} rich, or sudo apt install python3-rich',
    'yaml': f'{_PIP} pyyaml, or sudo apt install python3-yaml',
    'rosbags': f'{_PIP} rosbags' if _IS_VENV else f"{_PIP} rosbags 'numpy<2'",
    'mujoco': f'{_PIP} mujoco',
    **dict.fromkeys(
        (
            'diagnostic_msgs',
            'rcl_interfaces',
            'rclpy',
            'sensor_msgs',
            'std_msgs',
            'trajectory_msgs',
        ),
        "source the setup file of ROS 2, or run pip install '.[ros,demo]' in a copy of the "
        'repository',
    ),
}
"""Advice for each package that may be missing."""
_INVALID_ARGUMENTS = 2
_INTERRUPTED, _BROKEN_PIPE = 130, 141  # exit codes of a shell for SIGINT and SIGPIPE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, and return the exit code. Print any error on one line."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(arguments)
        sys.stdout.flush()  # flushed here, because a broken pipe is caught only here
        return code
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # Otherwise Python would print an error while flushing the output at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package not in _ADVICE:
            raise
        return _fail(f'{error}; {_ADVICE[package]}')
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
    command, *others = arguments or ['']
    if command in ('', '-h', '--help'):
        print(_HELP.format(commands='\n\n'.join(map(_listing, _COMMANDS.items()))))
        return 0 if command else _INVALID_ARGUMENTS
    if command == '--version':
        from ..ros import version

        print(f'inverse_dynamics {version()}')
        return 0
    if '--ros-args' in arguments and command not in _ROS_COMMANDS:
        return _fail(
            f'only these commands accept --ros-args: {", ".join(_ROS_COMMANDS)}; to run the node, '
            'use ros2 run inverse_dynamics_node inverse_dynamics_node --ros-args ...',
            _INVALID_ARGUMENTS,
        )
    if command not in COMMANDS:
        kind, names = (
            ('option', ['--help', '--version']) if command[0] == '-' else ('command', COMMANDS)
        )
        hint = did_you_mean(command, names) or f', expected one of {", ".join(names)}'
        return _fail(f"there is no {kind} '{shortened(command)}'{hint}", _INVALID_ARGUMENTS)
    if command in ('identify', 'payload'):
        # The matrices are so small that threads would slow the computation.
        os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    # Imported here, so that Ctrl-C ends the slow import without a traceback.
    module = import_module(f'.{command}', __package__)
    others, ros_arguments = _split(others)
    options = module.make_parser().parse_args(others)
    options.ros_arguments = ros_arguments
    code: int = module.run(options)
    return code


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Separate the arguments of the command from the arguments of ROS."""
    if '--ros-args' not in arguments:
        return arguments, []
    begin = arguments.index('--ros-args')
    rest = arguments[begin:]
    end = begin + (rest.index('--') if '--' in rest else len(rest))
    return arguments[:begin] + arguments[end + 1 :], arguments[begin:end]


def _listing(group: tuple[str, dict[str, str]]) -> str:
    title, commands = group
    return '\n'.join([f'{title}:', *(f'  {name:<9} {text}' for name, text in commands.items())])


def _fail(message: str, code: int = 1) -> int:
    # A message may contain names from files. Its line ends are those of a list of problems.
    lines = map(escaped, message.split('\n'))
    print('inverse_dynamics: ' + '\n'.join(lines), file=sys.stderr)
    return code


if __name__ == '__main__':
    sys.exit(main())
