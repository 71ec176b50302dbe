"""Axes and origins of the links for many states: `base_axes` on blocks of lanes, see `batch`."""

from __future__ import annotations

from typing import Any

from .base_axes import Axes, axes_in_base, in_base
from .batch import lane, LANES, store_lane
from .columns import OFFSET, rotation, vector
from .equations import add, origin_in_parent, Vector
from .jit import simd_inline, simd_step

FRAME = 12  # numbers in a lane: axes x, y, z and origin


@simd_step
def hold_base_frame(frames: Any) -> None:
    """Set the axes and the origin of the base in every lane."""
    for k in range(LANES):
        store_axes(frames, 0, k, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        store_lane(frames, 0, 9, k, (0.0, 0.0, 0.0))


@simd_step
def frame_step(robot: Any, i: int, place: Any, parents: Any, parent: int, frames: Any) -> None:
    """Compute the axes and the origin of a link in coordinates of the base."""
    R, offset = rotation(robot[i]), vector(robot[i], OFFSET)
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        axes_P = lane_axes(parents, parent, k)
        p = in_base(axes_P, origin_in_parent(R, offset, length))
        store_axes(frames, i, k, axes_in_base(axes_P, R, c, s))
        store_lane(frames, i, 9, k, add(lane_origin(parents, parent, k), p))


@simd_inline
def lane_axes(frames: Any, i: int, k: int) -> Axes:
    return lane(frames, i, 0, k), lane(frames, i, 3, k), lane(frames, i, 6, k)


@simd_inline
def lane_axis(frames: Any, i: int, k: int) -> Vector:
    """Return the axis of the joint of a link."""
    return lane(frames, i, 6, k)


@simd_inline
def lane_origin(frames: Any, i: int, k: int) -> Vector:
    return lane(frames, i, 9, k)


@simd_inline
def store_axes(frames: Any, i: int, k: int, axes: Axes) -> None:
    store_lane(frames, i, 0, k, axes[0])
    store_lane(frames, i, 3, k, axes[1])
    store_lane(frames, i, 6, k, axes[2])
