"""Judges a running node: whether every commanded joint was checked, and agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats, RobotModel
from .fault import GravityConvention, WITH_GRAVITY
from .live import (
    Agreement,
    Check,
    diagnose_samples,
    GRAVE,
    LiveSamples,
    Obstacle,
    Outcome,
)

DEFAULT_LEAST_RATE = 80.0  # [Hz]; the default rate of ros2_control is 100 Hz
OF_GIVEN_RATE = 0.8  # smallest fraction of the rate that the user gave
OF_UPDATE_RATE = 0.5  # smallest fraction of update_rate, because many drivers are slow


class StateRate(NamedTuple):
    """Measured rate of joint states, and values that determine the lowest sufficient rate."""

    measured: float | None
    """Measured rate [Hz], or None if unknown."""
    given: float | None = None
    """Rate that the user expects [Hz], or None if not given."""
    update_rate: float | None = None
    """Requested rate of commands [Hz], or None if each joint state leads to one command."""
    is_simulated: bool = False
    """Whether the node uses simulated time, which may be slower than real time."""

    @property
    def least(self) -> float:
        """Lowest sufficient rate [Hz]."""
        if self.given is not None:
            return OF_GIVEN_RATE * self.given
        if self.update_rate is not None:
            return OF_UPDATE_RATE * self.update_rate
        return 0.0 if self.is_simulated else DEFAULT_LEAST_RATE

    @property
    def is_slow(self) -> bool:
        """Whether the measured rate is too low."""
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
    convention: GravityConvention = WITH_GRAVITY,
    payloads: Sequence[tuple[str, float, Floats]] = (),
) -> Agreement:
    """
    Check whether model and robot agreed in the last few seconds.

    `reason` says why the node does not compute efforts, and is empty if the node computes efforts.
    `samples` and `robot` are None if the robot is unknown. `commanded` contains all commanded
    joints. `saturated` contains the commanded joints with efforts that reached the effort limits
    in the last few seconds. `gravity`, `limits`, `convention` and `payloads` are the arguments of
    `diagnose_samples`.
    """
    if reason:
        return Agreement(Outcome.UNDECIDED, Obstacle.NODE_STATE, reason=reason)
    if samples is None or robot is None:
        agreement = Agreement(Outcome.UNDECIDED, Obstacle.TOO_FEW_SAMPLES)
    else:
        samples = _without_constant(samples, commanded)
        agreement = diagnose_samples(samples, robot, gravity, limits, convention, payloads)
    agreement = _completed(agreement, commanded, saturated)
    is_grave = any(fault.kind in GRAVE for fault in agreement.faults)
    if rate.is_slow and not is_grave:
        agreement = replace(
            agreement,
            outcome=Outcome.DIFFER,
            obstacle=Obstacle.SLOW_STATES,
            faults=(),
            numbers=(rate.measured or 0.0, rate.least),
        )
    if saturated and (agreement.outcome is not Outcome.DIFFER or agreement.obstacle):
        return replace(
            agreement,
            outcome=Outcome.SATURATED,
            obstacle=Obstacle.SATURATED,
            faults=(),
            numbers=(),
        )
    return agreement


def _without_constant(samples: LiveSamples, commanded: Sequence[str]) -> LiveSamples:
    """Leave out constant efforts of joints that are not commanded, such as gripper joints."""
    is_commanded = np.isin(samples.joint_names, commanded) if commanded else True
    is_constant = (samples.measured == samples.measured[:1]).all(axis=0)
    measured = np.where(is_constant & ~np.array(is_commanded), np.nan, samples.measured)
    return samples._replace(measured=measured)


def _completed(
    agreement: Agreement, commanded: Sequence[str], saturated: Sequence[str]
) -> Agreement:
    """Add saturated joints, and the checks of all commanded joints."""
    checks = agreement.checks
    if checks:
        joints = commanded or list(checks)
        checks = {joint: checks.get(joint, Check.NOT_MEASURED) for joint in joints}
    return replace(agreement, saturated=tuple(saturated), checks=checks)


# ---- The gate ------------------------------------------------------------------------------


class Gate:
    """
    Collects the results of a whole run.

    A joint that was checked once stays checked. A difference stays a difference. `accepted` are
    joints that need no check.
    """

    def __init__(self, accepted: Sequence[str] = ()) -> None:
        self.accepted = tuple(accepted)
        self._done: set[str] = set()
        self._difference: Agreement | None = None

    def add(self, agreement: Agreement) -> Agreement:
        """Return the result of the run so far, given the latest result of the window."""
        self._done |= {name for name, check in agreement.checks.items() if check is Check.DONE}
        checks = {
            name: Check.DONE if name in self._done else check
            for name, check in agreement.checks.items()
            if name not in self.accepted
        }
        agreement = replace(agreement, checks=checks)
        if agreement.outcome is Outcome.DIFFER and agreement.faults:
            self._difference = agreement
        elif self._difference is not None:
            return replace(self._difference, is_past=True)
        if agreement.outcome is Outcome.AGREE and agreement.unchecked:
            return replace(agreement, outcome=Outcome.NOT_CHECKED, obstacle=Obstacle.NOT_CHECKED)
        return agreement
