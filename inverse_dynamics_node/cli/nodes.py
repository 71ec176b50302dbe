"""Finds running nodes by their names."""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from typing import Any

from ..errors import ConfigurationError, escaped

_DISCOVERY = 1.5  # [s]; usual duration of discovery
_PATIENCE = 5.0  # [s]; after this time, the wait is announced
MOST_DISCOVERY = 10.0  # [s]; longest wait for a node, except in `watch` without --for


def node_name(text: str) -> str:
    """Check a node name that was given on the command line, and return it."""
    if not re.fullmatch(r'/?(\w+/)*[A-Za-z_]\w*', text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"'{text}' cannot be the name of a node: use letters, digits, _, and / between parts"
        )
    return text


def choose_node(node: Any, wanted: str | None, is_patient: bool) -> str:
    """
    Return the full name of the inverse dynamics node that the user wants.

    `wanted` is the full name, or the last part of the name, or None for the only node. Wait until
    a node matches, but no longer than `MOST_DISCOVERY` unless `is_patient` is true. Raise
    ConfigurationError if no node matches, or if several match and none has the full name `wanted`.
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
            print(escaped(f'{_not_found(wanted, names)}; still waiting'), file=sys.stderr)
            has_announced = True
        time.sleep(0.05)
    if wanted in chosen:
        return str(wanted)
    return only_one(chosen)


def only_one(names: list[str]) -> str:
    """Return the only name, or '' if there is none; raise ConfigurationError for several names."""
    if len(names) > 1:
        raise ConfigurationError(
            f'there are {len(names)} nodes: {", ".join(names)}; choose one by its name, such as '
            f'{names[0]}'
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
    others = f', only {", ".join(names)}' if names else ''
    return f"no inverse dynamics node '{wanted}' found{others} ({where})"
