"""Connects ROS to the other parts of the package, and knows the version of the package."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
import re

_PACKAGE = 'inverse_dynamics_node'


def version() -> str:
    """Return the version of the installed package, or of the source tree."""
    try:
        return metadata.version(_PACKAGE)
    except metadata.PackageNotFoundError:
        manifest = Path(__file__).resolve().parents[2] / 'package.xml'
        found = re.search('<version>(.*?)</version>', manifest.read_text())
        return found[1] if found else 'unknown'
