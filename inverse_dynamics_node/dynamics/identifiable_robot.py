"""The efforts of a robot as a linear function of the inertial parameters of its bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..robot.model import Floats, RobotModel
from . import batch, regressor
from .dispatch import one_by_one, over_states
from .kernels import MATRIX as _M
from .kernels import prepared
from .kernels import VECTOR as _V
from .loaded_robot import LoadedRobot, STANDARD_GRAVITY


class IdentifiableRobot(LoadedRobot):
    r"""
    A robot with loads whose efforts are linear in its inertial parameters: :math:`\tau = Y\,\pi`.

    Parameters and errors are those of `LoadedRobot`.

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        super().__init__(robot, gravity)
        self._regressor_shape = len(robot.joint_names), 10 * (len(robot.parent) - 1)

    def regressor(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        r"""
        Compute the regressor Y of the inertial parameters: :math:`\tau = Y(q, qd, qdd)\,\pi`.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.
        out : ndarray, shape (..., n, 10 (b - 1)), optional
            Receives the result: C-contiguous float64.

        Returns
        -------
        regressor : ndarray, shape (..., n, 10 (b - 1))
            Ten columns for each moving body, in the order of ``robot.body_names[1:]``, which are
            the names of the joints that move them: for mass [kg], mass times centre of mass (x,
            y, z) [kg m], and inertia about the origin of the body's frame (xx, xy, yy, xz, yz,
            zz) [kg m^2], as in Pinocchio. The frame is the URDF frame of the joint.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        See Also
        --------
        inertial_parameters : pi of this robot.

        Notes
        -----
        Links that fixed joints hold together are one body. A body that a mimic joint moves has
        columns of its own, and adds to the row of the joint that is mimicked. Gravity and the
        motion of the base are included. Armature, friction and external wrenches are not: the
        efforts due to them do not depend on pi. Payloads are part of pi and do not change Y.

        The first call on a machine compiles; the machine code is cached on disk.

        """
        shape = self._regressor_shape
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(shape) if out is None else out
                if not self._regressor(q, qd, qdd, self._R_LZ, matrix, self._table):
                    return matrix
        except (AttributeError, TypeError, ValueError):
            pass

        def one(state: Sequence[Floats], out: Floats) -> int:
            return self._regressor(*state, self._R_LZ, out, self._table)

        def many(states: Sequence[Floats], out: Floats) -> int:
            return batch.regressor_many(states, out, self._R_LZ, self._table)

        return over_states(self.robot, shape, one_by_one(one), many, out, q=q, qd=qd, qdd=qdd)

    def inertial_parameters(self) -> Floats:
        """
        Return the inertial parameters pi of the moving bodies, including payloads.

        Returns
        -------
        parameters : ndarray, shape (10 (b - 1),)
            In the order of the columns of `regressor`. ``regressor(q, qd, qdd) @ parameters`` are
            the efforts of a robot without armature, friction and external wrenches.

        """
        bodies = range(1, len(self.robot.parent))
        parameters = [self._rigid_body(body).parameters() for body in bodies]
        return np.array(parameters).reshape(-1)

    @cached_property
    def _regressor(self) -> Callable[..., int]:
        """Prepared at the first use, because most programs do not need it."""
        return prepared(regressor.regressor, _V, _V, _V, _M, _M, _M)
