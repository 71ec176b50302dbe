"""
Converts a recording to a motion with uniform times, smoothed signals and derived accelerations.

A Savitzky-Golay filter fits a polynomial to a window of samples around each time. The polynomial
determines the smoothed signal and its derivatives. The filter has no delay. Measured efforts are
smoothed over the same window, so that measured and modelled efforts remain comparable.

The module also estimates the noise of the signals and the lag of recorded velocities. The spectrum
of the efforts shows whether the efforts were filtered before recording.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...errors import RecordingError
from ...robot.model import Booleans, Floats, Integers, RobotModel

WINDOWS = {1: (0.10, 3), 2: (0.15, 5)}
"""
Window [s] and degree of the polynomial, for one and two differentiations.

At 3 Hz, these filters attenuate accelerations by 0.2 % and 0.5 %, respectively. At 500 Hz, two
differentiations turn encoder noise of 1e-4 rad into acceleration noise of 0.05 rad/s^2.
"""
MIN_SLACK = 4  # least difference between window length [samples] and degree of the polynomial
MIN_RATE = 20.0  # lowest sampling rate from which accelerations can be derived [Hz]
GAP = 5.0  # [sampling periods]; signals are not interpolated across longer intervals
DUPLICATE = 0.25  # [sampling periods]; samples at shorter intervals are averaged
JUMP_BACK = 10.0  # [sampling periods]; if time goes back by less, the samples are sorted
MAX_DIFFERENCE = 0.5  # largest relative RMS difference of recorded and derived velocities
CLEAN = 0.05  # acceptable noise of accelerations, as a fraction of their RMS
MIN_SPEED = 1e-3  # [rad/s or m/s]; velocities of slower joints are not checked

MAX_LAG = 0.5  # largest lag to search for [s]
MIN_LAG = 0.01  # [s]; at 1 Hz, smaller lags cause acceleration errors of less than 6 %
LAG_EXPLAINS = 0.25  # largest fraction of the squared difference after a shift by the lag
FINEST = 0.005  # spacing of compared lags [s]
MAX_SHAPE = 0.2  # largest relative difference of shifted and derived velocities

LEAST_REPEATED = 0.002  # fraction of repeated samples that a recorder causes
REGULAR = 0.1  # largest relative spread of the distances between regular repeats

CUTOFFS = (1.0, 8.0)  # [Hz]; filters with a higher cut-off hardly affect smoothed efforts
STEEP = 35.0  # fall over two octaves that shows a filter [dB]; friction falls by only 12 dB
PASSED = 1e-4  # fraction of the largest power; a filter removed frequencies with less power
STILL_FALLING = 20.0  # further fall up to the highest octave [dB]; noise does not fall
OUTLIERS = 1.4826  # standard deviation divided by median deviation, in a normal distribution


class Recording(NamedTuple):
    """Measured states of m joints at k times."""

    joint_names: tuple[str, ...]
    times: Floats
    """Time stamps, shape (k,) [s]; jitter, gaps and duplicates are possible."""
    positions: Floats
    """Positions, shape (k, m) [rad or m]; NaN if missing in a message."""
    velocities: Floats | None
    """Velocities, shape (k, m) [rad/s or m/s]; NaN if missing; None if never recorded."""
    efforts: Floats
    """Efforts, shape (k, m) [N m or N]; NaN if missing in a message."""


class Motion(NamedTuple):
    """Smoothed states of m joints at K times, which are uniform except at gaps."""

    times: Floats
    """Times since the first stamp, shape (K,) [s]."""
    q: Floats
    """Positions, shape (K, m) [rad or m]."""
    qd: Floats
    """Velocities, shape (K, m) [rad/s or m/s]."""
    qdd: Floats
    """Accelerations, shape (K, m) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Efforts, shape (K, m) [N m or N]; NaN for joints without measured effort."""
    window: int
    """Number of samples in the smoothing window. Samples within a window are correlated."""
    degree: int
    """Degree of the smoothing polynomials."""
    joint_names: tuple[str, ...] = ()
    method: str = ''
    """Description of the filter."""
    notes: tuple[str, ...] = ()
    """Descriptions of ignored or repaired data."""
    effort_noise: Floats = np.zeros(0)
    """Noise that remains in the smoothed efforts, shape (m,) [N m or N]; NaN without efforts."""
    qdd_noise: Floats = np.zeros(0)
    """Noise of the accelerations, shape (m,) [rad/s^2 or m/s^2]."""
    cut_off: float = math.inf
    """Cut-off frequency [Hz] of a filter applied to efforts before recording; inf if none."""
    raw_efforts: Floats = np.zeros((0, 0))
    """Efforts before smoothing, shape (K, m) [N m or N]."""
    qd_noise: Floats = np.zeros(0)
    """
    Noise of the recorded velocities, including quantisation, shape (m,) [rad/s or m/s].

    Joints without recorded velocities have the noise of the derived velocities.
    """

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return float(np.median(np.diff(self.times)))


def without_turns(robot: RobotModel, recording: Recording) -> Recording:
    """Remove jumps by whole turns from the positions of continuous joints."""
    positions = recording.positions.copy()
    for j, name in enumerate(recording.joint_names):
        if robot.is_continuous[robot.joint_names.index(name)]:
            is_known = np.isfinite(positions[:, j])
            positions[is_known, j] = np.unwrap(positions[is_known, j])
    return recording._replace(positions=positions)


def derive(recording: Recording) -> Motion:
    """
    Smooth all signals of a recording, and derive missing velocities and all accelerations.

    Samples that repeat the one before are removed. Half a window is removed at the start, at the
    end, and on both sides of each gap. Raise RecordingError if shapes differ, if a joint has no
    position, if time goes back, if the recording is too short, or if the sampling rate is too low.
    """
    times = _checked(recording)
    recording, notes = without_repeats(recording._replace(times=times))
    times = recording.times
    columns = [RecordedColumn(recording, times, j) for j in range(len(recording.joint_names))]
    period = max(column.period for column in columns)
    if 1.0 / period < MIN_RATE:
        raise RecordingError(
            f'the recording has {1.0 / period:.3g} samples/s, expected at least {MIN_RATE:g}; '
            'accelerations cannot be derived from fewer samples'
        )
    orders, inconsistent = _orders(columns, period)
    window, degree = _window(max(orders), period), WINDOWS[max(orders)][1]
    pieces, grids, lost = [], [], 0.0
    for begin, end in _common_spans(columns):
        grid = _grid(begin, end, period)
        if len(grid) < 2 * window:
            lost += end - begin
            continue
        pieces.append(_smooth(columns, orders, grid, period, (window, degree)))
        grids.append(grid)
    if not pieces:
        duration = times[-1] - times[0]
        raise RecordingError(
            'every gap-free interval of the recording is too short to be differentiated, '
            f'expected at least {2 * window * period:.2g} s; the recording lasts {duration:.3g} s'
        )
    instants, q, qd, qdd, efforts, raw = (
        np.concatenate(parts) for parts in zip(*pieces, strict=True)
    )
    notes += _notes(columns, inconsistent, len(pieces), lost)
    longest = max(grids, key=len)
    noise = [
        _noise(column, order, longest, period, window, degree)
        for column, order in zip(columns, orders, strict=True)
    ]
    cut_offs = [
        cut_off(column.at(column.tau, longest), period) for column in columns if column.varies
    ]
    return Motion(
        instants - times[0],
        q,
        qd,
        qdd,
        efforts,
        window,
        degree,
        recording.joint_names,
        _method(orders, period, window, degree),
        notes,
        effort_noise=np.array([each[0] for each in noise]),
        qdd_noise=np.array([each[1] for each in noise]),
        cut_off=float(np.median(cut_offs)) if cut_offs else math.inf,
        raw_efforts=raw,
        qd_noise=np.array([each[2] for each in noise]),
    )


def _grid(begin: float, end: float, period: float) -> Floats:
    """Return uniform times from `begin` to at most `end`."""
    count = int((end - begin) / period + 1e-6) + 1
    return np.asarray(begin + period * np.arange(count, dtype=np.float64))


def _checked(recording: Recording) -> Floats:
    names = recording.joint_names
    if not names:
        raise RecordingError('the recording has no joint names')
    times = np.asarray(recording.times, dtype=float)
    shape = len(times), len(names)
    for what in ('positions', 'velocities', 'efforts'):
        values = getattr(recording, what)
        if values is not None and values.shape != shape:
            raise RecordingError(f'{what} have shape {values.shape}, expected {shape}')
    if len(times) < 2:
        raise RecordingError(f'the number of samples is {len(times)}, expected at least 2')
    if not np.isfinite(times).all():
        raise RecordingError(
            f'one of the times is {times[~np.isfinite(times)][0]}, expected finite times'
        )
    if not np.isfinite(recording.efforts).any():
        raise RecordingError('no joint has a measured effort')
    return times


def _orders(columns: list[RecordedColumn], period: float) -> tuple[list[int], list[str]]:
    """
    Return the number of differentiations per joint, and the joints with wrong velocities.

    Velocities that agree with the positions are differentiated once. Positions are differentiated
    twice if the velocities contradict them, for example because a filter delays the velocities, or
    if the velocities lead to noisier accelerations.
    """
    from scipy.signal import savgol_filter

    orders: list[int] = []
    wrong: list[str] = []
    windows = {order: (_window(order, period), WINDOWS[order][1]) for order in WINDOWS}
    for column in columns:
        orders.append(2 if column.qd is None else 1)
        if column.qd is None:
            continue
        grid = _grid(*max(column.spans(), key=lambda span: span[1] - span[0]), period)
        if len(grid) < 2 * windows[2][0]:
            continue
        rate = savgol_filter(column.at(column.q, grid), *windows[1], 1, period)
        recorded = savgol_filter(column.at(column.qd, grid), *windows[1])
        changes = savgol_filter(column.at(column.qd, grid), *windows[1], 1, period)
        noise = [_noise(column, k, grid, period, *windows[k])[1] for k in (1, 2)]
        is_wrong = rms(rate - recorded) > MAX_DIFFERENCE * rms(rate)
        if rms(rate) > MIN_SPEED and (is_wrong or lag(recorded, rate, period)):
            wrong.append(column.name)
            orders[-1] = 2
        elif noise[0] > max(CLEAN * float(rms(changes)), noise[1]):
            orders[-1] = 2
    return orders, wrong


def _window(order: int, period: float) -> int:
    """Return the number of samples in the smoothing window for 1 or 2 differentiations."""
    seconds, degree = WINDOWS[order]
    return 2 * max(round(0.5 * seconds / period), (degree + MIN_SLACK) // 2) + 1


def _common_spans(columns: list[RecordedColumn]) -> list[tuple[float, float]]:
    """Return the intervals in which no column has a gap."""
    spans = columns[0].spans()
    for column in columns[1:]:
        others = column.spans()
        spans = [
            (max(a, c), min(b, d)) for a, b in spans for c, d in others if max(a, c) < min(b, d)
        ]
    return spans


def _smooth(
    columns: list[RecordedColumn],
    orders: list[int],
    grid: Floats,
    period: float,
    window: tuple[int, int],
) -> tuple[Floats, ...]:
    """Smooth each column on a uniform grid, and remove half a window from both ends."""
    from scipy.signal import savgol_filter

    def smooth(values: Floats, order: int = 0) -> Floats:
        return np.asarray(savgol_filter(values, *window, deriv=order, delta=period, axis=0))

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
            recorded = column.at(column.qd, grid)
            qd[:, j], qdd[:, j] = smooth(recorded), smooth(recorded, 1)
    efforts = np.stack([smooth(tau), tau])
    efforts[:, :, [not column.has_effort for column in columns]] = np.nan
    inner = slice(window[0] // 2, len(grid) - window[0] // 2)
    return grid[inner], smooth(q)[inner], qd[inner], qdd[inner], *efforts[:, inner]


def _noise(
    column: RecordedColumn, order: int, grid: Floats, period: float, window: int, degree: int
) -> tuple[float, float, float]:
    """Estimate the noise of the smoothed effort, the acceleration and the velocity of a column."""
    from scipy.signal import savgol_coeffs, savgol_filter

    centre = float(savgol_coeffs(window, degree)[window // 2])

    def noise(values: Floats) -> float:
        return white_noise(values, savgol_filter(values, window, degree), centre)

    def derived(values: Floats, order: int) -> float:
        derivative = savgol_coeffs(window, degree, deriv=order, delta=period)
        # The filter multiplies white noise by the square root of its centre weight.
        return float(np.linalg.norm(derivative)) / math.sqrt(centre) * noise(values)

    q = column.at(column.q, grid)
    velocity, acceleration = derived(q, 1), derived(q, 2)
    if column.qd is not None:
        qd = column.at(column.qd, grid)
        # At rest, a velocity may alternate between two adjacent values.
        velocity = math.hypot(noise(qd) / math.sqrt(centre), resolution(column.qd))
        acceleration = derived(qd, 1) if order == 1 else acceleration
    effort = noise(column.at(column.tau, grid)) if column.has_effort else math.nan
    return effort, acceleration, velocity


def _method(orders: list[int], period: float, window: int, degree: int) -> str:
    if set(orders) == {1}:
        source = 'the recorded velocities, differentiated once'
    elif set(orders) == {2}:
        source = 'the recorded positions, differentiated twice'
    else:
        source = 'recorded velocities if they match the positions, and otherwise from positions'
    return (
        f'accelerations derived from {source}, with a Savitzky-Golay filter of degree {degree} '
        f'over {window} samples ({window * period * 1e3:.0f} ms at {1.0 / period:.4g} Hz); '
        'efforts smoothed over the same window'
    )


def _notes(
    columns: list[RecordedColumn], inconsistent: list[str], pieces: int, lost: float
) -> tuple[str, ...]:
    notes = []
    if inconsistent:
        notes.append(
            f'recorded velocities of {", ".join(inconsistent)} do not match the positions or lag '
            'behind them; velocities were derived from the positions instead'
        )
    merged = max(column.merged for column in columns)
    if merged:
        notes.append(f'averaged {merged} samples with duplicate time stamps')
    if pieces > 1:
        notes.append(f'because of gaps, the recording was differentiated in {pieces} pieces')
    if lost > 0.0:
        notes.append(
            f'ignored {lost:.2g} s in gap-free pieces that are too short to be differentiated'
        )
    return tuple(notes)


def rms(values: Floats) -> Floats:
    """Return the root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


# ---- Repeated samples ----------------------------------------------------------------------


def without_repeats(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """
    Remove samples that repeat the one before although the robot moves, and describe this in notes.

    A recorder that is faster than the hardware repeats samples. If the repeats come at regular
    distances, the hardware samples evenly, but the stamps of the other samples run ahead until the
    next repeat. The samples are then spread evenly.
    """
    velocities = recording.velocities
    signals = [recording.positions, recording.efforts]
    values = np.hstack(signals if velocities is None else [*signals, velocities])
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    is_repeat = np.append(False, same.all(axis=1))
    starts: Integers = np.flatnonzero(~is_repeat)
    lengths = np.diff(np.append(starts, len(values)))
    following = np.append(starts[1:], len(values) - 1)
    moves = (recording.positions[following] != recording.positions[starts]).any(axis=1)
    moves[-1] = True  # unknown
    # A long run of equal samples is a rest, even if a motion follows.
    moves &= lengths <= max(3, 2 * np.median(lengths))
    is_repeat &= np.repeat(moves, lengths)
    repeats = np.flatnonzero(is_repeat)
    if len(repeats) < LEAST_REPEATED * len(values):
        return recording, ()
    kept = np.flatnonzero(~is_repeat)
    times, rate = recording.times[kept], 1.0 / float(np.median(np.diff(recording.times)))
    note = f'removed {len(repeats)} samples that repeat the one before while the robot moves'
    distances = np.diff(repeats[np.append(True, np.diff(repeats) > 1)])
    if len(distances) > 1 and np.ptp(np.quantile(distances, (0.1, 0.9))) <= max(
        1.0, REGULAR * float(np.median(distances))
    ):
        times = _spread(times, is_repeat[np.minimum(kept + 1, len(values) - 1)])
        slower = 1.0 / float(np.median(np.diff(times)))
        note += (
            f'; these samples come at regular distances, because {rate:.4g} samples/s were '
            f'recorded of a source with {slower:.4g} samples/s; the other samples were spread '
            'evenly'
        )
    return Recording(
        recording.joint_names,
        times,
        recording.positions[kept],
        None if velocities is None else velocities[kept],
        recording.efforts[kept],
    ), (note,)


def _spread(times: Floats, was_repeated: Booleans) -> Floats:
    """Space times evenly between gaps; only the stamps of repeated samples are right."""
    breaks = np.flatnonzero(np.diff(times) > GAP * np.median(np.diff(times))) + 1
    spread = times.copy()
    for part in np.split(np.arange(len(times)), breaks):
        right = part[was_repeated[part]]
        if len(right) > 1:
            line = np.polyfit(right - right[0], times[right] - times[right[0]], 1)
            spread[part] = times[right[0]] + np.polyval(line, part - right[0])
    return np.asarray(spread)


# ---- One joint -----------------------------------------------------------------------------


class RecordedColumn:
    """Samples of one joint in order of time, without duplicates."""

    def __init__(self, recording: Recording, times: Floats, joint: int) -> None:
        self.name = recording.joint_names[joint]
        q, tau = recording.positions[:, joint], recording.efforts[:, joint]
        self.has_effort = bool(np.isfinite(tau).any())
        is_complete = np.isfinite(q) & (np.isfinite(tau) | (not self.has_effort))
        if is_complete.sum() < 2:
            raise RecordingError(
                'the number of samples with a position'
                f'{" and an effort" * self.has_effort} of joint '
                f"'{self.name}' is {int(is_complete.sum())}, expected at least 2"
            )
        t = times[is_complete]
        steps = np.diff(t)
        self.period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
        back = np.min(steps)
        if back < -JUMP_BACK * self.period:
            at = float(t[int(np.argmin(steps))] - times[0])
            raise RecordingError(
                f'time goes back by {-back:.3g} s, {at:.3g} s after the start; if the file '
                'contains two recordings, select one of them with its start and end time'
            )
        order = np.argsort(t, kind='stable')
        velocities = recording.velocities
        qd = np.full(len(q), np.nan) if velocities is None else velocities[:, joint]
        values = np.column_stack([times, q, tau, qd])[is_complete][order]
        values, self.merged = _merge(values, DUPLICATE * self.period)
        self.t, self.q, self.tau, qd = values.T
        self.qd = qd if np.isfinite(qd).all() else None
        self.varies = self.has_effort and bool(np.ptp(self.tau) > 0.0)

    def spans(self) -> list[tuple[float, float]]:
        """Return the start and end of each interval without gaps [s]."""
        breaks = np.flatnonzero(np.diff(self.t) > GAP * self.period)
        starts = [0, *(breaks + 1)]
        ends = [*breaks, len(self.t) - 1]
        return [(self.t[a], self.t[b]) for a, b in zip(starts, ends, strict=True)]

    def at(self, values: Floats, grid: Floats) -> Floats:
        """Interpolate values at uniform times that lie between two gaps."""
        from scipy.interpolate import CubicSpline  # the import takes 0.3 s

        a = max(int(np.searchsorted(self.t, grid[0] - 1e-9)) - 1, 0)
        b = int(np.searchsorted(self.t, grid[-1] + 1e-9)) + 1
        inside = slice(a, b)
        t = self.t[inside]
        # A knot beyond a gap would distort the spline near the last samples before the gap.
        near = (t >= grid[0] - 1e-9) & (t <= grid[-1] + self.period)
        return np.asarray(CubicSpline(t[near], values[inside][near])(grid))


def _merge(values: Floats, closest: float) -> tuple[Floats, int]:
    """Average rows with nearly equal times. The first column contains the times."""
    is_new = np.append(True, np.diff(values[:, 0]) > closest)
    if is_new.all():
        return values, 0
    starts: Integers = np.flatnonzero(is_new)
    counts = np.diff(np.append(starts, len(values)))
    merged: Floats = np.add.reduceat(values, starts) / counts[:, None]
    return merged, len(values) - len(merged)


# ---- Quality of uniform signals ------------------------------------------------------------


def white_noise(values: Floats, smoothed: Floats, centre_weight: float) -> float:
    """
    Estimate the standard deviation of the white noise that a Savitzky-Golay filter leaves.

    `centre_weight` is the weight that the filter gives to the middle sample. It equals the sum of
    all squared weights, because the filter is a projection.
    """
    removed = values - smoothed
    deviation = OUTLIERS * float(np.median(np.abs(removed - np.median(removed))))
    return deviation * math.sqrt(centre_weight / max(1.0 - centre_weight, 1e-9))


def resolution(values: Floats) -> float:
    """Return the step between quantised values, or 0 if no quantisation is evident."""
    levels = np.unique(values)
    # A quantised signal repeats its values, and all steps are multiples of the smallest step.
    if len(levels) < 3 or len(levels) > 0.2 * len(values):
        return 0.0
    multiples = np.diff(levels) / float(np.min(np.diff(levels)))
    is_grid = np.abs(multiples - np.round(multiples)) < 0.05
    return float(np.median(np.diff(levels))) if float(np.mean(is_grid)) > 0.9 else 0.0


def lag(recorded: Floats, derived: Floats, period: float) -> float:
    """
    Return the lag of the recorded velocity behind the derived velocity [s].

    Both velocities must be smooth. The result is 0 if no lag explains the difference. `period` is
    the sampling period [s].
    """
    # The signals are smooth, so fewer samples contain the same information.
    every = max(1, round(FINEST / period))
    recorded, derived, period = recorded[::every], derived[::every], every * period
    most = min(round(MAX_LAG / period), len(recorded) // 4)
    if most < 1:
        return 0.0
    middle = derived[most : len(derived) - most]
    shifts = np.arange(-most, most + 1)
    windows = np.lib.stride_tricks.sliding_window_view(recorded, len(middle))
    squares = np.array([np.mean((windows[most + k] - middle) ** 2) for k in shifts])
    best = int(np.argmin(squares))
    size = float(np.mean(middle**2))
    if squares[best] > LAG_EXPLAINS * squares[most] or squares[best] > MAX_SHAPE**2 * size:
        return 0.0
    found = float(shifts[best])
    if 0 < best < len(shifts) - 1:
        before, at, after = squares[best - 1 : best + 2]
        curvature = before - 2.0 * at + after
        found += 0.5 * float(before - after) / float(curvature) if curvature > 0.0 else 0.0
    return found * period if found * period >= MIN_LAG else 0.0


def cut_off(efforts: Floats, period: float) -> float:
    """
    Return the cut-off frequency [Hz] of a filter applied to the efforts before recording.

    Sensor noise reaches up to half the sampling rate. If the spectrum falls steeply at a few hertz
    and continues to fall, a filter has removed the noise. The result is inf if there was no
    filter. `efforts` are the recorded efforts before smoothing. `period` is the sampling period
    [s].
    """
    count = len(efforts)
    line = np.linspace(efforts[0], efforts[-1], count)
    power = np.abs(np.fft.rfft((efforts - line) * np.hanning(count))) ** 2
    frequencies: Floats = np.fft.rfftfreq(count, period).astype(np.float64)
    nyquist = 0.5 / period

    def level(low: float, high: float) -> float:
        chosen = (frequencies >= low) & (frequencies < high)
        return 10.0 * math.log10(float(np.mean(power[chosen])) + 1e-300) if chosen.any() else 0.0

    if not power.any():
        return math.inf
    highest = level(0.5 * nyquist, nyquist)
    frequencies_tried = np.geomspace(*CUTOFFS, 13)
    for frequency in frequencies_tried[frequencies_tried <= nyquist / 8.0]:
        above = level(2.0 * frequency, 4.0 * frequency)
        falls = level(0.5 * frequency, frequency) - above
        if falls > STEEP and above - highest > STILL_FALLING:
            return _passed(frequencies, power)
    return math.inf


def _passed(frequencies: Floats, power: Floats) -> float:
    """Return the highest frequency [Hz] at which a spectrum has significant power."""
    octaves = [
        (f, float(np.mean(found)))
        for f in np.geomspace(0.25, 0.25 * frequencies[-1], 40)
        if len(found := power[(frequencies >= f) & (frequencies < 2.0 * f)])
    ]
    largest = max(value for _, value in octaves)
    # Return the geometric mean of both ends of the octave.
    return float(max(f for f, value in octaves if value > PASSED * largest) * math.sqrt(2.0))
