"""The terms of the efforts of one state: inertial, velocity, gravity, friction, external."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..robot.model import Floats
from .columns import (
    ARMATURE,
    EXTERNAL_FORCE,
    EXTERNAL_MOMENT,
    friction_of,
    JOINT_COUNT,
    OMEGA,
    OMEGA_DOT,
    vector,
)
from .equations import Vector
from .jit import compiled, simd_inline
from .newton_euler import (
    check,
    clear,
    gravity_efforts,
    inverse_dynamics,
    joint_friction,
    NOT_FINITE,
    OK,
    WRONG_SIZE,
)


class EffortTerms(NamedTuple):
    """Terms of the joint efforts, each of shape (..., n) [N m or N]; their sum is the effort."""

    inertial: Floats
    """M(q) qdd, including armature."""
    velocity: Floats
    """C(q, qd) qd: Coriolis and centrifugal efforts, including those of a rotating base."""
    gravity: Floats
    """g(q), and the efforts due to the acceleration and rotation of the base."""
    friction: Floats
    """Viscous and Coulomb friction, including the part that grows with the load."""
    external: Floats
    """Minus the efforts that the external wrenches exert."""


@compiled
def effort_terms(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    state: Any,
    inertial: Any,
    velocity: Any,
    gravity: Any,
    external: Any,
    terms: Any,
    robot: Any,
) -> int:
    """
    Compute the terms of the efforts.

    Parameters
    ----------
    q, qd, qdd, robot
        As for `newton_euler.inverse_dynamics`.
    state : 4 sequences of n floats
        Scratch space; the last row is zero.
    inertial, velocity, gravity, external : tables
        Tables with these terms only, from `TermTables`.
    terms : 5 sequences of n floats
        Receives the terms in the order of `EffortTerms`; may share memory with q, qd and qdd.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(qd) != n or len(qdd) != n:
        return WRONG_SIZE
    if len(terms) != 5 or len(terms[0]) != n:
        return WRONG_SIZE
    for joint in range(n):
        state[0][joint], state[1][joint], state[2][joint] = q[joint], qd[joint], qdd[joint]
    q, qd, qdd, rest = state[0], state[1], state[2], state[3]
    status = inverse_dynamics(q, rest, qdd, terms[0], inertial)
    status = max(status, inverse_dynamics(q, qd, rest, terms[1], velocity))
    if any_of(vector(gravity[0], OMEGA)) or any_of(vector(gravity[0], OMEGA_DOT)):
        # Efforts due to the rotation of the base alone are part of the gravity term.
        status = max(status, inverse_dynamics(q, rest, rest, terms[2], velocity))
        for joint in range(n):
            terms[1][joint] -= terms[2][joint]
        status = max(status, inverse_dynamics(q, rest, rest, terms[2], gravity))
    else:
        status = max(status, gravity_efforts(q, terms[2], gravity))
    clear(terms[4])
    for i in range(1, len(external)):
        row = external[i]
        if any_of(vector(row, EXTERNAL_FORCE)) or any_of(vector(row, EXTERNAL_MOMENT)):
            status = max(status, inverse_dynamics(q, rest, rest, terms[4], external))
            break
    friction_terms(qd, qdd, terms[0], terms[1], terms[2], terms[3], terms[4], robot)
    return status if status != OK else check(terms[3])


@compiled
def friction_batch(qd: Any, qdd: Any, terms: Any, robot: Any) -> int:
    """Compute the terms of friction of many states from the other terms."""
    for k in range(len(qd)):
        friction_terms(
            qd[k], qdd[k], terms[0][k], terms[1][k], terms[2][k], terms[3][k], terms[4][k], robot
        )
        if check(terms[3][k]) != OK:
            return NOT_FINITE
    return OK


@compiled
def friction_terms(
    qd: Any,
    qdd: Any,
    inertial: Any,
    velocity: Any,
    gravity: Any,
    friction: Any,
    external: Any,
    robot: Any,
) -> None:
    """Compute the term of friction from the other terms."""
    for joint in range(len(friction)):
        row = robot[joint + 1]
        load = inertial[joint] + velocity[joint] + gravity[joint] + external[joint]
        load -= row[ARMATURE] * qdd[joint]  # on the motor's side of the gear
        friction[joint] = joint_friction(friction_of(row), qd[joint], load)


@simd_inline
def any_of(v: Vector) -> bool:
    """Return whether a vector is not zero."""
    return bool(v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0)
