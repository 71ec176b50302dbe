"""
Reduces the samples of a joint to a triangular factor, so that fits are fast.

A *sensor fault* of a joint is a wrong sign, a wrong scale or an offset of the measured effort, or
a rotor inertia that the model lacks. The *floor* of a joint is the fraction of the squared effort
that needs no explanation, because model errors and noise have this size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats
from ..columns import fit_nonnegative, gravity_columns, payload_columns

PARAMETER_COST = math.log(2.0)
"""Cost of a parameter. A parameter must at least halve the squared residual."""
FLOOR = 0.03  # accuracy of models, as a fraction of a joint's RMS effort
NOISE_FLOOR = 2.0  # RMS residuals below this multiple of the noise need no explanation
SAME_SCALE = (0.8, 1.25)  # factors in this range are model errors, not another unit
CREDIBLE = 0.3  # a credible fit leaves less than this fraction of the squared effort
FRICTION_ONLY = 0.01  # tolerance for a fit of friction alone, as a fraction of the squared effort
MIN_OFFSET = 0.05  # least offset, as a fraction of a joint's RMS effort
FRICTION = 0.03  # Coulomb friction above this fraction of a joint's RMS effort is considerable
MIN_VARIATION = 0.1  # a factor is fitted if the modelled effort varies by more than this fraction
MODEL, GRAVITY, WEIGHT, ACCELERATION, SPEED, DIRECTION, ONE, LOADS = 0, 1, 2, 5, 6, 7, 8, 9
"""
Column indices of joint samples. `WEIGHT` is the first of three columns with the efforts per
1 m/s^2 of gravity along x, y and z. `DIRECTION` is the smoothed direction of motion, and `ONE` is
a column of ones. `LOADS` is the first column for payloads. The last columns are the measured
efforts of all joints.
"""


class SensorFault(NamedTuple):
    """A combination of sensor faults of one joint."""

    is_swapped: bool = False
    is_scaled: bool = False
    has_rotor: bool = False
    """Whether the model lacks the rotor inertia of the joint."""
    has_offset: bool = False

    @property
    def parameters(self) -> int:
        """Number of parameters. A wrong scale is counted twice, because wrong scales are rare."""
        return sum(self) + self.is_scaled

    @property
    def sign(self) -> int:
        """Sign of the measured effort relative to the actual effort."""
        return -1 if self.is_swapped else 1


NO_FAULT = SensorFault()
ANOTHER_UNIT = SensorFault(is_scaled=True)
SENSOR_FAULTS = tuple(SensorFault(*flags) for flags in product((False, True), repeat=4))


class JointFit(NamedTuple):
    """Friction and sensor faults, fitted to the effort of one joint."""

    sensor_fault: SensorFault
    cost: float
    remaining: float
    """Fraction of the squared measured effort that the fit does not explain."""
    moves: bool = True
    """Whether the joint moved enough to identify its friction."""
    is_friction_only: bool = False
    """Whether friction alone explains the effort, so that sign and unit are unknown."""
    rms: float = 0.0
    """RMS of the residual, in the unit of the recorded effort."""
    damping: float = 0.0
    """Damping [N m s/rad or N s/m]."""
    coulomb: float = 0.0
    """Coulomb friction [N m or N]."""
    has_friction: bool = False
    """Whether Coulomb friction is considerable compared with the effort."""
    scale: float = 1.0
    rotor: float = 0.0
    """Rotor inertia [kg m^2 or kg]."""
    offset: float = 0.0
    """Offset of the effort, in the unit of the model [N m or N]."""

    def friction(self, qd: Floats, direction: Floats) -> Floats:
        """Return the friction at the given velocities and smoothed directions of motion."""
        return self.damping * qd + self.coulomb * direction


def unexplained_fraction(
    remaining: Sequence[float], squares: Sequence[float], is_prismatic: Sequence[bool]
) -> float:
    """Return the unexplained fraction of the squared efforts, averaged over both joint types."""
    left, whole = {False: 0.0, True: 0.0}, {False: 0.0, True: 0.0}
    for part, square, kind in zip(remaining, squares, is_prismatic, strict=True):
        left[kind] += part
        whole[kind] += square
    fractions = [left[kind] / whole[kind] for kind in whole if whole[kind]]
    return float(np.mean(fractions)) if fractions else math.nan


@dataclass
class JointSamples:
    """Samples of one joint, reduced to the triangular factor of a QR decomposition."""

    columns: Floats
    """Columns of K samples, shape (K, p)."""
    times: Floats
    """Times of the samples, shape (K,) [s]."""
    moves: bool
    """Whether friction and offsets can be identified."""
    noise: float = 0.0
    """Standard deviation of the noise of the effort [N m or N]."""
    is_prismatic: bool = False
    triangle: Floats = field(init=False)
    """Triangular factor of the samples, shape (p, p)."""
    squares: Floats = field(init=False)
    """Mean square of each column, shape (p,)."""

    def __post_init__(self) -> None:
        triangle: Floats = np.asarray(np.linalg.qr(self.columns, mode='r'))
        self.triangle = triangle / math.sqrt(len(self.columns))
        self.squares = np.sum(self.triangle**2, axis=0)

    @property
    def shows_scale(self) -> bool:
        """Whether the modelled effort varies enough to fit a scale to this joint alone."""
        mean = float(self.triangle[:, MODEL] @ self.triangle[:, ONE])
        variance = float(self.squares[MODEL]) - mean**2
        return self.moves or variance > MIN_VARIATION**2 * float(self.squares[MODEL])

    def without_friction(self, columns: Floats) -> Floats:
        """Project the friction columns out of the given columns of the triangular factor."""
        if not self.moves:
            return columns
        Q = np.linalg.qr(self.triangle[:, [SPEED, DIRECTION]])[0]
        return np.asarray(columns - Q @ (Q.T @ columns))

    def floor(self, measured: int) -> float:
        """Return the fraction of the squared effort that needs no explanation."""
        return float(FLOOR**2 + (NOISE_FLOOR * self.noise) ** 2 / self.squares[measured])

    def fit(
        self, weights: Floats, measured: int, sensor_fault: SensorFault, unit: float = 1.0
    ) -> JointFit:
        """
        Divide the column `measured` by `unit`, and fit friction and `sensor_fault` to it.

        The modelled effort is the sum of the first columns, each multiplied by its weight.
        """
        R = self.triangle
        model = R[:, : len(weights)] @ weights
        target = sensor_fault.sign / unit * R[:, measured]
        columns = [SPEED, DIRECTION] if self.moves else []
        columns += [ACCELERATION] if sensor_fault.has_rotor else []
        columns += [ONE] if sensor_fault.has_offset else []
        features = R[:, columns]
        if sensor_fault.is_scaled:
            features = np.column_stack([features, model])
        else:
            target = target - model
        signed = [columns.index(ONE)] if sensor_fault.has_offset else []
        solution, left = fit_nonnegative(features, target, signed)
        values = dict(zip(columns, solution[: len(columns)].tolist(), strict=True))
        squares = float(self.squares[measured]) / unit**2
        remaining = left / squares
        cost = (
            math.log(remaining + self.floor(measured)) + PARAMETER_COST * sensor_fault.parameters
        )
        scale = float(solution[-1]) if sensor_fault.is_scaled else 1.0
        per_scale = scale or 1.0
        coulomb = values.get(DIRECTION, 0.0)
        return JointFit(
            sensor_fault,
            cost,
            remaining,
            self.moves,
            scale=scale,
            rotor=values.get(ACCELERATION, 0.0) / per_scale,
            offset=values.get(ONE, 0.0) / per_scale,
            rms=math.sqrt(remaining * squares) * unit,
            damping=values.get(SPEED, 0.0) / per_scale,
            coulomb=coulomb / per_scale,
            has_friction=coulomb > FRICTION * math.sqrt(squares),
        )

    def best_fit(self, weights: Floats, measured: int, unit: float = 1.0) -> JointFit:
        """Return the most credible fit, with or without a sensor fault."""
        rms = math.sqrt(self.squares[measured]) / unit
        best = self.fit(weights, measured, NO_FAULT, unit)
        is_explained = best.remaining < self.floor(measured)
        possible = () if is_explained else self._possible_faults(weights, measured, unit)
        for sensor_fault, least in possible:
            least_cost = math.log(least + self.floor(measured))
            if least_cost + PARAMETER_COST * sensor_fault.parameters > best.cost:
                continue
            fit = self.fit(weights, measured, sensor_fault, unit)
            is_small = abs(fit.offset * fit.scale) < MIN_OFFSET * rms
            is_credible = (
                fit.cost < best.cost
                and fit.remaining < CREDIBLE
                and not self._is_arbitrary(measured, fit)
                and not (sensor_fault.is_scaled and SAME_SCALE[0] < fit.scale < SAME_SCALE[1])
                and not (sensor_fault.has_offset and is_small)
            )
            best = fit if is_credible else best
        is_friction_only = not best.sensor_fault.is_scaled and self._needs_no_model(
            measured, best.sensor_fault, best.remaining, FRICTION_ONLY
        )
        return best._replace(is_friction_only=is_friction_only)

    def _possible_faults(
        self, weights: Floats, measured: int, unit: float
    ) -> Iterator[tuple[SensorFault, float]]:
        """Yield possible sensor faults, each with a lower bound of the unexplained fraction."""
        has_scale = unit == 1.0 and self.shows_scale
        for is_swapped in (False, True):
            every = SensorFault(is_swapped, has_scale, self.moves, self.moves)
            # A fit with fewer parameters cannot leave less, so this bound avoids many slow fits.
            least = self.fit(weights, measured, every, unit).remaining
            if least < CREDIBLE:
                for sensor_fault in SENSOR_FAULTS[1:]:
                    is_part = all(a <= b for a, b in zip(sensor_fault, every, strict=True))
                    if sensor_fault.is_swapped == is_swapped and is_part:
                        yield sensor_fault, least

    def _is_arbitrary(self, measured: int, fit: JointFit) -> bool:
        """Return whether a model-free fit shows that the scale or sign of `fit` is arbitrary."""
        fault = fit.sensor_fault
        unscaled = fault._replace(is_scaled=False)
        if fault.is_scaled and self._needs_no_model(measured, unscaled, fit.remaining):
            return True
        # Friction that accelerates the joint reveals a wrong sign even without the model.
        upright = unscaled._replace(is_swapped=False)
        return fault.is_swapped and self._needs_no_model(measured, upright, fit.remaining)

    def _needs_no_model(
        self,
        measured: int,
        sensor_fault: SensorFault,
        remaining: float,
        tolerance: float = FLOOR**2,
    ) -> bool:
        """Return whether a model-free fit leaves little more than `remaining` unexplained."""
        without = self.fit(np.zeros(1), measured, sensor_fault).remaining
        return without <= 2.0 * remaining + tolerance


def sample_joints(
    dynamics: InverseDynamics,
    times: Floats,
    states: tuple[Floats, Floats, Floats],
    links: Sequence[str],
    joints: Sequence[int],
    *,
    measured: Floats,
    modelled: Floats,
    gravity: Floats,
    direction: Floats,
    used: Sequence[Booleans],
    moves: Sequence[bool],
    noise: Floats,
) -> list[JointSamples]:
    """
    Return the samples of c joints at K times, with columns for loads on the given links.

    `joints` contains indices in ``robot.joint_names``. `measured`, `modelled` and `gravity` are
    efforts, and `direction` is the smoothed direction of motion, each of shape (K, c). The
    modelled efforts exclude the friction that will be fitted. `used` contains one mask per joint,
    which selects the compared samples. `moves` says whether the friction of each joint can be
    identified. `noise` is the standard deviation of the noise of the efforts, shape (c,)
    [N m or N].
    """
    robot = dynamics.robot
    q, qd, qdd = states
    weight = gravity_columns(robot, q)
    loads = [payload_columns(robot, dynamics.gravity, link, states) for link in links]
    samples = []
    for c, i in enumerate(joints):
        columns = np.column_stack(
            [
                modelled[:, c],
                gravity[:, c],
                weight[:, i],
                qdd[:, i],
                qd[:, i],
                direction[:, c],
                np.ones(len(q)),
                *(load[:, i] for load in loads),
                measured,
            ]
        )
        own, is_prismatic = used[c], bool(robot.is_prismatic_joint[i])
        samples.append(
            JointSamples(columns[own], times[own], moves[c], float(noise[c]), is_prismatic)
        )
    return samples
