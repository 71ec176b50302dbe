"""Converts the best hypothesis to faults with their values and effects."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from ...robot.model import Floats
from .fault import Change, Fault, FaultKind
from .loads import MAX_COM_ERROR
from .regression import Fit, Hypothesis
from .rows import COULOMB, OFFSET, ROTOR
from .search import Search

CHANGED = 0.9  # a fault affects a joint if the correction leaves a smaller fraction of the RMS
FRICTION = 0.03  # Coulomb friction above this fraction of a joint's RMS effort is considerable
SURE = 5.0  # rotors and offsets are reported above this multiple of their standard errors
LEAST_ROTOR, LEAST_OFFSET = 0.05, 0.05  # least efforts, as a fraction of the RMS effort
MIN_DELAY = 0.01  # [s]; shorter delays are not reported


def faults_of(search: Search, fit: Fit, names: Sequence[str]) -> list[Fault]:
    """Return the faults of the best hypothesis, most important first."""
    return _Statements(search, fit, names).faults()


class _Statements:
    def __init__(self, search: Search, fit: Fit, names: Sequence[str]) -> None:
        self.search, self.fit, self.names = search, fit, tuple(names)
        self.rows, self.count = search.rows, len(names)
        self.used = self.rows.signals.used
        self.after = self._rms(fit)
        moves = self.rows.signals.moves
        friction = fit.drives[:, COULOMB] > FRICTION * fit.rms
        is_motor_side = 2 * int(np.sum(friction & moves)) > int(np.sum(moves))
        self.is_motor_side = is_motor_side

    def faults(self) -> list[Fault]:
        """Return the faults, most important first."""
        h = self.fit.hypothesis
        found: list[Fault] = []
        if h.window is not None:
            found.append(self._temporary(h))
        if h.axes:
            found.append(self._fault(FaultKind.REVERSED_AXIS, h.axes, h._replace(axes=())))
        if h.is_late and abs(delay := float(self.fit.shared['delay'][0])) > MIN_DELAY:
            found.append(Fault(FaultKind.DELAY, values=(delay,)))
        if h.source:
            found.append(self._order(h))
        if h.other_gravity:
            lacks = self.rows.convention.in_measured
            kind = FaultKind.GRAVITY_COMPENSATED if lacks else FaultKind.GRAVITY_MEASURED
            fault = self._fault(kind, (), h._replace(other_gravity=0))
            found.append(fault._replace(is_commanded=self.rows.convention.in_commands))
        if h.is_tilted:
            found.append(self._mounting(h._replace(is_tilted=False)))
        found += self._factors(h)
        if h.load:
            found.append(self._payload('load', h.load, h._replace(load='')))
        found += self._drives(FaultKind.ROTOR_INERTIA, ROTOR, LEAST_ROTOR)
        if h.has_offsets:
            found += self._drives(FaultKind.OFFSET, OFFSET, LEAST_OFFSET)
        found += self._unexplained()
        if self.search.has_wrong_bodies(self.fit):
            bodies = self.fit.columns.at.bodies
            part = self.fit.columns.matrix[:, :, bodies] @ self.fit.solution[:, bodies, None]
            without = self.fit._replace(residual=self.fit.residual - part[..., 0].T)
            found.append(Fault(FaultKind.BODIES, changes=self._changes(self._rms(without))))
        return found

    # ---- Effects -------------------------------------------------------------------------

    def _rms(self, fit: Fit) -> Floats:
        """Return the RMS residual of each joint in the unit of the recording, shape (c,)."""
        counts = np.maximum(self.used.sum(axis=0), 1)
        rms = np.sqrt(np.sum(self.used * fit.residual**2, axis=0) / counts)
        return np.asarray(rms * np.abs(fit.hypothesis.factor(self.count)))

    def _changes(self, before: Floats) -> tuple[Change, ...]:
        """Return the joints whose RMS residual clearly decreases, largest reduction first."""
        measured = self.rows.rms[self.fit.hypothesis.order(self.count)]
        found = [
            self._change(j, before[j], self.after[j], measured[j])
            for j in range(self.count)
            if self.after[j] < CHANGED * before[j]
        ]
        return tuple(sorted(found, key=lambda each: each.after - each.before))

    def _change(self, j: int, before: float, after: float, measured: float) -> Change:
        is_prismatic = bool(self.rows.robot.is_prismatic_joint[self.rows.index[j]])
        return Change(self.names[j], is_prismatic, float(before), float(after), float(measured))

    def _fault(
        self,
        kind: FaultKind,
        joints: Sequence[int],
        without: Hypothesis,
        values: Sequence[float] = (),
    ) -> Fault:
        """Return a fault with its effect; `without` is the hypothesis without the fault."""
        changes = self._changes(self._rms(self.search.fit(without)))
        return Fault(kind, tuple(self.names[j] for j in joints), tuple(values), changes)

    # ---- Faults --------------------------------------------------------------------------

    def _temporary(self, h: Hypothesis) -> Fault:
        window = h.window
        assert window is not None
        without = h._replace(window=None)
        if window.kind == 'tilt':
            fault = self._mounting(without)
        elif window.kind == 'load':
            fault = self._payload('window', window.link, without)
        else:
            joints = tuple(self.names[j] for j in window.joints)
            inside = window.inside(self.rows.signals.times)
            pushed = np.sqrt(np.mean(self.fit.residual[inside] ** 2, axis=0))
            pushed = pushed * np.abs(h.factor(self.count))
            measured = np.sqrt(np.mean(self.rows.signals.measured[inside] ** 2, axis=0))
            order = h.order(self.count)
            changes = [
                self._change(j, pushed[j], pushed[j], measured[order[j]]) for j in window.joints
            ]
            changes.sort(key=lambda each: -each.before)
            fault = Fault(FaultKind.EXTERNAL_FORCE, joints, changes=tuple(changes))
        return fault._replace(interval=(window.begin, window.end))

    def _order(self, h: Hypothesis) -> Fault:
        moved = [j for j, i in enumerate(h.source) if i != j]
        fault = self._fault(FaultKind.ORDER, moved, h._replace(source=()))
        return fault._replace(sources=tuple(self.names[h.source[j]] for j in moved))

    def _mounting(self, without: Hypothesis) -> Fault:
        given, found = self.rows.dynamics.gravity, self.fit.gravity
        cosine = float(given @ found / np.linalg.norm(given) / np.linalg.norm(found))
        fault = self._fault(FaultKind.MOUNTING, (), without, found.tolist())
        return fault._replace(angle=math.acos(min(1.0, max(-1.0, cosine))))

    def _payload(self, name: str, link: str, without: Hypothesis) -> Fault:
        mass, *moments = self.fit.shared[name].tolist()
        error, *deviations = self.fit.errors[name].tolist()
        com = [
            moment / mass if deviation < MAX_COM_ERROR * abs(mass) else math.nan
            for moment, deviation in zip(moments, deviations, strict=True)
        ]
        fault = self._fault(FaultKind.PAYLOAD, (), without, (mass, *com))
        return fault._replace(error=error, link=link)

    def _factors(self, h: Hypothesis) -> list[Fault]:
        """Return the faults of signs and units."""
        found = []
        if h.unit < 0.0:
            found.append(self._every(FaultKind.SIGN, -1.0, h._replace(unit=-h.unit)))
        if abs(h.unit) != 1.0:
            unit = math.copysign(1.0, h.unit)
            found.append(self._every(FaultKind.UNIT, abs(h.unit), h._replace(unit=unit)))
        known = self.search.shows_scale(self.fit)
        unknown = [name for name, each in zip(self.names, known, strict=True) if not each]
        for kind in (FaultKind.SIGN, FaultKind.SCALE):
            is_sign = kind is FaultKind.SIGN
            ours = sorted((j, factor) for j, factor in h.factors if (factor == -1.0) is is_sign)
            if not ours:
                continue
            joints, values = zip(*ours, strict=True)
            without = tuple(each for each in h.factors if (each[1] == -1.0) is not is_sign)
            fault = self._fault(kind, joints, h._replace(factors=without), values)
            is_every = len(joints) > 1 and set(self.names) <= {*fault.joints, *unknown}
            found.append(
                fault._replace(
                    unknown=tuple(unknown) if kind is FaultKind.SCALE else (),
                    is_every_joint=is_every,
                )
            )
        return found

    def _every(self, kind: FaultKind, factor: float, without: Hypothesis) -> Fault:
        fault = self._fault(kind, range(self.count), without, (factor,))
        return fault._replace(is_every_joint=True)

    def _drives(self, kind: FaultKind, column: int, least: float) -> list[Fault]:
        """Return a fault for the joints with a significant rotor inertia or offset."""
        fit, sizes = self.fit, self.fit.columns.sizes[:, column]
        values, errors = fit.drives[:, column], fit.drive_errors[:, column]
        efforts = np.abs(values) * sizes
        is_found = (np.abs(values) > SURE * errors) & (efforts > least * fit.rms)
        joints = np.flatnonzero(is_found & self.rows.signals.moves).tolist()
        if not joints:
            return []
        factor = np.abs(fit.hypothesis.factor(self.count))
        before = np.where(is_found, np.hypot(self.after, efforts * factor), self.after)
        return [
            Fault(
                kind,
                tuple(self.names[j] for j in joints),
                tuple(values[joints].tolist()),
                self._changes(before),
                is_motor_side=self.is_motor_side,
            )
        ]

    def _unexplained(self) -> list[Fault]:
        joints = np.flatnonzero(self.search.unexplained(self.fit)).tolist()
        if not joints:
            return []
        measured = self.rows.rms[self.fit.hypothesis.order(self.count)]
        changes = [self._change(j, self.after[j], self.after[j], measured[j]) for j in joints]
        names = tuple(self.names[j] for j in joints)
        return [Fault(FaultKind.UNEXPLAINED, names, changes=tuple(changes))]
