"""Axes and origins of the links for many states: `base_axes` on blocks of `lanes`."""

from __future__ import annotations

from typing import Any

from ..robot.model import Floats
from .base_axes import Axes, axes_in_base, in_base
from .columns import OFFSET, PARENT, rotation, vector
from .equations import add, origin_in_parent, Vector
from .jit import IS_COMPILED, simd_inline, simd_step
from .lanes import lane, LANES, store_lane

FRAME = 12  # numbers in a lane: axes x, y, z and origin


def count_pairs(robot: Floats) -> int:
    """Count the pairs of a link and a joint that moves it."""
    depth = [0]
    for parent in robot[1:, PARENT].astype(int).tolist():
        depth.append(depth[parent] + 1)
    return sum(depth)


@simd_inline
def matrices_of(states: Any, matrices: Any) -> Any:
    """Return the matrices of a block of states; see `arranged`."""
    if IS_COMPILED:
        return matrices[states]
    return matrices[..., states]


def arranged(matrices: Floats) -> Floats:
    """Arrange N matrices as steps index them: by lane, row and column."""
    return matrices if IS_COMPILED else matrices.transpose(1, 2, 0)[None]


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
