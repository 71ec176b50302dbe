"""
Fits damping, Coulomb friction and an offset to the residual efforts of one joint.

Near zero speed, dry friction can have any value up to its maximum. Therefore, samples near zero
speed are not used. A wider step of Coulomb friction, or friction that grows with the load, is
accepted only if the squared residual becomes clearly smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..columns import fit_nonnegative, friction_columns
from ..node_parameters import node_parameters

SURELY_MOVING = 3.0  # times the smoothing width; tanh(3) is 99.5 % of the final value
LEAST_MOVING = 1.0  # [s] in each direction, to distinguish Coulomb friction from an offset
SPREAD = 1.5  # ratio of largest to smallest speed, to distinguish damping from Coulomb friction
WIDTHS = (0.02, 0.03, 0.05, 0.08, 0.12)  # [rad/s or m/s]
BETTER = 0.85  # another width, or load friction, leaves at most this fraction of the squares
MOST_LOAD = 0.5  # larger ratios of friction to load have another cause
BLOCKS = 12  # blocks of a recording; the differences between blocks show the standard errors


class FrictionFit(NamedTuple):
    """Friction and offset of a joint: ``damping * qd + coulomb * tanh(qd / width) + offset``."""

    damping: float
    """Damping [N m s/rad or N s/m]; 0 if unknown."""
    coulomb: float
    """Coulomb friction [N m or N]; 0 if unknown."""
    offset: float
    """Constant offset of the effort [N m or N]."""
    damping_error: float
    """Standard error of ``damping``; dependent samples are taken into account."""
    coulomb_error: float
    offset_error: float
    unknown_because: str
    """Why the friction of this joint cannot be identified; empty if friction was fitted."""
    width: float = math.nan
    """Fitted speed over which Coulomb friction is smoothed [rad/s or m/s]; NaN if not fitted."""
    load_friction: float = 0.0
    """Additional Coulomb friction, as a fraction of the magnitude of the effort on the links."""

    @classmethod
    def unknown(cls, reason: str, offset: float = 0.0) -> FrictionFit:
        """Return a fit without friction; `reason` says why friction is unknown."""
        return cls(0.0, 0.0, offset, math.nan, math.nan, math.nan, reason)

    def efforts(self, qd: Floats, direction: Floats) -> Floats:
        """Return efforts of friction and offset at given velocities and smoothed directions."""
        return np.asarray(self.damping * qd + self.coulomb * direction + self.offset)

    @property
    def has_shape(self) -> bool:
        """Whether a width or a load friction was fitted."""
        return math.isfinite(self.width)


def is_moving(qd: Floats, width: float) -> Booleans:
    """Return a mask of the samples in which a joint moves fast enough for full dry friction."""
    return np.asarray(np.abs(qd) > SURELY_MOVING * width)


def lacks_reversal(qd: Floats, period: float, width: float, least: float = LEAST_MOVING) -> str:
    """Return why a joint did not move long enough in both directions; empty if it moved enough."""
    fast = SURELY_MOVING * width
    fastest = float(np.max(np.abs(qd)))
    if fastest <= fast:
        return (
            f'this joint was never faster than {fastest:.2g}, expected more than {fast:g} '
            '(rad/s or m/s)'
        )
    forth, back = period * (qd > fast).sum(), period * (qd < -fast).sum()
    if min(forth, back) < least:
        return (
            f'this joint moved forward for {forth:.2g} s and back for {back:.2g} s; expected '
            f'at least {least:g} s in each direction'
        )
    return ''


def obstacle(qd: Floats, period: float, width: float) -> str:
    """Return why a motion does not identify friction; empty if friction can be identified."""
    reason = lacks_reversal(qd, period, width)
    if reason:
        return reason
    speeds = np.abs(qd[is_moving(qd, width)])
    slow, quick = np.quantile(speeds, [0.05, 0.95])
    if quick < SPREAD * slow:
        return (
            f'the speed of this joint was nearly always between {slow:.2g} and {quick:.2g} '
            '(rad/s or m/s); this range is too small to distinguish damping from Coulomb friction'
        )
    return ''


def fit_friction(
    qd: Floats,
    direction: Floats,
    residual: Floats,
    period: float,
    window: int,
    width: float,
) -> FrictionFit:
    """
    Fit friction and an offset to the efforts that the model does not explain.

    The direction is ``tanh(qd / width)``, smoothed in the same way as the measured efforts, over a
    window [samples]. Neither damping nor Coulomb friction is negative.
    """
    reason = obstacle(qd, period, width)
    if reason:
        middle = float(np.median(residual))
        # If friction acts in one direction most of the time, the median contains friction.
        is_offset = np.var(residual) + (np.mean(residual) - middle) ** 2 < np.mean(residual**2)
        return FrictionFit.unknown(reason, middle if is_offset else 0.0)
    moving = is_moving(qd, width)
    features = np.column_stack([qd, direction, np.ones_like(qd)])[moving]
    fit, _ = fit_nonnegative(features, residual[moving], [2])
    errors = standard_errors(features, residual[moving] - features @ fit, moving, window)
    damping, coulomb, offset = fit.tolist()
    return FrictionFit(damping, coulomb, offset, *errors, '')


def fit_shape(
    fit: FrictionFit,
    qd: Floats,
    residual: Floats,
    load: Floats,
    smooth: Callable[[Floats], Floats],
    width: float,
    window: int,
) -> FrictionFit:
    """
    Fit the smoothing width and the load friction to all K samples of a joint.

    `fit` has the smoothing width `width` [rad/s or m/s], and is returned unless another width or
    load friction clearly reduces the squared residual. `residual`, shape (K,), is the measured
    effort minus the modelled effort without friction [N m or N]. `load`, shape (K,), is the
    magnitude of the modelled effort without friction and rotor [N m or N]. `smooth` applies the
    smoothing of the measured efforts to columns, shape (K, c). `window` is the length of the
    smoothing window [samples].
    """
    if fit.unknown_because:
        return fit
    columns = {
        each: friction_columns(qd, each, load, smooth) for each in dict.fromkeys((width, *WIDTHS))
    }
    # The triangular factors lead to the same least-squares fits as all samples.
    triangles = {
        each: np.asarray(np.linalg.qr(np.column_stack([of, residual]), mode='r'))
        for each, of in columns.items()
    }
    squares, best = _with_load(triangles[width], False)
    chosen = width
    for has_load in (False, True):
        for other, triangle in triangles.items():
            left, solution = _with_load(triangle, has_load)
            if left < BETTER * squares and solution[2] < MOST_LOAD:
                squares, best, chosen = left, solution, other
    if chosen == width and best[2] == 0.0:
        return fit
    unexplained = residual - columns[chosen] @ np.array(best)
    every = np.ones(len(qd), dtype=bool)
    errors = standard_errors(columns[chosen][:, [0, 1, 3]], unexplained, every, window)
    return FrictionFit(best[0], best[1], best[3], *errors, '', chosen, best[2])


def _with_load(
    triangle: Floats, has_load: bool
) -> tuple[float, tuple[float, float, float, float]]:
    """Return the squared residual, and damping, Coulomb friction, load friction and offset."""
    columns = triangle[:, :-1] * [1.0, 1.0, has_load, 1.0]
    factors, left = fit_nonnegative(columns, triangle[:, -1], [3])
    damping, coulomb, per_load, offset = factors.tolist()
    return left, (damping, coulomb, per_load, offset)


def standard_errors(
    features: Floats, residual: Floats, moving: Booleans, window: int
) -> tuple[float, float, float]:
    """
    Estimate standard errors from the differences between blocks of the recording.

    Neither smoothed samples nor model errors are independent. With the formula for independent
    samples, the standard errors would be far too small.
    """
    blocks = int(min(BLOCKS, max(2, len(moving) // (2 * window))))
    block = (np.flatnonzero(moving) * blocks) // len(moving)
    bread = np.linalg.pinv(features.T @ features)
    pulls = np.array([features[block == b].T @ residual[block == b] for b in range(blocks)])
    free = max(blocks - features.shape[1], 1)
    meat = pulls.T @ pulls * blocks / free
    variances = np.maximum(np.diagonal(bread @ meat @ bread), 0.0)
    damping, coulomb, offset = np.sqrt(variances).tolist()
    return damping, coulomb, offset


def friction_parameters(
    joint_names: Sequence[str],
    fits: Sequence[FrictionFit],
    width: float,
    armature: Sequence[float] = (),
) -> str:
    """
    Return the YAML text of node parameters with the fitted friction.

    Where the friction of a joint is unknown, the node uses the friction in the URDF. `width` is
    the speed over which Coulomb friction is smoothed where no width was fitted [rad/s or m/s].
    `armature` contains the rotor inertia of each joint [kg m^2 or kg], and is empty if none was
    found.
    """
    values: dict[str, float | Sequence[float]] = {
        'damping': [-1.0 if fit.unknown_because else fit.damping for fit in fits],
        'coulomb': [-1.0 if fit.unknown_because else fit.coulomb for fit in fits],
        'coulomb_width': width,
    }
    if any(fit.has_shape for fit in fits):
        values['coulomb_width'] = [fit.width if fit.has_shape else width for fit in fits]
        values['load_friction'] = [fit.load_friction for fit in fits]
    if armature:
        values['armature'] = armature
    title = (
        'Friction, fitted to a recording: damping [N m s/rad, N s/m] and Coulomb friction '
        '[N m, N].'
    )
    pairs = zip(joint_names, fits, strict=True)
    unknown = {name: fit.unknown_because for name, fit in pairs if fit.unknown_because}
    return node_parameters([title], joint_names, unknown, values)
