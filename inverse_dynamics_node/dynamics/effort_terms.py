"""Named results: the terms of joint efforts, and the force and moment at every joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..robot.model import Floats
from .equations import to_parent
from .jit import compiled, WRONG_SIZE
from .newton_euler import check, clear, inward_pass, outward_pass, own_wrench
from .robot_table import JOINT_COUNT, motion_of, store, store_wrench, wrench_of


class EffortTerms(NamedTuple):
    """Five terms of n joint efforts, each of shape (..., n) [N m or N]."""

    inertial: Floats
    """Efforts M(q) qdd due to the joint accelerations; M includes armature."""
    coriolis: Floats
    """Coriolis and centrifugal efforts C(q, qd) qd; C also depends on the rotation of the base."""
    gravity: Floats
    """Efforts g(q) due to gravity, springs, and the acceleration and rotation of the base."""
    friction: Floats
    """Efforts due to all kinds of friction, including friction that grows with the load."""
    external: Floats
    """Efforts that balance the external wrenches."""


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

    ``wrenches`` receives b rows of 6 numbers, for b bodies. ``R_LZ`` is as in
    `regressor.regressor`. ``tau`` receives the efforts without armature, friction and springs. The
    other arguments and the returned status are as in `newton_euler.inverse_dynamics`.

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
