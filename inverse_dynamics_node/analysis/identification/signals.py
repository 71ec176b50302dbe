"""
Recorded signals made comparable: on common uniform times, smoothed alike, with accelerations.

A Savitzky-Golay filter fits a polynomial to a window of samples about each time: its value and its
derivatives at that time are the smoothed signal and its rates. It delays nothing, and measured
efforts go through the same window, so that the two sides of a comparison keep in step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...errors import RecordingError
from ...robot.model import Floats, Integers

WINDOWS = {1: (0.10, 3), 2: (0.15, 5)}
"""Window [s] and degree of the polynomial, by how often there is to differentiate: at 3 Hz they
weaken accelerations by 0.2 and 0.5 %; of an encoder's noise of 1e-4 rad at 500 Hz, the second
makes 0.05 rad/s^2."""
SLACK = 4  # samples of the window beyond the degree, at least: or nothing would be smoothed
GAP = 5.0  # periods without a sample: nothing is said of the time in between
TWICE = 0.25  # periods: what is closer together is one sample that came twice
JUMP_BACK = 10.0  # periods: stamps that go back by less are sorted
SLOWEST = 20.0  # [Hz]: below this, accelerations of a robot cannot be told
TRUSTED = 0.5  # velocities that differ by more of their RMS from the rate of positions are none
STILL = 1e-3  # [rad/s or m/s]: a joint that is slower proves no velocity wrong


class Recording(NamedTuple):
    """What was measured of m joints at k times."""

    joint_names: tuple[str, ...]
    times: Floats
    """Shape (k,) [s]; as stamped, jitter, gaps and duplicates included."""
    positions: Floats
    """Shape (k, m) [rad or m]; NaN where a joint was not told of."""
    velocities: Floats | None
    """Shape (k, m) [rad/s or m/s]; NaN where there is none, None where there is none at all."""
    efforts: Floats
    """Shape (k, m) [N m or N]; NaN where there is none."""


class Motion(NamedTuple):
    """The same m joints at K uniform times, gaps apart."""

    joint_names: tuple[str, ...]
    times: Floats
    """Shape (K,) [s], from the first stamp on."""
    q: Floats
    """Shape (K, m) [rad or m]."""
    qd: Floats
    """Shape (K, m) [rad/s or m/s]."""
    qdd: Floats
    """Shape (K, m) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Shape (K, m) [N m or N]; NaN for joints without."""
    window: int
    """Samples that are smoothed over; neighbours within it are not independent."""
    degree: int
    """Of the polynomials that smooth."""
    method: str
    """How it was derived, in words."""
    notes: tuple[str, ...]
    """What was left out or mended, in words."""


def derive(recording: Recording) -> Motion:
    """
    Derive velocities and accelerations where they are missing, and smooth everything alike.

    Parameters
    ----------
    recording : Recording
        Of m joints.

    Returns
    -------
    motion : Motion
        Without the ends that the window spoils, and without the time around gaps.

    Raises
    ------
    RecordingError
        If shapes do not fit, a joint has no position, times go back, or too little is left.

    """
    times = _checked(recording)
    columns = [_Column(recording, times, j) for j in range(len(recording.joint_names))]
    period = max(column.period for column in columns)
    if 1.0 / period < SLOWEST:
        raise RecordingError(
            f'the recording has {1.0 / period:.3g} samples/s, expected at least {SLOWEST:g}: '
            'accelerations cannot be told from so few'
        )
    orders, mistrusted = _orders(columns, period)
    seconds, degree = WINDOWS[max(orders)]
    half = max(round(0.5 * seconds / period), (degree + SLACK) // 2)
    pieces, lost = [], 0.0
    for begin, end in _common_spans(columns):
        count = int((end - begin) / period + 1e-6) + 1
        if count < 4 * half:
            lost += end - begin
            continue
        grid: Floats = begin + period * np.arange(count, dtype=np.float64)
        pieces.append(_smooth(columns, orders, grid, period, (2 * half + 1, degree)))
    if not pieces:
        duration = times[-1] - times[0]
        raise RecordingError(
            f'the recording has no {4 * half * period:.2g} s without a gap (it lasts '
            f'{duration:.3g} s): too little to differentiate'
        )
    instants, q, qd, qdd, efforts = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    notes = _notes(columns, mistrusted, len(pieces), lost)
    method = _method(orders, period, 2 * half + 1, degree)
    window = 2 * half + 1
    names = recording.joint_names
    return Motion(names, instants - times[0], q, qd, qdd, efforts, window, degree, method, notes)


def smooth_alike(motion: Motion, values: Floats) -> Floats:
    """
    Smooth what was computed from a motion as its measured efforts were smoothed.

    Parameters
    ----------
    motion : Motion
        At K times.
    values : ndarray, shape (K, c)
        What turns too quickly to be taken as smooth already: Coulomb friction.

    Returns
    -------
    smoothed : ndarray, shape (K, c)

    """
    from scipy.signal import savgol_filter

    steps = np.diff(motion.times)
    breaks = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1
    pieces = [
        savgol_filter(piece, motion.window, motion.degree, axis=0)
        if len(piece) >= motion.window
        else piece
        for piece in np.split(values, breaks)
    ]
    return np.concatenate(pieces)


class _Column:
    """One joint's samples, in order of time, those that came twice made one."""

    def __init__(self, recording: Recording, times: Floats, joint: int) -> None:
        self.name = recording.joint_names[joint]
        q, tau = recording.positions[:, joint], recording.efforts[:, joint]
        self.has_effort = bool(np.isfinite(tau).any())
        there = np.isfinite(q) & (np.isfinite(tau) | (not self.has_effort))
        if there.sum() < 2:
            raise RecordingError(
                f"joint '{self.name}' has {int(there.sum())} samples with a position"
                + (' and an effort' if self.has_effort else '')
                + ', expected many'
            )
        t = times[there]
        steps = np.diff(t)
        self.period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
        back = np.min(steps)
        if back < -JUMP_BACK * self.period:
            at = float(t[int(np.argmin(steps))] - times[0])
            raise RecordingError(
                f'time goes back by {-back:.3g} s, {at:.3g} s after the start: are these two '
                'recordings in one? Choose one with a start and an end'
            )
        order = np.argsort(t, kind='stable')
        signals = [q, tau]
        if recording.velocities is not None:
            signals.append(recording.velocities[:, joint])
        values = np.column_stack([t, *(signal[there] for signal in signals)])[order]
        values, self.merged = _merge(values, TWICE * self.period)
        self.t, self.q, self.tau = values[:, 0], values[:, 1], values[:, 2]
        self.qd: Floats | None = values[:, 3] if values.shape[1] == 4 else None
        if self.qd is not None and not np.isfinite(self.qd).all():
            self.qd = None

    def spans(self) -> list[tuple[float, float]]:
        """Return the times from gap to gap."""
        breaks = np.flatnonzero(np.diff(self.t) > GAP * self.period)
        starts = [0, *(breaks + 1)]
        ends = [*breaks, len(self.t) - 1]
        return [(self.t[a], self.t[b]) for a, b in zip(starts, ends, strict=True)]

    def at(self, values: Floats, grid: Floats) -> Floats:
        """Interpolate to uniform times that no gap is within."""
        from scipy.interpolate import CubicSpline  # a third of a second, for who needs it only

        a = max(int(np.searchsorted(self.t, grid[0] - 1e-9)) - 1, 0)
        b = int(np.searchsorted(self.t, grid[-1] + 1e-9)) + 1
        inside = slice(a, b)
        t = self.t[inside]
        # A knot on the far side of a gap would pull at the last samples before it.
        near = (t >= grid[0] - 1e-9) & (t <= grid[-1] + self.period)
        found: Floats = CubicSpline(t[near], values[inside][near])(grid)
        return found


def _checked(recording: Recording) -> Floats:
    names = recording.joint_names
    if not names:
        raise RecordingError('no joint names')
    times = np.asarray(recording.times, dtype=float)
    shape = len(times), len(names)
    for what in ('positions', 'velocities', 'efforts'):
        values = getattr(recording, what)
        if values is not None and values.shape != shape:
            raise RecordingError(f'{what} have shape {values.shape}, expected {shape}')
    if len(times) < 2:
        raise RecordingError(f'{len(times)} samples, expected many')
    if not np.isfinite(times).all():
        raise RecordingError(f'a time is {times[~np.isfinite(times)][0]}, expected finite times')
    if not np.isfinite(recording.efforts).any():
        raise RecordingError('no joint has a measured effort: there is nothing to compare')
    return times


def _merge(values: Floats, closest: float) -> tuple[Floats, int]:
    """Make one row of rows whose times, the first column, are nearly the same."""
    is_new = np.append(True, np.diff(values[:, 0]) > closest)
    if is_new.all():
        return values, 0
    starts: Integers = np.flatnonzero(is_new)
    counts = np.diff(np.append(starts, len(values)))
    merged: Floats = np.add.reduceat(values, starts) / counts[:, None]
    return merged, len(values) - len(merged)


def _orders(columns: list[_Column], period: float) -> tuple[list[int], list[str]]:
    """Find how often to differentiate each column: once where it has velocities to trust."""
    from scipy.signal import savgol_filter

    orders, mistrusted = [], []
    for column in columns:
        if column.qd is None:
            orders.append(2)
            continue
        begin, end = max(column.spans(), key=lambda span: span[1] - span[0])
        count = int((end - begin) / period + 1e-6) + 1
        grid: Floats = begin + period * np.arange(count, dtype=np.float64)
        half = max(round(0.5 * WINDOWS[1][0] / period), 3)
        if len(grid) < 4 * half:
            orders.append(1)
            continue
        q = column.at(column.q, grid)
        rate = savgol_filter(q, 2 * half + 1, 3, 1, period)
        told = savgol_filter(column.at(column.qd, grid), 2 * half + 1, 3)
        size, difference = _rms(rate), _rms(rate - told)
        is_wrong = size > STILL and difference > TRUSTED * size
        orders.append(2 if is_wrong else 1)
        if is_wrong:
            mistrusted.append(column.name)
    return orders, mistrusted


def _common_spans(columns: list[_Column]) -> list[tuple[float, float]]:
    """Return the times that no column has a gap in."""
    spans = columns[0].spans()
    for column in columns[1:]:
        theirs = column.spans()
        both = [
            (max(a, c), min(b, d)) for a, b in spans for c, d in theirs if max(a, c) < min(b, d)
        ]
        spans = both
    return spans


def _smooth(
    columns: list[_Column],
    orders: list[int],
    grid: Floats,
    period: float,
    window: tuple[int, int],
) -> tuple[Floats, ...]:
    """Smooth every column over a uniform grid, and cut off the ends that have half a window."""
    from scipy.signal import savgol_filter

    def smooth(values: Floats, order: int = 0) -> Floats:
        result: Floats = savgol_filter(values, *window, deriv=order, delta=period, axis=0)
        return result

    q = np.column_stack([column.at(column.q, grid) for column in columns])
    tau = np.column_stack(
        [
            column.at(column.tau, grid) if column.has_effort else np.zeros(len(grid))
            for column in columns
        ]
    )
    qd, qdd = smooth(q, 1), smooth(q, 2)
    for j, (column, order) in enumerate(zip(columns, orders, strict=True)):
        if order == 1 and column.qd is not None:
            told = column.at(column.qd, grid)
            qd[:, j], qdd[:, j] = smooth(told), smooth(told, 1)
    tau = smooth(tau)
    tau[:, [not column.has_effort for column in columns]] = np.nan
    inner = slice(window[0] // 2, len(grid) - window[0] // 2)
    return grid[inner], smooth(q)[inner], qd[inner], qdd[inner], tau[inner]


def _method(orders: list[int], period: float, window: int, degree: int) -> str:
    if set(orders) == {1}:
        source = 'the recorded velocities, differentiated once'
    elif set(orders) == {2}:
        source = 'the recorded positions, differentiated twice'
    else:
        source = 'the recorded velocities where there are any to trust, else of positions'
    return (
        f'accelerations of {source}: Savitzky-Golay, polynomials of degree {degree} over '
        f'{window} samples ({window * period * 1e3:.0f} ms at {1.0 / period:.4g} Hz); efforts '
        'smoothed over the same window'
    )


def _notes(
    columns: list[_Column], mistrusted: list[str], pieces: int, lost: float
) -> tuple[str, ...]:
    notes = []
    if mistrusted:
        notes.append(
            f'velocities of {", ".join(mistrusted)} are not the rate of the positions; derived '
            'from positions instead'
        )
    merged = max(column.merged for column in columns)
    if merged:
        notes.append(f'{merged} samples came twice (same stamp): averaged')
    if pieces > 1:
        notes.append(f'{pieces - 1} gaps in the recording: derived on each side by itself')
    if lost > 0.0:
        notes.append(f'{lost:.2g} s between gaps are too short to differentiate: left out')
    return tuple(notes)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
