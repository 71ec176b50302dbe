"""From a recording to findings: what the model explains, friction, and what else there is."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics
from ...errors import ConfigurationError, RecordingError, unknown_name
from ...robot.model import Booleans, Floats, RobotModel
from .diagnoses import constant, describe, Diagnosis
from .evidence import (
    CREDIBLE,
    Evidence,
    Explanation,
    JointSamples,
    make_table,
)
from .friction import (
    fit_friction,
    FrictionFit,
    is_moving,
    why_not,
)
from .loads import parameters_of, payload_regressors, tip_links
from .signals import (
    derive,
    Motion,
    Recording,
    smooth_alike,
)

PER_WINDOW = 8  # samples of a smoothing window that fits use; more tell nothing new
CONSTANT = 1e-9  # of the largest effort: the rest is rounding


@dataclass(frozen=True, eq=False)
class JointFinding:
    """One joint's measured effort against the modelled one; efforts in N m or N."""

    name: str
    slides: bool
    rms_measured: float
    rms_modelled: float
    rms_residual: float
    """Of measured minus modelled."""
    explained: float
    """Share of the variation: 1 - var(residual) / var(measured); NaN if nothing varies."""
    explained_with_mean: float
    """The same with squares in place of variances; NaN for efforts of zero."""
    scale: float
    """Measured is about ``scale * modelled + offset``, by least squares."""
    offset: float
    friction: FrictionFit
    explained_in_the_end: float
    """``explained``, with the fitted friction and offset, and with what was found; over the time
    that the joint moved, if its friction could be told: at rest, dry friction may be anything."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What a recording tells of a robot and its model."""

    motion: Motion
    """As derived, of the joints that were recorded."""
    compared: tuple[int, ...]
    """Which of the motion's joints have a measured effort, c of them."""
    joints: tuple[JointFinding, ...]
    """Of these."""
    measured: Floats
    """Shape (K, c) [N m or N]."""
    modelled: Floats
    """Shape (K, c), friction included if the dynamics have any [N m or N]."""
    in_the_end: Floats
    """Shape (K, c): with the fitted friction, and with what was found, as it was recorded."""
    diagnoses: tuple[Diagnosis, ...]
    """What explains the difference, most important first; none if nothing needs to."""
    explained: float
    explained_in_the_end: float
    """Of joints that moved enough to tell, if any did."""
    width: float
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""


def identify(
    dynamics: InverseDynamics,
    recording: Recording,
    others: ArrayLike | None = None,
    link: str | None = None,
    width: float = FRICTION_WIDTH,
) -> Findings:
    """
    Hold a recorded run against the model.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints, and what is known to act on it.
    recording : Recording
        Of any m of its joints, in any order.
    others : array_like, shape (n,), optional
        Where joints rest that were not recorded [rad or m]; zero if left out.
    link : str, optional
        What may carry a load that the model does not know; without it, the tips of the tree.
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s].

    Returns
    -------
    findings : Findings

    Raises
    ------
    RecordingError
        If the recording is of other joints, or nothing can be derived from it.
    ConfigurationError
        If there is no such link.

    """
    robot = dynamics.robot
    if link is not None and link not in robot.link_names:
        raise ConfigurationError(unknown_name('link', link, robot.link_names))
    index = _index_of(recording.joint_names, robot)
    turning = [j for j, i in enumerate(index) if robot.is_continuous[i]]
    if turning:
        positions = recording.positions.copy()
        for j in turning:
            there = np.isfinite(positions[:, j])
            positions[there, j] = np.unwrap(positions[there, j])
        recording = recording._replace(positions=positions)
    motion = derive(recording)
    return _Comparison(dynamics, motion, index, others, link, width).findings()


def _index_of(names: tuple[str, ...], robot: RobotModel) -> list[int]:
    unknown = [name for name in names if name not in robot.joint_names]
    if unknown:
        raise RecordingError(
            f"the recording has joint '{unknown[0]}', which robot '{robot.name}' does not have; "
            f'it has {", ".join(robot.joint_names)}'
        )
    if len(set(names)) != len(names):
        raise RecordingError(f'a joint is recorded twice: {", ".join(names)}')
    return [robot.joint_names.index(name) for name in names]


class _Comparison:
    """One motion, held against one robot."""

    def __init__(
        self,
        dynamics: InverseDynamics,
        motion: Motion,
        index: list[int],
        others: ArrayLike | None,
        link: str | None,
        width: float,
    ) -> None:
        self.dynamics, self.motion, self.width = dynamics, motion, width
        robot = self.robot = dynamics.robot
        self.links = (link,) if link is not None else tip_links(robot)
        K, n = len(motion.times), len(robot.joint_names)
        q, qd, qdd = np.zeros((3, K, n))
        if others is not None:
            q[:] = others
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        self.states = q, qd, qdd
        self.columns = [j for j in range(len(index)) if np.isfinite(motion.efforts[:, j]).all()]
        self.index = [index[j] for j in self.columns]
        self.names = [motion.joint_names[j] for j in self.columns]
        self.measured = motion.efforts[:, self.columns]
        self.qd, self.qdd = motion.qd[:, self.columns], motion.qdd[:, self.columns]
        self.direction = smooth_alike(motion, np.tanh(self.qd / width))
        self.period = float(np.median(np.diff(motion.times)))
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        # Friction is fitted anew: what the dynamics have of it is no part of what it is fitted to.
        terms = dynamics.effort_terms(*self.states)
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        self.gravity: Floats = terms.gravity[:, self.index]

    def findings(self) -> Findings:
        live = self._live()
        evidence = self._evidence(live)
        explanation = evidence.explain() if live else None
        mended, efforts = self._mended(explanation, live)
        fits = self._friction(mended - efforts, self._obscure(explanation, live))
        for c, fit in enumerate(fits):
            efforts[:, c] += fit.efforts(self.qd[:, c], self.direction[:, c])
        telling = self._telling(fits)
        joints = tuple(
            self._finding(c, fits[c], (mended[:, c], efforts[:, c]), telling[c], c in live)
            for c in range(len(fits))
        )
        in_the_end = self._as_recorded(efforts, explanation, live)
        dead = {self.names[c]: float(self.measured[0, c]) for c in self._dead(live)}
        diagnoses = describe(
            explanation, [self.names[c] for c in live], self._slides(live), self.dynamics.gravity
        )
        return Findings(
            motion=self.motion,
            compared=tuple(self.columns),
            joints=joints,
            measured=self.measured,
            modelled=self.modelled,
            in_the_end=in_the_end,
            diagnoses=(*constant(dead), *diagnoses),
            explained=self._share(self.measured, self.modelled, live),
            explained_in_the_end=self._share(mended, efforts, self._moving(live), telling),
            width=self.width,
        )

    def _friction(self, left: Floats, obscure: dict[int, str]) -> list[FrictionFit]:
        fits = [
            fit_friction(
                self.qd[:, c],
                self.direction[:, c],
                left[:, c],
                self.period,
                self.motion.window,
                self.width,
            )
            for c in range(len(self.names))
        ]
        return [
            FrictionFit.unknown(reason, fit.offset if fit.cannot_tell else 0.0)
            if (reason := obscure.get(c, ''))
            else fit
            for c, fit in enumerate(fits)
        ]

    def _obscure(self, explanation: Explanation | None, live: list[int]) -> dict[int, str]:
        """Tell of which joints the friction cannot be told, however much they moved."""
        reasons = dict.fromkeys(self._dead(live), 'its effort was not measured')
        if explanation is None:
            return reasons
        is_scaled = any(fit.twist.is_scaled for fit in explanation.fits)
        for c, fit in zip(live, explanation.fits, strict=True):
            if fit.moves and fit.left > CREDIBLE:
                reasons[c] = 'its effort is not explained'
            elif is_scaled and fit.is_mute:
                reasons[c] = 'the unit of its effort is not known'
        return reasons

    def _live(self) -> list[int]:
        """Return the joints whose measured effort says something."""
        # A joint that carries nothing has rounding of the others' size.
        size = max(float(np.max(np.abs(self.measured))), float(np.max(np.abs(self.rigid))))
        return [c for c in range(len(self.names)) if np.ptp(self.measured[:, c]) > CONSTANT * size]

    def _dead(self, live: list[int]) -> list[int]:
        """Return the joints whose effort is always the same, and should not be."""
        least = 0.01 * float(np.max(np.abs(self.rigid)))
        rest = sorted(set(range(len(self.names))) - set(live))
        # A joint that carries nothing measures nothing.
        return [c for c in rest if np.ptp(self.rigid[:, c]) > least]

    def _evidence(self, live: list[int]) -> Evidence:
        step = max(1, self.motion.window // PER_WINDOW)
        some = slice(None, None, step)
        states = (self.states[0][some], self.states[1][some], self.states[2][some])
        robot, gravity = self.robot, self.dynamics.gravity
        weight = np.stack(
            [InverseDynamics(robot, axis).gravity_efforts(states[0]) for axis in np.eye(3)], -1
        )
        loads = [payload_regressors(robot, gravity, link, states) for link in self.links]
        tables: list[JointSamples] = []
        measured = self.measured[some][:, live]
        for c in live:
            i = self.index[c]
            qd = self.qd[some, c]
            columns = np.column_stack(
                [
                    self.rigid[some, c],
                    self.gravity[some, c],
                    weight[:, i],
                    self.qdd[some, c],
                    qd,
                    self.direction[some, c],
                    np.ones_like(qd),
                    *(load[:, i] for load in loads),
                    measured,
                ]
            )
            moves = not why_not(self.qd[:, c], self.period, self.width)
            if moves:
                columns = columns[is_moving(qd, self.width)]
            tables.append(make_table(columns, moves))
        samples = len(self.motion.times) / self.motion.window
        bodies = [robot.link_body[robot.link_names.index(link)] for link in self.links]
        weights = {k: float(robot.mass[b]) for k, b in zip(self.links, bodies, strict=True)}
        return Evidence(tables, weights, gravity, samples)

    def _mended(self, explanation: Explanation | None, live: list[int]) -> tuple[Floats, Floats]:
        """Undo what was found: the measured efforts as they should be, and their model."""
        measured, efforts = self.measured.copy(), self.rigid.copy()
        if explanation is None:
            return measured, efforts
        efforts += self._correction(explanation)
        for j, (c, fit) in enumerate(zip(live, explanation.fits, strict=True)):
            source = self.measured[:, live[explanation.source[j]]]
            measured[:, c] = fit.twist.sign * source / fit.scale
            efforts[:, c] += fit.rotor * self.qdd[:, c]
        return measured, efforts

    def _correction(self, explanation: Explanation) -> Floats:
        base = explanation.base
        q = self.states[0]
        correction: Floats = -self.gravity if base.is_weightless else np.zeros_like(self.rigid)
        if base.kind == 'mounting':
            turned = InverseDynamics(self.robot, base.solution).gravity_efforts(q)
            return turned[:, self.index] - self.gravity
        if base.kind == 'payload':
            loads = payload_regressors(self.robot, self.dynamics.gravity, base.link, self.states)
            parameters = parameters_of(base.solution[0], np.array(base.solution[1:]))
            correction += (loads @ parameters)[:, self.index]
        return correction

    def _as_recorded(
        self, efforts: Floats, explanation: Explanation | None, live: list[int]
    ) -> Floats:
        """Turn mended efforts into what the driver would have reported."""
        reported: Floats = efforts.copy()
        if explanation is not None:
            for j, (c, fit) in enumerate(zip(live, explanation.fits, strict=True)):
                source = live[explanation.source[j]]
                reported[:, source] = fit.twist.sign * fit.scale * efforts[:, c]
        return reported

    def _telling(self, fits: list[FrictionFit]) -> list[Booleans]:
        """Choose the time of every joint that says whether its friction is right."""
        return [
            is_moving(self.qd[:, c], self.width)
            if not fit.cannot_tell
            else np.ones(len(self.qd), dtype=bool)
            for c, fit in enumerate(fits)
        ]

    def _moving(self, live: list[int]) -> list[int]:
        """Leave out joints that friction may have held all the time, unless all are such."""
        moving = [c for c in live if not why_not(self.qd[:, c], self.period, self.width)]
        return moving or live

    def _finding(
        self,
        c: int,
        friction: FrictionFit,
        mended: tuple[Floats, Floats],
        telling: Booleans,
        is_live: bool,
    ) -> JointFinding:
        y, m = self.measured[:, c], self.modelled[:, c]
        varies = is_live and np.ptp(m) > CONSTANT * np.max(np.abs(m))
        scale, offset = np.polyfit(m, y, 1) if varies else (math.nan, math.nan)
        squares = float(np.mean(y**2))
        return JointFinding(
            name=self.names[c],
            slides=self._slides([c])[0],
            rms_measured=math.sqrt(squares),
            rms_modelled=float(np.sqrt(np.mean(m**2))),
            rms_residual=float(np.sqrt(np.mean((y - m) ** 2))),
            explained=_share_of_variation(y, m) if is_live else math.nan,
            explained_with_mean=1.0 - float(np.mean((y - m) ** 2)) / squares
            if squares
            else math.nan,
            scale=float(scale),
            offset=float(offset),
            friction=friction,
            explained_in_the_end=_share_of_variation(mended[0][telling], mended[1][telling])
            if is_live
            else math.nan,
        )

    def _slides(self, columns: list[int]) -> list[bool]:
        robot = self.robot
        return [
            bool(robot.is_prismatic[robot.body_names.index(self.names[c], 1)]) for c in columns
        ]

    def _share(
        self,
        measured: Floats,
        modelled: Floats,
        live: list[int],
        telling: list[Booleans] | None = None,
    ) -> float:
        """Return the share of the variation: of joints that turn, and that slide, their mean."""
        every = np.ones(len(measured), dtype=bool)
        varies, left = {False: 0.0, True: 0.0}, {False: 0.0, True: 0.0}
        for c, slide in zip(live, self._slides(live), strict=True):
            when = every if telling is None else telling[c]
            varies[slide] += float(np.var(measured[when, c]))
            left[slide] += float(np.var(measured[when, c] - modelled[when, c]))
        shares = [1.0 - left[kind] / varies[kind] for kind in varies if varies[kind] > 0.0]
        return float(np.mean(shares)) if shares else math.nan


def _share_of_variation(measured: Floats, modelled: Floats) -> float:
    variance = float(np.var(measured))
    if variance <= (1e-6 * float(np.max(np.abs(measured)))) ** 2:
        return math.nan
    return 1.0 - float(np.var(measured - modelled)) / variance
