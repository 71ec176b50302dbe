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
DUPLICATE = 0.25  # [sampling periods]; samples at shorter intervals are ignored
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
    qd_noise: Floats = np.zeros(0)
    """
    Noise of the recorded velocities, including quantisation, shape (m,) [rad/s or m/s].

    Joints without recorded velocities have the noise of the derived velocities.
    """
    cut_off: float = math.inf
    """Cut-off frequency [Hz] of a filter applied to efforts before recording; inf if none."""

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


def derive(recording: Recording, highest_rate: float = math.inf) -> Motion:
    """
    Smooth all signals of a recording, and derive missing velocities and all accelerations.

    `highest_rate` limits the sampling rate of the smoothed signals [Hz]. Samples that repeat the
    one before are removed. Half a window is removed at the start, at the end, and on both sides of
    each gap. Raise RecordingError if shapes differ, if a joint has no position, if time goes back,
    if the recording is too short, or if the sampling rate is too low.
    """
    _check(recording)
    start = recording.times[0]
    recording, notes = without_repeats(recording)
    joints = [_joint_samples(recording, j) for j in range(len(recording.joint_names))]
    period = max(joint.period for joint in joints)
    if 1.0 / period < MIN_RATE:
        raise RecordingError(
            f'the recording has {1.0 / period:.3g} samples/s, expected at least {MIN_RATE:g}; '
            'accelerations cannot be derived from fewer samples'
        )
    grids = [_grid(*span, period) for span in _common_spans(joints)]
    least = 2 * _window(2, period)[0]
    lost = sum(float(np.ptp(grid)) for grid in grids if len(grid) < least)
    grids = [grid for grid in grids if len(grid) >= least]
    if not grids:
        raise RecordingError(
            'every gap-free interval of the recording is too short to be differentiated, '
            f'expected at least {least * period:.2g} s; the recording lasts '
            f'{recording.times[-1] - start:.3g} s'
        )
    pieces = [_piece(recording, joints, grid) for grid in grids]
    longest = max(pieces, key=lambda piece: piece.shape[1])
    orders, wrong = _orders(longest, joints, period)
    order = int(orders.max())
    window, degree = _window(order, period)
    step = max(1, int(1.0 / (period * highest_rate) + 1e-9))
    smoothed = [_smoothed(piece, orders, window, degree, period, step) for piece in pieces]
    q, qd, qdd, efforts = np.concatenate(smoothed, axis=1)
    has_effort = np.array([joint.has_effort for joint in joints])
    efforts[:, ~has_effort] = np.nan
    varying = [tau for tau in longest[2][:, has_effort].T if np.ptp(tau) > 0.0]
    noises = _noises(longest, joints, orders, window, degree, period)
    return Motion(
        np.concatenate([_inner(grid, window)[::step] for grid in grids]) - start,
        q,
        qd,
        qdd,
        efforts,
        2 * (window // (2 * step)) + 1,
        degree,
        recording.joint_names,
        _method(orders, window, degree, period),
        (*notes, *_notes(joints, wrong, len(grids), lost)),
        np.where(has_effort, noises[0], np.nan),
        *noises[1:],
        float(np.median([cut_off(tau, period) for tau in varying])) if varying else math.inf,
    )


def _check(recording: Recording) -> None:
    names, times = recording.joint_names, recording.times
    if not names:
        raise RecordingError('the recording has no joint names')
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


# ---- Uniform samples -----------------------------------------------------------------------


def _grid(begin: float, end: float, period: float) -> Floats:
    """Return uniform times from `begin` to at most `end`."""
    count = int((end - begin) / period + 1e-6) + 1
    return np.asarray(begin + period * np.arange(count, dtype=np.float64))


def _window(order: int, period: float) -> tuple[int, int]:
    """Return window [samples] and degree of the filter for 1 or 2 differentiations."""
    seconds, degree = WINDOWS[order]
    return 2 * max(round(0.5 * seconds / period), (degree + MIN_SLACK) // 2) + 1, degree


def _inner(values: Floats, window: int) -> Floats:
    """Remove half a window from both ends."""
    return values[window // 2 : len(values) - window // 2]


def _filtered(
    values: Floats, window: int, degree: int, order: int = 0, period: float = 1.0
) -> Floats:
    """Smooth or differentiate uniform samples, and remove half a window from both ends."""
    from scipy.signal import savgol_filter

    return _inner(
        savgol_filter(values, window, degree, order, period, axis=0, mode='nearest'), window
    )


def _smoothed(
    piece: Floats, orders: Integers, window: int, degree: int, period: float, step: int
) -> Floats:
    """
    Return positions, velocities, accelerations and efforts, shape (4, samples, joints).

    Of the smoothed samples, each `step`-th one is returned.
    """

    def filtered(values: Floats, order: int) -> Floats:
        return np.array(_filtered(values, window, degree, order, period)[::step])

    q, qd, tau = piece
    found = np.stack([filtered(q, 0), filtered(q, 1), filtered(q, 2), filtered(tau, 0)])
    if (is_recorded := orders == 1).any():
        found[1:3, :, is_recorded] = [filtered(qd[:, is_recorded], order) for order in (0, 1)]
    return found


def _orders(
    piece: Floats, joints: list[JointSamples], period: float
) -> tuple[Integers, list[str]]:
    """
    Return the number of differentiations per joint, and the joints with wrong velocities.

    Velocities that agree with the positions are differentiated once. Positions are differentiated
    twice if the velocities contradict them, for example because a filter delays the velocities, or
    if the velocities lead to noisier accelerations.
    """
    q, qd, _ = piece
    once, twice = _window(1, period), _window(2, period)
    rates, recorded = _filtered(q, *once, 1, period), _filtered(qd, *once)
    noise = white_noise(qd, *once) * _gain(*once, 1, period)
    noise_of_q = white_noise(q, *twice) * _gain(*twice, 2, period)
    is_noisy = noise > np.maximum(CLEAN * rms(_filtered(qd, *once, 1, period)), noise_of_q)
    is_wrong = rms(rates - recorded) > MAX_DIFFERENCE * rms(rates)
    has_velocity = np.array([joint.has_velocity for joint in joints])
    for j in np.flatnonzero(has_velocity & ~is_wrong):
        is_wrong[j] = lag(recorded[:, j], rates[:, j], period) > 0.0
    is_wrong &= has_velocity & (rms(rates) > MIN_SPEED)
    wrong = [joint.name for joint, each in zip(joints, is_wrong, strict=True) if each]
    return np.where(~has_velocity | is_wrong | is_noisy, 2, 1), wrong


def white_noise(values: Floats, window: int, degree: int) -> Floats:
    """Estimate the white noise of uniform samples, from what a Savitzky-Golay filter removes."""
    removed = _inner(values, window) - _filtered(values, window, degree)
    deviation = OUTLIERS * np.median(np.abs(removed - np.median(removed, axis=0)), axis=0)
    # The filter is a projection, so it leaves this fraction of the variance.
    left = _gain(window, degree) ** 2
    return np.asarray(deviation / math.sqrt(max(1.0 - left, 1e-9)))


def _gain(window: int, degree: int, order: int = 0, period: float = 1.0) -> float:
    """Return the factor by which a Savitzky-Golay filter multiplies white noise."""
    from scipy.signal import savgol_coeffs

    return float(np.linalg.norm(savgol_coeffs(window, degree, deriv=order, delta=period)))


def _noises(
    piece: Floats,
    joints: list[JointSamples],
    orders: Integers,
    window: int,
    degree: int,
    period: float,
) -> tuple[Floats, Floats, Floats]:
    """Estimate the noise of smoothed efforts, of accelerations and of velocities."""
    q, qd, tau = (white_noise(values, window, degree) for values in piece)
    _, once, twice = (_gain(window, degree, order, period) for order in range(3))
    # At rest, a velocity may alternate between two adjacent values.
    steps = [joint.velocity_step for joint in joints]
    has_velocity = [joint.has_velocity for joint in joints]
    return (
        tau * _gain(window, degree),
        np.where(orders == 1, qd * once, q * twice),
        np.where(has_velocity, np.hypot(qd, steps), q * once),
    )


def _method(orders: Integers, window: int, degree: int, period: float) -> str:
    source = 'recorded velocities if they match the positions, and otherwise from positions'
    if orders.max() == 1:
        source = 'the recorded velocities, differentiated once'
    elif orders.min() == 2:
        source = 'the recorded positions, differentiated twice'
    return (
        f'accelerations derived from {source}, with a Savitzky-Golay filter of degree {degree} '
        f'over {window} samples ({window * period * 1e3:.0f} ms at {1.0 / period:.4g} Hz); '
        'efforts smoothed over the same window'
    )


def _notes(
    joints: list[JointSamples], wrong: list[str], pieces: int, lost: float
) -> tuple[str, ...]:
    notes = []
    if wrong:
        notes.append(
            f'recorded velocities of {", ".join(wrong)} do not match the positions or lag '
            'behind them; velocities were derived from the positions instead'
        )
    if duplicates := max(joint.duplicates for joint in joints):
        notes.append(f'ignored {duplicates} samples with duplicate time stamps')
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


class JointSamples(NamedTuple):
    """Which samples of a recording are those of one joint, without missing values."""

    name: str
    rows: Integers
    """Rows of the recording, in order of time and without duplicates, shape (n,)."""
    times: Floats
    """Times of the rows, shape (n,) [s]."""
    period: float
    """Median sampling period [s]."""
    has_velocity: bool
    velocity_step: float
    """Difference between adjacent values of a quantised velocity, or 0 [rad/s or m/s]."""
    has_effort: bool
    duplicates: int
    """Number of samples with duplicate times."""

    def spans(self) -> list[tuple[float, float]]:
        """Return the start and end of each interval without gaps [s]."""
        breaks = np.flatnonzero(np.diff(self.times) > GAP * self.period)
        starts, ends = self.times[[0, *(breaks + 1)]], self.times[[*breaks, -1]]
        return list(zip(starts.tolist(), ends.tolist(), strict=True))

    def at(self, values: Floats, grid: Floats) -> Floats:
        """Interpolate a column of the recording at uniform times that lie between two gaps."""
        from scipy.interpolate import CubicSpline  # the import takes 0.3 s

        # A knot beyond a gap would distort the spline near the last samples before the gap.
        first, end = np.searchsorted(self.times, [grid[0] - 1e-9, grid[-1] + self.period])
        return np.asarray(CubicSpline(self.times[first:end], values[self.rows[first:end]])(grid))


def _joint_samples(recording: Recording, j: int) -> JointSamples:
    """Return the samples of a joint; raise RecordingError if they are too few or not in order."""
    name, velocities = recording.joint_names[j], recording.velocities
    has_effort = bool(np.isfinite(recording.efforts[:, j]).any())
    is_complete = np.isfinite(recording.positions[:, j])
    if has_effort:
        is_complete &= np.isfinite(recording.efforts[:, j])
    rows: Integers = np.flatnonzero(is_complete)
    if len(rows) < 2:
        raise RecordingError(
            f'the number of samples with a position{" and an effort" * has_effort} of joint '
            f"'{name}' is {len(rows)}, expected at least 2"
        )
    steps = np.diff(recording.times[rows])
    period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
    if (back := float(np.min(steps))) < -JUMP_BACK * period:
        at = float(recording.times[rows[int(np.argmin(steps))]] - recording.times[0])
        raise RecordingError(
            f'time goes back by {-back:.3g} s, {at:.3g} s after the start; if the file '
            'contains two recordings, select one of them with its start and end time'
        )
    rows = rows[np.argsort(recording.times[rows], kind='stable')]
    is_new = np.append(True, np.diff(recording.times[rows]) > DUPLICATE * period)
    duplicates = int(np.count_nonzero(~is_new))
    rows = rows[is_new]
    qd = np.full(len(rows), np.nan) if velocities is None else velocities[rows, j]
    has_velocity = bool(np.isfinite(qd).all())
    step = resolution(qd) if has_velocity else 0.0
    times = recording.times[rows]
    return JointSamples(name, rows, times, period, has_velocity, step, has_effort, duplicates)


def _piece(recording: Recording, joints: list[JointSamples], grid: Floats) -> Floats:
    """Return positions, velocities and efforts at uniform times; zero if not recorded."""
    piece = np.zeros((3, len(grid), len(joints)))
    for j, joint in enumerate(joints):
        piece[0, :, j] = joint.at(recording.positions[:, j], grid)
        if joint.has_velocity and recording.velocities is not None:
            piece[1, :, j] = joint.at(recording.velocities[:, j], grid)
        if joint.has_effort:
            piece[2, :, j] = joint.at(recording.efforts[:, j], grid)
    return piece


def _common_spans(joints: list[JointSamples]) -> list[tuple[float, float]]:
    """Return the intervals in which no joint has a gap."""
    spans = joints[0].spans()
    for joint in joints[1:]:
        others = joint.spans()
        spans = [
            (max(a, c), min(b, d)) for a, b in spans for c, d in others if max(a, c) < min(b, d)
        ]
    return spans


# ---- Quality of uniform signals ------------------------------------------------------------


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
