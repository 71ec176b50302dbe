"""
The status that a node reports.

`Monitor` creates the status. `write_status` and `read_status` transfer the status through
``/diagnostics`` to the command ``watch``. `status_text` describes the status in words.
"""

# ruff: noqa: RUF009 -- key() returns a dataclasses.field
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
import enum
from typing import Any, NamedTuple

from .settings import Mode
from .supervision import COMPUTING_PHASES, Phase

_MOST_NAMES = 5  # largest number of node names in one message


class Level(enum.IntEnum):
    """Severity of a status; the numbers are those of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class NodeNames(NamedTuple):
    """Names of the first few nodes, and the number of further nodes."""

    first: tuple[str, ...] = ()
    more: int = 0
    """Number of further nodes."""

    @classmethod
    def of(cls, names: Sequence[str]) -> NodeNames:
        """Shorten a list of node names."""
        return cls(tuple(names[:_MOST_NAMES]), max(0, len(names) - _MOST_NAMES))

    def __str__(self) -> str:
        """Return the names, and the number of further nodes."""
        return ', '.join(self.first) + (f' and {self.more} more' if self.more else '')


class Payload(NamedTuple):
    """The payload of a link."""

    mass: float
    """Mass [kg]."""
    link: str

    def __str__(self) -> str:
        """Return the mass and the link."""
        return f'{self.mass:g} kg on {self.link}'


def key(name: str, form: str = '', absent: str = '', default: Any = None) -> Any:
    """
    Declare a value with its key in ``/diagnostics``.

    If ``name`` contains ``*``, the value has several keys. Each key has a name or number instead
    of ``*``. ``form`` is the format of numbers. ``absent`` is the text for None. Without this
    text, a value of None is not reported. ``default`` is the value if the key is not reported.

    """
    return field(default=default, metadata={'key': name, 'form': form, 'absent': absent})


@dataclass(frozen=True)
class Part:
    """The status of one part of the node."""

    level: Level = Level.OK
    message: str = ''
    """The status in words."""


@dataclass(frozen=True)
class LoopStatus(Part):
    """The status of the control loop; rates and times are those since the last report."""

    state: str = key('state', default='')
    """Lifecycle state."""
    rate: float | None = key('rate [Hz]', '.1f')
    """Rate of the commands [Hz]."""
    requested_rate: float | None = key('requested rate [Hz]', 'g', 'that of the joint states')
    period_p99: float | None = key('period p99 [ms]', '.3f', 'none')
    """99th percentile of the times between commands [s]; reported in ms."""
    period_worst: float | None = key('period worst [ms]', '.3f', 'none')
    """Longest time between commands [s]; reported in ms."""
    compute_time_p99: float | None = key('compute time p99 [ms]', '.3f', 'none')
    """99th percentile of the computation times [s]; reported in ms."""
    overruns: int | None = key('overruns')
    """Number of commands since the start that were more than half a period late."""
    mode: Mode | None = key('mode')
    """Mode of the controller; this value and those below are None unless the node is active."""
    phase: Phase | None = key('phase')
    is_dry_run: bool | None = key('dry run')
    gain: float | None = key('gain', '.3f')


@dataclass(frozen=True)
class MessagesStatus(Part):
    """Number of rejected messages, by topic and reason."""

    rejected: Mapping[str, int] | None = key('*')


@dataclass(frozen=True)
class OtherNodesStatus(Part):
    """Other nodes that use the topic of the commands or have the name of this node."""

    commands: str = key('commands', default='')
    """Topic of the commands."""
    subscribers: NodeNames = key('subscribers of the commands', default=NodeNames())
    rivals: NodeNames = key('other publishers of the commands', default=NodeNames())
    namesakes: int | None = key('other nodes with this name')


@dataclass(frozen=True)
class ClockStatus(Part):
    """The clock of a simulation."""

    time: float | None = key('time [s]', '.3f')
    """Simulated time [s]; 0 if none has arrived."""
    unchanged_for: float | None = key('unchanged for [s]', '.1f')
    """Time since the last change of the simulated time, measured by a steady clock [s]."""
    publishers: int | None = key('publishers')
    """Number of publishers of /clock."""


@dataclass(frozen=True)
class JointStatesStatus(Part):
    """The joint states that the node receives."""

    topic: str = key('topic', default='')
    rate: float | None = key('rate [Hz]', '.1f')
    """Rate at which all commanded joints are updated [Hz]."""
    age: float | None = key('age [s]', '.3f', 'never')
    """Largest age among the latest states of the commanded joints [s]."""
    timeout: float | None = key('timeout [s]', 'g')
    publishers: int | None = key('publishers')
    late: tuple[str, ...] = key('late, not commanded', default=())
    locked: tuple[str, ...] = key('locked, never reported', default=())
    without_velocity: tuple[str, ...] = key('without velocity', default=())


@dataclass(frozen=True)
class ReferenceStatus(Part):
    """The reference, and whether it is followed."""

    age: float | None = key('age [s]', '.3f', 'never')
    timeout: float | None = key('timeout [s]', 'g')
    """Age up to which a reference is followed [s]; 0 means unlimited."""
    mode: Mode | None = key('mode')


@dataclass(frozen=True)
class EffortsStatus(Part):
    """The commanded efforts, and the settings for measured efforts."""

    receivers: int | None = key('receivers')
    topic: str = key('topic with names', default='')
    external_topic: str = key('topic of the external efforts', default='')
    measures_gravity: bool | None = key('measured efforts contain gravity')
    """Whether measured efforts contain gravity, according to the parameters."""
    measured_scale: tuple[float, ...] = key('scale of the measured efforts', 'g', default=())
    """Factors for the measured efforts, in the order of the commands."""
    scale: tuple[float, ...] = key('scale', 'g', default=())
    """Factors that convert modelled efforts into commands, in the order of the commands."""
    limits: tuple[float, ...] = key('limits [N m, N]', 'g', default=())
    """Effort limits in the order of the commands [N m or N]; inf means unlimited."""
    cut: tuple[str, ...] = key('cut to limit since the last report', default=())
    cut_counts: Mapping[str, int] | None = key('* cut to limit')
    """How often the effort of each joint has been cut to its limit since the start."""
    slowed_counts: Mapping[str, int] | None = key('* slowed')
    """How often a rate limit has slowed the effort of each joint since the start."""


@dataclass(frozen=True)
class ModelStatus(Part):
    """The robot and its loads."""

    robot: str = key('robot', default='')
    mass: float | None = key('mass [kg]', '.4g')
    joints: tuple[str, ...] = key('joints', default=())
    """Commanded joints."""
    payloads: tuple[Payload, ...] = key('payload', default=())
    payload_coms: tuple[float, ...] = key('payload com [m]', '.4g', default=())
    """Centres of mass in the frames of the links, three numbers for each payload."""
    gravity: tuple[float, ...] | None = key('gravity [m/s^2]', '.3f', 'not included')
    """Gravity that the commands include, in the frame of the base link; None if excluded."""
    gravity_at_root: tuple[float, ...] | None = key('gravity in the root link [m/s^2]', '.3f')
    """Gravity in the frame of the root link, even if the commands do not include it."""
    warnings: tuple[str, ...] = key('warning *', default=())
    """Warnings about the robot description."""


@dataclass(frozen=True)
class SchedulingStatus(Part):
    """Priority of the control loop."""

    policy: str | None = key('policy')
    priority: int | None = key('priority')


class Problem(NamedTuple):
    """A problem in one part of the node."""

    part: str
    level: str
    """The level, ``WARN`` or ``ERROR``."""
    message: str


@dataclass(frozen=True)
class NodeStatus:
    """
    The complete status of a node, in the order of publication.

    Parts that do not exist are None. The parts about the robot exist after the node is configured.
    The clock part exists if simulated time is used.

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
        """Return the effort limit of each commanded joint [N m or N]; empty if unknown."""
        return self._by_joint(self.efforts.limits) if self.efforts else {}

    def unscaled_limits(self) -> dict[str, float]:
        """Return, by joint, the modelled effort that reaches the limit if the offset is zero."""
        scale = self._by_joint(self.efforts.scale) if self.efforts else {}
        return {
            joint: limit / abs(scale[joint])
            for joint, limit in self.limits().items()
            if scale.get(joint)
        }

    def measured_scale(self) -> dict[str, float]:
        """Return the factor for the measured efforts of each commanded joint; empty if unknown."""
        return self._by_joint(self.efforts.measured_scale) if self.efforts else {}

    def _by_joint(self, values: tuple[float, ...]) -> dict[str, float]:
        joints = self.model.joints if self.model else ()
        return dict(zip(joints, values, strict=True)) if len(joints) == len(values) else {}

    def problems(self) -> tuple[Problem, ...]:
        """Return the problems of all parts, with errors first."""
        found = [
            (-part.level, Problem(name, part.level.name, part.message))
            for name, part in self.parts().items()
            if part.level is not Level.OK
        ]
        return tuple(problem for _, problem in sorted(found))


class Topics(NamedTuple):
    """Resolved names of topics."""

    joint_states: str = ''
    joint_efforts: str = ''
    external_efforts: str = ''


class GraphInfo(NamedTuple):
    """The state and the connections of the node."""

    receivers: int
    """Number of subscriptions to the commands."""
    publishers: int
    """Number of publishers of joint states."""
    is_active: bool
    state: str
    """Lifecycle state."""
    name: str = ''
    """Fully qualified name of this node."""
    others: OtherNodesStatus = OtherNodesStatus()
    """Other nodes; level and message are not set yet."""
    clock: ClockStatus | None = None
    """None unless the node uses simulated time."""
    silence: float = 0.0
    """Length of the silence on joint_states [s]; see `StalledPublishers`."""
    state_rate: float = 0.0
    """Rate at which all commanded joints were updated since the last report [Hz]."""
    topics: Topics = Topics()
