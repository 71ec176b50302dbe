"""
What a node says about itself: one record, from the control loop to `watch`.

`Monitor` makes it, ``diagnostics`` writes it to ``/diagnostics`` and reads it back, and
`status_text` says it in words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
import enum
from typing import NamedTuple

from .settings import Mode
from .supervision import COMPUTING_PHASES, Phase

_MOST_NAMES = 5  # of nodes, in one message


class Level(enum.IntEnum):
    """Severity; the numbers are those of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class NodeNames(NamedTuple):
    """The first few of many nodes."""

    first: tuple[str, ...] = ()
    more: int = 0
    """How many more there are."""

    @classmethod
    def of(cls, names: Sequence[str]) -> NodeNames:
        """Keep the first few names."""
        return cls(tuple(names[:_MOST_NAMES]), max(0, len(names) - _MOST_NAMES))

    def __str__(self) -> str:
        """Return the names, and how many more there are."""
        return ', '.join(self.first) + (f' and {self.more} more' if self.more else '')


class Payload(NamedTuple):
    """The load on a link."""

    mass: float
    """[kg]."""
    link: str

    def __str__(self) -> str:
        """Return the mass and the link."""
        return f'{self.mass:g} kg on {self.link}'


@dataclass(frozen=True)
class Part:
    """A part of the node. Values that are not reported are None or empty."""

    level: Level = Level.OK
    message: str = ''
    """The state in words."""


@dataclass(frozen=True)
class LoopStatus(Part):
    """The control loop, and what it is doing; the statistics are those since the last report."""

    state: str = ''
    """Lifecycle state."""
    rate: float | None = None
    """Commands per second [Hz]."""
    requested_rate: float | None = None
    """[Hz]; None if there is one command for each joint state."""
    period_p99: float | None = None
    """99th percentile of the times between commands [s]."""
    period_worst: float | None = None
    """[s]."""
    compute_time_p99: float | None = None
    """[s]."""
    overruns: int | None = None
    """Commands since the start that were more than half a period late."""
    mode: Mode | None = None
    """None unless the node is active; the same for the values below."""
    phase: Phase | None = None
    is_dry_run: bool | None = None
    gain: float | None = None
    """Factor of the computed efforts, 0 to 1."""


@dataclass(frozen=True)
class MessagesStatus(Part):
    """Messages that could not be used."""

    rejected: Mapping[str, int] = field(default_factory=dict)
    """Numbers of messages, by topic and reason."""


@dataclass(frozen=True)
class OtherNodesStatus(Part):
    """Other nodes that use the topic of the commands, or the name of this node."""

    commands: str = ''
    """Topic of the commands."""
    subscribers: NodeNames = field(default_factory=NodeNames)
    rivals: NodeNames = field(default_factory=NodeNames)
    """Other publishers of the commands."""
    namesakes: int | None = None


@dataclass(frozen=True)
class ClockStatus(Part):
    """The clock of a simulation."""

    time: float | None = None
    """[s]; 0 if none has arrived."""
    unchanged_for: float | None = None
    """Steady time since it changed [s]."""
    publishers: int | None = None


@dataclass(frozen=True)
class JointStatesStatus(Part):
    """The joint states that arrive."""

    topic: str = ''
    rate: float | None = None
    """Updates of all commanded joints per second [Hz]."""
    age: float | None = None
    """[s]; None if a commanded joint was never reported."""
    timeout: float | None = None
    """[s]."""
    publishers: int | None = None
    late: tuple[str, ...] = ()
    """Joints that are not commanded, and late."""
    locked: tuple[str, ...] = ()
    """Joints at their locked positions, because they were never reported."""
    without_velocity: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReferenceStatus(Part):
    """The reference, and whether it is followed."""

    age: float | None = None
    """[s]; None if there was none."""
    timeout: float | None = None
    """[s]; 0: unlimited."""
    mode: Mode | None = None


@dataclass(frozen=True)
class EffortsStatus(Part):
    """The commands."""

    receivers: int | None = None
    """Number of subscribers."""
    topic: str = ''
    """Topic of the efforts with names."""
    external_topic: str = ''
    """Topic of the external efforts."""
    external_cutoff: float | None = None
    """Cutoff of the external efforts [Hz]."""
    limits: tuple[float, ...] = ()
    """Largest efforts in the order of the commanded joints [N m or N]; inf if there is none."""
    cut: tuple[str, ...] = ()
    """Joints whose efforts were cut to these since the last report."""
    cut_counts: Mapping[str, int] = field(default_factory=dict)
    """Commands since the start that were cut to a limit, by joint."""
    slowed_counts: Mapping[str, int] = field(default_factory=dict)
    """Commands since the start that a rate limit slowed, by joint."""


@dataclass(frozen=True)
class ModelStatus(Part):
    """The robot and its loads."""

    robot: str = ''
    mass: float | None = None
    """[kg]."""
    joints: tuple[str, ...] = ()
    """Commanded joints."""
    payloads: tuple[Payload, ...] = ()
    gravity: tuple[float, ...] | None = None
    """[m/s^2]; None if the model does not include it."""
    warnings: tuple[str, ...] = ()
    """About the robot description."""


@dataclass(frozen=True)
class SchedulingStatus(Part):
    """Priority and memory of the process; the scheduler is unknown on some platforms."""

    memory: str = ''
    policy: str | None = None
    priority: int | None = None
    cpus: tuple[int, ...] | None = None
    threads: int | None = None
    """Number of threads with this priority."""


class Problem(NamedTuple):
    """A part of the node that is not OK."""

    part: str
    level: str
    """``WARN`` or ``ERROR``."""
    message: str


@dataclass(frozen=True)
class NodeStatus:
    """
    Everything that a node says about itself, in the order in which it is published.

    Parts that do not exist are None: those of the robot until the node is configured, and the
    clock without simulated time.

    """

    loop: LoopStatus
    messages: MessagesStatus | None = None
    other_nodes: OtherNodesStatus | None = None
    clock: ClockStatus | None = None
    joint_states: JointStatesStatus | None = None
    reference: ReferenceStatus | None = None
    efforts: EffortsStatus | None = None
    model: ModelStatus | None = None
    scheduling: SchedulingStatus | None = None

    def parts(self) -> dict[str, Part]:
        """Return the parts that exist, by their names in ``/diagnostics``."""
        parts = {field.name.replace('_', ' '): getattr(self, field.name) for field in fields(self)}
        return {name: part for name, part in parts.items() if part is not None}

    @property
    def is_computing(self) -> bool:
        """Whether the node computes efforts for the current joint states."""
        return self.loop.state == 'active' and self.loop.phase in COMPUTING_PHASES

    def limits(self) -> dict[str, float]:
        """Return the largest efforts by commanded joint [N m or N]; empty if they are unknown."""
        if self.model is None or self.efforts is None:
            return {}
        pairs = zip(self.model.joints, self.efforts.limits, strict=False)
        return dict(pairs) if len(self.model.joints) == len(self.efforts.limits) else {}

    def problems(self) -> tuple[Problem, ...]:
        """Return the parts that are not OK, errors first."""
        found = [
            (-part.level, Problem(name, part.level.name, part.message))
            for name, part in self.parts().items()
            if part.level is not Level.OK
        ]
        return tuple(problem for _, problem in sorted(found))


class Others(NamedTuple):
    """Other nodes that use the topic of the commands, or the name of this node."""

    name: str = ''
    """Fully qualified name of this node."""
    commands: str = ''
    """Topic of the commands."""
    subscribers: tuple[str, ...] = ()
    """Nodes that subscribe to the commands."""
    rivals: tuple[str, ...] = ()
    """Other nodes that publish on the topic of the commands."""
    namesakes: int = 0
    """Number of other nodes with the name of this one."""


class SimulatedTime(NamedTuple):
    """The clock of a simulation."""

    time: float
    """[s]; 0 if none has arrived."""
    unchanged_for: float
    """Steady time since it changed [s]."""
    publishers: int
    """Number of publishers of /clock."""


class Topics(NamedTuple):
    """Resolved names of topics."""

    joint_states: str = ''
    joint_efforts: str = ''
    external_efforts: str = ''


class GraphInfo(NamedTuple):
    """The state of the node, and its connections."""

    receivers: int
    """Number of subscriptions to the commands."""
    publishers: int
    """Number of publishers of joint states."""
    is_active: bool
    state: str
    """Lifecycle state."""
    others: Others = Others()
    state_publishers: tuple[str, ...] = ()
    """Nodes that publish joint states; empty unless their positions contradict each other."""
    simulated: SimulatedTime | None = None
    """None unless the node uses simulated time."""
    is_dry_run: bool = False
    """Whether the commands are not sent."""
    silence: float = 0.0
    """Time since the last message on joint_states, of any joint [s]."""
    state_rate: float = 0.0
    """Updates of all commanded joints since the last report [Hz]."""
    topics: Topics = Topics()
