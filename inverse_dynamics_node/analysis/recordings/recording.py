"""The samples of a recording, and those of one joint in order of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...errors import RecordingError
from ...robot.model import Floats, Integers

GAP = 5.0  # periods without a sample; signals are not interpolated across a gap
DUPLICATE = 0.25  # periods; samples that are closer together are duplicates
JUMP_BACK = 10.0  # periods; samples whose stamps go back by less are sorted


class Recording(NamedTuple):
    """Measured states of m joints at k times."""

    joint_names: tuple[str, ...]
    times: Floats
    """Stamps, shape (k,) [s]; may have jitter, gaps and duplicates."""
    positions: Floats
    """Shape (k, m) [rad or m]; NaN if a message lacks the joint."""
    velocities: Floats | None
    """Shape (k, m) [rad/s or m/s]; NaN if a message lacks it; None if no velocity was recorded."""
    efforts: Floats
    """Shape (k, m) [N m or N]; NaN if a message lacks it."""


class RecordedColumn:
    """Samples of one joint in order of time, without duplicates."""

    def __init__(self, recording: Recording, times: Floats, joint: int) -> None:
        self.name = recording.joint_names[joint]
        q, tau = recording.positions[:, joint], recording.efforts[:, joint]
        self.has_effort = bool(np.isfinite(tau).any())
        is_complete = np.isfinite(q) & (np.isfinite(tau) | (not self.has_effort))
        if is_complete.sum() < 2:
            raise RecordingError(
                f"joint '{self.name}' has {int(is_complete.sum())} samples with a position"
                + (' and an effort' if self.has_effort else '')
                + ', expected at least 2'
            )
        t = times[is_complete]
        steps = np.diff(t)
        self.period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
        back = np.min(steps)
        if back < -JUMP_BACK * self.period:
            at = float(t[int(np.argmin(steps))] - times[0])
            raise RecordingError(
                f'time goes back by {-back:.3g} s, {at:.3g} s after the start; if these are two '
                'recordings in one file, select one of them by its start and end'
            )
        order = np.argsort(t, kind='stable')
        signals = [q, tau]
        if recording.velocities is not None:
            signals.append(recording.velocities[:, joint])
        values = np.column_stack([t, *(signal[is_complete] for signal in signals)])[order]
        values, self.merged = _merge(values, DUPLICATE * self.period)
        self.t, self.q, self.tau = values[:, 0], values[:, 1], values[:, 2]
        self.qd: Floats | None = values[:, 3] if values.shape[1] == 4 else None
        if self.qd is not None and not np.isfinite(self.qd).all():
            self.qd = None
        self.varies = self.has_effort and bool(np.ptp(self.tau) > 0.0)

    def spans(self) -> list[tuple[float, float]]:
        """Return begin and end of the intervals without gaps."""
        breaks = np.flatnonzero(np.diff(self.t) > GAP * self.period)
        starts = [0, *(breaks + 1)]
        ends = [*breaks, len(self.t) - 1]
        return [(self.t[a], self.t[b]) for a, b in zip(starts, ends, strict=True)]

    def at(self, values: Floats, grid: Floats) -> Floats:
        """Interpolate to uniform times between two gaps."""
        from scipy.interpolate import CubicSpline  # the import takes 0.3 s

        a = max(int(np.searchsorted(self.t, grid[0] - 1e-9)) - 1, 0)
        b = int(np.searchsorted(self.t, grid[-1] + 1e-9)) + 1
        inside = slice(a, b)
        t = self.t[inside]
        # A knot beyond a gap would distort the spline near the last samples before it.
        near = (t >= grid[0] - 1e-9) & (t <= grid[-1] + self.period)
        found: Floats = CubicSpline(t[near], values[inside][near])(grid)
        return found


def _merge(values: Floats, closest: float) -> tuple[Floats, int]:
    """Average rows with nearly the same time, which is the first column."""
    is_new = np.append(True, np.diff(values[:, 0]) > closest)
    if is_new.all():
        return values, 0
    starts: Integers = np.flatnonzero(is_new)
    counts = np.diff(np.append(starts, len(values)))
    merged: Floats = np.add.reduceat(values, starts) / counts[:, None]
    return merged, len(values) - len(merged)
