"""The force and moment at every joint of one state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..robot.model import Floats
from .columns import ACCEL, FORCE, JOINT_COUNT, MOMENT, OMEGA, OMEGA_DOT, store, vector
from .equations import to_parent
from .jit import compiled
from .newton_euler import check, clear, inward_pass, OK, outward_pass, own_wrench, WRONG_SIZE


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
    base = robot[0]
    motion = vector(base, OMEGA), vector(base, OMEGA_DOT), vector(base, ACCEL)
    force, moment = own_wrench(base, *motion)
    store(base, FORCE, force)
    store(base, MOMENT, moment)
    clear(tau)
    inward_pass(tau, robot)
    for i in range(len(robot)):
        R = R_LZ[i]
        store(wrenches[i], 0, to_parent(R, 1.0, 0.0, vector(robot[i], FORCE)))
        store(wrenches[i], 3, to_parent(R, 1.0, 0.0, vector(robot[i], MOMENT)))
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
