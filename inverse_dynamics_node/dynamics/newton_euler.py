"""
The two passes of Luh, Walker and Paul for one state; the equations are in `equations`.

The functions are compiled by numba where it is installed and run as Python where it is not. Both
take a robot as one table, with a row for each body and the columns of `columns`: an array for
numba, a list of lists for Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, fabs, sin, tanh
from typing import Any

from .columns import (
    ACCEL,
    ARMATURE,
    COM,
    COSINE,
    COULOMB,
    DAMPING,
    EXTERNAL_FORCE,
    EXTERNAL_MOMENT,
    FORCE,
    HAS_JOINT_TERMS,
    HAS_LOAD_FRICTION,
    inertia,
    INVERSE_WIDTH,
    JOINT,
    JOINT_COUNT,
    JOINT_TERMS,
    LENGTH,
    LOAD_FRICTION,
    MASS,
    MOMENT,
    MULTIPLIER,
    OFFSET,
    OMEGA,
    OMEGA_DOT,
    PARENT,
    POSITION_OFFSET,
    rotation,
    SINE,
    SLIDES,
    STEP,
    store,
    vector,
)
from .equations import (
    add,
    angular_acceleration,
    angular_velocity,
    child_force,
    child_moment,
    cross,
    joint_effort,
    net_force,
    net_moment,
    origin_in_parent,
    own_moment,
    point_acceleration,
    sliding_acceleration,
    subtract,
    to_link,
    Vector,
)
from .jit import compiled, simd_inline

OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2


@compiled
def inverse_dynamics(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    tau: Any,
    robot: Any,
) -> int:
    """
    Compute the joint efforts that produce the joint accelerations, LWP (36)-(47).

    Parameters
    ----------
    q, qd, qdd : sequence of n floats
        Joint positions [rad or m], velocities [rad/s or m/s] and accelerations.
    tau : sequence of n floats
        Receives the joint efforts [N m or N].
    robot : table from `robot_table`
        Row 0 contains the motion of the base.

    Returns
    -------
    status : int
        `OK`, `WRONG_SIZE` (then tau is untouched) or `NOT_FINITE`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
        return WRONG_SIZE
    outward_pass(q, qd, qdd, robot)
    if robot[0][HAS_JOINT_TERMS] != 0.0:
        # After the outward pass and joint by joint, because tau may be the array of qd or qdd.
        joint_terms(qd, qdd, tau, robot)
    else:
        clear(tau)
    inward_pass(tau, robot)
    if robot[0][HAS_LOAD_FRICTION] != 0.0:
        load_friction(tau, robot)
    return check(tau)


@compiled
def inverse_dynamics_batch(q: Any, qd: Any, qdd: Any, tau: Any, robot: Any) -> int:
    """Call `inverse_dynamics` for every row of the arguments; return the first failure."""
    for k in range(len(tau)):
        status = inverse_dynamics(q[k], qd[k], qdd[k], tau[k], robot)
        if status != OK:
            return status
    return OK


@simd_inline
def place_link(link: Any, q: float) -> Vector:
    """Store how far a link has turned and slid: cosine, sine, length; and return them."""
    position = link[MULTIPLIER] * q + link[POSITION_OFFSET]
    if link[SLIDES] != 0.0:
        c, s, length = 1.0, 0.0, position
    else:
        c, s, length = cos(position), sin(position), 0.0
    link[COSINE], link[SINE], link[LENGTH] = c, s, length
    return c, s, length


@compiled
def gravity_efforts(q: Sequence[float], tau: Any, robot: Any) -> int:
    """
    Compute the joint efforts that hold the robot still.

    As `inverse_dynamics` for velocities and accelerations of zero, on a base that does not rotate:
    every link has the acceleration of the base, in its own frame.

    Parameters
    ----------
    q, tau, robot
        As for `inverse_dynamics`.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(tau) != n:
        return WRONG_SIZE
    store(robot[0], FORCE, (0.0, 0.0, 0.0))
    store(robot[0], MOMENT, (0.0, 0.0, 0.0))
    for i in range(1, len(robot)):
        link = robot[i]
        c, s, _ = place_link(link, q[int(link[JOINT])])
        accel = to_link(rotation(link), c, s, vector(robot[int(link[PARENT])], ACCEL))
        force_net = net_force(link[MASS], accel)
        moment = cross(vector(link, COM), force_net)
        store(link, ACCEL, accel)
        store(link, FORCE, subtract(force_net, vector(link, EXTERNAL_FORCE)))
        store(link, MOMENT, subtract(moment, vector(link, EXTERNAL_MOMENT)))
    for joint in range(n):
        tau[joint] = q[joint] - q[joint]  # 0, or NaN where no effort depends on it
    inward_pass(tau, robot)
    return check(tau)


@compiled
def outward_pass(
    q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], robot: Any
) -> None:
    """Propagate the motion from base to tips, and compute each link's own force and moment."""
    store(robot[0], FORCE, (0.0, 0.0, 0.0))
    store(robot[0], MOMENT, (0.0, 0.0, 0.0))
    for i in range(1, len(robot)):
        link = robot[i]
        parent = robot[int(link[PARENT])]
        joint, slides = int(link[JOINT]), link[SLIDES]
        rate, rate_dot = link[MULTIPLIER] * qd[joint], link[MULTIPLIER] * qdd[joint]
        turn, turn_dot = (1.0 - slides) * rate, (1.0 - slides) * rate_dot
        slide, slide_dot = slides * rate, slides * rate_dot
        c, s, length = place_link(link, q[joint])
        R = rotation(link)
        p = origin_in_parent(R, vector(link, OFFSET), length)
        omega_P, omega_dot_P = vector(parent, OMEGA), vector(parent, OMEGA_DOT)
        accel = point_acceleration(p, omega_P, omega_dot_P, vector(parent, ACCEL))
        omega_P, omega_dot_P = to_link(R, c, s, omega_P), to_link(R, c, s, omega_dot_P)
        omega = angular_velocity(omega_P, turn)
        omega_dot = angular_acceleration(omega_P, omega_dot_P, turn, turn_dot)
        accel = sliding_acceleration(to_link(R, c, s, accel), omega, slide, slide_dot)
        store(link, OMEGA, omega)
        store(link, OMEGA_DOT, omega_dot)
        store(link, ACCEL, accel)
        force, moment = own_wrench(link, omega, omega_dot, accel)
        store(link, FORCE, force)
        store(link, MOMENT, moment)


@simd_inline
def own_wrench(
    link: Any, omega: Vector, omega_dot: Vector, accel: Vector
) -> tuple[Vector, Vector]:
    """Compute the force and moment that a link's own motion requires, less its external load."""
    com = vector(link, COM)
    accel_com = point_acceleration(com, omega, omega_dot, accel)
    force_net = net_force(link[MASS], accel_com)
    moment_net = net_moment(inertia(link), omega, omega_dot)
    force = subtract(force_net, vector(link, EXTERNAL_FORCE))
    moment = own_moment(com, force_net, moment_net)
    return force, subtract(moment, vector(link, EXTERNAL_MOMENT))


@compiled
def inward_pass(tau: Any, robot: Any) -> None:
    """Propagate forces and moments from tips to base, and add each joint's effort to tau."""
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        parent = robot[int(link[PARENT])]
        force, moment = vector(link, FORCE), vector(link, MOMENT)
        # The effort of a mimic joint adds to its master's: equal power.
        tau[int(link[JOINT])] += link[MULTIPLIER] * joint_effort(force, moment, link[SLIDES])

        R, c, s = rotation(link), link[COSINE], link[SINE]
        p = origin_in_parent(R, vector(link, OFFSET), link[LENGTH])
        force = child_force(R, c, s, force)
        moment = child_moment(R, c, s, p, force, moment)
        store(parent, FORCE, add(vector(parent, FORCE), force))
        store(parent, MOMENT, add(vector(parent, MOMENT), moment))


@compiled
def joint_terms(qd: Sequence[float], qdd: Sequence[float], tau: Any, robot: Any) -> None:
    """
    Set tau to the terms of a single joint: rotor inertia, viscous and Coulomb friction.

    Friction is an internal pair at one joint and does not propagate to the joints below. This is
    the authors' form of 1980, tau = n . z + b qd; with LWP (22), (23) of 1979 it would propagate.

    """
    for joint in range(len(tau)):
        row = robot[joint + 1]
        rate = qd[joint]
        tau[joint] = row[ARMATURE] * qdd[joint] + row[DAMPING] * rate
        if row[COULOMB] != 0.0 or row[LOAD_FRICTION] != 0.0:
            row[STEP] = tanh(rate * row[INVERSE_WIDTH])
            tau[joint] += row[COULOMB] * row[STEP]
        row[JOINT_TERMS] = tau[joint]


@compiled
def load_friction(tau: Any, robot: Any) -> None:
    """
    Add Coulomb friction that grows with the load on the gear to the efforts of the inward pass.

    The load is the effort (47) that links, payloads and external wrenches require. Rotor inertia
    and friction act on the motor's side of the gear and do not load it.

    """
    for joint in range(len(tau)):
        row = robot[joint + 1]
        if row[LOAD_FRICTION] != 0.0:
            load = tau[joint] - row[JOINT_TERMS]
            tau[joint] += row[LOAD_FRICTION] * row[STEP] * fabs(load)


@compiled
def clear(tau: Any) -> None:
    """Set tau to zero."""
    for joint in range(len(tau)):
        tau[joint] = 0.0


@compiled
def check(tau: Any) -> int:
    """Return `NOT_FINITE` if any effort is; a NaN or infinity in any input reaches an effort."""
    for joint in range(len(tau)):
        if tau[joint] - tau[joint] != 0.0:  # 0 for finite numbers only
            return NOT_FINITE
    return OK
