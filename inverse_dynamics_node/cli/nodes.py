"""Running nodes that commands look for by name."""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from typing import Any

from ..errors import ConfigurationError

_DISCOVERY = 1.5  # [s]; discovery takes up to this long, and longer on a busy machine
_PATIENCE = 5.0  # [s]; until the wait for a node is reported
MOST_DISCOVERY = 10.0  # [s]; until --for reports that there is no node


def node_name(text: str) -> str:
    """Check the name of a node on the command line."""
    if not re.fullmatch(r'/?(\w+/)*[A-Za-z_]\w*', text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"'{text}' cannot be the name of a node: letters, digits and _, with / between them"
        )
    return text


def choose_node(node: Any, wanted: str | None, is_patient: bool) -> str:
    """
    Find the name of the node that is meant.

    Parameters
    ----------
    node : Node
        The node of this process.
    wanted : str or None
        Its name, or the end of it; None if it is the only one.
    is_patient : bool
        Whether to wait until there is one.

    Raises
    ------
    ConfigurationError
        If there are several, or none after a while.

    """
    from ..ros.observer import find_nodes

    began = time.monotonic()
    has_announced = False
    while True:
        names = find_nodes(node)
        waited = time.monotonic() - began
        chosen = [name for name in names if _is_named(name, wanted)]
        if chosen and (waited > _DISCOVERY or wanted in chosen):
            break
        if not is_patient and waited > MOST_DISCOVERY:
            raise ConfigurationError(_not_found(wanted, names))
        if waited > _PATIENCE and not has_announced:
            print(f'{_not_found(wanted, names)}; waiting for it', file=sys.stderr)
            has_announced = True
        time.sleep(0.05)
    if wanted in chosen:
        return str(wanted)
    return only_one(chosen)


def only_one(names: list[str]) -> str:
    """Return the only name, empty if there is none; several are an error."""
    if len(names) > 1:
        raise ConfigurationError(
            f'{len(names)} nodes: {", ".join(names)}; choose one by its name, such as {names[0]}'
        )
    return names[0] if names else ''


def _is_named(name: str, wanted: str | None) -> bool:
    return wanted is None or name == wanted or name.endswith(f'/{wanted.lstrip("/")}')


def _not_found(wanted: str | None, names: list[str]) -> str:
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    where = f'ROS_DOMAIN_ID is {domain}, ROS_AUTOMATIC_DISCOVERY_RANGE is {reach}'
    if wanted is None:
        return f'no inverse dynamics node found ({where})'
    others = f'; there are {", ".join(names)}' if names else ''
    return f"no inverse dynamics node '{wanted}' found{others} ({where})"
