"""
Fits damping, Coulomb friction and an offset to the residual efforts of one joint.

`fit_friction` ignores samples near zero speed, because dry friction can have any value there.
`fit_shape` also fits the speed over which Coulomb friction is smoothed, and friction that grows
with the load. This fit is accepted only if it clearly reduces the squared residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..columns import fit_nonnegative, friction_columns
from ..node_parameters import node_parameters

SURELY_MOVING = 3.0  # multiple of the smoothing width; tanh(3) is 0.995
LEAST_MOVING = 1.0  # [s] in each direction, to distinguish Coulomb friction from an offset
SPREAD = 1.5  # smallest ratio of speeds, to distinguish damping from Coulomb friction
WIDTHS = (0.02, 0.03, 0.05, 0.08, 0.12)  # [rad/s or m/s]
BETTER = 0.85  # another width or load friction must leave less than this fraction of the squares
MOST_LOAD = 0.5  # larger ratios of friction to load have another cause
BLOCKS = 12  # largest number of blocks for the estimate of standard errors


class FrictionFit(NamedTuple):
    """
    Friction and offset of a joint.

    The effort is ``damping * qd + (coulomb + load_friction * load) * tanh(qd / width) + offset``.
    """

    damping: float
    """Damping [N m s/rad or N s/m], or 0 if unknown."""
    coulomb: float
    """Coulomb friction [N m or N], or 0 if unknown."""
    offset: float
    """Constant offset of the effort [N m or N]."""
    damping_error: float
    """Standard error of ``damping``, or NaN if unknown."""
    coulomb_error: float
    offset_error: float
    unknown_because: str
    """Reason why friction is unknown. The text is empty if friction was fitted."""
    width: float = math.nan
    """Speed over which Coulomb friction is smoothed [rad/s or m/s], or NaN if not fitted."""
    load_friction: float = 0.0
    """Additional Coulomb friction per unit of ``load``, the size of the effort on the links."""

    @classmethod
    def unknown(cls, reason: str, offset: float = 0.0) -> FrictionFit:
        """Return a fit with unknown friction."""
        return cls(0.0, 0.0, offset, math.nan, math.nan, math.nan, reason)

    def friction(self, qd: Floats, direction: Floats) -> Floats:
        """Return viscous plus Coulomb friction for given velocities and smoothed directions."""
        return self.damping * qd + self.coulomb * direction

    @property
    def has_shape(self) -> bool:
        """Whether the width and the load friction were fitted."""
        return math.isfinite(self.width)


def is_moving(qd: Floats, width: float) -> Booleans:
    """Return a mask of the samples with enough speed for full Coulomb friction."""
    return np.asarray(np.abs(qd) > SURELY_MOVING * width)


def lacks_reversal(qd: Floats, period: float, width: float, least: float = LEAST_MOVING) -> str:
    """Return why a joint did not move fast and long enough in each direction, or '' if it did."""
    fast = SURELY_MOVING * width
    fastest = float(np.max(np.abs(qd)))
    if fastest <= fast:
        return (
            f'the largest speed of this joint was {fastest:.2g} rad/s or m/s, expected more than '
            f'{fast:g}'
        )
    forth, back = period * (qd > fast).sum(), period * (qd < -fast).sum()
    if min(forth, back) < least:
        return (
            f'this joint moved faster than {fast:g} rad/s or m/s for {forth:.2g} s forward and '
            f'{back:.2g} s backward, expected at least {least:g} s in each direction'
        )
    return ''


def obstacle(qd: Floats, period: float, width: float) -> str:
    """Return why a motion does not reveal friction, or '' if it does."""
    reason = lacks_reversal(qd, period, width)
    if reason:
        return reason
    speeds = np.abs(qd[is_moving(qd, width)])
    slow, quick = np.quantile(speeds, [0.05, 0.95])
    if quick < SPREAD * slow:
        return (
            f'the range of speeds from {slow:.2g} to {quick:.2g} rad/s or m/s is too narrow to '
            'distinguish damping from Coulomb friction'
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
    Fit nonnegative friction coefficients and an offset to the residual efforts of one joint.

    `direction` is ``tanh(qd / width)``, smoothed like the measured efforts. `period` is the
    sampling period [s], and `window` is the length of the smoothing window [samples].
    """
    reason = obstacle(qd, period, width)
    if reason:
        middle = float(np.median(residual))
        # The median contains friction if the joint moves in one direction most of the time.
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

    `fit` was made with the smoothing width `width` [rad/s or m/s]. Return `fit` unless another
    width or a load friction clearly reduces the squared residual. `residual`, shape (K,), is the
    measured effort minus the modelled effort without friction [N m or N]. `load`, shape (K,), is
    the magnitude of the modelled effort without friction and rotor effort [N m or N]. `smooth` is
    the filter that was applied to the measured efforts, and accepts columns of shape (K, c).
    `window` is the length of the smoothing window [samples].
    """
    if fit.unknown_because:
        return fit
    columns = {
        each: friction_columns(qd, each, load, smooth) for each in dict.fromkeys((width, *WIDTHS))
    }
    # A fit to the triangular factor equals a fit to all samples.
    triangles = {
        each: np.asarray(np.linalg.qr(np.column_stack([of, residual]), mode='r'))
        for each, of in columns.items()
    }
    squares, best, chosen = math.inf, np.zeros(4), width  # the first trial is always better
    for has_load in (False, True):
        for other, triangle in triangles.items():
            features = triangle[:, :-1] * [1.0, 1.0, has_load, 1.0]
            solution, left = fit_nonnegative(features, triangle[:, -1], [3])
            if left < BETTER * squares and solution[2] < MOST_LOAD:
                squares, best, chosen = left, solution, other
    damping, coulomb, per_load, offset = best.tolist()
    if chosen == width and per_load == 0.0:
        return fit
    unexplained = residual - columns[chosen] @ best
    every = np.ones(len(qd), dtype=bool)
    errors = standard_errors(columns[chosen][:, [0, 1, 3]], unexplained, every, window)
    return FrictionFit(damping, coulomb, offset, *errors, '', chosen, per_load)


def standard_errors(
    features: Floats, residual: Floats, moving: Booleans, window: int
) -> tuple[float, float, float]:
    """
    Estimate the standard errors of damping, Coulomb friction and offset.

    The estimate uses the differences between blocks of the recording. The formula for independent
    samples would give errors that are far too small, because smoothed samples and model errors are
    not independent.
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
    Return node parameters with the fitted friction, as YAML text.

    The node uses the friction of the URDF for joints with unknown friction. `width` is the speed
    over which Coulomb friction is smoothed if no width was fitted [rad/s or m/s]. `armature`
    contains the rotor inertia of each joint [kg m^2 or kg], or is empty.
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
        'Friction fitted to a recording: damping [N m s/rad, N s/m] and Coulomb friction [N m, N].'
    )
    pairs = zip(joint_names, fits, strict=True)
    unknown = {name: fit.unknown_because for name, fit in pairs if fit.unknown_because}
    return node_parameters([title], joint_names, unknown, values)
