"""Finds the file with the robot description, given as a path or a URI; runs xacro if needed."""

from __future__ import annotations

import os
from pathlib import Path
import re
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from lxml import etree

from ..errors import ConfigurationError, UrdfError
from ..robot.model import RobotModel
from ..robot.urdf import load_urdf
from ..robot.urdf.xml import parse, read_source

_XACRO = re.compile(r'(?P<file>.+\.xacro)(?P<arguments>(?:\s+\w+:=\S*)*)\s*', re.S)


class _Given(NamedTuple):
    file: str
    arguments: dict[str, str] | None
    """For xacro; None if the file is a URDF."""


def load_file(given: str, on_missing_inertial: str) -> tuple[RobotModel, str]:
    """
    Load the robot description from the parameter robot_description_file.

    Parameters
    ----------
    given : str
        An absolute path, a path relative to the working directory or to a home directory (``~``),
        ``file:///path`` or ``package://package/path``. If it ends in ``.xacro``, the file is
        processed by xacro first; arguments ``name:=value`` may follow.
    on_missing_inertial : str
        See `load_urdf`.

    Returns
    -------
    robot : RobotModel
        The robot model.
    description : str
        The URDF as XML text.

    Raises
    ------
    ConfigurationError
        If the file or the package does not exist, or xacro cannot process the file.
    UrdfError
        If the file cannot be used.

    """
    file, arguments = _split(given)
    try:
        path = _resolve(file)
        if arguments is None or not path.exists():
            return load_urdf(path, on_missing_inertial), _text_of(path)
        return _load_xacro(path, arguments, on_missing_inertial)
    except ConfigurationError as error:
        raise ConfigurationError(f"robot_description_file '{given}': {error}") from None
    except UrdfError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        where = ''
        if file != str(path):
            is_relative = path == Path.cwd() / file
            where = f" ('{file}'{f', working directory {Path.cwd()}' if is_relative else ''})"
        if '.xacro ' in file:
            where += '; arguments of xacro are NAME:=VALUE'
        raise ConfigurationError(f'robot_description_file: no such file: {path}{where}') from None


def _split(given: str) -> _Given:
    match = _XACRO.fullmatch(given)
    if match is None:
        return _Given(given, None)
    pairs = (argument.partition(':=') for argument in match['arguments'].split())
    return _Given(match['file'], {name: value for name, _, value in pairs})


def _load_xacro(
    path: Path, arguments: dict[str, str], on_missing_inertial: str
) -> tuple[RobotModel, str]:
    try:
        import xacro
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f'{error}: install xacro (apt install ros-jazzy-xacro, or pip install xacro)'
        ) from None
    try:
        text = xacro.process_file(str(path), mappings=arguments).toprettyxml(indent='  ')
    except Exception as error:  # any: xacro evaluates Python expressions
        raise ConfigurationError(f'xacro: {error or repr(error)}') from None
    try:
        return load_urdf(text, on_missing_inertial), text
    except UrdfError as error:
        # The problems have the line numbers of the output of xacro.
        raise UrdfError(error.problems, f'output of xacro {path}') from None


def _text_of(path: Path) -> str:
    """Return a file that has been loaded, decoded, without comments."""
    root, _ = parse(read_source(path))
    etree.strip_tags(root, etree.Comment)
    return str(etree.tostring(root, encoding='unicode'))


def _resolve(given: str) -> Path:
    """Return the absolute path."""
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
        # Not found, not the name of a package, or no AMENT_PREFIX_PATH.
        raise ConfigurationError(
            f"package '{package}' not found; AMENT_PREFIX_PATH is "
            + (prefixes or 'empty: source the setup.bash of the workspace')
        ) from None
    except ModuleNotFoundError as error:
        raise ConfigurationError(f'package:// needs ament_index_python: {error}') from None
