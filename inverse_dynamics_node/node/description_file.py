"""Finds the file with the robot description, given as a path or a URI."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ..errors import ConfigurationError, UrdfError
from ..robot.model import RobotModel
from ..robot.urdf import load_urdf


def load_file(given: str, on_missing_inertial: str) -> RobotModel:
    """
    Load the robot description from the parameter robot_description_file.

    Parameters
    ----------
    given : str
        An absolute path, a path relative to the working directory or to a home directory (``~``),
        ``file:///path`` or ``package://package/path``.
    on_missing_inertial : str
        See `load_urdf`.

    Returns
    -------
    robot : RobotModel
        The robot model.

    Raises
    ------
    ConfigurationError
        If the file or the package does not exist.
    UrdfError
        If the file cannot be used.

    """
    try:
        path = _resolve(given)
        return load_urdf(path, on_missing_inertial)
    except ConfigurationError as error:
        raise ConfigurationError(f"robot_description_file '{given}': {error}") from None
    except UrdfError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        where = ''
        if given != str(path):
            is_relative = path == Path.cwd() / given
            where = f" ('{given}'{f', working directory {Path.cwd()}' if is_relative else ''})"
        raise ConfigurationError(f'robot_description_file: no such file: {path}{where}') from None


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
