"""Axes and origins of the links in coordinates of the base, for quantities of pairs of links."""

from __future__ import annotations

from typing import Any

from .equations import add, dot, origin_in_parent, Vector
from .jit import simd_inline
from .robot_table import (
    COSINE,
    LENGTH,
    OFFSET,
    POSITION,
    rotation,
    SINE,
    store,
    vector,
    X_AXIS,
    Y_AXIS,
    Z_AXIS,
)

Axes = tuple[Vector, Vector, Vector]
"""Axes x, y, z of a frame."""


@simd_inline
def hold_base_axes(base: Any) -> None:
    """Store the axes and the origin of the base."""
    store(base, X_AXIS, (1.0, 0.0, 0.0))
    store(base, Y_AXIS, (0.0, 1.0, 0.0))
    store(base, Z_AXIS, (0.0, 0.0, 1.0))
    store(base, POSITION, (0.0, 0.0, 0.0))


@simd_inline
def place_in_base(link: Any, parent: Any) -> None:
    """Store the axes and the origin of a link, after `place_link`."""
    R, axes_P = rotation(link), axes(parent)
    p = origin_in_parent(R, vector(link, OFFSET), link[LENGTH])
    x, y, z = axes_in_base(axes_P, R, link[COSINE], link[SINE])
    store(link, X_AXIS, x)
    store(link, Y_AXIS, y)
    store(link, Z_AXIS, z)
    store(link, POSITION, add(vector(parent, POSITION), in_base(axes_P, p)))


@simd_inline
def axes(row: Any) -> Axes:
    """Read the axes of a link."""
    return vector(row, X_AXIS), vector(row, Y_AXIS), vector(row, Z_AXIS)


@simd_inline
def axes_in_base(axes_P: Axes, R: Any, c: Any, s: Any) -> Axes:
    """Return the axes of a link from those of its parent; R, c and s as in `equations`."""
    x = c * R[0] + s * R[1], c * R[3] + s * R[4], c * R[6] + s * R[7]
    y = c * R[1] - s * R[0], c * R[4] - s * R[3], c * R[7] - s * R[6]
    z = R[2], R[5], R[8]
    return in_base(axes_P, x), in_base(axes_P, y), in_base(axes_P, z)


@simd_inline
def in_base(axes: Axes, v: Vector) -> Vector:
    """Return a vector of the frame with these axes in coordinates of the base."""
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


@simd_inline
def in_frame(axes: Axes, v: Vector) -> Vector:
    """Return a vector in coordinates of the base in the frame with these axes."""
    return dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)
