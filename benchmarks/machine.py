"""Description of the machine on which the benchmarks ran."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import textwrap

PACKAGES = (
    'inverse_dynamics_node',
    'numpy',
    'numba',
    'pin',
    'mujoco',
    'drake',
    'roboticstoolbox-python',
)
ROS_PACKAGES = (
    'inverse_dynamics_node',
    'numpy',
    'numba',
    'ros-jazzy-rclpy',
    'ros-rmw-fastrtps-cpp',
)
"""Libraries to list with measurements of the node."""


def describe(packages: Sequence[str] = PACKAGES) -> str:
    """Describe processor, load, Python and library versions in lines for a Markdown page."""
    text = (
        f'{processor()}, {os.cpu_count()} cores, load {load()} before the start; '
        f'{platform.system()}, Python {platform.python_version()}; '
        f'{", ".join(versions(packages))}.'
    )
    # Pages are 100 columns wide; loop.md appends the load to the end of a line.
    return textwrap.fill(text, 80, break_on_hyphens=False)


def load() -> str:
    """Return the load average of the last minute; call this before any work."""
    return f'{os.getloadavg()[0]:.1f}' if hasattr(os, 'getloadavg') else '?'


def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    for line in lines:
        if line.startswith('model name'):
            return line.partition(':')[2].strip()
    return platform.machine()


def versions(packages: Sequence[str]) -> list[str]:
    """List the installed libraries with their versions."""
    found = []
    for name in packages:
        try:
            found.append(f'{name} {version(name)}')
        except PackageNotFoundError:
            found.append(f'{name} not installed')
    return found
