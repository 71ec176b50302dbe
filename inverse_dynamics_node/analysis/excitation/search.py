"""
Searches for the motion that determines masses and friction most accurately.

The search varies the coefficients of a Fourier series [1]_ to maximise the determinant of the
information matrix (D-optimal design). During the search, violated limits add a penalty. The
result respects all limits.

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
from ...robot.model import Floats, Integers
from .clearance import CLEARANCE, Nearest, TOUCH
from .fourier import basis, FourierSeries
from .information import Unknowns
from .limits import excess, MotionLimits, States, whole_positions, whole_states

DURATION = 10.0  # [s]
HARMONICS = 5
"""Number of harmonics of the Fourier series."""
NOISE = 0.01
"""Assumed standard deviation of measured efforts, as a fraction of the effort limit."""
SAMPLES_PER_SECOND = 10.0
"""Assumed rate of independent samples in the smoothed measured efforts [Hz]."""
_STEP = 1e-6
"""
Step of finite differences [rad or m].

For velocities and accelerations, the step is multiplied by the largest speed of the joint.
"""
_PER_HARMONIC = 16
"""Number of samples per harmonic during the search."""
_FINE = 8
"""Checks of the limits use this many states per sample of the search."""
_DENSER = 4
"""For each sample, the search checks this many poses for collisions."""
_COARSE, _SHRINKING = 8, 0.95
"""
Coarse checks use one out of `_COARSE` states.

If a motion fails a full check, its amplitude is multiplied by `_SHRINKING`.
"""
_WAY = 60
"""Number of poses that the search checks on the path to the start of a motion."""
CANDIDATES = 30
"""Number of random motions. The search starts from the best random motion."""
_POSES = 300
"""Number of random poses. At least one of these poses must respect all limits."""
_NEARLY_ALL = 0.9
"""If more than this fraction of poses reach below the floor, the floor is probably too high."""
_ROUNDS = ((1e1, 60), (1e2, 60), (1e3, 60), (1e4, 60))
"""Penalty weight and number of iterations of each round."""
_LARGEST_WORK = 1.5e9
"""Largest number of regressor entries that a search may compute."""
_FEWEST_ITERATIONS = 5
_AIM = 0.99
"""The search aims at this fraction of the limits, because penalties permit small violations."""
_REPAIRS = (0.98, 0.96, 0.92)
"""Smaller fractions of the limits, which are tried if the result violates a limit."""
_OF_REPAIR = (1e5, 30)
"""Penalty weight and number of iterations of each repair."""
_LEAST_NOISE = 1e-6
"""Smallest assumed noise [N m or N]."""
_TINY = 1e-9
"""Value that is added to the diagonal of the information matrix to keep it invertible."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """The best motion that was found."""

    series: FourierSeries
    limits: MotionLimits
    unknowns: Unknowns
    information: Floats
    """Information matrix of the scaled unknowns, shape (unknowns, unknowns)."""
    log_det: float
    """Log-determinant of the information matrix per sample."""
    random_log_det: float
    """Largest `log_det` of `CANDIDATES` random motions within the same limits."""
    nearest: tuple[Nearest, ...] = ()
    """Smallest distances during the motion and on the path to its start, in ascending order."""


def find_excitation(
    dynamics: InverseDynamics,
    limits: MotionLimits,
    duration: float = DURATION,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Excitation:
    """
    Find an excitation motion.

    Equal arguments give equal results. `duration` is the duration of the motion [s]. The assumed
    standard deviation of measured efforts is `NOISE` times the effort limit. The largest effort of
    random motions replaces a missing effort limit. `progress` is called regularly with the
    completed fraction, 0 to 1.

    Raises ConfigurationError if an argument is invalid, if no pose is within the limits, or if
    every motion that was tried leads to a collision.

    """
    if not 0.0 < duration < math.inf:
        raise ConfigurationError(f'duration is {duration!r}, expected a finite time above 0 s')
    motions = MotionSpace(dynamics, limits, duration)
    candidates = motions.random(CANDIDATES, np.random.default_rng(0))
    unknowns = Unknowns(dynamics, limits, _assumed_noise(motions, candidates))
    objective = _Objective(motions, unknowns)
    scores = [objective.log_det(x) for x in candidates]
    first = candidates[int(np.argmax(scores))]
    found = _improved(objective, first, progress)
    count = SAMPLES_PER_SECOND * duration
    safe = [motions.within_limits(found, first), *candidates]
    for x in sorted(safe, key=objective.log_det, reverse=True):
        nearest = motions.nearest(x)
        if not nearest or nearest[0].distance > TOUCH:
            return Excitation(
                FourierSeries(limits.joint_names, duration, motions.coefficients(x)),
                limits,
                unknowns,
                count * objective.information(x),
                objective.log_det(x),
                max(scores),
                nearest,
            )
    raise ConfigurationError(
        'every motion that was tried leads to a collision, either during the motion or on the way '
        'to its start; narrow the limits in a copy of the URDF'
    )


class MotionSpace:
    """
    All motions of m joints as Fourier series with h harmonics.

    An array x of shape (m, 2 h - 1) represents one motion. The entries of x are coefficients of
    the `FourierSeries`, relative to the middle and the half width of the position ranges.

    """

    def __init__(self, dynamics: InverseDynamics, limits: MotionLimits, duration: float) -> None:
        self.dynamics, self.limits = dynamics, limits
        self.shape = len(limits.index), 2 * HARMONICS - 1
        count = _PER_HARMONIC * HARMONICS
        # The end is left out, because the end equals the start.
        self.basis, self._fine_basis, (self._pose_basis, _, _) = (
            basis(np.linspace(0.0, duration, k * count, endpoint=False), duration, HARMONICS)
            for k in (1, _FINE, _DENSER)
        )

    def coefficients(self, x: Floats) -> Floats:
        """Return the coefficients of the `FourierSeries` of a motion."""
        coefficients: Floats = x * self.limits.half[:, np.newaxis]
        coefficients[:, 0] += self.limits.middle
        return coefficients

    def states(self, x: Floats) -> States:
        """Return the states of a motion at the samples of the search."""
        return States(*(part @ self.coefficients(x).T for part in self.basis))

    def is_within_limits(self, x: Floats, every: int = 1) -> bool:
        """Return whether a motion respects all limits in every n-th state, where n is `every`."""
        states = States(*(part[::every] @ self.coefficients(x).T for part in self._fine_basis))
        if excess(self.dynamics, self.limits, states).any():
            return False
        return self._is_clear(states.q, every)

    def _is_clear(self, q: Floats, every: int = 1) -> bool:
        """Return whether poses, and the path to the first pose, keep the minimum distances."""
        clearance = self.limits.clearance
        if clearance is None:
            return True
        way = self.way_to(q[0], _FINE // _DENSER * _WAY // every)
        return clearance.is_kept(whole_positions(self.limits, q)) and clearance.is_kept(way, True)

    def nearest(self, x: Floats) -> tuple[Nearest, ...]:
        """Return the smallest distances during a motion and on the path to its start."""
        clearance, q = self.limits.clearance, self._fine_basis[0] @ self.coefficients(x).T
        if clearance is None:
            return ()
        found = clearance.nearest(whole_positions(self.limits, q))
        at_rest = clearance.nearest(self.limits.rest[np.newaxis])
        touching = [each.names for each in at_rest if each.distance < CLEARANCE]
        on_way = clearance.nearest(self.way_to(q[0], _WAY))
        found += [each for each in on_way if each.names not in touching]
        return tuple(sorted(found, key=lambda each: each.distance))

    def missing_clearance(self, x: Floats, aim: float) -> tuple[float, Floats]:
        """
        Return how far a motion violates the minimum distances, and the gradient.

        The violation is the mean of `Clearance.violation` over the motion, plus the mean over the
        path to its start. The gradient with respect to the coefficients has the shape (moving
        joints, 2 * harmonics - 1). `Clearance.violation` describes `aim`.

        """
        clearance, index = self.limits.clearance, self.limits.index
        if clearance is None:
            return 0.0, np.zeros(self.shape)
        q = self._pose_basis @ self.coefficients(x).T
        missing, of_poses = clearance.violation(whole_positions(self.limits, q), aim)
        on_way, of_way = clearance.violation(self.way_to(q[0], _WAY), aim, is_way=True)
        slopes = of_poses[:, index] / len(q)
        slopes[0] += np.linspace(0.0, 1.0, _WAY, endpoint=False) @ of_way[:, index] / _WAY
        of_coefficients: Floats = slopes.T @ self._pose_basis
        return float(missing.mean() + on_way.mean()), of_coefficients

    def way_to(self, start: Floats, count: int) -> Floats:
        """Return poses on the straight path from `rest` to a start pose, shape (count, joints)."""
        rest, (end,) = self.limits.rest, whole_positions(self.limits, start[np.newaxis])
        places = np.linspace(0.0, 1.0, count, endpoint=False)
        return np.asarray(rest + places[:, np.newaxis] * (end - rest))

    def random(self, count: int, rng: np.random.Generator) -> list[Floats]:
        """Draw random motions that are as large as the limits permit."""
        centres = self._poses(rng)
        found = []
        for k in range(count):
            still = np.zeros(self.shape)
            still[:, 0] = centres[k % len(centres)]
            swing = rng.normal(size=self.shape)
            swing[:, 0] = 0.0
            # First, each joint fills its range or reaches its largest speed.
            found.append(self._largest(still, swing / self._size(still, swing)))
        return found

    def within_limits(self, x: Floats, safe: Floats) -> Floats:
        """Shrink a motion, or blend it with a safe motion, until it respects all limits."""
        still = np.zeros(self.shape)
        still[:, 0] = x[:, 0]
        for end, smallest in ((still, 0.5), (safe, 0.0)):
            for factor in np.linspace(1.0, smallest, 51):
                reduced: Floats = end + factor * (x - end)
                if self.is_within_limits(reduced):
                    return reduced
        return safe

    def _largest(self, still: Floats, swing: Floats) -> Floats:
        """Reduce the swing around a pose until the motion respects all limits."""
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            if self.is_within_limits(still + middle * swing, _COARSE):
                low = middle
            else:
                high = middle
        while not self.is_within_limits(still + low * swing):
            low *= _SHRINKING
        return still + low * swing

    def _size(self, still: Floats, swing: Floats) -> Floats:
        """Return the swing of each joint as a fraction of its limits, shape (joints, 1)."""
        states = States(*(part @ (swing * self.limits.half[:, None]).T for part in self.basis))
        room = self.limits.half * (1.0 - np.abs(still[:, 0]))
        ratios = np.maximum(np.abs(states.q) / room, np.abs(states.qd) / self.limits.speeds)
        return np.asarray(np.max(ratios, axis=0)[:, np.newaxis])

    def _poses(self, rng: np.random.Generator) -> Floats:
        """Return poses within the limits, relative to the middle and half width of the ranges."""
        poses = rng.uniform(-0.5, 0.5, (_POSES, self.shape[0]))
        poses[0] = 0.0
        q = self.limits.middle + self.limits.half * poses
        states = States(q, np.zeros_like(q), np.zeros_like(q))
        held = np.flatnonzero(~excess(self.dynamics, self.limits, states).any(axis=1))
        clear = (k for k in held if self._is_clear(q[k : k + 1]))
        found = list(islice(clear, CANDIDATES))
        if not found:
            raise ConfigurationError(self._why(states, held))
        return np.asarray(poses[found])

    def _why(self, states: States, held: Integers) -> str:
        """Explain why no pose respects all limits; `held` indexes poses that drives can hold."""
        limits = self.limits
        if len(held):
            return self._why_not_clear(whole_positions(limits, states.q[held]))
        efforts = np.abs(self.dynamics.efforts(*whole_states(limits, states)))
        least = np.min(efforts, axis=0)
        names = self.dynamics.robot.joint_names
        weak = [
            f"'{names[i]}' needs at least {least[i]:.3g}, limit {limits.efforts[i]:.3g}"
            for i in np.flatnonzero(least > limits.efforts)
        ]
        reason = f' [N m, N]: {listed(weak, 4)}' if weak else '; widen the ranges'
        return f'no sampled pose is within the effort limits{reason}'

    def _why_not_clear(self, poses: Floats) -> str:
        """Explain why no pose keeps the minimum distances."""
        clearance = self.limits.clearance
        assert clearance
        found = clearance.contacts(poses)
        is_floor = [clearance.names(row)[1] == 'floor' for row in found.row.tolist()]
        below = len(np.unique(found.pose[is_floor]))
        if below < _NEARLY_ALL * len(poses):
            return (
                f'none of {len(poses)} sampled poses can be reached without a collision; widen '
                'the ranges, or lower the floor (--floor)'
            )
        lowest = float(clearance.extent(poses).lowest[2])
        height = math.floor(10.0 * (lowest - CLEARANCE)) / 10.0
        return (
            f'none of {len(poses)} sampled poses is free of collisions: {below} of them reach '
            f'below the floor at {clearance.floor:g} m, down to {lowest:.2f} m; lower the floor '
            f'(--floor {height:g}) or switch it off (--floor none)'
        )


class _Objective:
    """Negative log-determinant of the information matrix, plus penalties for violated limits."""

    def __init__(self, motions: MotionSpace, unknowns: Unknowns) -> None:
        self.motions, self.unknowns = motions, unknowns
        self.aim = _AIM

    def information(self, x: Floats) -> Floats:
        """Return the information matrix per sample, shape (unknowns, unknowns)."""
        return _information(self.unknowns.weighted(self.motions.states(x)))

    def log_det(self, x: Floats) -> float:
        """Return the log-determinant of the information matrix per sample."""
        return float(np.linalg.slogdet(self.information(x))[1])

    def __call__(self, flat: Floats, weight: float) -> tuple[float, Floats]:
        """Return the value to minimise and its gradient."""
        motions, x = self.motions, flat.reshape(self.motions.shape)
        states = motions.states(x)
        columns = self.unknowns.weighted(states)
        information = _information(columns)
        k, u = len(columns), columns.shape[2]
        factors: Floats = columns @ np.linalg.inv(information) * (-2.0 / k)
        information_lost = self.unknowns.weighted_sum(factors)

        def linearised(states: States) -> Floats:
            return np.asarray(information_lost(states) + weight * u / k * self._violation(states))

        value = -float(np.linalg.slogdet(information)[1])
        value += weight * u / k * float(np.sum(self._violation(states)))
        slopes = _gradient(linearised, states, motions.limits.speeds)
        of_coefficients = sum(
            part.T @ slope for part, slope in zip(motions.basis, slopes, strict=True)
        )
        missing, of_poses = motions.missing_clearance(x, self.aim)
        value += weight * u * missing
        total = np.asarray(of_coefficients).T + weight * u * of_poses
        return value, (total * motions.limits.half[:, np.newaxis]).ravel()

    def _violation(self, states: States) -> Floats:
        beyond = excess(self.motions.dynamics, self.motions.limits, states, self.aim)
        return np.asarray(np.sum(beyond**2, axis=1))


def _gradient(function: Callable[[States], Floats], states: States, speeds: Floats) -> States:
    """
    Differentiate a function at every state.

    The function returns one number per state. Each number depends only on its own state.

    """
    here = function(states)
    k, m = states.q.shape
    slopes = States(*np.empty((3, k, m)))
    for j in range(m):
        steps = _STEP * np.array([1.0, speeds[j], speeds[j]])
        moved = States(*(np.tile(part, (3, 1)) for part in states))
        for order in range(3):
            moved[order][order * k : (order + 1) * k, j] += steps[order]
        changes = function(moved).reshape(3, k) - here
        for order in range(3):
            slopes[order][:, j] = changes[order] / steps[order]
    return slopes


def _information(columns: Floats) -> Floats:
    # One product per sample, because BLAS would start threads for a large product. Threads are
    # slow on a busy machine.
    products = columns.transpose(0, 2, 1) @ columns
    return np.asarray(np.mean(products, axis=0) + _TINY * np.eye(columns.shape[2]))


def _improved(objective: _Objective, x: Floats, progress: Callable[[float], None]) -> Floats:
    """Improve the motion x by a gradient search."""
    from scipy.optimize import minimize

    most = _most_iterations(objective)
    rounds = [(weight, min(iterations, most)) for weight, iterations in _ROUNDS]
    total = sum(iterations for _, iterations in rounds)
    done = 0

    def report(_: Floats) -> None:
        nonlocal done
        done += 1
        progress(min(1.0, done / total))

    def descend(x: Floats, weight: float, iterations: int) -> Floats:
        result = minimize(
            objective,
            x.ravel(),
            args=(weight,),
            jac=True,
            method='L-BFGS-B',
            callback=report,
            options={'maxiter': iterations, 'maxcor': 20},
        )
        return np.asarray(result.x, dtype=float).reshape(x.shape)

    for weight, iterations in rounds:
        x = descend(x, weight, iterations)
    for objective.aim in _REPAIRS:
        if objective.motions.is_within_limits(x):
            break
        x = descend(x, *_OF_REPAIR)
    progress(1.0)
    return x


def _most_iterations(objective: _Objective) -> int:
    """Return the largest number of iterations per round. More joints lead to fewer iterations."""
    m, n = objective.motions.shape[0], len(objective.motions.limits.rest)
    entries = n * objective.unknowns.rigid_count  # per regressor
    states = 3 * m * len(objective.motions.basis[0])  # per gradient
    most = _LARGEST_WORK / (len(_ROUNDS) * states * entries)
    return max(_FEWEST_ITERATIONS, int(most))


def _assumed_noise(motions: MotionSpace, candidates: list[Floats]) -> Floats:
    limits, dynamics = motions.limits, motions.dynamics
    states = (whole_states(limits, motions.states(x)) for x in candidates)
    efforts = np.array([dynamics.efforts(*each) for each in states])
    largest = np.max(np.abs(efforts), axis=(0, 1))[limits.index]
    given = dynamics.robot.effort_limits[limits.index]
    of = np.where(np.isfinite(given), given, largest)
    return np.asarray(np.maximum(NOISE * of, _LEAST_NOISE))
