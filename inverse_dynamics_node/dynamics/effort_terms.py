"""The terms of the efforts, and the force and moment at every joint."""

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
    """Terms of the joint efforts, each of shape (..., n) [N m or N]; their sum is the effort."""

    inertial: Floats
    """M(q) qdd, including armature."""
    coriolis: Floats
    """C(q, qd) qd: Coriolis and centrifugal efforts, including those of a rotating base."""
    gravity: Floats
    """g(q), springs, and the efforts due to the acceleration and rotation of the base."""
    friction: Floats
    """Friction, including the parts that grow with the load and the root of the speed."""
    external: Floats
    """Minus the efforts that the external wrenches exert."""


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
    Compute the terms of the efforts.

    Parameters
    ----------
    q, qd, qdd, robot
        As for `newton_euler.inverse_dynamics`.
    state : 4 sequences of n floats
        Scratch space; the last row is zero.
    inertial, coriolis, gravity, external : tables
        Tables with these terms only, from `term_tables`.
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
    status = max(status, inverse_dynamics(q, qd, rest, terms[1], coriolis))
    if any_of(vector(gravity[0], OMEGA)) or any_of(vector(gravity[0], OMEGA_DOT)):
        # Efforts due to the rotation of the base alone are part of the gravity term.
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
    coriolis: Any,
    gravity: Any,
    friction: Any,
    external: Any,
    robot: Any,
) -> None:
    """Compute the term of friction from the other terms."""
    for joint in range(len(friction)):
        row = robot[joint + 1]
        load = inertial[joint] + coriolis[joint] + gravity[joint] + external[joint]
        ratio, before = coupling_of(row)
        if ratio != 0.0:
            rotor = row[ARMATURE] * (qdd[joint] + ratio * qdd[before])
            friction[joint] = load - rotor
            friction[before] -= ratio * rotor
        else:
            friction[joint] = load - row[ARMATURE] * qdd[joint]  # on the motor's side of the gear
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
    """Return whether a vector is not zero."""
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
"""Terms of the efforts, and the columns that are zero in the table that computes each of them."""


class TermTables(NamedTuple):
    """Robot tables that leave one term of the efforts, for `effort_terms`."""

    inertial: Floats
    coriolis: Floats
    gravity: Floats
    external: Floats


def term_tables(table: Floats) -> TermTables:
    """Return the tables of the terms, from the table of the robot and its loads."""
    tables = TermTables(*(table.copy() for _ in _ABSENT))
    for term, columns in _ABSENT.items():
        for part in columns:
            getattr(tables, term)[:, part] = 0.0
    return tables


class JointWrenches(NamedTuple):
    """
    Force and moment at every joint, of shape (..., b, 3), in the order of ``robot.body_names``.

    A row is the wrench that the parent of the body exerts on it, in the URDF frame of the joint
    between them and about its origin. The first row is the wrench of the mount on the base.

    """

    force: Floats
    """[N]."""
    moment: Floats
    """[N m]."""


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
    Compute the force and moment that the parent of every link exerts on it, LWP (45), (46).

    Parameters
    ----------
    q, qd, qdd, tau, robot
        As for `newton_euler.inverse_dynamics`, but tau does not include the joint terms.
    R_LZ : b sequences of 9 floats
        Rotations into the frames of the wrenches, from the frames of the table.
    wrenches : b sequences of 6 floats
        Receives force and moment. The first row is for the base, whose parent is the mount.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

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
    """Call `joint_wrenches` for every row of the states; return the first failure."""
    for k in range(len(q)):
        status = joint_wrenches(q[k], qd[k], qdd[k], tau, R_LZ, wrenches[k], robot)
        if status != OK:
            return status
    return OK
