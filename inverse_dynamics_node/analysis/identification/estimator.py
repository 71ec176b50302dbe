"""Identifies the bodies and joints of a robot from recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...errors import RecordingError
from ...robot.model import Booleans, Floats
from ..recordings.signals import Motion
from .delay import estimate_delay, shifted
from .drive_terms import choose_terms, fit_terms, widths_to_try
from .fit import choose_urdf_weight, correlation, Equations, Solution, solve, solve_within_reason
from .gains import first_gains
from .preparation import PreparedRecording
from .regression import GAIN, IdentificationProblem, Model, Regression, WIDTH

ROUNDS = 3
WIDTH_ROUNDS = 4
DELAY_ROUNDS = 3
GAIN_ROUNDS = 5
LEAST_DELAY = 2e-4
"""Delay that is not worth removing [s]."""
FIRST_URDF_WEIGHT = 1.0
SMOOTHING_RANGE = (0.1, 0.6)
"""Shortest and longest smoothing window of the fit [s]."""
BLOCKS = 8
LEAST_DURATION = 3.0
"""Duration of the smoothed recordings below which nothing is identified [s]."""
LEAST_TRAVEL = {False: 0.02, True: 0.002}
"""Travel of a joint below which its friction is unknown [rad], prismatic [m]."""
LEAST_RETURN = 0.1
"""Fraction of the travel that has to go in the other direction."""
GOOD_RECORDINGS = (
    'record all joints moving at the same time, slowly and fast, for 30 s or more; '
    '`inverse_dynamics excite` plans such a motion'
)


class Estimator:
    """
    The fits to one set of recordings; attributes are filled step by step.

    Parameters
    ----------
    problem : IdentificationProblem
        The robot and what is identified.
    prepared : sequence of PreparedRecording
        The recordings.
    progress : callable
        Called with the fraction that is done.

    """

    def __init__(
        self,
        problem: IdentificationProblem,
        prepared: Sequence[PreparedRecording],
        progress: Callable[[float], None],
    ) -> None:
        self.problem, self.prepared, self.progress = problem, prepared, progress
        self.motions = [run.motion for run in prepared]
        self.moving = moving_joints(problem, prepared)
        self.duration = sum(float(np.ptp(motion.times)) for motion in self.motions)
        self.seconds = self._smoothing_window()
        self.regression = Regression(problem, self.motions, self.seconds, BLOCKS)
        if self.duration < LEAST_DURATION or not len(self.regression.efforts):
            raise RecordingError(
                f'after smoothing, the recordings last {self.duration:.2g} s, expected at least '
                f'{LEAST_DURATION:g} s in a row; {GOOD_RECORDINGS}'
            )
        self.grid = widths_to_try(np.quantile(np.abs(self.regression.qd), 0.95, axis=0))
        self.delay = self.delay_error = self.delay_removed = 0.0
        identified = problem.identified
        self.gains = np.ones(len(problem.joints))
        self.gain_known = np.zeros(len(problem.joints), dtype=bool)
        if problem.currents:
            self.gains, self.gain_known = first_gains(
                self.regression, identified.before, self.grid[3], self.moving
            )
            self.regression.set_efforts(self.aligned(self.motions))
        self.weights: Floats
        self.equations: Equations
        self.solution: Solution
        self.used: Booleans
        self.friction, self.friction_used = choose_terms(
            self.regression, identified.before, self.moving, self.grid, optional=False
        )
        progress(0.2)
        self._iterate(identified.reference, np.full(len(identified.bodies), FIRST_URDF_WEIGHT))
        self._remove_delay()
        if problem.currents:
            self._fit_gains()
        progress(0.6)
        self.weights = weights_of(self.regression.residual(self.solution.model))
        self.urdf_weight, self.trials = choose_urdf_weight(
            self.equations, self.weights, self.used, self.solution.model
        )
        progress(0.9)
        self._finish()

    def _smoothing_window(self) -> float:
        """Choose a window that leaves the motion as it is: fast robots need a short one."""
        ratios = []
        for motion in self.motions:
            for joint, moves in zip(self.problem.joints, self.moving, strict=True):
                if moves:
                    qdd = np.sqrt(np.mean(motion.qdd[:, joint] ** 2))
                    ratios.append(np.sqrt(np.mean(motion.qd[:, joint] ** 2)) / max(qdd, 1e-9))
        typical = 0.7 * float(np.quantile(ratios, 0.25)) if ratios else np.inf
        return float(np.clip(min(typical, self.duration / 40.0), *SMOOTHING_RANGE))

    def _iterate(self, bodies: Floats, urdf_weights: Floats, rounds: int = ROUNDS) -> None:
        """Fit terms and bodies in turn, with weights from the residuals."""
        regression = self.regression
        for _ in range(rounds):
            start, self.used = choose_terms(regression, bodies, self.moving, self.grid)
            self.weights = weights_of(regression.residual(start))
            self.equations = Equations(regression, start)
            self.solution = solve(self.equations, self.weights, urdf_weights, self.used, start)
            bodies = self.solution.model.bodies

    def _remove_delay(self) -> None:
        """Shift the efforts by their delay, if that improves the fit."""
        for _ in range(DELAY_ROUNDS):
            delay, self.delay_error = estimate_delay(self.regression, self.solution, self.weights)
            self.delay = self.delay_removed + delay
            if abs(delay) < max(2.0 * self.delay_error, LEAST_DELAY):
                return
            weights, before = self.weights, self._loss(self.weights)
            removed = self.delay_removed
            self._shift(self.delay)
            if self._loss(weights) > before:
                self.delay = removed
                self._shift(removed)
                return

    def _fit_gains(self) -> None:
        """Fit gains with everything else, to first order."""
        for _ in range(GAIN_ROUNDS):
            self.used[:, GAIN] = self.gain_known
            model = self.solution.model
            self.equations = Equations(self.regression, model)
            urdf_weights = self.solution.prior.weights
            self.solution = solve(self.equations, self.weights, urdf_weights, self.used, model)
            model = self.solution.model
            change = 1.0 + np.clip(model.joints[:, GAIN], -0.3, 0.3)
            common = self._common_factor(change)
            self.gains *= np.where(self.gain_known, change, 1.0) * common
            model = model.scaled(common)
            model.joints[:, GAIN] = 0.0
            self.solution = self.solution._replace(model=model)
            self.regression.set_efforts(self.aligned(self.motions))
            self.weights = self.weights / common**2
        self.used[:, GAIN] = False

    def _common_factor(self, change: Floats) -> float:
        """Return the factor that keeps the mean of the gains, unless a mass is known."""
        identified = self.problem.identified
        knows_mass = self.problem.payload is not None or identified.fixed_robot().mass[1:].any()
        if knows_mass or not self.gain_known.any():
            return 1.0
        return float(np.exp(-np.mean(np.log(change[self.gain_known]))))

    def aligned(self, motions: Sequence[Motion]) -> list[Floats]:
        """Return the efforts of motions without delay, in N m or N, each of shape (K, m)."""
        return [shifted(motion, self.delay_removed) * self.gains for motion in motions]

    def _shift(self, delay: float) -> None:
        self.delay_removed = delay
        self.regression.set_efforts(self.aligned(self.motions))
        self._iterate(self.solution.model.bodies, self.solution.prior.weights, 2)

    def _loss(self, weights: Floats) -> float:
        residual = self.regression.residual(self.solution.model)
        return float((weights * residual**2).sum())

    def _finish(self) -> None:
        """Fit with the chosen weight of the robot description."""
        bodies = self.solution.model.bodies
        self._iterate(bodies, np.full(len(bodies), self.urdf_weight), 2)
        self.friction, self.friction_used = choose_terms(
            self.regression, self.problem.identified.before, self.moving, self.grid, optional=False
        )
        # The widths of friction are fitted with everything else, to first order.
        self.used[:, WIDTH] = self.moving
        for _ in range(WIDTH_ROUNDS):
            self.equations = Equations(self.regression, self.solution.model)
            self.solution, self.data_fraction = solve_within_reason(
                self.equations, self.weights, self.urdf_weight, self.used, self.solution.model
            )
            model = self.solution.model.with_fitted_widths()
            self.solution = self.solution._replace(model=model)

    def folds(self) -> list[tuple[Model, Model]]:
        """Return friction and identified models fitted without each of the blocks."""
        found = []
        for k in range(self.equations.block_count):
            rows = (self.regression.block != k) & (self.regression.block >= 0)
            friction = fit_terms(
                self.regression,
                self.problem.identified.before,
                self.friction_used,
                self.friction.widths,
                rows,
            )
            solution = solve(
                self.equations, self.weights, self.solution.prior.weights, self.used,
                self.solution.model, k,
            )  # fmt: skip
            found.append((friction, solution.model.exported()))
        return found


def weights_of(residual: Floats) -> Floats:
    """Return the weights of the joints: inverse variances, for dependent samples."""
    squares = np.mean(residual**2, axis=0)
    dependent = np.array([correlation(column) for column in residual.T])
    return np.asarray(1.0 / (np.maximum(squares, 1e-6 * squares.max() + 1e-12) * dependent))


def moving_joints(
    problem: IdentificationProblem, prepared: Sequence[PreparedRecording]
) -> Booleans:
    """Return which joints moved so that their friction can be identified."""
    forth = np.zeros(len(problem.joints))
    back = np.zeros(len(problem.joints))
    for run in prepared:
        steps = np.diff(run.motion.q[:, problem.joints], axis=0)
        forth += np.maximum(steps, 0.0).sum(axis=0)
        back -= np.minimum(steps, 0.0).sum(axis=0)
    slides = problem.identified.robot.is_prismatic_joint[problem.joints]
    least = np.where(slides, LEAST_TRAVEL[True], LEAST_TRAVEL[False])
    return np.asarray(np.minimum(forth, back) > np.maximum(least, LEAST_RETURN * (forth + back)))
