"""
The Bayesian regression that explains measured efforts.

The rows are the samples of all joints. The columns are changes of the bodies, friction, rotors and
offsets, each with a prior. A *hypothesis* is a set of faults. A fault is a further column, such as
a payload, or a transformation of the measured efforts, such as another sign. The *evidence* of a
hypothesis is the probability of the measured efforts, averaged over all values of the unknowns.
Therefore, unknowns that are not needed reduce it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ..columns import STATES_AT_ONCE
from .loads import MAX_REACH, point_mass_parameters
from .rows import (
    Columns,
    LOAD_FRICTION,
    OFFSET,
    Places,
    POINT_MASS,
    ROTOR,
    Rows,
    Signals,
    Window,
)

NEEDED = 12.0  # least log evidence that a fault must add
ROUNDS = 6  # of variances, nonnegative friction, and nonlinear parameters
FLOOR = 0.01  # accuracy of models, as a fraction of a joint's RMS effort
LEAST_FLOOR = 0.001  # the same, as a fraction of the largest RMS effort of all joints of a type
UNEXPLAINED = 0.3  # fraction of the squared effort that a good fit leaves at most
MOST_UNEXPLAINED = 0.5  # the same for all joints of a type; more is reported at rest too
NOISE_FLOOR = 2.0  # RMS residuals below this multiple of the noise need no explanation
SEGMENTS = 40  # for samples that nothing explains
LOUD = 4.0  # multiple of the median loudness above which segments lose their weight
CLIP = 25.0  # largest squared residual that counts, in variances
BODIES_COST = 28.0  # of bodies that are not accurate
GOOD_BODIES, WIDE_BODIES = 0.2, 6.0  # multiples of the usual spread of the bodies
SURE_ENOUGH = 2.0  # the same as CERTAIN in brief searches, which may see one pose only
CERTAIN = 4.0  # a load is reported if its mass exceeds this multiple of its standard error
USUAL_OFFSET, WIDE_OFFSET = 0.01, 1.0  # standard deviation, as a fraction of the RMS effort
DRIVE_SPREAD = np.array([3.0, 3.0, 0.2, 1.0, USUAL_OFFSET])
LOAD_SPREAD = np.array([4.0, 0.8, 0.8, 0.8])
DELAY_SPREAD = 0.1  # [s]
LEAST_TILT = 0.02  # [rad]
RADIAL = 0.002  # relative standard deviation of the magnitude of gravity


class Hypothesis(NamedTuple):
    """A set of faults."""

    axes: tuple[int, ...] = ()
    """Joints with reversed axes."""
    factors: tuple[tuple[int, float], ...] = ()
    """Joints, and the factors of their measured efforts."""
    unit: float = 1.0
    """Factor of all measured efforts."""
    source: tuple[int, ...] = ()
    """Joints under whose names the efforts were recorded; empty if in order."""
    other_gravity: int = 0
    """
    `OWN` if the measured efforts lack gravity, or contain it unexpectedly; `OF_MODEL` if they lack
    the gravity efforts of the model.
    """
    load: str = ''
    """Link with an unknown payload."""
    is_tilted: bool = False
    is_late: bool = False
    has_wrong_bodies: bool = False
    has_offsets: bool = False
    window: Window | None = None

    @property
    def sensors(self) -> tuple[object, ...]:
        """The faults of signs, units and names."""
        return self.axes, self.factors, self.unit, self.source

    def without_one(self) -> list[Hypothesis]:
        """Return the hypotheses with one fault less."""
        changes: list[dict[str, Any]] = [
            {name: default}
            for name, default in Hypothesis._field_defaults.items()
            if name not in ('axes', 'factors') and getattr(self, name) != default
        ]
        for name in ('axes', 'factors'):
            found = getattr(self, name)
            changes += [{name: tuple(x for x in found if x != y)} for y in found]
        return [self._replace(**change) for change in changes]

    def factor(self, count: int) -> Floats:
        """Return the factor of the measured effort of each joint, shape (c,)."""
        factors = np.full(count, self.unit)
        for j, factor in self.factors:
            factors[j] *= factor
        return factors

    def order(self, count: int) -> Integers:
        """Return the joint under whose name each effort was recorded, shape (c,)."""
        return np.array(self.source or range(count), dtype=np.intp)


class Fit(NamedTuple):
    """A hypothesis, fitted to the rows."""

    hypothesis: Hypothesis
    evidence: float
    """Logarithm of the probability of the measured efforts."""
    is_credible: bool
    """Whether the faults leave little unexplained, and loads are near their links."""
    shared: dict[str, Floats]
    """Values of the unknowns that all joints share."""
    errors: dict[str, Floats]
    """Standard errors of these values."""
    gravity: Floats
    """Fitted gravity, shape (3,) [m/s^2]."""
    drives: Floats
    """Damping, Coulomb friction, load friction, rotor and offset, shape (c, 5)."""
    drive_errors: Floats
    residual: Floats
    """In the units of the model, shape (S, c) [N m or N]."""
    variance: Floats
    """Variance of the residuals, shape (c,)."""
    rms: Floats
    """RMS of the measured efforts in the units of the model, shape (c,)."""
    bodies: float
    """Spread of the bodies, as a multiple of the usual spread."""
    solution: Floats
    """Factor of each column in the residual, shape (c, p)."""
    columns: Columns


class Regression:
    """
    The regression of the efforts in rows.

    `is_brief` means that the rows are a few seconds of filtered samples.
    """

    def __init__(self, rows: Rows, is_brief: bool = False) -> None:
        self.rows, self.is_brief = rows, is_brief
        s = rows.signals
        self.per_row = s.independent / max(len(s.times), 1) * s.used
        self.trust = np.ones(len(s.times))
        """Weights of the samples: small where nothing explains the efforts."""
        self.segment = np.arange(len(s.times)) * SEGMENTS // max(len(s.times), 1)

    def fit(self, h: Hypothesis) -> Fit:
        """Fit a hypothesis, with accurate bodies unless the efforts clearly show other ones."""
        fits = [self.fit_with(h, WIDE_BODIES if h.has_wrong_bodies else 1.0)]
        fits[0] = fits[0]._replace(evidence=fits[0].evidence - BODIES_COST)
        if not h.has_wrong_bodies:
            fits.append(self.fit_with(h, GOOD_BODIES))
        return max(fits, key=lambda fit: fit.evidence)

    def with_friction(self, fit: Fit, has_bodies: bool) -> Fit:
        """
        Fit friction accurately, with the faults of a fit; `has_bodies` says whether bodies differ.

        Offsets have a wide prior, because they look like friction. Friction that depends on the
        load is fitted where it is significant, because it also looks like other friction.
        """
        h = fit.hypothesis._replace(has_offsets=True)
        bodies = fit.bodies if has_bodies else 0.0
        first = self.fit_with(h, bodies)
        values, errors = first.drives[:, LOAD_FRICTION], first.drive_errors[:, LOAD_FRICTION]
        found = self.fit_with(h, bodies, values > CERTAIN * errors)
        return found._replace(shared=fit.shared)

    def fit_with(
        self, h: Hypothesis, bodies: float, has_load_friction: Booleans | None = None
    ) -> Fit:
        """Fit a hypothesis, given the spread of the bodies."""
        rows, c = self.rows, self.rows.count
        signs = np.ones(c)
        signs[list(h.axes)] = -1.0
        columns = rows.columns(signs, h.other_gravity, h.window)
        factor, order = h.factor(c), h.order(c)
        weights, pushed = self.weights(h.window)
        G, width = columns.product(weights), columns.matrix.shape[2]
        lateness = np.ones((c, width))
        lateness[:, columns.at.rate] = (-signs / factor)[:, None]
        if h.is_late:
            G = G * lateness[:, :, None] * lateness[:, None, :]
        target = np.zeros((c, width))
        target[np.arange(c), order] = signs / factor
        target[:, columns.at.model] = -1.0
        rms = rows.rms[order] / np.abs(factor)
        spread = DRIVE_SPREAD * rms[:, None]
        spread[:, LOAD_FRICTION] = DRIVE_SPREAD[LOAD_FRICTION] * columns.sizes[:, LOAD_FRICTION]
        if has_load_friction is not None:
            spread[~has_load_friction, LOAD_FRICTION] = 0.0
        if h.has_offsets:
            spread[:, OFFSET] = WIDE_OFFSET * rms
        dry = ~rows.signals.moves * rows.signals.dry[order] / np.abs(factor)
        spread[:, OFFSET] = np.hypot(spread[:, OFFSET], dry)
        counts = np.maximum(weights.sum(axis=0), 1e-9)
        noise = (rows.signals.noise[order] / factor) ** 2
        floor = (FLOOR * rms) ** 2 + (LEAST_FLOOR * rows.largest / factor) ** 2
        variance = (0.3 * rms) ** 2 + noise + floor
        shared = _Shared(h, columns.at, rows.dynamics.gravity, width, bodies)
        unbounded = spread.copy()
        x, drives = np.zeros(shared.map.shape[1]), np.zeros((c, len(columns.at.drive)))
        for k in range(ROUNDS):
            if k:
                spread[:, :OFFSET][drives[:, :OFFSET] < 0.0] = 0.0
                shared.update(x)
            goal = target - shared.known
            x, drives, solved = _solve(G, goal, shared.map, columns.at.drive, spread, variance)
            u = goal - shared.map @ x
            u[:, columns.at.drive] -= spread * drives
            squares = np.einsum('ci,cij,cj->c', u, G, u)
            variance = np.maximum(squares / counts, noise) + floor
        drive_errors = spread * solved.drive_errors
        if has_load_friction is not None:  # friction of zero is not certain
            certain = _solve(G, goal, shared.map, columns.at.drive, unbounded, variance)[2]
            drive_errors = unbounded * certain.drive_errors
        residual = (columns.matrix @ (u * lateness)[:, :, None])[..., 0].T
        expected = np.where(pushed, CLIP * variance, variance)
        clipped = np.minimum(residual**2 / expected, CLIP)
        evidence = -0.5 * (solved.log_det + float(x @ x) + float(np.sum(drives**2)))
        evidence -= 0.5 * float(np.sum(self.per_row * (clipped + np.log(expected * factor**2))))
        left = self.left(residual, pushed)
        touched = [*h.axes, *(j for j, _ in h.factors), *np.flatnonzero(order != np.arange(c))]
        is_explained = bool((left[touched] < UNEXPLAINED * rms[touched] ** 2).all())
        if h.other_gravity or h.unit != 1.0 or h.load or h.is_tilted:
            allowed = np.maximum(UNEXPLAINED * rms**2, NOISE_FLOOR**2 * noise)
            is_explained &= float(left.sum()) < float(allowed.sum())
        turned = float(np.linalg.norm(shared.gravity - shared.of_model))
        is_explained &= not h.is_tilted or turned > LEAST_TILT * shared.size
        is_credible = is_explained and shared.is_credible(
            x, solved.errors, SURE_ENOUGH if self.is_brief else CERTAIN
        )
        return Fit(
            h,
            evidence,
            is_credible,
            shared.values(x),
            shared.values(solved.errors),
            shared.gravity,
            spread * drives / columns.sizes,
            drive_errors / columns.sizes,
            residual,
            variance,
            rms,
            bodies,
            u * lateness,
            columns,
        )

    def left(self, residual: Floats, pushed: Booleans) -> Floats:
        """Return the mean squared residual of each joint outside of pushes, shape (c,)."""
        weights = self.per_row * self.trust[:, None] * ~pushed
        counts = np.maximum(weights.sum(axis=0), 1e-9)
        return np.asarray(np.sum(weights * residual**2, axis=0) / counts)

    def weights(self, window: Window | None) -> tuple[Floats, Booleans]:
        """Return the weights of all samples, and a mask of the samples that a push explains."""
        weights = self.per_row * self.trust[:, None]
        pushed = np.zeros(weights.shape, dtype=bool)
        if window is not None:
            inside = window.inside(self.rows.signals.times)[:, None]
            weights = np.where(inside, self.per_row, weights)
            if window.kind == 'push':
                pushed = inside & np.isin(np.arange(self.rows.count), window.joints)
                weights = np.where(pushed, 0.0, weights)
        return weights, pushed

    def _loudness(self, fit: Fit) -> Floats:
        """Return the mean squared residual of each segment, in variances."""
        used = self.rows.signals.used
        squares = np.sum(used * fit.residual**2 / fit.variance, axis=1)
        total = np.bincount(self.segment, squares, SEGMENTS)
        return np.asarray(total / np.maximum(np.bincount(self.segment, used.sum(1), SEGMENTS), 1))

    def trusting(self, fit: Fit) -> Fit:
        """Reduce the weight of segments that the fit does not explain, and fit again."""
        loud = self._loudness(fit)
        median = float(np.median(loud[loud > 0.0])) if (loud > 0.0).any() else 1.0
        trust = 1.0 / (1.0 + (loud / (LOUD * median)) ** 2)
        self.trust = trust[self.segment]
        return self.fit(fit.hypothesis)

    def unexplained(self, fit: Fit) -> Booleans:
        """Return for each joint whether most of its moving effort is not explained."""
        h, s = fit.hypothesis, self.rows.signals
        noise = s.noise[h.order(self.rows.count)] / h.factor(self.rows.count)
        least = np.maximum(UNEXPLAINED * fit.rms**2, (NOISE_FLOOR * noise) ** 2)
        left = self.left(fit.residual, self.weights(h.window)[1])
        found = (left > least) & s.moves
        # The effort of a joint at rest also contains unknown dry friction.
        kinds = self.rows.robot.is_prismatic_joint[self.rows.index]
        fractions = [
            float(left[same].sum() / np.sum(fit.rms[same] ** 2))
            for same in (kinds, ~kinds)
            if same.any()
        ]
        is_bad = min(fractions) > MOST_UNEXPLAINED
        return np.asarray(left > least if is_bad and not found.any() else found)

    def has_wrong_bodies(self, fit: Fit) -> bool:
        """Return whether the efforts show that the bodies are not accurate."""
        return fit.bodies != GOOD_BODIES and not self.unexplained(fit).all()

    def explained(self, fit: Fit, signals: Signals, rotors: Booleans) -> Floats:
        """
        Return the efforts that a fit explains, shape (S, c).

        The efforts are those of other samples of the same motion, in the units of the model. They
        contain friction, offsets, and all faults of the hypothesis that act on the model. `rotors`
        says which joints have a rotor that the model lacks.
        """
        h, at, parts = fit.hypothesis, fit.columns.at, []
        signs = np.ones(self.rows.count)
        signs[list(h.axes)] = -1.0
        solution = -fit.solution
        solution[:, : self.rows.count] = 0.0
        solution[:, at.rate] = 0.0
        solution[:, at.drive[ROTOR]] *= rotors
        for k in range(0, len(signals.times), STATES_AT_ONCE):
            rows = self.rows.at(signals.part(slice(k, k + STATES_AT_ONCE)))
            columns = rows.columns(signs, h.other_gravity, h.window)
            scaled = solution.copy()
            # The columns of the drives were divided by their sizes, which differ in each part.
            scaled[:, at.drive] *= columns.sizes / fit.columns.sizes
            parts.append((columns.matrix @ scaled[:, :, None])[..., 0].T)
        return np.concatenate(parts)


class _Shared:
    """The unknowns that all joints share: bodies, loads, gravity and a delay."""

    def __init__(
        self, h: Hypothesis, at: Places, gravity: Floats, width: int, spread: float
    ) -> None:
        self.at, self.link, self.of_model, self.gravity = at, h.load, gravity, gravity
        self.size = float(np.linalg.norm(gravity))
        window = h.window.kind if h.window is not None else ''
        every = np.full(len(at.bodies), spread)
        parts = {'bodies': (at.bodies, every)}
        if h.load:
            parts['load'] = at.loads[h.load][:POINT_MASS], LOAD_SPREAD
        if window == 'load':
            parts['window'] = at.window, LOAD_SPREAD
        if h.is_late:
            parts['delay'] = at.rate, np.array([DELAY_SPREAD])
        self.tilt = at.tilt if h.is_tilted else at.window if window == 'tilt' else at.tilt[:0]
        if len(self.tilt):
            parts['tilt'] = self.tilt, np.full(3, self.size)
        index = np.concatenate([places for places, _ in parts.values()])
        self.map = np.zeros((width, len(index)))
        """Columns for one unit of each scaled unknown."""
        self.map[index, np.arange(len(index))] = np.concatenate([s for _, s in parts.values()])
        ends = np.cumsum([len(places) for places, _ in parts.values()]).tolist()
        self.places = {
            name: (places, slice(end - len(places), end))
            for (name, (places, _)), end in zip(parts.items(), ends, strict=True)
        }
        self.known = np.zeros(width)
        """Known efforts, as factors of all columns."""

    def values(self, x: Floats) -> dict[str, Floats]:
        """Return the values, or standard errors, of the unknowns."""
        found = {}
        for name, (places, span) in self.places.items():
            block = self.map[places, span]
            found[name] = block @ x[span]
        return found

    def is_credible(self, x: Floats, errors: Floats, certain: float) -> bool:
        """Return whether all loads are known and near their links."""
        values, deviations = self.values(x), self.values(errors)
        return all(
            abs(values[name][0]) > certain * deviations[name][0]
            and np.linalg.norm(values[name][1:]) < MAX_REACH * abs(values[name][0])
            for name in ('load', 'window')
            if name in values
        )

    def update(self, x: Floats) -> None:
        """Make the efforts linear about the solution."""
        values = self.values(x)
        self.known = np.zeros_like(self.known)
        if self.link and abs(values['load'][0]) > 1e-3:
            mass, moments = float(values['load'][0]), values['load'][1:]
            com = np.clip(moments / mass, -MAX_REACH, MAX_REACH)
            second = point_mass_parameters(mass, com)[POINT_MASS:]
            self.known[self.at.loads[self.link][POINT_MASS:]] = second
        if len(self.tilt):
            # A change of the mounting turns gravity, and keeps its magnitude.
            vector = self.gravity + values['tilt']
            self.gravity = self.size * vector / np.linalg.norm(vector)
            axes = np.linalg.svd(self.gravity[None])[2].T
            spread = self.size * np.array([RADIAL, 1.0, 1.0])
            self.map[self.tilt, self.places['tilt'][1]] = axes * spread
            self.known[self.tilt] = self.gravity - self.of_model


class _Solved(NamedTuple):
    log_det: float
    errors: Floats
    drive_errors: Floats


def _solve(
    G: Floats, goal: Floats, shared: Floats, drive: Integers, spread: Floats, variance: Floats
) -> tuple[Floats, Floats, _Solved]:
    """Return the scaled shared unknowns, those of the drives, shape (c, 5), and their errors."""
    w = 1.0 / variance
    A = shared.T @ np.tensordot(w, G, 1) @ shared
    A[np.diag_indices_from(A)] += 1.0
    of_drive = G[:, drive] * (w[:, None] * spread)[:, :, None]
    B = of_drive @ shared
    D = of_drive[:, :, drive] * spread[:, None, :]
    D[:, np.arange(len(drive)), np.arange(len(drive))] += 1.0
    b = shared.T @ np.einsum('c,cij,cj->i', w, G, goal)
    d = (of_drive @ goal[:, :, None])[..., 0]
    inverse_D = np.linalg.inv(D)
    eliminated = np.einsum('cij,cjk->cik', inverse_D, B)
    A -= np.einsum('cji,cjk->ik', B, eliminated)
    b = b - np.einsum('cji,cj->i', eliminated, d)
    inverse = np.linalg.inv(A)
    x = inverse @ b
    drives = (inverse_D @ (d - B @ x)[:, :, None])[..., 0]
    log_det = float(np.linalg.slogdet(A)[1] + np.linalg.slogdet(D)[1].sum())
    variances = np.diagonal(inverse_D, axis1=1, axis2=2) + np.einsum(
        'cij,jk,cik->ci', eliminated, inverse, eliminated
    )
    errors = np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
    return x, drives, _Solved(log_det, errors, np.sqrt(np.maximum(variances, 0.0)))
