"""Checks whether model and robot agree, from the state of the node and the last seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from ...robot.model import Floats, RobotModel
from .agreement import Agreement, Obstacle, Outcome
from .fault import FaultKind
from .live import diagnose
from .live_samples import LiveSamples

DEFAULT_LEAST_RATE = 80.0  # [Hz]; the default of the controller manager of ros2_control is 100
OF_GIVEN_RATE = 0.8  # fraction of the rate given by the user, below which states are slow
OF_UPDATE_RATE = 0.5  # the same of update_rate: many drivers are slower than the loop

_STRONGER_THAN_SLOW = (
    FaultKind.SIGN,
    FaultKind.SCALE,
    FaultKind.GRAVITY_COMPENSATED,
    FaultKind.PAYLOAD,
    FaultKind.MOUNTING,
)
"""Causes that are found in slow states too; residuals without a cause may be due to the rate."""

LEAST_CHECKED = 0.25
"""
Fraction of the commanded joints that an agreement must rest on. At rest in a random pose, gravity
loads two of six joints of a UR arm; one joint says little about the others.
"""


class StateRate(NamedTuple):
    """Rates of joint states [Hz]."""

    measured: float | None
    """None if unknown."""
    given: float | None = None
    """Expected by the user."""
    update_rate: float | None = None
    """Requested rate of the commands; None if there is one for each joint state."""
    is_simulated: bool = False
    """Whether the node uses simulated time, which may be slower than real time."""

    @property
    def least(self) -> float:
        """Rate below which joint states are slow."""
        if self.given is not None:
            return OF_GIVEN_RATE * self.given
        if self.update_rate is not None:
            return OF_UPDATE_RATE * self.update_rate
        return 0.0 if self.is_simulated else DEFAULT_LEAST_RATE

    @property
    def is_slow(self) -> bool:
        """Whether joint states arrive far too rarely."""
        return self.measured is not None and self.measured < self.least


def check_agreement(
    reason: str,
    rate: StateRate,
    samples: LiveSamples | None,
    robot: RobotModel | None,
    gravity: Floats,
    limits: Floats | None = None,
    commanded: Sequence[str] = (),
    saturated: Sequence[str] = (),
) -> Agreement:
    """
    Check whether model and robot agree.

    Parameters
    ----------
    reason : str
        Why the node does not compute efforts; empty if it does.
    rate : StateRate
        Rates of joint states.
    samples : LiveSamples or None
        The last seconds; None if the robot is unknown.
    robot, gravity, limits
        As for `diagnose`.
    commanded : sequence of str
        The commanded joints.
    saturated : sequence of str
        Those whose efforts were cut to their limits in the last seconds.

    Returns
    -------
    agreement : Agreement

    """
    if reason:
        return Agreement(Outcome.UNDECIDED, Obstacle.NODE_STATE, reason=reason)
    if samples is None or robot is None:
        agreement = Agreement(Outcome.UNDECIDED, Obstacle.TOO_FEW_SAMPLES)
    else:
        agreement = diagnose(samples, robot, gravity, limits)
    agreement = _completed(agreement, commanded, saturated)
    if rate.is_slow and agreement.cause not in _STRONGER_THAN_SLOW:
        values = (rate.measured or 0.0, rate.least)
        agreement = replace(
            agreement,
            outcome=Outcome.DIFFER,
            cause=Obstacle.SLOW_STATES,
            joints=(),
            values=values,
        )
    if saturated and (
        agreement.outcome is not Outcome.DIFFER or agreement.cause is Obstacle.SLOW_STATES
    ):
        return replace(
            agreement, outcome=Outcome.SATURATED, cause=Obstacle.SATURATED, joints=(), values=()
        )
    return agreement


def _completed(
    agreement: Agreement, commanded: Sequence[str], saturated: Sequence[str]
) -> Agreement:
    """Add what concerns the commanded joints; an agreement must rest on enough of them."""
    compared = (*agreement.checked, *agreement.unchecked)
    agreement = replace(agreement, saturated=tuple(saturated))
    if not compared:
        return agreement
    unmeasured = tuple(joint for joint in commanded if joint not in compared)
    agreement = replace(agreement, unmeasured=unmeasured)
    count = len(set(commanded) & set(agreement.checked))
    if agreement.outcome is Outcome.AGREE and count < LEAST_CHECKED * len(commanded):
        values = (float(count), float(len(commanded)))
        return replace(
            agreement, outcome=Outcome.FEW_JOINTS, cause=Obstacle.FEW_JOINTS, values=values
        )
    return agreement
