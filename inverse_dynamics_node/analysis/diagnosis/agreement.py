"""The result of a live comparison of model and robot."""

from __future__ import annotations

from dataclasses import dataclass
import enum

from .fault import FaultKind


class Outcome(enum.Enum):
    """Whether model and robot agree, and the arm can be held by the efforts."""

    AGREE = 'agree'
    DIFFER = 'differ'
    UNDECIDED = 'undecided'
    SATURATED = 'saturated'
    """The efforts are cut to their limits, and no difference was found."""
    FEW_JOINTS = 'few_joints'
    """They agree, but only few joints could be compared."""


class Obstacle(enum.Enum):
    """Why an agreement is not enough to go live, or cannot be decided."""

    SLOW_STATES = 'slow_states'
    SATURATED = 'saturated'
    FEW_JOINTS = 'few_joints'
    # It cannot be decided:
    NO_DIAGNOSTICS = 'no_diagnostics'
    NODE_STATE = 'node_state'
    NO_EFFORTS = 'no_efforts'
    ZERO_EFFORTS = 'zero_efforts'
    TOO_FEW_SAMPLES = 'too_few_samples'
    SMALL_EFFORTS = 'small_efforts'
    AT_REST = 'at_rest'


@dataclass(frozen=True)
class Size:
    """RMS efforts of all compared joints of one kind over the window [N m or N]."""

    residual: float
    """Measured minus modelled."""
    measured: float
    is_prismatic: bool = False


@dataclass(frozen=True)
class Agreement:
    """Whether model and robot agree, and why not."""

    outcome: Outcome
    cause: FaultKind | Obstacle | None = None
    """None if they agree."""
    joints: tuple[str, ...] = ()
    """Joints that differ; empty if the cause concerns the whole robot."""
    values: tuple[float, ...] = ()
    """
    Factor of each joint of a `SCALE`; mass [kg] of a `PAYLOAD`; gravity in the frame of the root
    link [m/s^2] of a `MOUNTING`; measured and lowest sufficient rate [Hz] of `SLOW_STATES`;
    numbers of checked and of commanded joints of `FEW_JOINTS`.
    """
    link: str = ''
    """Link that carries the payload."""
    reason: str = ''
    """Message of the node, for `NODE_STATE`."""
    sizes: tuple[Size, ...] = ()
    """Revolute joints first."""
    checked: tuple[str, ...] = ()
    """Joints whose efforts are large enough to see a wrong sign."""
    unchecked: tuple[str, ...] = ()
    """Joints whose efforts are too small for that."""
    unmeasured: tuple[str, ...] = ()
    """Commanded joints without measured efforts."""
    saturated: tuple[str, ...] = ()
    """Commanded joints whose efforts are cut to their limits."""
    is_moving: bool = True
    """Whether a compared joint moved in the window."""
    also_swapped: tuple[str, ...] = ()
    """Joints with a swapped sign, beside another cause."""
