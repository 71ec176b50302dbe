"""Compares a recorded motion with the model of the robot."""

from __future__ import annotations

from functools import partial
import math

import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.inverse_dynamics import InverseDynamics
from ...dynamics.loaded_robot import FRICTION_WIDTH
from ...errors import RecordingError
from ...robot.model import Booleans, Floats, RobotModel
from .bodies import Bodies, wrong_bodies
from .diagnoses import diagnose, diagnose_bodies, diagnose_constant, diagnose_part, Diagnosis
from .evidence import Evidence
from .explanation import Explanation
from .findings import Findings, JointFinding
from .friction import fit_friction, FrictionFit, is_moving, obstacle
from .friction_shape import fit_shape
from .joint_samples import CREDIBLE, JointSamples
from .loads import moves_with, payload_regressors, point_mass_parameters, tip_links
from .part import Cause, Part
from .parts import best_interval, find_part, MUCH_LOUDER
from .recorded_column import Recording
from .signals import derive, Motion, smooth_like_efforts
from .tilt import changing_gravity_efforts

SAMPLES_PER_WINDOW = 8  # used by fits; the samples of a smoothing window are dependent
MOVED = 0.02  # [rad or m]; a joint that moved less shows no load
INERTIAS = 50  # samples at which the effect of noisy accelerations is computed
ALL = slice(None)
CONSTANT = 1e-9  # fraction of the largest effort; smaller variations are rounding errors


def identify(
    dynamics: InverseDynamics,
    recording: Recording,
    others: ArrayLike | None = None,
    link: str | None = None,
    width: float | None = None,
) -> Findings:
    """
    Compare a recording with the model.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot with n joints, and all known loads on it.
    recording : Recording
        Recording of any m of its joints, in any order.
    others : array_like, shape (n,), optional
        Positions of the joints that were not recorded [rad or m]; default: zero.
    link : str, optional
        Link that may carry an unknown load; default: the tips of the tree.
    width : float, optional
        Speed over which Coulomb friction is smoothed [rad/s or m/s]; default: fitted for each
        joint where the recording shows it.

    Returns
    -------
    findings : Findings

    Raises
    ------
    RecordingError
        If the robot does not have a recorded joint, or the recording is not usable.
    ConfigurationError
        If the link does not exist.

    """
    robot = dynamics.robot
    if link is not None:
        robot.link_index(link)  # raises if it does not exist
    index = _indices(recording.joint_names, robot)
    continuous = [j for j, i in enumerate(index) if robot.is_continuous[i]]
    if continuous:
        positions = recording.positions.copy()
        for j in continuous:
            is_known = np.isfinite(positions[:, j])
            positions[is_known, j] = np.unwrap(positions[is_known, j])
        recording = recording._replace(positions=positions)
    motion = derive(recording)
    return _Comparison(dynamics, motion, index, others, link, width).findings()


def _indices(names: tuple[str, ...], robot: RobotModel) -> list[int]:
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
    """The efforts of one motion, measured and modelled; columns are the compared joints."""

    def __init__(
        self,
        dynamics: InverseDynamics,
        motion: Motion,
        index: list[int],
        others: ArrayLike | None,
        link: str | None,
        width: float | None,
    ) -> None:
        self.dynamics, self.motion = dynamics, motion
        self.fits_shape = width is None
        self.width = width = FRICTION_WIDTH if width is None else width
        self.load: Floats = np.zeros(0)
        robot = self.robot = dynamics.robot
        K, n = len(motion.times), len(robot.joint_names)
        q, qd, qdd = np.zeros((3, K, n))
        if others is not None:
            q[:] = others
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        self.states = q, qd, qdd
        self.all_index = index
        links = (link,) if link is not None else tip_links(robot)
        moved = np.ptp(q, axis=0) > MOVED
        self.links = tuple(link for link in links if moves_with(robot, link, moved))
        self.compared = [j for j in range(len(index)) if np.isfinite(motion.efforts[:, j]).all()]
        self.index = [index[j] for j in self.compared]
        self.names = [motion.joint_names[j] for j in self.compared]
        self.measured = motion.efforts[:, self.compared]
        self.qd, self.qdd = motion.qd[:, self.compared], motion.qdd[:, self.compared]
        self.direction = smooth_like_efforts(motion, np.tanh(self.qd / width))
        self.period = float(np.median(np.diff(motion.times)))
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        # Friction is fitted again, to efforts without the friction that the dynamics may have.
        terms = dynamics.effort_terms(*self.states)
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        self.gravity: Floats = terms.gravity[:, self.index]
        self.noise = self._noise()
        self.varying = self._varying()
        self.constant = self._unexpectedly_constant()

    def findings(self) -> Findings:
        evidence = self._evidence()
        explanation = evidence.explain()
        part = find_part(evidence, explanation)
        bodies = None
        if part is not None:
            part = self._refined(part)
            evidence, explanation = part.evidence, part.outside
        else:
            bodies = self._wrong_bodies(evidence, explanation)
            if bodies is not None:
                explanation = bodies.explanation
        measured, efforts = self._corrected(explanation, part)
        used = np.ones(len(efforts), dtype=bool)
        if part is not None and part.cause is Cause.FORCE:
            used = ~self._inside(part)
        fits = self._friction(measured[used] - efforts[used], self._obscured(explanation), used)
        if self.fits_shape and part is None:
            fits = self._with_shape(fits, measured - efforts, explanation)
        for c, fit in enumerate(fits):
            efforts[:, c] += self._friction_efforts(c, fit)
        recorded = self._as_recorded(efforts, explanation)
        when = [used & each for each in self._when_comparable(fits)]
        rubbing = self._with_friction_only()
        return Findings(
            motion=self.motion,
            compared=tuple(self.compared),
            joints=tuple(
                self._joint_finding(c, fits[c], rubbing[:, c], recorded[:, c], when[c])
                for c in range(len(fits))
            ),
            measured=self.measured,
            modelled=self.modelled,
            corrected=recorded,
            diagnoses=self._diagnoses(evidence, explanation, part, bodies),
            width=self.width,
            is_too_short=evidence.is_too_short,
            moving=tuple(self._moving()),
        )

    def _with_shape(
        self, fits: list[FrictionFit], residual: Floats, explanation: Explanation
    ) -> list[FrictionFit]:
        """Fit the shape of the friction of joints whose friction is known."""
        self.load = np.abs(self.rigid + self._correction(explanation))
        return [
            fit_shape(
                fit,
                self.qd[:, c],
                residual[:, c],
                self.load[:, c],
                partial(smooth_like_efforts, self.motion),
                self.width,
                self.motion.window,
            )
            for c, fit in enumerate(fits)
        ]

    def _friction_efforts(self, c: int, fit: FrictionFit) -> Floats:
        """Return the efforts of friction and offset of a column."""
        qd = self.qd[:, c]
        if not fit.has_shape:
            return fit.efforts(qd, self.direction[:, c])
        direction = np.tanh(qd / fit.width)
        step = np.column_stack([direction, self.load[:, c] * direction])
        step = smooth_like_efforts(self.motion, step)
        efforts: Floats = fit.efforts(qd, step[:, 0]) + fit.load_friction * step[:, 1]
        return efforts

    def _inside(self, part: Part) -> Booleans:
        begin, end = part.interval
        return np.asarray((self.motion.times >= begin) & (self.motion.times <= end))

    def _wrong_bodies(self, evidence: Evidence, explanation: Explanation) -> Bodies | None:
        """Return the residuals with fitted links if several links are wrong."""
        if not self.varying:
            return None
        some = self._step()
        states = (self.states[0][some], self.states[1][some], self.states[2][some])
        rows = [self._used(c)[some] for c in self.varying]
        index = [self.index[c] for c in self.varying]
        return wrong_bodies(evidence, explanation, self.dynamics, states, rows, index)

    def _step(self) -> slice:
        """Return the samples that fits use."""
        return slice(None, None, max(1, self.motion.window // SAMPLES_PER_WINDOW))

    def _moves(self, c: int) -> bool:
        return not obstacle(self.qd[:, c], self.period, self.width)

    def _used(self, c: int) -> Booleans:
        """Return at which times the effort of a joint is compared."""
        if not self._moves(c):
            return np.ones(len(self.qd), dtype=bool)
        return is_moving(self.qd[:, c], self.width)

    def _refined(self, part: Part) -> Part:
        """Return a part whose begin and end are accurate to a sample."""
        if part.cause is Cause.TILT:
            return part
        is_force = part.cause is Cause.FORCE
        measured, efforts = self._corrected(part.outside._replace(hypothesis=part.evidence.as_is))
        load = np.zeros_like(efforts) if is_force else self._correction(part.outside)
        gain = np.zeros(len(efforts))
        for j, c in enumerate(self.varying):
            fit = part.outside.fits[j]
            if not fit.moves or (is_force and j not in part.joints):
                continue
            left = measured[:, c] - efforts[:, c] - fit.offset
            left -= fit.damping * self.qd[:, c] + fit.coulomb * self.direction[:, c]
            variance = max((fit.rms / part.outside.factor(j)) ** 2, 1e-12)
            after = MUCH_LOUDER * variance if is_force else (left - load[:, c]) ** 2
            gain += (left**2 - after) / variance
        return part._replace(interval=best_interval(self.motion.times, gain, part.interval))

    def _with_friction_only(self) -> Floats:
        """Return the modelled efforts with friction that is fitted without diagnoses."""
        efforts: Floats = self.rigid.copy()
        for c, fit in enumerate(self._friction(self.measured - self.rigid, {})):
            efforts[:, c] += fit.damping * self.qd[:, c]
            efforts[:, c] += fit.coulomb * self.direction[:, c]
        return efforts

    def _noise(self) -> Floats:
        """Return the noise of measured minus modelled efforts, shape (c,)."""
        some = slice(None, None, max(1, len(self.motion.times) // INERTIAS))
        inertia = self.dynamics.mass_matrix(self.states[0][some])
        modelled: Floats = inertia[:, :, self.all_index] * self.motion.qdd_noise
        squares: Floats = np.mean(np.sum(modelled**2, axis=-1), axis=0)
        noise: Floats = np.hypot(
            np.sqrt(squares[self.index]), self.motion.effort_noise[self.compared]
        )
        return noise

    def _varying(self) -> list[int]:
        """Return the columns whose measured effort varies by more than rounding errors."""
        # Compare with all joints: the effort of a joint without load is rounding errors only.
        largest = max(float(np.max(np.abs(self.measured))), float(np.max(np.abs(self.rigid))))
        variation = np.ptp(self.measured, axis=0)
        return [c for c in range(len(self.names)) if variation[c] > CONSTANT * largest]

    def _unexpectedly_constant(self) -> list[int]:
        """Return the columns whose measured effort is constant, but not the modelled one."""
        least = 0.01 * float(np.max(np.abs(self.rigid)))
        constant = sorted(set(range(len(self.names))) - set(self.varying))
        return [c for c in constant if np.ptp(self.rigid[:, c]) > least]

    def _evidence(self) -> Evidence:
        some = self._step()
        states = (self.states[0][some], self.states[1][some], self.states[2][some])
        robot, gravity = self.robot, self.dynamics.gravity
        weight = np.stack(
            [InverseDynamics(robot, axis).gravity_efforts(states[0]) for axis in np.eye(3)], -1
        )
        loads = [payload_regressors(robot, gravity, link, states) for link in self.links]
        joints: list[JointSamples] = []
        measured = self.measured[some][:, self.varying]
        times = self.motion.times[some]
        for c in self.varying:
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
            used = self._used(c)[some]
            joints.append(
                JointSamples(
                    columns[used],
                    times[used],
                    self._moves(c),
                    float(self.noise[c]),
                    self._is_prismatic([c])[0],
                )
            )
        duration = len(self.motion.times) * self.period
        sample_count = len(self.motion.times) / self.motion.window
        bodies = [robot.link_body[robot.link_index(link)] for link in self.links]
        masses = {k: float(robot.mass[b]) for k, b in zip(self.links, bodies, strict=True)}
        return Evidence(joints, masses, gravity, sample_count, duration)

    def _corrected(
        self, explanation: Explanation, part: Part | None = None
    ) -> tuple[Floats, Floats]:
        """Return measured efforts without distortions, and modelled ones with the hypothesis."""
        measured = self.measured / explanation.unit
        correction = self._correction(explanation)
        if part is not None and part.cause is Cause.LOAD:
            correction = correction * self._inside(part)[:, None]
        if part is not None and part.cause is Cause.TILT:
            correction = changing_gravity_efforts(
                part, self.robot, self.states[0], self.motion.times
            )[:, self.index]
            correction = correction - self.gravity
        efforts = self.rigid + correction
        for j, (c, fit) in enumerate(zip(self.varying, explanation.fits, strict=True)):
            source = self.measured[:, self.varying[explanation.source[j]]]
            measured[:, c] = fit.distortion.sign * source / explanation.factor(j)
            efforts[:, c] += fit.rotor * self.qdd[:, c]
        return measured, efforts

    def _correction(self, explanation: Explanation) -> Floats:
        """Return the efforts that the hypothesis adds to the model."""
        hypothesis = explanation.hypothesis
        if hypothesis.kind == 'mounting':
            turned = InverseDynamics(self.robot, hypothesis.solution)
            return turned.gravity_efforts(self.states[0])[:, self.index] - self.gravity
        correction: Floats = np.zeros_like(self.rigid)
        if hypothesis.is_weightless:
            correction -= self.gravity
        if hypothesis.kind == 'payload':
            mass, *com = hypothesis.solution
            regressors = payload_regressors(
                self.robot, self.dynamics.gravity, hypothesis.link, self.states
            )
            efforts = regressors @ point_mass_parameters(mass, np.array(com))
            correction += efforts[:, self.index]
        return correction

    def _as_recorded(self, efforts: Floats, explanation: Explanation) -> Floats:
        """Distort efforts in the way in which the driver distorts them."""
        recorded: Floats = explanation.unit * efforts
        for j, (c, fit) in enumerate(zip(self.varying, explanation.fits, strict=True)):
            source = self.varying[explanation.source[j]]
            recorded[:, source] = fit.distortion.sign * explanation.factor(j) * efforts[:, c]
        return recorded

    def _friction(
        self, residual: Floats, obscured: dict[int, str], used: Booleans | slice = ALL
    ) -> list[FrictionFit]:
        """Fit friction to a residual, which consists of the used samples."""
        fits = []
        for c in range(len(self.names)):
            fit = fit_friction(
                self.qd[used, c],
                self.direction[used, c],
                residual[:, c],
                self.period,
                self.motion.window,
                self.width,
            )
            if c in obscured:
                fit = FrictionFit.unknown(obscured[c], fit.offset if fit.unknown_because else 0.0)
            fits.append(fit)
        return fits

    def _obscured(self, explanation: Explanation) -> dict[int, str]:
        """Return why the friction of some columns is unknown even if they moved enough."""
        reasons = dict.fromkeys(self.constant, 'its effort was not measured')
        is_scaled = any(fit.distortion.is_scaled for fit in explanation.fits)
        for c, fit in zip(self.varying, explanation.fits, strict=True):
            if fit.moves and fit.remaining > CREDIBLE:
                reasons[c] = 'its effort is not explained'
            elif is_scaled and fit.is_friction_only:
                reasons[c] = 'the unit of its effort is unknown'
        return reasons

    def _when_comparable(self, fits: list[FrictionFit]) -> list[Booleans]:
        """Select the samples of every column at which fitted friction is valid."""
        every = np.ones(len(self.qd), dtype=bool)
        return [
            every if fit.unknown_because else is_moving(self.qd[:, c], self.width)
            for c, fit in enumerate(fits)
        ]

    def _moving(self) -> list[int]:
        """Leave out joints that friction may have held all the time, unless it may hold all."""
        moving = [c for c in self.varying if self._moves(c)]
        return moving or self.varying

    def _joint_finding(
        self, c: int, friction: FrictionFit, rubbing: Floats, corrected: Floats, when: Booleans
    ) -> JointFinding:
        measured, modelled = self.measured[when, c], self.modelled[when, c]
        is_varying = c in self.varying
        has_line = is_varying and np.ptp(modelled) > CONSTANT * np.max(np.abs(modelled))
        scale, offset = np.polyfit(modelled, measured, 1) if has_line else (math.nan, math.nan)
        return JointFinding(
            name=self.names[c],
            is_prismatic=self._is_prismatic([c])[0],
            rms_measured=_rms(measured),
            rms_modelled=_rms(modelled),
            rms_residual=_rms(measured - modelled),
            rms_friction=_rms(measured - rubbing[when]),
            rms_corrected=_rms(measured - corrected[when]),
            noise=math.nan if math.isfinite(self.motion.cut_off) else float(self.noise[c]),
            scale=float(scale),
            offset=float(offset),
            friction=friction,
            is_varying=is_varying,
        )

    def _diagnoses(
        self,
        evidence: Evidence,
        explanation: Explanation,
        part: Part | None,
        bodies: Bodies | None,
    ) -> tuple[Diagnosis, ...]:
        constant = {self.names[c]: float(self.measured[0, c]) for c in self.constant}
        names = [self.names[c] for c in self.varying]
        found = [] if part is None else diagnose_part(part, names)
        if self.varying and (part is None or part.cause is Cause.FORCE):
            found += diagnose(evidence, explanation, names)
        if bodies is not None:
            found = [each for each in found if each.kind != 'unexplained']
            found.append(diagnose_bodies(bodies, evidence, names))
        return (*diagnose_constant(constant), *found)

    def _is_prismatic(self, columns: list[int]) -> list[bool]:
        return [bool(self.robot.is_prismatic_joint[self.index[c]]) for c in columns]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
