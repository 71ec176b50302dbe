"""`inverse_dynamics demo ...`: the node on a simulated robot."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Have the command listed; its arguments are read by the demo itself."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'demo', help='run the node on a simulated robot (needs ROS 2 and MuJoCo)', add_help=False
    )
    parser.set_defaults(run=lambda options: main([]))


def main(arguments: list[str]) -> int:
    """Hand over to the demo: the one command that needs ROS, imported only when chosen."""
    from ..simulation.demo import main as run_demo

    return run_demo(arguments)
