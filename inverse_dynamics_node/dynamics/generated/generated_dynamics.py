"""Inverse dynamics with code that is generated for one robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn
import warnings

import numpy as np
from numpy.typing import ArrayLike

from ...robot.model import Floats
from ..inverse_dynamics import InverseDynamics
from ..jit import IS_COMPILED, OK
from .codegen import acting_numbers, Code, write_out, write_out_mass_matrix


class State(NamedTuple):
    """Arrays of shape (n,) for n joints; callers fill q, qd and qdd, and `update` fills tau."""

    q: Floats
    """Joint positions [rad or m]."""
    qd: Floats
    """Joint velocities [rad/s or m/s]."""
    qdd: Floats
    """Joint accelerations [rad/s^2 or m/s^2]."""
    tau: Floats
    """Joint efforts [N m or N]."""


def no_code(*_: Any) -> int:
    """Return a status other than `OK`; replaces code that is missing or omits a nonzero load."""
    return -1


NO_CODE: Code = no_code, no_code
NO_CODE_WARNING = 'InverseDynamics is used because code generation failed with {!r}'


class GeneratedDynamics:
    """
    Fast inverse dynamics for control loops, with code that is generated for one robot.

    The results may differ from those of `InverseDynamics` by rounding errors, because the
    processor may fuse multiplications and additions. A change of gravity, base motion, payloads,
    wrenches, friction or armature in ``dynamics`` applies at once, without another compilation.

    The code omits loads that are zero when the object is created. If such a load becomes nonzero,
    `InverseDynamics` computes the efforts until the load is zero again. Without numba,
    `InverseDynamics` always computes the efforts.

    Parameters
    ----------
    dynamics : InverseDynamics
        Dynamics with a typical value of every load that the control loop will set.

    Attributes
    ----------
    state : State
        Named tuple of the arrays ``q, qd, qdd, tau`` for `update`, each of shape (n,).

    Notes
    -----
    Creating an object takes a few tenths of a second, because every object compiles its own code.
    The code is not cached, because compiled code contains memory addresses. The first call of
    `mass_matrix` compiles more code, and should be made before the control loop starts.

    """

    def __init__(self, dynamics: InverseDynamics) -> None:
        block = np.zeros((4, len(dynamics.robot.joint_names)))
        # The address of the block is constant, because numpy cannot resize an array with views.
        self.state = State(*block)
        self._tau = self.state.tau
        self._dynamics = dynamics
        self._table = dynamics.table
        self._traced = acting_numbers(self._table)
        self._revision = dynamics.revision
        self._code = NO_CODE
        if IS_COMPILED:
            try:
                self._code = write_out(self._table, block)
            except Exception as error:  # the internals of numba vary between versions
                warnings.warn(NO_CODE_WARNING.format(error), stacklevel=2)
        self._in_block, self._in_arrays = self._code
        self._compiled_mass_matrix: Callable[[Any, Any], int] | None = None
        self._mass_matrix: Callable[[Any, Any], int] = self._first_mass_matrix

    def update(self) -> Floats:
        """
        Compute the efforts for the values in ``state``; this is the fastest call from Python.

        Returns
        -------
        tau : ndarray, shape (n,)
            The array ``state.tau``, which this call overwrites.

        Raises
        ------
        JointStateError
            If a value is not finite.

        """
        if self._revision != self._dynamics.revision:
            self._select_code()
        if self._in_block() != OK:
            # `InverseDynamics` handles every case, and raises errors for invalid states.
            return self._dynamics.efforts(*self.state)
        return self._tau

    def efforts(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        """
        Compute the joint efforts for given arrays.

        Parameters, result and errors are those of `InverseDynamics.efforts`.

        """
        if self._revision != self._dynamics.revision:
            self._select_code()
        try:
            tau = np.empty_like(self._tau) if out is None else out
            if self._in_arrays(q, qd, qdd, tau) == OK:
                return tau
        except (TypeError, ValueError):  # lists, integers, batches, views with strides
            pass
        return self._dynamics.efforts(q, qd, qdd, out)

    def mass_matrix(self, q: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute the mass matrix; the first call compiles code.

        Parameters, result and errors are those of `InverseDynamics.mass_matrix`.

        """
        if self._revision != self._dynamics.revision:
            self._select_code()
        try:
            matrix = np.empty(2 * self._tau.shape) if out is None else out
            if self._mass_matrix(q, matrix) == OK:
                return matrix
        except (TypeError, ValueError):
            pass
        return self._dynamics.mass_matrix(q, out)

    def _first_mass_matrix(self, q: Any, matrix: Any) -> int:
        """Compile and run the code for the mass matrix."""
        self._compiled_mass_matrix = no_code
        if IS_COMPILED:
            try:
                self._compiled_mass_matrix = write_out_mass_matrix(self._table, self._traced)
            except Exception as error:
                warnings.warn(NO_CODE_WARNING.format(error), stacklevel=3)
        self._select_code()
        return self._mass_matrix(q, matrix)

    def _select_code(self) -> None:
        """Select the generated code, or `InverseDynamics` if the code omits a nonzero load."""
        self._revision = self._dynamics.revision
        is_new = (acting_numbers(self._table) & ~self._traced).any()
        self._in_block, self._in_arrays = NO_CODE if is_new else self._code
        if self._compiled_mass_matrix is not None:
            self._mass_matrix = no_code if is_new else self._compiled_mass_matrix

    def __reduce__(self) -> NoReturn:
        raise TypeError('GeneratedDynamics cannot be copied or pickled; make a new object')
