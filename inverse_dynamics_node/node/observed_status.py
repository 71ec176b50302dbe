"""The state of a node, read from its messages on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple

from ..control.phase import COMPUTING_PHASES
from ..control.status import Level

_COMPUTING = {phase.value for phase in COMPUTING_PHASES}


class Problem(NamedTuple):
    """A part of the node that is not OK."""

    part: str
    level: str
    """``WARN`` or ``ERROR``."""
    message: str


@dataclass(frozen=True)
class ObservedStatus:
    """The state of a node; values that it does not report are empty, None or NaN."""

    state: str
    """Lifecycle state."""
    phase: str
    mode: str
    activity: str
    """Phase and its reason, in words."""
    is_computing: bool
    """Whether the node computes efforts for the current joint states."""
    is_dry_run: bool
    rate: float | None
    """Commands per second [Hz]."""
    requested_rate: float | None
    """[Hz]; None if there is one command for each joint state."""
    state_rate: float | None
    """Joint states per second [Hz]."""
    state_age: float | None
    """Age of the joint states [s]."""
    state_timeout: float | None
    reference_age: float | None
    """Age of the reference [s]."""
    reference_timeout: float | None
    """[s]; 0: unlimited."""
    receivers: int | None
    """Number of subscribers of the commands."""
    commands: str
    """Topic of the commands."""
    subscribers: str
    """Nodes that subscribe to the commands."""
    payload: str
    joints: tuple[str, ...]
    """Commanded joints."""
    limits: tuple[float, ...]
    """Largest efforts of these [N m or N]; inf if there is none."""
    saturated: tuple[str, ...]
    """Joints whose efforts were cut to these since the report before."""
    gravity: tuple[float, ...]
    """[m/s^2]; zero if the model does not include it."""
    cutoff: float
    """Cutoff of the external efforts [Hz]."""
    uses_simulated_time: bool
    topics: Mapping[str, str] = field(default_factory=dict)
    """Topics of ``joint_states``, ``joint_efforts`` and ``external_efforts``."""
    problems: tuple[Problem, ...] = ()
    """Parts that are not OK, errors first."""


def read_status(message: Any, node: str) -> ObservedStatus | None:
    """
    Read the state of a node.

    Parameters
    ----------
    message : diagnostic_msgs.msg.DiagnosticArray
        A message of any node.
    node : str
        Fully qualified name of the node.

    Returns
    -------
    status : ObservedStatus or None
        None if the message is from another node.

    """
    prefix = f'{node.strip("/")}: '
    parts = {
        status.name.removeprefix(prefix): status
        for status in message.status
        if status.name.startswith(prefix)
    }
    if 'loop' not in parts:
        return None
    values = {
        part: {pair.key: pair.value for pair in status.values} for part, status in parts.items()
    }
    loop, states = values['loop'], values.get('joint states', {})
    reference, efforts = values.get('reference', {}), values.get('efforts', {})
    others, model = values.get('other nodes', {}), values.get('model', {})
    phase = loop.get('phase', '')
    return ObservedStatus(
        state=loop.get('state', ''),
        phase=phase,
        mode=loop.get('mode', ''),
        activity=parts['loop'].message,
        is_computing=loop.get('state') == 'active' and phase in _COMPUTING,
        is_dry_run=loop.get('dry run') == 'yes',
        rate=_number(loop.get('rate [Hz]')),
        requested_rate=_number(loop.get('requested rate [Hz]')),
        state_rate=_number(states.get('rate [Hz]')),
        state_age=_number(states.get('age [s]')),
        state_timeout=_number(states.get('timeout [s]')),
        reference_age=_number(reference.get('age [s]')),
        reference_timeout=_number(reference.get('timeout [s]')),
        receivers=int(efforts['receivers']) if 'receivers' in efforts else None,
        commands=others.get('commands', ''),
        subscribers=others.get('subscribers of the commands', ''),
        payload=model.get('payload', ''),
        joints=_names(model.get('joints', '')),
        limits=tuple(_limit(text) for text in efforts.get('limits [N m, N]', '').split(', ')),
        saturated=_names(efforts.get('cut to limit since the last report', '')),
        gravity=_vector(model.get('gravity [m/s^2]', '')),
        cutoff=_number(efforts.get('cutoff of the external efforts [Hz]')) or 0.0,
        uses_simulated_time='clock' in parts,
        topics={
            'joint_states': states.get('topic', ''),
            'joint_efforts': efforts.get('topic with names', ''),
            'external_efforts': efforts.get('topic of the external efforts', ''),
        },
        problems=_problems(parts),
    )


def _problems(parts: Mapping[str, Any]) -> tuple[Problem, ...]:
    levels = {part: Level(status.level[0]) for part, status in parts.items()}
    found = [
        (-level, Problem(part, level.name, parts[part].message))
        for part, level in levels.items()
        if level is not Level.OK
    ]
    return tuple(problem for _, problem in sorted(found))


def _names(text: str) -> tuple[str, ...]:
    return tuple(name for name in text.split(', ') if name not in ('', 'none'))


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text is not None else None
    except ValueError:  # such as 'never'
        return None


def _limit(text: str) -> float:
    number = _number(text)
    return math.inf if number is None else number


def _vector(text: str) -> tuple[float, ...]:
    numbers = [_number(word) for word in text.split(',')]
    known = tuple(number for number in numbers if number is not None)
    return known if len(known) == 3 else (0.0, 0.0, 0.0)
