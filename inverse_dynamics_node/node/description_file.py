"""Loads the robot description from the topic, a parameter or a file, with xacro if needed."""

from __future__ import annotations

import os
from pathlib import Path
import re
from urllib.parse import unquote, urlsplit

from lxml import etree

from ..errors import ConfigurationError, did_you_mean, listed, shortened, UrdfError
from ..robot.model import RobotModel
from ..robot.urdf import load_urdf
from ..robot.urdf.xml import is_text, parse, read_source
from .parameters import Configuration

_XACRO = re.compile(r'(?P<file>.+\.xacro)(?P<arguments>(?:\s+\w+:=\S*)*)\s*', re.S)


def load_robot(configuration: Configuration, description: str) -> tuple[RobotModel, str]:
    """
    Return the robot and the text of its URDF.

    `description` is the URDF from the topic. A URDF from a parameter or a file has
    precedence. Raise an InverseDynamicsError if there is no usable description.
    """
    if configuration.robot_description_file:
        return load_file(configuration.robot_description_file)
    text = configuration.robot_description or description
    if not text:
        raise ConfigurationError(
            'there is no robot description: none has arrived on the topic, and neither parameter '
            'robot_description nor robot_description_file is set'
        )
    if not is_text(text):  # load_urdf would open the text as a file
        is_parameter = bool(configuration.robot_description)
        where = "parameter 'robot_description'" if is_parameter else 'the robot description'
        hint = '; for a file, set robot_description_file' if is_parameter else ''
        raise ConfigurationError(
            f"{where} is '{shortened(text)}', expected the URDF as XML text{hint}"
        )
    return load_urdf(text), text


def load_file(given: str) -> tuple[RobotModel, str]:
    """
    Load the file named by robot_description_file; return the robot and the URDF text.

    `given` is a path, ``file:///path`` or ``package://package/path``. A path may start with
    ``~``. If the file name ends in ``.xacro``, xacro processes the file, and arguments
    ``name:=value`` may follow the name. Raise a ConfigurationError if the file or the package
    does not exist, or if xacro fails. Raise a UrdfError if the file cannot be used.
    """
    file, arguments = _split(given)
    try:
        path = _resolve(file)
        if arguments is None or not path.exists():
            return load_urdf(path), _text_of(path)
        return _load_xacro(path, arguments)
    except ConfigurationError as error:
        raise ConfigurationError(f"robot_description_file '{given}': {error}") from None
    except UrdfError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        where = ''
        if file != str(path):
            is_relative = path == Path.cwd() / file
            where = f" (given as '{file}'{f' in {Path.cwd()}' if is_relative else ''})"
        if '.xacro ' in file:
            where += '; give arguments of xacro as NAME:=VALUE'
        raise ConfigurationError(f'robot_description_file: no such file: {path}{where}') from None


def _split(given: str) -> tuple[str, dict[str, str] | None]:
    """Return the file name and the arguments for xacro; for a URDF, the arguments are None."""
    match = _XACRO.fullmatch(given)
    if match is None:
        return given, None
    pairs = (argument.partition(':=') for argument in match['arguments'].split())
    return match['file'], {name: value for name, _, value in pairs}


def _load_xacro(path: Path, arguments: dict[str, str]) -> tuple[RobotModel, str]:
    try:
        import xacro
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f'{error}; install xacro (apt install ros-jazzy-xacro, or pip install xacro)'
        ) from None
    given = _Arguments(arguments)
    try:
        text = xacro.process_file(str(path), mappings=given).toprettyxml(indent='  ')
    except Exception as error:  # of any type: xacro evaluates Python expressions
        raise ConfigurationError(f'xacro failed: {_message(error)}') from None
    for name in arguments:
        if name not in given.used:
            declared = sorted(given.used)
            text = (
                f'the arguments are {listed(declared)}' if declared else 'there are no arguments'
            )
            hint = did_you_mean(name, declared)
            raise ConfigurationError(f"xacro argument '{name}' is not declared; {text}{hint}")
    try:
        return load_urdf(text), text
    except UrdfError as error:
        # The line numbers in the problems refer to the output of xacro.
        raise UrdfError(error.problems, f'output of xacro for {path}') from None


class _Arguments(dict[str, str]):
    """The given arguments; `used` collects the names of those that the file asks for."""

    def __init__(self, given: dict[str, str]) -> None:
        super().__init__(given)
        self.used: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.used.add(str(name))
        return super().__contains__(name)


def _message(error: Exception) -> str:
    """Return the message of an error of xacro once, although it may contain that of its cause."""
    own, cause = str(error.args[0] if error.args else ''), getattr(error, 'exc', None)
    repeats = isinstance(cause, OSError) or (own and str(cause) in own)
    text = ' '.join((own if repeats else str(error) or repr(error)).split())
    text = re.sub(r"<class '[\w.]+'>: ", '', text).strip('"')
    undefined = re.search(r'Undefined substitution argument (\w+)', text)
    hint = f'; give it as {undefined[1]}:=VALUE after the file name' if undefined else ''
    return text + hint


def _text_of(path: Path) -> str:
    """Read a URDF file, and return its text without the comments."""
    root = parse(read_source(path))
    etree.strip_tags(root, etree.Comment)
    return str(etree.tostring(root, encoding='unicode'))


def _resolve(given: str) -> Path:
    """Return the absolute path of a file name or URI."""
    if given.startswith('package://'):
        package, _, rest = given.removeprefix('package://').partition('/')
        if not package or not rest:
            raise ConfigurationError('expected package://PACKAGE/PATH')
        return _share_directory(package) / rest
    if given.startswith('file:'):
        uri = urlsplit(given)
        if uri.netloc not in ('', 'localhost') or not uri.path.startswith('/'):
            raise ConfigurationError('expected file:///ABSOLUTE/PATH')
        return Path(unquote(uri.path))
    try:
        # A shell does not expand a ~ after :=.
        return Path(given).expanduser().absolute()
    except RuntimeError:
        raise ConfigurationError('no such user') from None
    except FileNotFoundError:
        raise ConfigurationError('the working directory no longer exists') from None


def _share_directory(package: str) -> Path:
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '')
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(package, print_warning=False))
    except (LookupError, ValueError, OSError):
        # The package is unknown, its name is invalid, or AMENT_PREFIX_PATH is not set.
        raise ConfigurationError(
            f"package '{package}' not found; AMENT_PREFIX_PATH is "
            + (prefixes or 'empty: source the setup.bash of the workspace')
        ) from None
    except ModuleNotFoundError as error:
        raise ConfigurationError(f'package:// needs ament_index_python ({error})') from None
