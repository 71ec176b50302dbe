"""Causes that change the efforts of the whole robot, fitted to a few seconds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...robot.end_effector import last_link
from ...robot.model import Floats, RobotModel
from ..diagnosis.columns import gravity_columns, payload_columns
from .agreement import FaultKind
from .window import LiveSamples

MOST_STATES = 60
"""
States used by a fit; states that are closer in time differ little. Kernels for 64 states or more
may have to be compiled first, for which the display would stop.
"""
MIN_MASS = 0.05  # [kg]
MAX_DISTANCE = 0.6  # [m] of the centre of mass of a payload from its link
MIN_TILT = math.radians(5.0)
SAME_MAGNITUDE = (0.8, 1.25)  # gravity of another magnitude has another cause
WHOLE_WEIGHT = (0.75, 1.25)  # fraction of gravity that the driver compensates


class CandidateModel(NamedTuple):
    """A cause, and the efforts by which the measured ones exceed the model."""

    kind: FaultKind
    efforts: Floats
    """Shape (k, n) [N m or N]."""
    parameters: int
    values: tuple[float, ...] = ()
    link: str = ''


def candidate_models(
    samples: LiveSamples, residual: Floats, weights: Floats, robot: RobotModel, gravity: Floats
) -> list[CandidateModel]:
    """
    Fit a missing payload, a wrong direction of gravity, and gravity that the driver compensates.

    Parameters
    ----------
    samples : LiveSamples
        Samples of all n joints at k times.
    residual : ndarray, shape (k, n)
        Measured minus modelled efforts [N m or N].
    weights : ndarray, shape (n,)
        Inverse tolerances of the residual of the joints; 0 for joints that are not compared.
    robot : RobotModel
        The robot.
    gravity : ndarray, shape (3,)
        Gravity of the model in the frame of the root link [m/s^2].

    Returns
    -------
    candidates : list of CandidateModel
        Those whose parameters are plausible.

    """
    step = max(1, -(-len(samples.times) // MOST_STATES))
    some = slice(None, None, step)
    q: Floats = np.nan_to_num(samples.q)
    qd: Floats = np.nan_to_num(samples.qd)
    qdd: Floats = np.zeros_like(qd)
    if len(qd) > 1:
        qdd[:] = np.gradient(qd, samples.times, axis=0)
    states = q[some], qd[some], qdd[some]
    target, times, all_times = residual[some], samples.times[some], samples.times
    g = float(np.linalg.norm(gravity))
    if g == 0.0:  # the driver compensates gravity, and possibly that of payloads too
        return []

    def at_all_times(efforts: Floats) -> Floats:
        columns = [np.interp(all_times, times, column) for column in efforts.T]
        result: Floats = np.column_stack(columns)
        return result

    def fit(regressors: Floats) -> Floats:
        rows = (regressors * weights[:, None]).reshape(-1, regressors.shape[-1])
        return np.asarray(
            np.linalg.lstsq(rows, (target * weights).ravel(), rcond=1e-6)[0], dtype=np.float64
        )

    found = []
    weight = gravity_columns(robot, states[0])
    lacking = -(weight @ gravity)[..., None]
    (fraction,) = fit(lacking)
    if WHOLE_WEIGHT[0] < fraction < WHOLE_WEIGHT[1]:
        efforts = at_all_times(lacking[..., 0])
        found.append(CandidateModel(FaultKind.GRAVITY_COMPENSATED, efforts, 1))
    change = fit(weight)
    actual = gravity + change
    ratio = float(np.linalg.norm(actual)) / g
    cosine = float(actual @ gravity) / (ratio * g * g) if ratio else 1.0
    is_tilted = math.acos(min(1.0, max(-1.0, cosine))) > MIN_TILT
    if is_tilted and SAME_MAGNITUDE[0] < ratio < SAME_MAGNITUDE[1]:
        efforts = at_all_times(weight @ change)
        found.append(CandidateModel(FaultKind.MOUNTING, efforts, 3, tuple(actual.tolist())))
    link = last_link(robot)
    load = payload_columns(robot, gravity, link, states)
    for parameters in (1, 4):
        solution = fit(load[..., :parameters])
        mass = float(solution[0])
        distance = float(np.linalg.norm(solution[1:])) / max(abs(mass), 1e-9)
        if abs(mass) < MIN_MASS or distance > MAX_DISTANCE or mass < -float(np.sum(robot.mass)):
            continue
        efforts = at_all_times(load[..., :parameters] @ solution)
        found.append(CandidateModel(FaultKind.PAYLOAD, efforts, 1 + parameters, (mass,), link))
    return found
