"""Joint efforts term by term, and the force and moment at every joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..robot.model import Floats
from . import robot_table
from .equations import to_parent, Vector
from .jit import compiled, NOT_FINITE, OK, simd_inline, WRONG_SIZE
from .newton_euler import (
    check,
    clear,
    gravity_efforts,
    inverse_dynamics,
    inward_pass,
    joint_friction,
    outward_pass,
    own_wrench,
)
from .robot_table import (
    ARMATURE,
    coupling_of,
    EXTERNAL_FORCE,
    EXTERNAL_MOMENT,
    friction_of,
    JOINT_COUNT,
    motion_of,
    OMEGA,
    OMEGA_DOT,
    store,
    store_wrench,
    vector,
    wrench_of,
)


class EffortTerms(NamedTuple):
    """Five terms of n joint efforts, each of shape (..., n) [N m or N]."""

    inertial: Floats
    """Efforts M(q) qdd due to the joint accelerations; M includes armature."""
    coriolis: Floats
    """Coriolis and centrifugal efforts C(q, qd) qd; C also depends on the rotation of the base."""
    gravity: Floats
    """Efforts g(q) due to gravity, springs, and the acceleration and rotation of the base."""
    friction: Floats
    """Efforts due to all kinds of friction, including load-dependent and square-root friction."""
    external: Floats
    """Efforts that balance the external wrenches."""


@compiled
def effort_terms(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    state: Any,
    inertial: Any,
    coriolis: Any,
    gravity: Any,
    external: Any,
    terms: Any,
    robot: Any,
) -> int:
    """
    Compute the five terms of the efforts of n joints, in the order of `EffortTerms`.

    The arguments ``inertial`` to ``external`` are the tables from `term_tables`. ``state`` is
    scratch memory with 4 rows of n numbers. The last row of ``state`` must be zero. ``terms``
    receives 5 rows of n numbers, and may share memory with q, qd and qdd. The other arguments and
    the returned status are as in `newton_euler.inverse_dynamics`.

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
    status = max(status, inverse_dynamics(q, qd, rest, terms[1], coriolis))
    if any_of(vector(gravity[0], OMEGA)) or any_of(vector(gravity[0], OMEGA_DOT)):
        # Efforts due to the rotation of the base alone belong to the gravity term.
        status = max(status, inverse_dynamics(q, rest, rest, terms[2], coriolis))
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
    """Compute the friction term of many states from the other four terms."""
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
    coriolis: Any,
    gravity: Any,
    friction: Any,
    external: Any,
    robot: Any,
) -> None:
    """Compute the friction term from the other four terms."""
    for joint in range(len(friction)):
        row = robot[joint + 1]
        load = inertial[joint] + coriolis[joint] + gravity[joint] + external[joint]
        ratio, before = coupling_of(row)
        if ratio != 0.0:
            rotor = row[ARMATURE] * (qdd[joint] + ratio * qdd[before])
            friction[joint] = load - rotor
            friction[before] -= ratio * rotor
        else:
            friction[joint] = load - row[ARMATURE] * qdd[joint]  # rotors do not load the gear
    for joint in range(len(friction)):
        row = robot[joint + 1]
        ratio, before = coupling_of(row)
        if ratio != 0.0:
            rate = qd[joint] + ratio * qd[before]
            friction[joint] = joint_friction(friction_of(row), rate, friction[joint])
            friction[before] += ratio * friction[joint]
        else:
            friction[joint] = joint_friction(friction_of(row), qd[joint], friction[joint])


@simd_inline
def any_of(v: Vector) -> bool:
    """Return whether any component of a vector is nonzero."""
    return bool(v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0)


_NO_BODIES = (robot_table.MASS, robot_table.INERTIA_COLUMNS, robot_table.BASE_MOTION_COLUMNS)
_NO_DRIVE_TERMS = (robot_table.DRIVE_TERM_COLUMNS, robot_table.HAS_DRIVE_TERMS)
_NO_SPRINGS = (robot_table.SPRING_COLUMNS, robot_table.HAS_SPRINGS)
_ABSENT: dict[str, tuple[int | slice, ...]] = {
    'inertial': (
        robot_table.BASE_MOTION_COLUMNS,
        robot_table.EXTERNAL_COLUMNS,
        robot_table.FRICTION_COLUMNS,
        *_NO_SPRINGS,
    ),
    'coriolis': (
        robot_table.BASE_ACCELERATION_COLUMNS,
        robot_table.EXTERNAL_COLUMNS,
        *_NO_DRIVE_TERMS,
        *_NO_SPRINGS,
    ),
    'gravity': (robot_table.EXTERNAL_COLUMNS, *_NO_DRIVE_TERMS),
    'external': (*_NO_BODIES, *_NO_DRIVE_TERMS, *_NO_SPRINGS),
}
"""Columns of the robot table that are set to zero for each effort term."""


def term_tables(table: Floats) -> list[Floats]:
    """Copy a robot table for each term in `_ABSENT`, and set the absent columns to zero."""
    tables = [table.copy() for _ in _ABSENT]
    for copy, columns in zip(tables, _ABSENT.values(), strict=True):
        for part in columns:
            copy[:, part] = 0.0
    return tables


class JointWrenches(NamedTuple):
    """
    Force and moment at the joints of b bodies, each of shape (..., b, 3).

    Each row is the wrench that the parent of a body exerts on the body. The rows are in the order
    of ``robot.body_names``. The axes and the reference point are those of the joint's URDF frame.
    The first row is the wrench that the mount exerts on the base.

    """

    force: Floats
    """Force on each body [N]."""
    moment: Floats
    """Moment on each body about the joint's origin [N m]."""


@compiled
def joint_wrenches(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    tau: Any,
    R_LZ: Any,
    wrenches: Any,
    robot: Any,
) -> int:
    """
    Compute the force and moment that every body receives from its parent, LWP (45), (46).

    ``wrenches`` receives b rows of 6 numbers, for b bodies. The first row is the wrench that the
    mount exerts on the base. ``R_LZ`` is as in `regressor.regressor`. ``tau`` receives the efforts
    without armature, friction and springs. The other arguments and the returned status are as in
    `newton_euler.inverse_dynamics`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
        return WRONG_SIZE
    if len(wrenches) != len(robot) or len(wrenches[0]) != 6:
        return WRONG_SIZE
    outward_pass(q, qd, qdd, robot)
    force, moment = own_wrench(robot[0], *motion_of(robot[0]))
    store_wrench(robot[0], force, moment)
    clear(tau)
    inward_pass(tau, robot)
    for i in range(len(robot)):
        force, moment = wrench_of(robot[i])
        store(wrenches[i], 0, to_parent(R_LZ[i], 1.0, 0.0, force))
        store(wrenches[i], 3, to_parent(R_LZ[i], 1.0, 0.0, moment))
    return check(tau)


@compiled
def joint_wrenches_batch(
    q: Any, qd: Any, qdd: Any, tau: Any, R_LZ: Any, wrenches: Any, robot: Any
) -> int:
    """Call `joint_wrenches` for every state; return the status of the first failure, or `OK`."""
    for k in range(len(q)):
        status = joint_wrenches(q[k], qd[k], qdd[k], tau, R_LZ, wrenches[k], robot)
        if status != OK:
            return status
    return OK
