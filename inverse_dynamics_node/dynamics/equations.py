r"""
The equations of Luh, Walker and Paul in link coordinates, as functions of 3-vectors.

The paper is cited as LWP, with its equation numbers:

    J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator dynamics
    for computer control", IFAC, 1979, 165-172.

=============  ================================================================  ============
name           meaning, in link coordinates                                      unit
=============  ================================================================  ============
omega          angular velocity of the link                                      rad/s
omega_dot      angular acceleration of the link                                  rad/s^2
accel          acceleration of the link's origin, minus gravity                  m/s^2
accel_com      acceleration of the link's centre of mass, minus gravity          m/s^2
force_net      resultant force on the link                                       N
moment_net     resultant moment on the link, about its centre of mass            N m
force          force of the parent on the link                                   N
moment         moment of the parent on the link, about the origin of the link    N m
=============  ================================================================  ============

The outward pass, from base to tips, evaluates (36), (37), (40), (44), (41) and (42), in this
order. The inward pass evaluates (45), (46) and (47).

Three equations of the paper are not needed. Equations (38) and (43) are the angular acceleration
and the effort in base coordinates. Equations (37) and (47) give both in link coordinates.
Equation (39) is the linear velocity, on which no force depends.

Gravity is not a separate term, because equation (31) gives the base the acceleration -g.

The frames are those of a URDF, rotated so that z is the joint axis. In the Denavit-Hartenberg
frames of the paper, joint i + 1 moves about or along z of frame i. Here joint i moves about or
along z of the frame of link i. The offset p from the parent's origin is therefore constant in the
parent's frame, except that a translational joint adds a distance along the axis. Moments are about
the origin of the link. Terms with z are added after the rotation into the link's frame.

Every joint has a rate ``turn`` about z and a rate ``slide`` along z. One of the two is zero. The
paper's separate cases for rotational and translational joints are therefore one expression.

`recursion` evaluates the equations link by link, as in the paper. Tests compare the passes of
`newton_euler` with `recursion`.

Vectors are tuples, so that a component may be a number or a numpy array.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any, NamedTuple

from .jit import simd_inline

Vector = tuple[Any, Any, Any]

# Outward pass


@simd_inline
def angular_velocity(omega_P: Vector, turn: Any) -> Vector:
    """(36): angular velocity R_LP omega_P + z turn; the caller has applied R_LP."""
    return omega_P[0], omega_P[1], omega_P[2] + turn


@simd_inline
def angular_acceleration(omega_P: Vector, omega_dot_P: Vector, turn: Any, turn_dot: Any) -> Vector:
    """(37): R_LP omega_dot_P + z turn_dot + R_LP omega_P x z turn; the caller has applied R_LP."""
    x, y, z = omega_dot_P
    return x + omega_P[1] * turn, y - omega_P[0] * turn, z + turn_dot


@simd_inline
def point_acceleration(p: Vector, omega: Vector, omega_dot: Vector, accel: Vector) -> Vector:
    """
    (40), (44): acceleration of a point p of a body, accel + omega_dot x p + omega x (omega x p).

    The origin of the body has the acceleration accel. In (44), p is the centre of mass. In (40), p
    is the origin of the next link, and `sliding_acceleration` adds the terms due to sliding.

    """
    return add(accel, add(cross(omega_dot, p), cross(omega, cross(omega, p))))


@simd_inline
def sliding_acceleration(accel: Vector, omega: Vector, slide: Any, slide_dot: Any) -> Vector:
    """(40) for a translational joint: add z slide_dot + 2 omega x z slide."""
    x, y, z = accel
    return x + 2.0 * omega[1] * slide, y - 2.0 * omega[0] * slide, z + slide_dot


@simd_inline
def net_force(mass: Any, accel_com: Vector) -> Vector:
    """(41): resultant force m accel_com."""
    return mass * accel_com[0], mass * accel_com[1], mass * accel_com[2]


@simd_inline
def net_moment(J: Any, omega: Vector, omega_dot: Vector) -> Vector:
    """(42): resultant moment J omega_dot + omega x (J omega); J is about the centre of mass."""
    return add(symmetric(J, omega_dot), cross(omega, symmetric(J, omega)))


# Inward pass. The wrenches of all children are added to the wrench of the link.


@simd_inline
def child_force(R: Any, c: Any, s: Any, force: Vector) -> Vector:
    """(45): force on a child, in the parent's frame: R_PL force."""
    return to_parent(R, c, s, force)


@simd_inline
def own_moment(com: Vector, force_net: Vector, moment_net: Vector) -> Vector:
    """(46): net moment on a link about the link's origin, moment_net + com x force_net."""
    return add(moment_net, cross(com, force_net))


@simd_inline
def child_moment(R: Any, c: Any, s: Any, p: Vector, force: Vector, moment: Vector) -> Vector:
    """(46): moment on a child about the parent's origin: R_PL moment + p x force from (45)."""
    return add(to_parent(R, c, s, moment), cross(p, force))


@simd_inline
def joint_effort(force: Vector, moment: Vector, slides: Any) -> Any:
    """
    (47): z . moment for a rotational joint, z . force for a translational joint.

    ``slides`` is 0 or 1. The function has no branch, so that the compiler can vectorise loops.

    """
    return slides * force[2] + (1.0 - slides) * moment[2]


# Frames. R is R_PL at joint position 0, row by row. The cosine and sine of the joint angle are c
# and s.


@simd_inline
def origin_in_parent(R: Any, p: Vector, length: Any) -> Vector:
    """Return a link's origin in the parent's frame after sliding by ``length`` along z."""
    return add(p, (R[2] * length, R[5] * length, R[8] * length))


@simd_inline
def to_link(R: Any, c: Any, s: Any, v: Vector) -> Vector:
    """Rotate a vector from the parent's frame to the link's frame: R_LP v."""
    x = R[0] * v[0] + R[3] * v[1] + R[6] * v[2]
    y = R[1] * v[0] + R[4] * v[1] + R[7] * v[2]
    z = R[2] * v[0] + R[5] * v[1] + R[8] * v[2]
    return c * x + s * y, c * y - s * x, z


@simd_inline
def to_parent(R: Any, c: Any, s: Any, v: Vector) -> Vector:
    """Rotate a vector from the link's frame to the parent's frame: R_PL v."""
    x, y, z = c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


# Vectors


@simd_inline
def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@simd_inline
def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@simd_inline
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@simd_inline
def dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@simd_inline
def symmetric(J: Any, v: Vector) -> Vector:
    """Multiply the symmetric matrix J (xx, xy, xz, yy, yz, zz) by the vector v."""
    return (
        J[0] * v[0] + J[1] * v[1] + J[2] * v[2],
        J[1] * v[0] + J[3] * v[1] + J[4] * v[2],
        J[2] * v[0] + J[4] * v[1] + J[5] * v[2],
    )


# The recursion, without the loads, friction and mimic joints of `newton_euler`


class Link(NamedTuple):
    """Geometry and inertia of a link; z is the axis of the link's joint."""

    R: Any  # R_PL at joint position 0, row by row
    p: Vector  # p_PL at joint position 0 [m]
    com: Vector  # [m]
    mass: float  # [kg]
    J: Any  # about the centre of mass: xx, xy, xz, yy, yz, zz [kg m^2]
    parent: int  # index of the parent, smaller than that of the link; -1 is the base
    slides: bool


def recursion(
    links: Sequence[Link],
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    gravity: Vector,
) -> list[float]:
    """Return the joint efforts of a tree of links on a base at rest: LWP (36)-(47)."""
    at_rest = 0.0, 0.0, 0.0
    n = len(links)
    # The base has the index -1, the last element.
    omega, omega_dot = [at_rest] * (n + 1), [at_rest] * (n + 1)
    accel = [subtract(at_rest, gravity)] * (n + 1)  # (31)
    force, moment = [at_rest] * (n + 1), [at_rest] * (n + 1)
    places: list[tuple[float, float, Vector]] = []
    tau = [0.0] * n

    for i, (R, p, com, mass, J, parent, slides) in enumerate(links):
        turn, turn_dot, slide, slide_dot = 0.0, 0.0, qd[i], qdd[i]
        c, s, length = 1.0, 0.0, q[i]
        if not slides:
            turn, turn_dot, slide, slide_dot = qd[i], qdd[i], 0.0, 0.0
            c, s, length = cos(q[i]), sin(q[i]), 0.0
        p = origin_in_parent(R, p, length)
        places.append((c, s, p))

        carried = to_link(R, c, s, omega[parent])
        carried_dot = to_link(R, c, s, omega_dot[parent])
        at_origin = point_acceleration(p, omega[parent], omega_dot[parent], accel[parent])
        omega[i] = angular_velocity(carried, turn)  # (36)
        omega_dot[i] = angular_acceleration(carried, carried_dot, turn, turn_dot)  # (37)
        at_origin = to_link(R, c, s, at_origin)
        accel[i] = sliding_acceleration(at_origin, omega[i], slide, slide_dot)  # (40)
        accel_com = point_acceleration(com, omega[i], omega_dot[i], accel[i])  # (44)
        force[i] = net_force(mass, accel_com)  # (41)
        moment_net = net_moment(J, omega[i], omega_dot[i])  # (42)
        moment[i] = own_moment(com, force[i], moment_net)

    for i in reversed(range(n)):
        R, parent, (c, s, p) = links[i].R, links[i].parent, places[i]
        force_P = child_force(R, c, s, force[i])
        force[parent] = add(force[parent], force_P)  # (45)
        moment_P = child_moment(R, c, s, p, force_P, moment[i])
        moment[parent] = add(moment[parent], moment_P)  # (46)
        tau[i] = joint_effort(force[i], moment[i], links[i].slides)  # (47)
    return tau
