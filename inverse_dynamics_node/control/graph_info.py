"""The ROS graph around the node, as values."""

from __future__ import annotations

from typing import NamedTuple


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
