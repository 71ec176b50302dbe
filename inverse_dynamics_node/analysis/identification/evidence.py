"""
What explains measured efforts best, for how many fitted numbers.

Every joint's samples are reduced to a small triangle first, from which any combination of columns
can be fitted at once. A *base* is what the whole robot's efforts are made of; a *twist* is what
became of one joint's effort on its way into the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .loads import fit_payload, PARAMETERS, parameters_of

PRICE = math.log(2.0)
"""What a number costs: it has to halve the squares that are left, or it explains nothing."""
FLOOR = 0.03  # of a joint's RMS effort: models are not better than that, and need not be
SAME = (0.8, 1.25)  # a factor within is a model that is a little off, and no other unit
CREDIBLE = 0.3  # of the squares: an effort of which more is left over was not understood
ALONE = 0.01  # of the squares: beside friction that explains the rest, a model tells no unit
LEAST_OFFSET = 0.05  # of a joint's RMS effort
TIE = 0.1  # costs that differ by less are the same
ROUNDS = 3  # of fitting the base to twisted joints, and twists to the base

# Columns of a joint's table, before those of loads and of all measured efforts.
MODEL, GRAVITY, WEIGHT, ACCELERATION, SPEED, DIRECTION, ONE, LOADS = 0, 1, 2, 5, 6, 7, 8, 9
"""The model with gravity; gravity's part; that of 1 m/s^2 along x, y, z; what friction follows."""


class Distortion(NamedTuple):
    """What became of one joint's effort on its way into the recording."""

    is_swapped: bool = False
    is_scaled: bool = False
    has_rotor: bool = False
    """Whether there is an inertia that the model lacks, felt at this joint alone."""
    has_offset: bool = False

    @property
    def numbers(self) -> int:
        """How many numbers it takes; a factor counts twice, as units are rarely wrong."""
        return sum(self) + self.is_scaled

    @property
    def sign(self) -> int:
        return -1 if self.is_swapped else 1


PLAIN = Distortion()
TWISTS = tuple(Distortion(*flags) for flags in product((False, True), repeat=4))


class Fit(NamedTuple):
    """One joint's effort, explained by a base and a twist."""

    twist: Distortion
    cost: float
    left: float
    """Share of the squares of the measured effort that is left."""
    moves: bool = True
    """Whether the joint moved enough to tell its friction."""
    is_mute: bool = False
    """Whether friction alone explains as much: nothing can be told of sign and unit."""
    scale: float = 1.0
    rotor: float = 0.0
    """[kg m^2 or kg]."""
    offset: float = 0.0
    """In the model's unit [N m or N]."""


class Hypothesis(NamedTuple):
    """What the whole robot's efforts are made of."""

    kind: str
    """``as_is``, ``weightless``, ``mounting`` or ``payload``."""
    columns: Floats
    """What to multiply the first columns of a joint's table by."""
    numbers: int
    is_weightless: bool = False
    """Whether the model's gravity is left out."""
    link: str = ''
    solution: tuple[float, ...] = ()
    errors: tuple[float, ...] = ()


class Explanation(NamedTuple):
    """A base, and a fit of every joint to it."""

    base: Hypothesis
    fits: tuple[Fit, ...]
    source: tuple[int, ...]
    """Which measured effort belongs to each joint."""

    @property
    def cost(self) -> float:
        moved = sum(i != j for i, j in enumerate(self.source))
        numbers = self.base.numbers + moved
        return sum(fit.cost for fit in self.fits) + PRICE * numbers

    @property
    def is_plausible(self) -> bool:
        """Tell whether it could be: in unknown units, no load can be told."""
        is_scaled = any(fit.twist.is_scaled for fit in self.fits)
        return self.base.kind in ('as_is', 'weightless') or not is_scaled


@dataclass
class JointSamples:
    """One joint's samples, reduced: `triangle` has the scalar products of all columns."""

    triangle: Floats
    moves: bool
    """Whether friction and offsets can be told."""
    squares: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.squares = np.sum(self.triangle**2, axis=0)

    def fit(self, base: Floats, measured: int, twist: Distortion) -> Fit:
        """Fit a twist to a measured effort, by the number of its column."""
        from scipy.optimize import nnls

        R = self.triangle
        square = self.squares[measured]
        model = R[:, : len(base)] @ base
        target = twist.sign * R[:, measured]
        columns = [R[:, [SPEED, DIRECTION]]] if self.moves else []
        columns += [R[:, [ACCELERATION]]] if twist.has_rotor else []
        columns += [R[:, [ONE]], -R[:, [ONE]]] if twist.has_offset else []
        if twist.is_scaled:
            columns += [model[:, None]]
        else:
            target = target - model
        solution = np.zeros(0)
        if columns:
            features = np.hstack(columns)
            lengths = np.linalg.norm(features, axis=0)
            lengths[lengths == 0.0] = 1.0
            solution = nnls(features / lengths, target)[0] / lengths
            target = target - features @ solution
        left = float(np.sum(target**2) / square)
        cost = math.log(left + FLOOR**2) + PRICE * twist.numbers
        numbers: list[float] = solution[2 if self.moves else 0 :].tolist()
        rotor = numbers.pop(0) if twist.has_rotor else 0.0
        offset = numbers.pop(0) - numbers.pop(0) if twist.has_offset else 0.0
        scale = numbers.pop(0) if twist.is_scaled else 1.0
        scale, per_scale = (scale, scale) if scale else (0.0, 1.0)
        return Fit(
            twist,
            cost,
            left,
            self.moves,
            scale=scale,
            rotor=rotor / per_scale,
            offset=offset / per_scale,
        )

    def best(self, base: Floats, measured: int) -> Fit:
        """Find the twist that explains a measured effort best; plain if none is credible."""
        plain = self.fit(base, measured, PLAIN)
        size = math.sqrt(self.squares[measured])
        best = plain
        for twist in TWISTS[1:]:
            if not self.moves and (twist.has_rotor or twist.has_offset):
                continue
            fit = self.fit(base, measured, twist)
            is_credible = (
                fit.cost < best.cost
                and fit.left < CREDIBLE
                and not self._is_idle(measured, fit)
                and not (twist.is_scaled and SAME[0] < fit.scale < SAME[1])
                and not (twist.has_offset and abs(fit.offset * fit.scale) < LEAST_OFFSET * size)
            )
            best = fit if is_credible else best
        is_mute = not best.twist.is_scaled and self._does_without(
            measured, best.twist, best.left, ALONE
        )
        return best._replace(is_mute=is_mute)

    def _is_idle(self, measured: int, fit: Fit) -> bool:
        """Tell whether friction alone explains as much, so that sign and factor are guesses."""
        twist = fit.twist
        # A friction that drives is a sign that is swapped: that needs no model.
        if twist.is_swapped and self._does_without(
            measured, twist._replace(is_swapped=False, is_scaled=False), fit.left
        ):
            return True
        return twist.is_scaled and self._does_without(
            measured, twist._replace(is_scaled=False), fit.left
        )

    def _does_without(
        self, measured: int, twist: Distortion, left: float, most: float = FLOOR**2
    ) -> bool:
        """Tell whether next to nothing more is left without the model."""
        return self.fit(np.zeros(1), measured, twist).left <= 2.0 * left + most


def make_table(columns: Floats, moves: bool) -> JointSamples:
    """Reduce samples, shape (K, p), to what their least squares need."""
    triangle: Floats = np.asarray(np.linalg.qr(columns, mode='r'))
    triangle = triangle / math.sqrt(len(columns))
    return JointSamples(triangle, moves)


class Evidence:
    """
    All joints' tables, and the search for what explains them.

    Parameters
    ----------
    tables : sequence of JointSamples
        Of n joints.
    links : mapping of str to float
        What may carry a load, and the mass of the body that it is part of [kg]; their regressors
        are in the tables, from column ``LOADS`` on.
    gravity : ndarray, shape (3,)
        In the base frame [m/s^2].
    samples : float
        How many independent samples a joint has.

    """

    def __init__(
        self,
        tables: Sequence[JointSamples],
        links: Mapping[str, float],
        gravity: Floats,
        samples: float,
    ) -> None:
        self.tables = tuple(tables)
        self.links = tuple(links)
        self.weights = tuple(links.values())
        self.gravity = gravity
        self.samples = samples
        self.width = LOADS + PARAMETERS * len(links)
        self.as_is = Hypothesis('as_is', self._columns({MODEL: 1.0}), 0)

    def explain(self) -> Explanation:
        """Find the explanation that costs least."""
        as_is = self._fitted(self.as_is)
        best_possible = len(self.tables) * math.log(FLOOR**2)
        if as_is.cost - best_possible < PRICE:
            return as_is  # one more number could not pay
        weightless = self._fitted(self._weightless())
        found = [as_is, weightless]
        # From joints as they are, and from joints as they look without another base.
        for start in ([Fit(PLAIN, 0.0, 1.0)] * len(self.tables), list(as_is.fits)):
            found += self._iterate(self._mounting, start)
            for k in range(len(self.links)):
                found += self._iterate(partial(self._payload, k, self.as_is), start)
                found += self._iterate(partial(self._payload, k, weightless.base), start)
        found += self._reordered()
        # Where an offset at a joint would do as well as its missing gravity, it is gravity.
        return min(
            (explanation for explanation in found if explanation.is_plausible),
            key=lambda explanation: explanation.cost - TIE * explanation.base.is_weightless,
        )

    def _columns(self, weights: dict[int, float]) -> Floats:
        columns = np.zeros(self.width)
        for column, weight in weights.items():
            columns[column] = weight
        return columns

    def _weightless(self) -> Hypothesis:
        columns = self._columns({MODEL: 1.0, GRAVITY: -1.0})
        return Hypothesis('weightless', columns, 1, is_weightless=True)

    def _fitted(self, base: Hypothesis) -> Explanation:
        fits = [table.best(base.columns, self.width + j) for j, table in enumerate(self.tables)]
        return Explanation(base, tuple(fits), tuple(range(len(fits))))

    def _iterate(
        self, make: Callable[[list[Fit]], Hypothesis | None], fits: list[Fit]
    ) -> list[Explanation]:
        """Fit a base to joints and joints to the base, in turn."""
        found: list[Explanation] = []
        for _ in range(ROUNDS):
            base = make(fits)
            if base is None:
                break
            found.append(self._fitted(base))
            if len(found) > 1 and found[-1].cost > found[-2].cost - TIE:
                break
            fits = list(found[-1].fits)
        return found

    def _rows(self, fits: list[Fit], fixed: Floats) -> tuple[Floats, Floats] | None:
        """Stack the joints' tables and what is left of a fixed base, weighted, friction out."""
        tables, targets = [], []
        for j, (table, fit) in enumerate(zip(self.tables, fits, strict=True)):
            if fit.twist.is_scaled:
                continue  # its unit is unknown
            R = table.triangle
            target = fit.twist.sign * R[:, self.width + j] - R[:, : self.width] @ fixed
            target = target - fit.rotor * R[:, ACCELERATION] - fit.offset * R[:, ONE]
            columns = R[:, : self.width]
            if table.moves:
                Q = np.linalg.qr(R[:, [SPEED, DIRECTION]])[0]
                target = target - Q @ (Q.T @ target)
                columns = columns - Q @ (Q.T @ columns)
            # A joint counts by how well it is understood.
            variance = (min(fit.left, 1.0) + FLOOR**2) * table.squares[self.width + j]
            weight = math.sqrt(self.samples / variance)
            tables.append(weight * columns)
            targets.append(weight * target)
        return (np.vstack(tables), np.concatenate(targets)) if tables else None

    def _mounting(self, fits: list[Fit]) -> Hypothesis | None:
        fixed = self._columns({MODEL: 1.0, GRAVITY: -1.0})
        rows = self._rows(fits, fixed)
        if rows is None:
            return None
        regressors = rows[0][:, WEIGHT : WEIGHT + 3]
        gravity = np.linalg.lstsq(regressors, rows[1], rcond=1e-6)[0]
        g, g_0 = np.linalg.norm(gravity), np.linalg.norm(self.gravity)
        # Another direction is another mounting; another magnitude is something else.
        if g_0 == 0.0 or not 0.8 * g_0 < g < 1.25 * g_0:
            return None
        angle = math.acos(np.clip(gravity @ self.gravity / (g * g_0), -1.0, 1.0))
        if angle < math.radians(3.0):
            return None
        columns = fixed.copy()
        columns[WEIGHT : WEIGHT + 3] = gravity
        return Hypothesis('mounting', columns, 3, solution=tuple(gravity.tolist()))

    def _payload(self, k: int, under: Hypothesis, fits: list[Fit]) -> Hypothesis | None:
        rows = self._rows(fits, under.columns)
        if rows is None:
            return None
        where = slice(LOADS + PARAMETERS * k, LOADS + PARAMETERS * (k + 1))
        samples = self.samples * len(self.tables)
        solution, errors = fit_payload(rows[0][:, where], rows[1], samples)
        # Nothing can be lacking but what is there.
        least = -self.weights[k] - 3.0 * errors[0]
        if abs(solution[0]) < 3.0 * errors[0] or solution[0] < least:
            return None
        columns = under.columns.copy()
        columns[where] = parameters_of(float(solution[0]), solution[1:])
        return Hypothesis(
            'payload',
            columns,
            4 + under.numbers,
            under.is_weightless,
            self.links[k],
            tuple(solution.tolist()),
            tuple(errors.tolist()),
        )

    def _reordered(self) -> list[Explanation]:
        """Try the measured efforts of joints that are not understood in another order."""
        from scipy.optimize import linear_sum_assignment

        n = len(self.tables)
        plain = [
            table.fit(self.as_is.columns, self.width + j, PLAIN)
            for j, table in enumerate(self.tables)
        ]
        lost = [j for j in range(n) if plain[j].left > CREDIBLE]
        if len(lost) < 2:
            return []
        fits = [
            [self.tables[j].fit(self.as_is.columns, self.width + i, PLAIN) for i in lost]
            for j in lost
        ]
        costs = np.array([[fit.cost for fit in row] for row in fits])
        rows, columns = linear_sum_assignment(costs + PRICE * (1.0 - np.eye(len(lost))))
        chosen, source = list(self._fitted(self.as_is).fits), list(range(n))
        for row, column in zip(rows, columns, strict=True):
            if row != column:
                if fits[row][column].left > CREDIBLE:
                    return []
                chosen[lost[row]] = fits[row][column]
                source[lost[row]] = lost[column]
        return [Explanation(self.as_is, tuple(chosen), tuple(source))]
