"""The efforts of a recorded motion, measured and modelled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats
from ..columns import gravity_columns, payload_columns
from ..recordings.resampling import smooth_like_efforts
from ..recordings.signals import Motion
from .friction import is_moving, obstacle
from .intervals import FaultInterval
from .joint_samples import JointSamples
from .loads import moves_with, tip_links
from .regression_data import RegressionData

SAMPLES_PER_WINDOW = 8  # used by fits; the samples of a smoothing window are dependent
MOVED = 0.02  # [rad or m]; a joint that moved less shows no load
INERTIAS = 50  # samples at which the effect of noisy accelerations is computed
CONSTANT = 1e-9  # fraction of the largest effort; smaller variations are rounding errors


class ComparedEfforts:
    """
    The efforts of one motion, measured and modelled; columns are the compared joints.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot with n joints, and all known loads on it.
    motion : Motion
        Motion of m of its joints.
    index : list of int
        Positions of these joints in ``robot.joint_names``.
    others : array_like, shape (n,), optional
        Positions of the joints that were not recorded [rad or m]; default: zero.
    link : str, optional
        Link that may carry an unknown load; default: the tips of the tree.
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s].

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        motion: Motion,
        index: list[int],
        others: ArrayLike | None,
        link: str | None,
        width: float,
    ) -> None:
        self.dynamics, self.motion = dynamics, motion
        self.width = width
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
        self.period = motion.period
        self.modelled: Floats = dynamics.efforts(*self.states)[:, self.index]
        # Friction is fitted again, to efforts without the friction that the dynamics may have.
        terms = dynamics.effort_terms(*self.states)
        self.rigid: Floats = self.modelled - terms.friction[:, self.index]
        self.gravity: Floats = terms.gravity[:, self.index]
        self.noise = self._noise()
        self.varying = self._varying()
        self.constant = self._unexpectedly_constant()

    @property
    def fit_samples(self) -> slice:
        """The samples that fits use."""
        return slice(None, None, max(1, self.motion.window // SAMPLES_PER_WINDOW))

    @property
    def fit_states(self) -> tuple[Floats, Floats, Floats]:
        """Positions, velocities and accelerations at the samples that fits use."""
        q, qd, qdd = self.states
        return q[self.fit_samples], qd[self.fit_samples], qdd[self.fit_samples]

    def inside(self, fault: FaultInterval) -> Booleans:
        """Return which samples are in a part of the recording."""
        begin, end = fault.interval
        return np.asarray((self.motion.times >= begin) & (self.motion.times <= end))

    def moves(self, c: int) -> bool:
        """Return whether a joint moves enough to identify its friction."""
        return not obstacle(self.qd[:, c], self.period, self.width)

    def used(self, c: int) -> Booleans:
        """Return at which times the effort of a joint is compared."""
        if not self.moves(c):
            return np.ones(len(self.qd), dtype=bool)
        return is_moving(self.qd[:, c], self.width)

    def is_prismatic(self, c: int) -> bool:
        """Return whether a joint is prismatic."""
        return bool(self.robot.is_prismatic_joint[self.index[c]])

    def regression_data(self) -> RegressionData:
        """Return the samples of the varying efforts, with all efforts that may explain them."""
        q, _, _ = states = self.fit_states
        robot, gravity = self.robot, self.dynamics.gravity
        weight = gravity_columns(robot, q)
        loads = [payload_columns(robot, gravity, link, states) for link in self.links]
        joints = [self._joint_samples(c, weight, loads) for c in self.varying]
        duration = len(self.motion.times) * self.period
        sample_count = len(self.motion.times) / self.motion.window
        bodies = [robot.link_body[robot.link_index(link)] for link in self.links]
        masses = {k: float(robot.mass[b]) for k, b in zip(self.links, bodies, strict=True)}
        return RegressionData(joints, masses, gravity, sample_count, duration)

    def _joint_samples(self, c: int, weight: Floats, loads: Sequence[Floats]) -> JointSamples:
        """Return the samples of a column, with the columns of `joint_samples`."""
        some, i = self.fit_samples, self.index[c]
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
                self.measured[some][:, self.varying],
            ]
        )
        used = self.used(c)[some]
        return JointSamples(
            columns[used],
            self.motion.times[some][used],
            self.moves(c),
            float(self.noise[c]),
            self.is_prismatic(c),
        )

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
