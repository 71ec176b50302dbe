"""
The two passes of Luh, Walker and Paul for one state.

The robot is a table in the layout of `robot_table`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, fabs, sin, tanh
from typing import Any

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
from .jit import compiled, NOT_FINITE, OK, simd_inline, WRONG_SIZE
from .robot_table import (
    ACCEL,
    ARMATURE,
    body_of,
    COSINE,
    coupling_of,
    FORCE,
    frame_of,
    friction_of,
    HAS_DRIVE_TERMS,
    HAS_SPRINGS,
    JOINT,
    JOINT_COUNT,
    joint_of,
    LENGTH,
    load_of,
    MOMENT,
    motion_of,
    MULTIPLIER,
    OMEGA,
    OMEGA_DOT,
    PARENT,
    POSITION_OFFSET,
    PRELOAD,
    RATE,
    RATE_DOT,
    rotation,
    SINE,
    SLIDES,
    STIFFNESS,
    store,
    store_wrench,
    vector,
    wrench_of,
)


@compiled
def inverse_dynamics(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    tau: Any,
    robot: Any,
) -> int:
    """
    Compute the joint efforts that produce the joint accelerations.

    The equations are (36)-(47) of Luh, Walker and Paul. ``q``, ``qd`` and ``qdd`` contain the
    positions [rad or m], velocities and accelerations of n joints. ``tau`` receives the n efforts
    [N m or N]. ``robot`` is a table in the layout of `robot_table`. The returned status is `OK`,
    `NOT_FINITE` or `WRONG_SIZE`. After `WRONG_SIZE`, tau is unchanged.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
        return WRONG_SIZE
    outward_pass(q, qd, qdd, robot)
    has_drive_terms = robot[0][HAS_DRIVE_TERMS] != 0.0
    if has_drive_terms:
        for joint in range(n):  # stored, because tau may be the array of qd or qdd
            robot[joint + 1][RATE], robot[joint + 1][RATE_DOT] = qd[joint], qdd[joint]
    if robot[0][HAS_SPRINGS] != 0.0:
        for joint in range(n):
            tau[joint] = spring_effort(robot[joint + 1], q[joint])
    else:
        clear(tau)
    inward_pass(tau, robot)
    if has_drive_terms:
        drive_terms(tau, robot)
    return check(tau)


@simd_inline
def place_link(link: Any, q: float) -> Vector:
    """Store and return the cosine and sine of the joint angle, and the sliding distance."""
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
    Compute the joint efforts that hold the robot still on a base that does not rotate.

    The efforts equal those of `inverse_dynamics` at zero joint velocities and accelerations. Every
    link then has the acceleration of the base. Arguments and status are as in `inverse_dynamics`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(tau) != n:
        return WRONG_SIZE
    store_wrench(robot[0], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for i in range(1, len(robot)):
        link = robot[i]
        c, s, _ = place_link(link, q[int(link[JOINT])])
        accel = to_link(rotation(link), c, s, vector(robot[int(link[PARENT])], ACCEL))
        mass, com, _ = body_of(link)
        external_force, external_moment = load_of(link)
        force_net = net_force(mass, accel)
        moment = cross(com, force_net)
        store(link, ACCEL, accel)
        store(link, FORCE, subtract(force_net, external_force))
        store(link, MOMENT, subtract(moment, external_moment))
    for joint in range(n):
        # The spring effort is NaN if the position is not finite, even without a spring.
        tau[joint] = spring_effort(robot[joint + 1], q[joint])
    inward_pass(tau, robot)
    return check(tau)


@compiled
def outward_pass(
    q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], robot: Any
) -> None:
    """Compute the motion and the `own_wrench` of every link, from base to tips."""
    store_wrench(robot[0], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for i in range(1, len(robot)):
        link = robot[i]
        # Called first, because the compiler reads earlier values again after sine and cosine.
        c, s, length = place_link(link, q[int(link[JOINT])])
        parent, joint, multiplier, slides = joint_of(link)
        R, p = frame_of(link)
        omega_P, omega_dot_P, accel_P = motion_of(robot[parent])
        rate, rate_dot = multiplier * qd[joint], multiplier * qdd[joint]
        turn, turn_dot = (1.0 - slides) * rate, (1.0 - slides) * rate_dot
        slide, slide_dot = slides * rate, slides * rate_dot
        p = origin_in_parent(R, p, length)

        carried, carried_dot = to_link(R, c, s, omega_P), to_link(R, c, s, omega_dot_P)
        at_origin = point_acceleration(p, omega_P, omega_dot_P, accel_P)
        omega = angular_velocity(carried, turn)  # (36)
        omega_dot = angular_acceleration(carried, carried_dot, turn, turn_dot)  # (37)
        at_origin = to_link(R, c, s, at_origin)
        accel = sliding_acceleration(at_origin, omega, slide, slide_dot)  # (40)
        store(link, OMEGA, omega)
        store(link, OMEGA_DOT, omega_dot)
        store(link, ACCEL, accel)
        force, moment = own_wrench(link, omega, omega_dot, accel)  # (44), (41), (42)
        store_wrench(link, force, moment)


@simd_inline
def own_wrench(
    link: Any, omega: Vector, omega_dot: Vector, accel: Vector
) -> tuple[Vector, Vector]:
    """Return the net force and moment on a link, minus the external wrench."""
    mass, com, J = body_of(link)
    external_force, external_moment = load_of(link)
    accel_com = point_acceleration(com, omega, omega_dot, accel)  # (44)
    force_net = net_force(mass, accel_com)  # (41)
    moment_net = net_moment(J, omega, omega_dot)  # (42)
    moment = own_moment(com, force_net, moment_net)
    return subtract(force_net, external_force), subtract(moment, external_moment)


@compiled
def inward_pass(tau: Any, robot: Any) -> None:
    """Sum up the wrenches from tips to base, and add the joint efforts to tau."""
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        parent, joint, multiplier, slides = joint_of(link)
        carrier = robot[parent]
        R, p = frame_of(link)
        c, s, length = link[COSINE], link[SINE], link[LENGTH]
        force, moment = wrench_of(link)
        p = origin_in_parent(R, p, length)

        force_P = child_force(R, c, s, force)
        moment_P = child_moment(R, c, s, p, force_P, moment)
        store(carrier, FORCE, add(vector(carrier, FORCE), force_P))  # (45)
        store(carrier, MOMENT, add(vector(carrier, MOMENT), moment_P))  # (46)
        # Power is conserved if a mimic joint adds multiplier * effort to its master joint.
        tau[joint] += multiplier * joint_effort(force, moment, slides)  # (47)


@simd_inline
def spring_effort(row: Any, position: Any) -> Any:
    """Return the joint effort that balances the spring at a joint."""
    return row[STIFFNESS] * position + row[PRELOAD]


@compiled
def drive_terms(tau: Any, robot: Any) -> None:
    """
    Add the armature and friction efforts of each drive to the efforts of the inward pass.

    Friction is an internal pair of moments at one joint, and does not propagate to the base. In
    1980, Luh, Walker and Paul added friction in the same way: tau = n . z + b qd. With equations
    (22) and (23) of their 1979 paper, friction would propagate. A coupled drive also acts on the
    previous joint.

    """
    for joint in range(len(tau)):
        row = robot[joint + 1]
        rate, rate_dot = row[RATE], row[RATE_DOT]
        ratio, before = coupling_of(row)
        if ratio != 0.0:
            rate += ratio * robot[before + 1][RATE]
            rate_dot += ratio * robot[before + 1][RATE_DOT]
        friction = joint_friction(friction_of(row), rate, tau[joint])
        effort = row[ARMATURE] * rate_dot + friction
        tau[joint] += effort
        if ratio != 0.0:
            tau[before] += ratio * effort  # friction of joint `before` is already included


@simd_inline
def joint_friction(numbers: Any, rate: Any, load: Any) -> Any:
    """
    Return the friction effort of a drive; ``numbers`` are from `friction_of`.

    Coulomb friction may grow with ``load``. The load is the effort that links, payloads,
    external wrenches and springs require. The load excludes armature and friction efforts,
    because these act on the motor's side of the gear.

    """
    damping, coulomb, load_friction, inverse_width = numbers
    if coulomb != 0.0 or load_friction != 0.0:
        dry = coulomb + load_friction * fabs(load)
        return damping * rate + dry * tanh(inverse_width * rate)
    return damping * rate


@compiled
def clear(tau: Any) -> None:
    """Set tau to zero."""
    for joint in range(len(tau)):
        tau[joint] = 0.0


@compiled
def check(tau: Any) -> int:
    """Return `NOT_FINITE` if any effort is not finite, otherwise `OK`."""
    for joint in range(len(tau)):
        if tau[joint] - tau[joint] != 0.0:  # 0 for finite numbers only
            return NOT_FINITE
    return OK
