"""Conversion of arguments to arrays; error messages contain the argument's name and value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigurationError, JointStateError, plain
from ..robot.model import Floats, RobotModel
from ..robot.rigid_body import RigidBody
from .batch import LANES
from .jit import OK

_LARGEST_PAYLOAD = 1e9  # [kg], [m], [kg m^2]; sums and products of smaller numbers are finite
_ROUNDING = 1e-3  # permitted rounding error of principal moments, relative to their sum
Computation = Callable[[Sequence[Floats], Floats], int]
"""Takes the arrays of N states, and the array for N results; returns a status code."""


def over_states(
    robot: RobotModel,
    kind: tuple[int, ...],
    one: Callable[..., int],
    out: Floats | None,
    many: Computation | None = None,
    **arguments: ArrayLike,
) -> Floats:
    """
    Compute a quantity for one or more states; return an array of shape (..., *kind).

    The ``arguments``, such as ``q``, may have any type that numpy can convert. ``kind`` is the
    shape of the result for one state. ``one`` takes the arrays of one state and the array for the
    result, and returns a status code. ``many`` replaces ``one`` for at least `batch.LANES` states.
    If ``out`` is given, the result is written to ``out``. Wrong shapes and non-finite values raise
    a JointStateError.

    """
    state = tuple(arguments.values())
    try:
        if state[0].ndim == 1:  # type: ignore[union-attr]
            result = np.empty(kind) if out is None else out
            # After a failure, the code below finds the cause.
            if one(*state, result) == OK:
                return result
    except (AttributeError, TypeError, ValueError):  # lists, integers, views with strides
        pass
    rows, shape = broadcast(len(robot.joint_names), **arguments)
    shape = (*shape[:-1], *kind)
    if out is not None:
        check_out(out, shape)
    result = np.empty(shape) if out is None or not is_free(out, rows) else out
    flat = result.reshape(len(rows[0]), *kind)
    if many is not None and robot.joint_names and len(flat) >= LANES:
        status = many(rows, flat)
    else:
        status = max(map(one, *rows, flat), default=OK)
    if status != OK:
        raise explain(robot.joint_names, **arguments)
    if out is None or result is out:
        return result
    out[...] = result
    return out


def read_vectors(name: str, values: ArrayLike, n: int) -> Floats:
    """Convert values to a float64 array of shape (..., n)."""
    try:
        found = np.asarray(values)
    except ValueError as error:
        raise JointStateError(f'{name} is not an array of numbers: {error}') from None
    if found.dtype.kind not in 'fiub':
        raise JointStateError(f'{name} is an array of {found.dtype}, expected real numbers')
    # The compiled functions accept only contiguous, writable arrays; other arrays are copied.
    is_accepted = found.dtype == np.float64 and found.flags.carray
    vectors = found if is_accepted else np.require(found, np.float64, ['C', 'W'])
    if vectors.shape[-1:] != (n,):
        raise JointStateError(f'{name} has shape {vectors.shape}, but the robot has {n} joints')
    return vectors


def broadcast(n: int, **arguments: ArrayLike) -> tuple[list[Floats], tuple[int, ...]]:
    """Broadcast arguments; return arrays with one row per state, and the broadcast shape."""
    vectors = [read_vectors(name, values, n) for name, values in arguments.items()]
    try:
        shape = np.broadcast_shapes(*(vector.shape for vector in vectors))
    except ValueError:
        shapes = ', '.join(str(vector.shape) for vector in vectors)
        names = ', '.join(arguments)
        raise JointStateError(
            f'{names} have shapes {shapes}, which cannot be broadcast together'
        ) from None
    return [_rows(vector, shape) for vector in vectors], shape


def _rows(vectors: Floats, shape: tuple[int, ...]) -> Floats:
    if vectors.shape != shape:
        vectors = np.array(np.broadcast_to(vectors, shape), order='C')
    return vectors.reshape(math.prod(shape[:-1]), shape[-1])


def explain(joint_names: Sequence[str], **arguments: ArrayLike) -> JointStateError:
    """Return an error that explains a non-finite result; raise an error if a shape is wrong."""
    n = len(joint_names)
    for name, values in arguments.items():
        vectors = read_vectors(name, values, n)
        bad = np.argwhere(~np.isfinite(vectors))
        if len(bad):
            where = tuple(int(index) for index in bad[0])
            sample = f' (sample {where[:-1]})' if where[:-1] else ''
            joint = joint_names[where[-1]]
            return JointStateError(f"{name} of joint '{joint}' is {vectors[where]}{sample}")
    return JointStateError(
        'the result overflows because a position, velocity or acceleration is too large'
    )


def check_out(out: Floats, shape: tuple[int, ...]) -> None:
    """Raise a JointStateError if an array cannot hold a result of the given shape."""
    if not isinstance(out, np.ndarray) or out.dtype != np.float64 or not out.flags.writeable:
        kind = out.dtype if isinstance(out, np.ndarray) else type(out).__name__
        raise JointStateError(f'out has type {kind}, expected a writable array of float64')
    if out.shape != shape:
        raise JointStateError(f'out has shape {out.shape}, expected {shape}')


def is_free(out: Floats, others: Sequence[Floats]) -> bool:
    """Return whether ``out`` is contiguous and shares no memory with an input."""
    return out.flags.c_contiguous and not any(np.may_share_memory(out, x) for x in others)


def read_joints(name: str, values: ArrayLike, n: int, is_signed: bool = False) -> Floats:
    """Convert one or n numbers to an array of shape (n,); refuse negative numbers by default."""
    try:
        numbers = np.broadcast_to(np.asarray(values, dtype=np.float64), (n,))
    except (TypeError, ValueError):
        raise ConfigurationError(
            f'{name} is {plain(values)!r}, expected one number, or one for each of {n} joints'
        ) from None
    if not (np.isfinite(numbers) & (is_signed | (numbers >= 0.0))).all():
        least = '' if is_signed else ' of at least 0'
        raise ConfigurationError(f'{name} is {plain(values)!r}, expected finite numbers{least}')
    return numbers


def read_vector(name: str, values: ArrayLike, unit: str) -> Floats:
    """Convert a sequence of three finite numbers to an array."""
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigurationError(
            f'{name} is {plain(values)!r}, expected three finite numbers [{unit}]'
        )
    return vector


def read_inertial(mass: float, com: ArrayLike, inertia: ArrayLike) -> tuple[float, Floats, Floats]:
    """Convert and check the mass, centre of mass and inertia of a rigid body."""
    try:
        number, moments = float(mass), np.array(inertia, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigurationError(
            f'mass is {plain(mass)!r} and inertia is {plain(inertia)!r}, expected numbers'
        ) from None
    if not (math.isfinite(number) and number >= 0.0):
        raise ConfigurationError(
            f'mass is {plain(mass)!r}, expected a finite number of at least 0 [kg]'
        )
    if moments.shape != (3, 3) or not np.isfinite(moments).all():
        raise ConfigurationError(f'inertia is {plain(inertia)!r}, expected a finite 3 by 3 matrix')
    # The tolerances are fractions of the largest element, because rotations cause rounding errors.
    largest = np.abs(moments).max()
    if np.abs(moments - moments.T).max() > 1e-6 * largest:
        raise ConfigurationError(f'inertia is {plain(inertia)!r}, expected a symmetric matrix')
    if np.min(np.linalg.eigvalsh(moments)) < -1e-9 * largest:
        raise ConfigurationError(
            f'inertia is {plain(inertia)!r}, expected no negative principal moment'
        )
    return number, read_vector('com', com, 'm'), moments


def read_payload(mass: float, com: ArrayLike, inertia: ArrayLike) -> RigidBody:
    """
    Convert and check a payload that comes from outside.

    A ConfigurationError is raised if no rigid body can have this mass and inertia, or if a number
    is larger than 1e9.

    """
    payload = RigidBody(*read_inertial(mass, com, inertia))
    largest = max(
        payload.mass, float(np.abs(payload.com).max()), float(np.abs(payload.inertia).max())
    )
    if largest > _LARGEST_PAYLOAD:
        raise ConfigurationError(
            f'a value of the payload (mass, centre of mass or inertia) is {largest:g}, expected '
            f'at most {_LARGEST_PAYLOAD:g} kg, m or kg m^2'
        )
    principal = np.linalg.eigvalsh(payload.inertia)
    if payload.mass and principal[0] + principal[1] < principal[2] - _ROUNDING * np.sum(principal):
        moments = ', '.join(f'{moment:.3g}' for moment in principal)
        raise ConfigurationError(
            'the inertia of the payload is physically impossible: one of the principal moments '
            f'({moments} kg m^2) exceeds the sum of the others'
        )
    return payload
