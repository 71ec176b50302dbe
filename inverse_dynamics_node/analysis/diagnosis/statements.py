"""Converts the best hypothesis to faults with their values."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from ...robot.model import Booleans
from .fault import Fault, FaultKind
from .loads import MAX_COM_ERROR
from .regression import Fit
from .rows import OFFSET, ROTOR
from .search import Search

SURE = 5.0  # rotors and offsets are reported above this multiple of their standard errors
LEAST = 0.05  # least effort of rotors and offsets, as a fraction of the RMS effort
MIN_DELAY = 0.01  # [s]; shorter delays are not reported


def faults_of(search: Search, fit: Fit, names: Sequence[str]) -> list[Fault]:
    """Return the faults of the best hypothesis, most important first."""
    h, found = fit.hypothesis, []
    joint = tuple(names)
    if h.window is not None:
        found.append(_temporary(search, fit, joint))
    if h.axes:
        found.append(Fault(FaultKind.REVERSED_AXIS, tuple(joint[j] for j in h.axes)))
    if h.is_late and abs(delay := float(fit.shared['delay'][0])) > MIN_DELAY:
        found.append(Fault(FaultKind.DELAY, values=(delay,)))
    if moved := [j for j, i in enumerate(h.source) if i != j]:
        sources = tuple(joint[h.source[j]] for j in moved)
        found.append(Fault(FaultKind.ORDER, tuple(joint[j] for j in moved), sources=sources))
    if h.other_gravity:
        lacks = search.rows.convention.in_measured
        kind = FaultKind.GRAVITY_COMPENSATED if lacks else FaultKind.GRAVITY_MEASURED
        found.append(Fault(kind, is_commanded=search.rows.convention.in_commands))
    if h.is_tilted:
        found.append(_mounting(search, fit))
    found += _factors(search, fit, joint)
    if h.load:
        found.append(_payload(fit, 'load', h.load))
    drives = {FaultKind.ROTOR_INERTIA: ROTOR}
    if h.has_offsets:
        drives[FaultKind.OFFSET] = OFFSET
    for kind, column in drives.items():
        joints = np.flatnonzero(is_considerable(search, fit, column))
        values = tuple(fit.drives[joints, column].tolist())
        found += [Fault(kind, tuple(joint[j] for j in joints), values)] if values else []
    if unexplained := [joint[j] for j in np.flatnonzero(search.unexplained(fit))]:
        found.append(Fault(FaultKind.UNEXPLAINED, tuple(unexplained)))
    if search.has_wrong_bodies(fit):
        found.append(Fault(FaultKind.BODIES))
    return found


def is_considerable(search: Search, fit: Fit, column: int) -> Booleans:
    """Return for each joint whether its rotor or offset is large and significant, shape (c,)."""
    values, errors = fit.drives[:, column], fit.drive_errors[:, column]
    is_large = np.abs(values) * fit.columns.sizes[:, column] > LEAST * fit.rms
    return np.asarray(is_large & (np.abs(values) > SURE * errors) & search.rows.signals.moves)


def _temporary(search: Search, fit: Fit, names: tuple[str, ...]) -> Fault:
    window = fit.hypothesis.window
    assert window is not None
    if window.kind == 'tilt':
        fault = _mounting(search, fit)
    elif window.kind == 'load':
        fault = _payload(fit, 'window', window.link)
    else:
        fault = Fault(FaultKind.EXTERNAL_FORCE, tuple(names[j] for j in window.joints))
    return fault._replace(interval=(window.begin, window.end))


def _mounting(search: Search, fit: Fit) -> Fault:
    given, found = search.rows.dynamics.gravity, fit.gravity
    cosine = float(given @ found / np.linalg.norm(given) / np.linalg.norm(found))
    angle = math.acos(min(1.0, max(-1.0, cosine)))
    return Fault(FaultKind.MOUNTING, values=tuple(found.tolist()), angle=angle)


def _payload(fit: Fit, name: str, link: str) -> Fault:
    mass, *moments = fit.shared[name].tolist()
    error, *deviations = fit.errors[name].tolist()
    com = [
        moment / mass if deviation < MAX_COM_ERROR * abs(mass) else math.nan
        for moment, deviation in zip(moments, deviations, strict=True)
    ]
    return Fault(FaultKind.PAYLOAD, values=(mass, *com), error=error, link=link)


def _factors(search: Search, fit: Fit, names: tuple[str, ...]) -> list[Fault]:
    """Return the faults of signs and units."""
    h, found = fit.hypothesis, []
    every = Fault(FaultKind.SIGN, names, (-1.0,), is_every_joint=True)
    if h.unit < 0.0:
        found.append(every)
    if abs(h.unit) != 1.0:
        found.append(every._replace(kind=FaultKind.UNIT, values=(abs(h.unit),)))
    shown = search.shows_scale(fit)
    unknown = tuple(name for name, is_known in zip(names, shown, strict=True) if not is_known)
    for kind in (FaultKind.SIGN, FaultKind.SCALE):
        is_sign = kind is FaultKind.SIGN
        factors = {names[j]: factor for j, factor in sorted(h.factors)
                   if (factor == -1.0) is is_sign}  # fmt: skip
        if factors:
            fault = Fault(kind, tuple(factors), tuple(factors.values()))
            is_every = len(factors) > 1 and set(names) <= {*factors, *unknown}
            found.append(
                fault._replace(unknown=() if is_sign else unknown, is_every_joint=is_every)
            )
    return found
