"""The standard errors to expect of what is identified from one run of an exciting motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robot.model import Floats
from ..base_parameters import NAMES
from .information import OF_JOINT
from .search import Excitation
from .states import random_states

_STATES = 500
"""Random states within the limits for the error of predicted efforts."""
_GROUPS = (slice(0, 1), slice(1, 4), slice(4, 10))
"""Mass, first moments and moments of inertia among the parameters of a body."""


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """
    Standard errors due to the assumed noise; NaN where the efforts determine no such unknown.

    The unknowns of bodies are base parameters: where only a combination of parameters has an
    effect, the error is that of the combination, listed under one of its members.

    """

    joint_names: tuple[str, ...]
    """The m joints that move."""
    noise: Floats
    """Assumed standard deviation of measured efforts, shape (m,) [N m or N]."""
    of_joints: Floats
    """Of the kinds in `OF_JOINT`, shape (m, 4)."""
    efforts: Floats
    """Of the efforts of random states within the limits (RMS), shape (m,) [N m or N]."""
    body_names: tuple[str, ...]
    """The bodies without the base."""
    of_bodies: Floats
    """Largest of mass [kg], first moments [kg m] and inertia [kg m^2], shape (b - 1, 3)."""
    count: int
    """Number of unknowns."""


def expected_errors(excitation: Excitation) -> ExpectedErrors:
    """Compute the standard errors that one run of an exciting motion leads to."""
    unknowns, limits = excitation.unknowns, excitation.limits
    covariance = np.linalg.inv(excitation.information)
    errors = np.sqrt(np.diagonal(covariance)) / unknowns.scale
    m, robot = len(limits.joint_names), unknowns.dynamics.robot
    everything = np.full(unknowns.rigid_count + len(OF_JOINT) * m, np.nan)
    everything[unknowns.columns] = errors
    of_bodies = everything[: unknowns.rigid_count].reshape(-1, len(NAMES))
    groups = [np.where(np.isnan(of_bodies), -1.0, of_bodies)[:, group] for group in _GROUPS]
    largest = np.stack([np.max(group, axis=1) for group in groups], axis=1)
    states = random_states(limits, _STATES, np.random.default_rng(2))
    columns = unknowns.of_efforts(states) / unknowns.scale
    variances = np.einsum('kju,uv,kjv->kj', columns, covariance, columns, optimize=True)
    return ExpectedErrors(
        limits.joint_names,
        unknowns.noise,
        everything[unknowns.rigid_count :].reshape(len(OF_JOINT), m).T,
        np.sqrt(np.mean(variances, axis=0)),
        robot.body_names[1:],
        np.where(largest < 0.0, np.nan, largest),
        len(errors),
    )
