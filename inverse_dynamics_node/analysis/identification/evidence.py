"""
Finds the explanation of measured efforts that leaves least unexplained with fewest parameters.

A *hypothesis* concerns the efforts of the whole robot, such as a payload. The efforts of every
joint may be distorted in addition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .joint_samples import (
    ACCELERATION,
    CREDIBLE,
    DIRECTION,
    Fit,
    FLOOR,
    GRAVITY,
    JointSamples,
    LOADS,
    MODEL,
    ONE,
    PARAMETER_COST,
    SPEED,
    UNDISTORTED,
    WEIGHT,
)
from .loads import fit_payload, PARAMETERS, point_mass_parameters

COST_TOLERANCE = 0.1  # smaller differences of costs are ignored
MAX_ITERATIONS = 3  # of fitting the hypothesis and the distortions in turn


class Hypothesis(NamedTuple):
    """What the efforts of the whole robot consist of."""

    kind: str
    """``as_is``, ``weightless``, ``mounting`` or ``payload``."""
    weights: Floats
    """Factors of the first columns of the samples."""
    parameters: int
    """Number of parameters."""
    is_weightless: bool = False
    """Whether the gravity efforts of the model are left out."""
    link: str = ''
    """Link that carries the payload."""
    solution: tuple[float, ...] = ()
    """Fitted gravity [m/s^2]; or mass [kg] and centre of mass [m]."""
    errors: tuple[float, ...] = ()
    """Standard errors of the solution."""


class Explanation(NamedTuple):
    """A hypothesis, and the fit of every joint to it."""

    hypothesis: Hypothesis
    fits: tuple[Fit, ...]
    source: tuple[int, ...]
    """Index of the measured effort that belongs to each joint."""

    @property
    def cost(self) -> float:
        """Logarithm of the remaining squares, plus the cost of all parameters."""
        moved = sum(i != j for i, j in enumerate(self.source))
        parameters = self.hypothesis.parameters + moved
        return sum(fit.cost for fit in self.fits) + PARAMETER_COST * parameters

    @property
    def is_plausible(self) -> bool:
        """Whether it is possible: loads cannot be identified in unknown units."""
        is_scaled = any(fit.distortion.is_scaled for fit in self.fits)
        return self.hypothesis.kind in ('as_is', 'weightless') or not is_scaled


class Evidence:
    """
    The samples of all joints, and the search for their explanation.

    Parameters
    ----------
    joints : sequence of JointSamples
        Samples of n joints.
    links : mapping of str to float
        Links that may carry a load, with the mass of the body of each [kg]. The efforts of loads
        on them are in the samples, from column ``LOADS`` on.
    gravity : ndarray, shape (3,)
        Gravity of the model in the frame of the base link [m/s^2].
    sample_count : float
        Number of independent samples of a joint.

    """

    def __init__(
        self,
        joints: Sequence[JointSamples],
        links: Mapping[str, float],
        gravity: Floats,
        sample_count: float,
    ) -> None:
        self.joints = tuple(joints)
        self.links = tuple(links)
        self.link_masses = tuple(links.values())
        self.gravity = gravity
        self.sample_count = sample_count
        self.first_measured = LOADS + PARAMETERS * len(links)
        self.as_is = Hypothesis('as_is', self._weights({MODEL: 1.0}), 0)

    def explain(self) -> Explanation:
        """Return the explanation with the lowest cost."""
        as_is = self._fit_joints(self.as_is)
        lowest_cost = len(self.joints) * math.log(FLOOR**2)
        if as_is.cost - lowest_cost < PARAMETER_COST:
            return as_is  # no further parameter can be worth its cost
        weightless = self._fit_joints(self._weightless())
        found = [as_is, weightless]
        # Start without distortions, and with those that seem best for the model as it is.
        for start in ([Fit(UNDISTORTED, 0.0, 1.0)] * len(self.joints), list(as_is.fits)):
            found += self._iterate(self._mounting, start)
            for k in range(len(self.links)):
                found += self._iterate(partial(self._payload, k, self.as_is), start)
                found += self._iterate(partial(self._payload, k, weightless.hypothesis), start)
        found += self._reordered()
        # If an offset of a joint explains as much as missing gravity, prefer missing gravity.
        return min(
            (explanation for explanation in found if explanation.is_plausible),
            key=lambda each: each.cost - COST_TOLERANCE * each.hypothesis.is_weightless,
        )

    def _weights(self, values: dict[int, float]) -> Floats:
        weights = np.zeros(self.first_measured)
        for column, value in values.items():
            weights[column] = value
        return weights

    def _weightless(self) -> Hypothesis:
        weights = self._weights({MODEL: 1.0, GRAVITY: -1.0})
        return Hypothesis('weightless', weights, 1, is_weightless=True)

    def _fit_joints(self, hypothesis: Hypothesis) -> Explanation:
        fits = tuple(
            samples.best_fit(hypothesis.weights, self.first_measured + j)
            for j, samples in enumerate(self.joints)
        )
        return Explanation(hypothesis, fits, tuple(range(len(fits))))

    def _iterate(
        self, fit_hypothesis: Callable[[list[Fit]], Hypothesis | None], fits: list[Fit]
    ) -> list[Explanation]:
        """Fit a hypothesis to the joints, and the joints to the hypothesis, in turn."""
        found: list[Explanation] = []
        for _ in range(MAX_ITERATIONS):
            hypothesis = fit_hypothesis(fits)
            if hypothesis is None:
                break
            found.append(self._fit_joints(hypothesis))
            if len(found) > 1 and found[-1].cost > found[-2].cost - COST_TOLERANCE:
                break
            fits = list(found[-1].fits)
        return found

    def _rows(self, fits: list[Fit], fixed: Floats) -> tuple[Floats, Floats] | None:
        """
        Stack the samples of all joints, weighted, with friction and distortions removed.

        Returns columns and targets; the targets are the efforts that the fixed columns leave. None
        if the units of all efforts are unknown.

        """
        stacked, targets = [], []
        for j, (samples, fit) in enumerate(zip(self.joints, fits, strict=True)):
            if fit.distortion.is_scaled:
                continue  # its unit is unknown
            R = samples.triangle
            columns = R[:, : self.first_measured]
            target = fit.distortion.sign * R[:, self.first_measured + j] - columns @ fixed
            target = target - fit.rotor * R[:, ACCELERATION] - fit.offset * R[:, ONE]
            if samples.moves:
                Q = np.linalg.qr(R[:, [SPEED, DIRECTION]])[0]
                target = target - Q @ (Q.T @ target)
                columns = columns - Q @ (Q.T @ columns)
            # Joints that are explained well have more weight.
            variance = min(fit.remaining, 1.0) + FLOOR**2
            variance *= samples.squares[self.first_measured + j]
            weight = math.sqrt(self.sample_count / variance)
            stacked.append(weight * columns)
            targets.append(weight * target)
        return (np.vstack(stacked), np.concatenate(targets)) if stacked else None

    def _mounting(self, fits: list[Fit]) -> Hypothesis | None:
        """Fit the direction of gravity."""
        fixed = self._weights({MODEL: 1.0, GRAVITY: -1.0})
        rows = self._rows(fits, fixed)
        if rows is None:
            return None
        regressors = rows[0][:, WEIGHT : WEIGHT + 3]
        gravity = np.linalg.lstsq(regressors, rows[1], rcond=1e-6)[0]
        g, g_0 = np.linalg.norm(gravity), np.linalg.norm(self.gravity)
        # A different magnitude has another cause than the mounting.
        if g_0 == 0.0 or not 0.8 * g_0 < g < 1.25 * g_0:
            return None
        angle = math.acos(np.clip(gravity @ self.gravity / (g * g_0), -1.0, 1.0))
        if angle < math.radians(3.0):
            return None
        weights = fixed.copy()
        weights[WEIGHT : WEIGHT + 3] = gravity
        return Hypothesis('mounting', weights, 3, solution=tuple(gravity.tolist()))

    def _payload(self, k: int, base: Hypothesis, fits: list[Fit]) -> Hypothesis | None:
        """Fit a point mass on link k to the efforts that a base hypothesis leaves."""
        rows = self._rows(fits, base.weights)
        if rows is None:
            return None
        load = slice(LOADS + PARAMETERS * k, LOADS + PARAMETERS * (k + 1))
        sample_count = self.sample_count * len(self.joints)
        solution, errors = fit_payload(rows[0][:, load], rows[1], sample_count)
        # A body cannot lack more than its mass.
        least = -self.link_masses[k] - 3.0 * errors[0]
        if abs(solution[0]) < 3.0 * errors[0] or solution[0] < least:
            return None
        weights = base.weights.copy()
        weights[load] = point_mass_parameters(float(solution[0]), solution[1:])
        return Hypothesis(
            'payload',
            weights,
            4 + base.parameters,
            base.is_weightless,
            self.links[k],
            tuple(solution.tolist()),
            tuple(errors.tolist()),
        )

    def _reordered(self) -> list[Explanation]:
        """Assign the efforts of joints that are not explained to each other's joints."""
        from scipy.optimize import linear_sum_assignment

        n, weights = len(self.joints), self.as_is.weights

        def fit(joint: int, measured: int) -> Fit:
            return self.joints[joint].fit(weights, self.first_measured + measured, UNDISTORTED)

        unexplained = [j for j in range(n) if fit(j, j).remaining > CREDIBLE]
        if len(unexplained) < 2:
            return []
        fits = [[fit(j, i) for i in unexplained] for j in unexplained]
        costs = np.array([[fit.cost for fit in row] for row in fits])
        penalty = PARAMETER_COST * (1.0 - np.eye(len(unexplained)))
        rows, columns = linear_sum_assignment(costs + penalty)
        chosen, source = list(self._fit_joints(self.as_is).fits), list(range(n))
        for row, column in zip(rows, columns, strict=True):
            if row != column:
                if fits[row][column].remaining > CREDIBLE:
                    return []
                chosen[unexplained[row]] = fits[row][column]
                source[unexplained[row]] = unexplained[column]
        return [Explanation(self.as_is, tuple(chosen), tuple(source))]
