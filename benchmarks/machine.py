"""What the figures were measured on."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
import platform

from .timing import CORES

PACKAGES = (
    'inverse_dynamics_node',
    'numpy',
    'numba',
    'pin',
    'mujoco',
    'drake',
    'roboticstoolbox-python',
)


def describe() -> str:
    """Name the machine, Python and the libraries."""
    return (
        f'{processor()}, {len(CORES) or "?"} cores; {platform.system()}, Python '
        f'{platform.python_version()}; {", ".join(versions())}.'
    )


def processor() -> str:
    """Name the processor."""
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    for line in lines:
        if line.startswith('model name'):
            return line.partition(':')[2].strip()
    return platform.machine()


def versions() -> list[str]:
    """List the libraries with their versions."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f'{name} {version(name)}')
        except PackageNotFoundError:
            found.append(f'{name} not installed')
    return found
