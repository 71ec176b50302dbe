"""
Searches for the motion that determines masses and friction most accurately.

The search varies the coefficients of a Fourier series [1]_ at random, and keeps each change that
reduces the determinant of the covariance of the unknowns (D-optimal design). The swing of each
joint is scaled to its position and speed limits. Motions that exceed an effort limit or lead to a
collision are rejected.

References
----------
.. [1] J. Swevers, C. Ganseman, D. B. Tukel, J. De Schutter, H. Van Brussel, "Optimal robot
   excitation and identification", IEEE Transactions on Robotics and Automation 13(5), 1997.

"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
import math

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import ConfigurationError, listed
from ...robot.model import Floats
from .collisions import Collisions
from .fourier import basis, FourierSeries
from .information import Unknowns
from .limits import MotionLimits, States, whole_positions, whole_states

DURATION = 10.0  # [s]
HARMONICS = 5
"""Number of harmonics of the Fourier series."""
_SAMPLES = 80
"""Number of samples of a motion during the search."""
_FINE = 8
"""The result is checked at this many states per sample of the search."""
_WAY = 60
"""Number of poses that are checked on the path to the start of a motion."""
CANDIDATES = 30
"""Number of random motions. The search starts from the best one."""
_SMALLER = 0.8
"""Factor that reduces the swing of a random motion until it is permitted."""
_STILL = 1e-3
"""The search for a permitted motion ends at this swing, relative to the ranges."""
_INSIDE = 0.8
"""Largest distance of these poses from the middle of a range, relative to its half width."""
_POSES = 300
"""Number of random poses. At least one of these poses must be permitted."""
_MOST_TRIALS = 2000
_FEWEST_TRIALS = 60
_LARGEST_WORK = 6e9
"""Approximate number of multiplications that a search may need."""
_CHANGED = 0.3
"""Fraction of the coefficients that a trial changes."""
_SCALES = (0.005, 0.5)
"""Smallest and largest standard deviation of a change, relative to the ranges."""
_GROWTH = 1.1
"""Factor of the standard deviation after a success; four failures reduce it by about 2 %."""
_DECAY = 0.995


@dataclass(frozen=True, eq=False)
class Excitation:
    """The best motion that was found."""

    series: FourierSeries
    limits: MotionLimits
    unknowns: Unknowns
    information: Floats
    """Information matrix of `unknowns`."""


def find_excitation(
    dynamics: InverseDynamics,
    limits: MotionLimits,
    collisions: Collisions | None = None,
    duration: float = DURATION,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Excitation:
    """
    Find an excitation motion.

    Equal arguments give equal results. `duration` is the duration of the motion [s]. `progress` is
    called regularly with the completed fraction, 0 to 1. Raises ConfigurationError if no permitted
    motion is found.

    """
    if not 0.0 < duration < math.inf:
        raise ConfigurationError(f'duration is {duration}, expected a finite time above 0 s')
    rng = np.random.default_rng(0)
    motions = MotionSpace(dynamics, limits, collisions, duration)
    candidates = motions.random(CANDIDATES, rng)
    unknowns = Unknowns(dynamics, limits)

    def information(x: Floats) -> Floats:
        return unknowns.information(motions.states(x), duration)

    def score(x: Floats) -> float:
        return float(np.linalg.slogdet(np.eye(len(unknowns.columns)) + information(x))[1])

    work = _SAMPLES * len(limits.index) * len(unknowns.columns) ** 2
    trials = int(np.clip(_LARGEST_WORK / work, _FEWEST_TRIALS, _MOST_TRIALS))
    scores = [score(x) for x in candidates]
    found = [motions.reduced(candidates[int(np.argmax(scores))], _FINE)]
    best, scale = score(found[0]), 0.1
    for k in range(trials):
        progress((k + 1.0) / trials)
        change = rng.normal(scale=scale, size=motions.shape)
        x = motions.within_ranges(found[-1] + change * (rng.random(motions.shape) < _CHANGED))
        value = score(x) if motions.keeps_efforts(x) else -math.inf
        is_better = value > best and motions.is_free(x)
        if is_better:
            found.append(x)
            best = value
        scale = float(np.clip(scale * (_GROWTH if is_better else _DECAY), *_SCALES))
    # The search checks few states. Its start was checked completely.
    x = next((x for x in reversed(found[1:]) if motions.is_permitted(x, _FINE)), found[0])
    return Excitation(
        FourierSeries(limits.joint_names, duration, motions.coefficients(x)),
        limits,
        unknowns,
        information(x),
    )


class MotionSpace:
    """
    All motions of m joints as Fourier series with h harmonics.

    An array x of shape (m, 2 h - 1) represents one motion. The entries of x are coefficients of
    the `FourierSeries`, relative to the middle and the half width of the position ranges.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        limits: MotionLimits,
        collisions: Collisions | None,
        duration: float,
    ) -> None:
        self.dynamics, self.limits, self.collisions = dynamics, limits, collisions
        self.shape = len(limits.index), 2 * HARMONICS - 1
        # The end is left out, because the end equals the start.
        times = np.linspace(0.0, duration, _FINE * _SAMPLES, endpoint=False)
        self._basis = basis(times, duration, HARMONICS)

    def coefficients(self, x: Floats) -> Floats:
        """Return the coefficients of the `FourierSeries` of a motion."""
        coefficients: Floats = x * self.limits.half[:, np.newaxis]
        coefficients[:, 0] += self.limits.middle
        return coefficients

    def states(self, x: Floats, density: int = 1) -> States:
        """Return the states of a motion; `density` is the number of states per sample."""
        every = _FINE // density
        return States(*(part[::every] @ self.coefficients(x).T for part in self._basis))

    def within_ranges(self, x: Floats, largest: float = 1.0) -> Floats:
        """Multiply the swing of each joint by at most `largest`, to keep its range and speed."""
        still = np.clip(x[:, 0], -1.0, 1.0)
        swing = x[:, 1:]
        q, qd = (np.max(np.abs(part[:, 1:] @ swing.T), axis=0) for part in self._basis[:2])
        speeds = self.limits.speeds / self.limits.half
        room = np.minimum(
            (1.0 - np.abs(still)) / np.maximum(q, _STILL), speeds / np.maximum(qd, _STILL)
        )
        return np.column_stack([still, swing * np.minimum(room, largest)[:, np.newaxis]])

    def keeps_efforts(self, x: Floats, density: int = 1) -> bool:
        """Return whether a motion keeps the effort limits."""
        states = whole_states(self.limits, self.states(x, density))
        return bool((np.abs(self.dynamics.efforts(*states)) <= self.limits.efforts).all())

    def is_free(self, x: Floats, density: int = 1) -> bool:
        """Return whether a motion, and the straight path to its start, have no collision."""
        if self.collisions is None:
            return True
        q = whole_positions(self.limits, self.states(x, density).q)
        places = np.linspace(0.0, 1.0, density * _WAY)[:, np.newaxis]
        way = self.limits.rest + places * (q[0] - self.limits.rest)
        return self.collisions.is_free(q) and self.collisions.is_way_free(way)

    def is_permitted(self, x: Floats, density: int = 1) -> bool:
        """Return whether a motion keeps the effort limits and has no collision."""
        return self.keeps_efforts(x, density) and self.is_free(x, density)

    def random(self, count: int, rng: np.random.Generator) -> list[Floats]:
        """Draw random motions that are as large as the limits permit."""
        centres = self._centres(rng)
        found = []
        for k in range(count):
            still = np.zeros(self.shape)
            still[:, 0] = centres[k % len(centres)]
            swing = rng.normal(size=self.shape)
            swing[:, 0] = 0.0
            found.append(self.reduced(self.within_ranges(still + swing, math.inf)))
        return found

    def reduced(self, x: Floats, density: int = 1) -> Floats:
        """Reduce the swing of a motion around a permitted pose until the motion is permitted."""
        x = x.copy()
        while not self.is_permitted(x, density) and np.abs(x[:, 1:]).max() > _STILL:
            x[:, 1:] *= _SMALLER
        return x

    def _centres(self, rng: np.random.Generator) -> Floats:
        """
        Return permitted poses, relative to the middle and half width of the ranges.

        Random poses of robots with many joints have collisions. Therefore the poses are random
        points on the paths from `rest` to such poses.

        """
        limits, robot = self.limits, self.dynamics.robot
        rest = (limits.rest[limits.index] - limits.middle) / limits.half
        centres = rng.uniform(-1.0, 1.0, (_POSES, self.shape[0]))
        centres = np.clip(rest + rng.random((_POSES, 1)) * (centres - rest), -_INSIDE, _INSIDE)
        q = whole_positions(limits, limits.middle + limits.half * centres)
        efforts = np.abs(self.dynamics.gravity_efforts(q))
        is_held = (efforts <= limits.efforts).all(axis=1)
        if not is_held.any():
            least = np.min(efforts, axis=0)
            weak = [
                f"'{robot.joint_names[i]}' needs at least {least[i]:.3g}, limit "
                f'{limits.efforts[i]:.3g}'
                for i in np.flatnonzero(least > limits.efforts)
            ]
            reason = f' [N m, N]: {listed(weak, 4)}' if weak else '; widen the ranges'
            raise ConfigurationError(f'no random pose is within the effort limits{reason}')
        still = np.zeros((np.count_nonzero(is_held), *self.shape))
        still[:, :, 0] = centres[is_held]
        found = list(islice((x[:, 0] for x in still if self.is_free(x)), CANDIDATES))
        if not found:
            assert self.collisions
            raise ConfigurationError(
                f'no random pose can be reached without a collision; in most of {len(still)} '
                f'poses, these collide: {self.collisions.most_frequent(q[is_held])}; lower the '
                'floor (--floor), or narrow the ranges in a copy of the URDF'
            )
        return np.array(found)
