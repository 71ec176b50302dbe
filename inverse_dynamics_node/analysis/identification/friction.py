"""
Friction of one joint, fitted to what the model leaves: damping, Coulomb friction and an offset.

Near zero speed dry friction is anything up to its full value, whatever a formula says: samples
from there are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats

SURELY_MOVING = 3.0  # widths: there tanh has 99.5 % of its end value
LEAST_MOVING = 1.0  # [s] each way, or Coulomb friction cannot be told from an offset
SPREAD = 1.5  # largest over smallest speed, or damping cannot be told from Coulomb friction
BLOCKS = 12  # the recording is cut in so many to see how much the fit depends on which


class FrictionFit(NamedTuple):
    """Friction of one joint: ``damping * qd + coulomb * tanh(qd / width)``, and an offset."""

    damping: float
    """[N m s/rad or N s/m]; 0 where it cannot be told."""
    coulomb: float
    """[N m or N]; 0 where it cannot be told."""
    offset: float
    """[N m or N]."""
    damping_error: float
    """Standard error of ``damping``, the dependence of neighbouring samples included."""
    coulomb_error: float
    offset_error: float
    cannot_tell: str
    """Why nothing can be said of this joint's friction; empty if something can."""

    @classmethod
    def unknown(cls, reason: str, offset: float = 0.0) -> FrictionFit:
        """Return a fit that cannot tell."""
        return cls(0.0, 0.0, offset, math.nan, math.nan, math.nan, reason)

    def efforts(self, qd: Floats, direction: Floats) -> Floats:
        """Return friction and offset, at speeds and their smoothed directions."""
        efforts: Floats = self.damping * qd + self.coulomb * direction + self.offset
        return efforts


def is_moving(qd: Floats, width: float) -> Booleans:
    """Tell where a joint surely slides, by its speeds, so that dry friction has one value."""
    return np.asarray(np.abs(qd) > SURELY_MOVING * width)


def why_not(qd: Floats, period: float, width: float) -> str:
    """Say what keeps a motion from telling friction; nothing if it does not."""
    fast = SURELY_MOVING * width
    fastest = float(np.max(np.abs(qd)))
    if fastest <= fast:
        return f'it was never faster than {fastest:.2g}, expected more than {fast:g}'
    forth, back = period * (qd > fast).sum(), period * (qd < -fast).sum()
    if min(forth, back) < LEAST_MOVING:
        return (
            f'it moved {forth:.2g} s forth and {back:.2g} s back, expected {LEAST_MOVING:g} s each'
        )
    speeds = np.abs(qd[is_moving(qd, width)])
    slow, quick = np.quantile(speeds, [0.05, 0.95])
    if quick < SPREAD * slow:
        return f'its speed was {slow:.2g} to {quick:.2g}: damping and Coulomb friction look alike'
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
    Fit friction and an offset to the efforts that the model leaves.

    Parameters
    ----------
    qd : ndarray, shape (K,)
        Speeds of the joint [rad/s or m/s].
    direction : ndarray, shape (K,)
        ``tanh(qd / width)``, smoothed as the measured efforts are.
    residual : ndarray, shape (K,)
        Measured minus modelled effort, friction out of the model [N m or N].
    period : float
        Time between samples [s].
    window : int
        Samples that were smoothed over.
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s].

    Returns
    -------
    fit : FrictionFit
        Neither damping nor Coulomb friction below zero.

    """
    from scipy.optimize import nnls

    reason = why_not(qd, period, width)
    if reason:
        return FrictionFit.unknown(reason, float(np.median(residual)))
    moving = is_moving(qd, width)
    features = np.column_stack([qd, direction, np.ones_like(qd)])[moving]
    # Offsets may be negative: two columns for one number.
    both = np.column_stack([features, -features[:, 2]])
    scale = np.linalg.norm(both, axis=0)
    samples = np.column_stack([both / scale, residual[moving]])
    triangle = np.asarray(np.linalg.qr(samples, mode='r'))
    solution = nnls(triangle[:, :-1], triangle[:, -1])[0] / scale
    fit = np.array([solution[0], solution[1], solution[2] - solution[3]])
    errors = _standard_errors(features, residual[moving] - features @ fit, moving, window)
    damping, coulomb, offset = fit.tolist()
    return FrictionFit(damping, coulomb, offset, *errors, '')


def _standard_errors(
    features: Floats, left: Floats, moving: Booleans, window: int
) -> tuple[float, float, float]:
    """
    Estimate standard errors from how differently blocks of the recording pull at the fit.

    Smoothed samples are not independent, and neither is what a model lacks: counting samples
    would promise far too much.

    """
    blocks = int(min(BLOCKS, max(2, len(moving) // (2 * window))))
    block = (np.flatnonzero(moving) * blocks) // len(moving)
    bread = np.linalg.pinv(features.T @ features)
    pulls = np.array([features[block == b].T @ left[block == b] for b in range(blocks)])
    free = max(blocks - features.shape[1], 1)
    meat = pulls.T @ pulls * blocks / free
    variances = np.maximum(np.diagonal(bread @ meat @ bread), 0.0)
    damping, coulomb, offset = np.sqrt(variances).tolist()
    return damping, coulomb, offset


def friction_parameters(
    joint_names: Sequence[str], fits: Sequence[FrictionFit], width: float
) -> str:
    """
    Write friction as parameters of the node, in YAML.

    Parameters
    ----------
    joint_names : sequence of str
        The joints, in the order of the lists.
    fits : sequence of FrictionFit
        One for each; where one cannot tell, the node is to use the friction of the URDF.
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s].

    Returns
    -------
    text : str
        For ``--ros-args --params-file``.

    """
    unknown = [
        f'# {name}: cannot tell, {fit.cannot_tell}; -1.0 is the friction of the URDF.'
        for name, fit in zip(joint_names, fits, strict=True)
        if fit.cannot_tell
    ]
    damping = ', '.join(_number(-1.0 if fit.cannot_tell else fit.damping) for fit in fits)
    coulomb = ', '.join(_number(-1.0 if fit.cannot_tell else fit.coulomb) for fit in fits)
    names = ', '.join("'" + name.replace("'", "''") + "'" for name in joint_names)
    lines = [
        '# Friction, fitted to a recording: damping [N m s/rad, N s/m] and Coulomb friction '
        '[N m, N].',
        *unknown,
        '/**:',
        '  ros__parameters:',
        f'    joints: [{names}]',
        '    include_friction: true',
        f'    damping: [{damping}]',
        f'    coulomb: [{coulomb}]',
        f'    coulomb_width: {_number(width)}',
    ]
    return '\n'.join(lines) + '\n'


def _number(value: float) -> str:
    """Write a number with a decimal point, which tells ROS that a list is one of decimals."""
    text = f'{value:.5g}'
    if 'e' in text:
        mantissa, exponent = text.split('e')
        return f'{mantissa if "." in mantissa else mantissa + ".0"}e{exponent}'
    return text if '.' in text else text + '.0'
