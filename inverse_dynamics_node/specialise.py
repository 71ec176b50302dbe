"""
Machine code for one robot: the passes of `newton_euler`, written out.

Nothing is derived a second time. The functions of `newton_euler` run here as they stand, once, but
on numbers of another kind: arithmetic on a `RunTimeNumber` does not compute, it writes the
instruction that will. What a robot's table holds for good (who is whose parent, what slides, the
offsets) are plain numbers, which steer the functions as ever; so loops and branches are gone, and
with them every product with a zero of the table. What is left is one straight line of code.

What may change while it runs is read anew at each call. Only where nothing acted when the code was
written, there is no code for it; a `Specialised` object sees to that.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from types import FunctionType
from typing import Any, NamedTuple, NoReturn
import warnings

import numpy as np

from . import newton_euler
from . import table as columns
from .compilation import IS_COMPILED
from .dynamics import InverseDynamics
from .model import Floats
from .newton_euler import NOT_FINITE, OK

if IS_COMPILED:
    import numba
    from numba.extending import intrinsic

DIFFERS_FROM_CODE = -1


class State(NamedTuple):
    """One state of n joints, each of shape (n,), to be written to in place."""

    q: Floats
    """Joint positions [rad or m]."""
    qd: Floats
    """Joint velocities [rad/s or m/s]."""
    qdd: Floats
    """Joint accelerations [rad/s^2 or m/s^2]."""
    tau: Floats
    """Joint efforts [N m or N]."""


class Specialised:
    """
    Inverse dynamics of one robot for a control loop: code of its own, on arrays of its own.

    Computes what `InverseDynamics.efforts` does, but for rounding: multiplications and additions
    are fused where the processor can. What is set on the dynamics counts here at once, without
    compiling: gravity, motion of the base, payloads, wrenches, friction, armature. Where a
    number is set that was zero when this object was made (a base that begins to turn, say),
    `InverseDynamics.efforts` does the work for as long as it is not zero again; it always does
    without numba.

    Parameters
    ----------
    dynamics : InverseDynamics
        As it usually is in the loop: weightless robots are rare, wrenches come and go.

    Attributes
    ----------
    state : State
        Named tuple of ``q, qd, qdd``, to be filled before a call, and ``tau``.

    Notes
    -----
    Compiles for tenths of a second, each time: the code holds the addresses of the arrays.

    """

    def __init__(self, dynamics: InverseDynamics) -> None:
        block = np.zeros((4, len(dynamics.robot.joint_names)))
        # Views of the block: numpy does not let anyone resize what the code has the address of.
        self.state = State(*block)
        self._tau = self.state.tau
        self._dynamics = dynamics
        self._table = dynamics.table
        self._traced = _acting(self._table)
        self._revision = dynamics.revision
        self._code = _nothing_fits
        if IS_COMPILED:
            try:
                self._code = write_out(self._table, block)
            except Exception as error:  # it reaches deep into numba, whose versions differ
                warnings.warn(f'no code of its own for this robot: {error!r}', stacklevel=2)
        self._run = self._code

    def efforts(self) -> Floats:
        """
        Compute the joint efforts of ``state.q, state.qd, state.qdd``.

        Returns
        -------
        tau : ndarray, shape (n,)
            ``state.tau``, written anew.

        Raises
        ------
        JointStateError
            If a value is not finite.

        """
        if self._revision != self._dynamics.revision:
            self._look_again()
        if self._run() != OK:
            # The general way fits any robot, and tells what is wrong with a state.
            return self._dynamics.efforts(*self.state)
        return self._tau

    def _look_again(self) -> None:
        """Use the code only while what acts on the robot has a place in it."""
        self._revision = self._dynamics.revision
        is_new = _acting(self._table) & ~self._traced
        self._run = _nothing_fits if is_new.any() else self._code

    def __reduce__(self) -> NoReturn:
        raise TypeError('code is bound to its arrays, and not to be copied: make another')


def _nothing_fits() -> int:
    return DIFFERS_FROM_CODE


def _acting(table: Floats) -> Any:
    """Tell which numbers of a table may change between calls, and are not zero now."""
    mask = np.zeros(table.shape, dtype=bool)
    inputs = (columns.MASS, columns.COM, columns.INERTIA, columns.EXTERNAL, columns.JOINT_TERMS)
    for part in inputs:
        mask[:, part] = True
    mask[0, columns.BASE_MOTION] = True
    return mask & (table != 0.0)


def write_out(table: Floats, block: Floats) -> Callable[[], int]:
    """
    Compile `newton_euler.inverse_dynamics` for one robot and one place of its state.

    Parameters
    ----------
    table : ndarray, shape (b, 64)
        From `robot_table`.
    block : ndarray, shape (4, n)
        Rows q, qd, qdd, tau.

    Returns
    -------
    code : function without arguments
        Returns a status as `newton_euler.inverse_dynamics` does. Keeps the arrays alive.

    """

    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def straight_line(_: Any) -> Any:
        def write(context: Any, builder: Any, *_: Any) -> Any:
            writer = Writer(context, builder)
            robot = table.tolist()
            for i, k in np.argwhere(_acting(table)):
                robot[i][k] = writer.load(table[i, k:])
            q, qd, qdd, tau = ([writer.load(row[k:]) for k in range(len(row))] for row in block)
            functions = _functions_that_write(writer, [*q, *qd, *qdd])
            status = functions['inverse_dynamics'](q, qd, qdd, tau, robot)
            for k, effort in enumerate(tau):
                writer.store(effort, block[3, k:])
            return status

        return numba.int64(), write

    code = numba.njit('int64()')(lambda: straight_line())
    code.disable_compile()
    return code  # type: ignore[no-any-return]


class RunTimeNumber:
    """
    A number that is not known before the code runs: arithmetic on it writes an instruction.

    Sums with 0 and products with 0 or 1 need none. To Python it equals no plain number: where
    `newton_euler` asks whether it is zero, what is written is the way of a number that is not.

    """

    def __init__(self, writer: Writer, value: Any) -> None:
        self.writer = writer
        self.value = value

    def __add__(self, other: Any) -> Any:
        return self if other == 0.0 else self.writer.operation('fadd', self, other)

    def __sub__(self, other: Any) -> Any:
        return self if other == 0.0 else self.writer.operation('fsub', self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.writer.operation('fsub', other, self)

    def __mul__(self, other: Any) -> Any:
        if other == 0.0:
            return 0.0
        return self if other == 1.0 else self.writer.operation('fmul', self, other)

    __radd__ = __add__
    __rmul__ = __mul__


class Writer:
    """Writes instructions for numbers of both kinds, into a function that numba compiles."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context = context
        self.builder = builder

    def operation(self, name: str, *numbers: Any) -> RunTimeNumber:
        write = getattr(self.builder, name)
        return RunTimeNumber(self, write(*map(self._value, numbers), flags=('contract',)))

    def load(self, array: Floats) -> RunTimeNumber:
        return RunTimeNumber(self, self.builder.load(self._first(array)))

    def store(self, number: Any, array: Floats) -> None:
        self.builder.store(self._value(number), self._first(array))

    def elementary(self, function: Callable[[float], float]) -> Callable[[Any], Any]:
        """Make a function of `math` one that takes numbers of both kinds."""
        call = self.context.get_function(function, numba.float64(numba.float64))

        def write(number: Any) -> Any:
            if not isinstance(number, RunTimeNumber):
                return function(number)
            return RunTimeNumber(self, call(self.builder, [number.value]))

        return write

    def status(self, number: Any) -> Any:
        """Choose a status: whether a number is one, or a NaN."""
        value = self._value(number)
        is_nan = self.builder.fcmp_unordered('uno', value, value)
        return self.builder.select(is_nan, *(self._integer(x) for x in (NOT_FINITE, OK)))

    def _value(self, number: Any) -> Any:
        if isinstance(number, RunTimeNumber):
            return number.value
        return self.context.get_constant(numba.float64, number)

    def _integer(self, number: int) -> Any:
        return self.context.get_constant(numba.int64, number)

    def _first(self, array: Floats) -> Any:
        """Point to the first number of an array."""
        kind = self.context.get_value_type(numba.float64).as_pointer()
        return self.builder.inttoptr(self._integer(array.ctypes.data), kind)


def _functions_that_write(writer: Writer, inputs: list[RunTimeNumber]) -> dict[str, Any]:
    """Take the functions of `newton_euler` as they were before numba, with others to call."""
    # Where a zero was left out, no NaN or infinity reaches an effort: inputs are checked as well.
    zero_if_finite = sum(x - x for x in inputs)

    def check(tau: list[Any]) -> Any:
        return writer.status(sum((x - x for x in reversed(tau)), zero_if_finite))

    functions = {**vars(newton_euler), 'check': check}
    for function in (math.cos, math.sin, math.tanh):
        functions[function.__name__] = writer.elementary(function)
    for name, function in functions.items():
        if hasattr(function, 'py_func'):
            functions[name] = FunctionType(function.py_func.__code__, functions)
    return functions
