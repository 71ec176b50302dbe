"""
Fits damping, Coulomb friction and an offset to the efforts of one joint that the model leaves.

Near zero speed dry friction can have any value up to its maximum: such samples are not used. How
wide the step of Coulomb friction is, and how it grows with the load, is accepted only if it
explains far more than a narrow step without load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..columns import fit_nonnegative, friction_columns
from ..node_parameters import node_parameters

SURELY_MOVING = 3.0  # widths; at this speed tanh has 99.5 % of its final value
LEAST_MOVING = 1.0  # [s] in each direction, to distinguish Coulomb friction from an offset
SPREAD = 1.5  # largest over smallest speed, to distinguish damping from Coulomb friction
WIDTHS = (0.02, 0.03, 0.05, 0.08, 0.12)  # [rad/s or m/s]
BETTER = 0.85  # fraction of the squares that a width or the load must leave at most
MOST_LOAD = 0.5  # larger ratios of friction to load are another cause
BLOCKS = 12  # parts of the recording whose differences give the standard errors


class FrictionFit(NamedTuple):
    """Friction of one joint: ``damping * qd + coulomb * tanh(qd / width)``, and an offset."""

    damping: float
    """[N m s/rad or N s/m]; 0 if unknown."""
    coulomb: float
    """[N m or N]; 0 if unknown."""
    offset: float
    """[N m or N]."""
    damping_error: float
    """Standard error of ``damping``, for dependent samples."""
    coulomb_error: float
    offset_error: float
    unknown_because: str
    """Why the friction of this joint cannot be identified; empty if it was fitted."""
    width: float = math.nan
    """Speed over which Coulomb friction is smoothed, if it was fitted [rad/s or m/s]."""
    load_friction: float = 0.0
    """Increase of Coulomb friction per magnitude of the effort that moves the links."""

    @classmethod
    def unknown(cls, reason: str, offset: float = 0.0) -> FrictionFit:
        """Return a fit without friction, and the reason."""
        return cls(0.0, 0.0, offset, math.nan, math.nan, math.nan, reason)

    def efforts(self, qd: Floats, direction: Floats) -> Floats:
        """Return the efforts of friction and offset for velocities and smoothed directions."""
        efforts: Floats = self.damping * qd + self.coulomb * direction + self.offset
        return efforts

    @property
    def has_shape(self) -> bool:
        """Whether width or load friction was fitted."""
        return math.isfinite(self.width)


def is_moving(qd: Floats, width: float) -> Booleans:
    """Return where a joint moves fast enough for dry friction to have its full value."""
    return np.asarray(np.abs(qd) > SURELY_MOVING * width)


def lacks_reversal(qd: Floats, period: float, width: float, least: float = LEAST_MOVING) -> str:
    """Return why a joint did not move long enough in both directions; empty if it did."""
    fast = SURELY_MOVING * width
    fastest = float(np.max(np.abs(qd)))
    if fastest <= fast:
        return f'it was never faster than {fastest:.2g}, expected more than {fast:g}'
    forth, back = period * (qd > fast).sum(), period * (qd < -fast).sum()
    if min(forth, back) < least:
        return (
            f'it moved forward for {forth:.2g} s and back for {back:.2g} s, expected '
            f'{least:g} s each'
        )
    return ''


def obstacle(qd: Floats, period: float, width: float) -> str:
    """Return why friction cannot be identified from a motion; empty if it can."""
    reason = lacks_reversal(qd, period, width)
    if reason:
        return reason
    speeds = np.abs(qd[is_moving(qd, width)])
    slow, quick = np.quantile(speeds, [0.05, 0.95])
    if quick < SPREAD * slow:
        return (
            f'its speed was always between {slow:.2g} and {quick:.2g}, which does not distinguish '
            'damping from Coulomb friction'
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

    The direction is ``tanh(qd / width)``, smoothed over the window [samples] as the measured
    efforts were. Neither damping nor Coulomb friction is negative.

    """
    reason = obstacle(qd, period, width)
    if reason:
        middle = float(np.median(residual))
        # Where friction acts in one direction most of the time, the median is part of it.
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
    Fit the width of the step and the friction per load to all samples of a joint.

    Parameters
    ----------
    fit : FrictionFit
        Friction with the common width.
    qd : ndarray, shape (K,)
        Velocities of the joint [rad/s or m/s].
    residual : ndarray, shape (K,)
        Measured minus modelled effort without friction [N m or N].
    load : ndarray, shape (K,)
        Magnitude of the modelled effort without friction and rotor [N m or N].
    smooth : callable
        Smooths columns of shape (K, c) in the same way as the measured efforts.
    width : float
        Common width [rad/s or m/s].
    window : int
        Number of samples of the smoothing window.

    Returns
    -------
    fit : FrictionFit
        The given one if another shape does not explain far more.

    """
    if fit.unknown_because:
        return fit
    columns = {
        each: friction_columns(qd, each, load, smooth) for each in dict.fromkeys((width, *WIDTHS))
    }
    triangles = {each: _triangle(of, residual) for each, of in columns.items()}
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


def _triangle(columns: Floats, residual: Floats) -> Floats:
    """Return rows that lead to the same least-squares fits as all samples."""
    return np.asarray(np.linalg.qr(np.column_stack([columns, residual]), mode='r'))


def _with_load(
    triangle: Floats, has_load: bool
) -> tuple[float, tuple[float, float, float, float]]:
    """Return the remaining sum of squares, and damping, Coulomb, load friction and offset."""
    columns = triangle[:, :-1] * [1.0, 1.0, has_load, 1.0]
    factors, left = fit_nonnegative(columns, triangle[:, -1], [3])
    damping, coulomb, per_load, offset = factors.tolist()
    return left, (damping, coulomb, per_load, offset)


def standard_errors(
    features: Floats, residual: Floats, moving: Booleans, window: int
) -> tuple[float, float, float]:
    """
    Estimate standard errors from the differences between blocks of the recording.

    Smoothed samples are not independent, and neither are the errors of the model: the formula for
    independent samples would give far too small errors.

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
    Return friction as parameters of the node, in YAML.

    Parameters
    ----------
    joint_names : sequence of str
        The joints, in the order of the lists.
    fits : sequence of FrictionFit
        One per joint; for an unknown friction, the node uses that of the URDF.
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s], unless it was fitted.
    armature : sequence of float
        Rotor inertia of each joint [kg m^2, kg]; empty if none was found.

    Returns
    -------
    text : str
        For ``--ros-args --params-file``.

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
