"""
Code generation for one robot.

To generate code, the functions of `newton_euler` and `mass_matrix` run once. In this run, every
joint state and load is a `RunTimeNumber`. Arithmetic on a `RunTimeNumber` emits an instruction
instead of computing a result. Constants of the robot, such as joint types and offsets, remain
plain numbers. The generated code therefore contains no loops, no branches, and no products with a
constant zero.

At each call, the code reads the loads from the robot table. Payloads, gravity and other loads
that are zero during generation are left out. `GeneratedDynamics` detects when such a load becomes
nonzero.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from types import FunctionType
from typing import Any, cast

import numpy as np

from ...robot.model import Floats
from .. import equations, link_kinematics, mass_matrix, newton_euler, robot_table
from ..jit import IS_COMPILED, NOT_FINITE, OK, WRONG_SIZE

if IS_COMPILED:
    import numba
    from numba.extending import intrinsic


Code = tuple[Callable[[], int], Callable[[Any, Any, Any, Any], int]]
"""
Two functions that return a status code of the module `jit`.

The first function reads and writes the ``block`` of `write_out`. The second function has the
arguments q, qd, qdd and tau.
"""


def acting_numbers(table: Floats) -> Any:
    """Return a mask of the numbers in a table that are nonzero and may change between calls."""
    mask = np.zeros(table.shape, dtype=bool)
    for part in (
        robot_table.MASS,
        robot_table.COM_COLUMNS,
        robot_table.INERTIA_COLUMNS,
        robot_table.EXTERNAL_COLUMNS,
        robot_table.SPRING_COLUMNS,
        robot_table.DRIVE_TERM_COLUMNS,
    ):
        mask[:, part] = True
    mask[0, robot_table.BASE_MOTION_COLUMNS] = True
    return mask & (table != 0.0)


def write_out(table: Floats, block: Floats) -> Code:
    """
    Compile `newton_euler.inverse_dynamics` for one robot.

    ``table`` is from `robot_table`. ``block``, shape (4, n), contains q, qd, qdd and tau. The two
    arrays must exist as long as the code, because the code contains the addresses of the arrays.

    """
    n = block.shape[1]

    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def straight_line(_: Any, q: Any, qd: Any, qdd: Any, tau: Any) -> Any:
        def write(context: Any, builder: Any, _: Any, addresses: Any) -> Any:
            writer = Writer(context, builder)
            robot = _run_time_table(writer, table, acting_numbers(table))
            q, qd, qdd, tau = ([writer.load(row, k) for k in range(n)] for row in addresses)
            functions = _functions_that_write(writer, [*q, *qd, *qdd])
            status = functions['inverse_dynamics'](q, qd, qdd, tau, robot)
            for k, effort in enumerate(tau):
                writer.store(effort, addresses[3], k)
            return status

        return numba.int64(q, qd, qdd, tau), write

    q_row, qd_row, qdd_row, tau_row = (row.ctypes.data for row in block)

    def in_block() -> Any:
        return straight_line(q_row, qd_row, qdd_row, tau_row)

    def in_arrays(q: Floats, qd: Floats, qdd: Floats, tau: Floats) -> Any:
        if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
            return WRONG_SIZE
        return straight_line(q.ctypes.data, qd.ctypes.data, qdd.ctypes.data, tau.ctypes.data)

    signature = 'int64(f8[::1], f8[::1], f8[::1], f8[::1])'
    return _compile(in_block, 'int64()'), _compile(in_arrays, signature)


def write_out_mass_matrix(table: Floats, acting: Any) -> Callable[[Any, Any], int]:
    """
    Compile `mass_matrix.mass_matrix` for one robot, as a function with the arguments q and matrix.

    At each call, the code reads the numbers of the table that the mask ``acting`` selects. The
    table must exist as long as the code, because the code contains the address of the table.

    """
    n = int(table[0, robot_table.JOINT_COUNT])

    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def straight_line(_: Any, q: Any, matrix: Any) -> Any:
        def write(context: Any, builder: Any, _: Any, addresses: Any) -> Any:
            writer = Writer(context, builder)
            robot = _run_time_table(writer, table, acting)
            q = [writer.load(addresses[0], k) for k in range(n)]
            matrix = [[0.0] * n for _ in range(n)]
            status = _functions_that_write(writer, q)['mass_matrix'](q, matrix, robot)
            for k, entry in enumerate(entry for row in matrix for entry in row):
                writer.store(entry, addresses[1], k)
            return status

        return numba.int64(q, matrix), write

    def in_arrays(q: Floats, matrix: Floats) -> Any:
        if len(q) != n or matrix.shape != (n, n):
            return WRONG_SIZE
        return straight_line(q.ctypes.data, matrix.ctypes.data)

    return cast(Callable[[Any, Any], int], _compile(in_arrays, 'int64(f8[::1], f8[:,::1])'))


def _run_time_table(writer: Writer, table: Floats, acting: Any) -> list[list[Any]]:
    """Return the rows of a table, with run-time numbers where the mask ``acting`` is True."""
    base = writer.integer(table.ctypes.data)
    robot: list[list[Any]] = table.tolist()
    for i, k in np.argwhere(acting):
        robot[i][k] = writer.load(base, i * robot_table.COLUMNS + k)
    return robot


def _compile(function: Callable[..., int], signature: str) -> Any:
    compiled = numba.njit(signature)(function)
    compiled.disable_compile()  # other argument types raise a TypeError
    return compiled


def _functions_that_write(writer: Writer, inputs: list[RunTimeNumber]) -> dict[str, Any]:
    """Copy the compiled functions; the copies emit instructions with the writer."""
    # The inputs are checked too, because omitted products with zero do not propagate NaN or inf.
    zero_if_finite = sum(x - x for x in inputs)

    def check(tau: list[Any]) -> Any:
        return writer.status(sum((x - x for x in reversed(tau)), zero_if_finite))

    def check_diagonal(matrix: list[list[Any]]) -> Any:
        return check([row[k] for k, row in enumerate(matrix)])

    functions = {**vars(robot_table), **vars(equations), **vars(link_kinematics)}
    functions |= {**vars(newton_euler), **vars(mass_matrix)}
    functions |= {'check': check, 'check_diagonal': check_diagonal}
    for function in (math.cos, math.fabs, math.sin, math.sqrt, math.tanh):
        functions[function.__name__] = writer.elementary(function)
    for name, function in functions.items():
        if hasattr(function, 'py_func'):
            functions[name] = FunctionType(function.py_func.__code__, functions)
    return functions


class RunTimeNumber:
    """
    A number that is known only at run time.

    Arithmetic on the number emits an instruction, except for sums with 0 and products with 0 or 1.
    A `RunTimeNumber` never equals 0, so that comparisons in `newton_euler` select the branch for
    nonzero numbers.

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
    """Emits instructions into a function that numba compiles."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context = context
        self.builder = builder

    def operation(self, name: str, *numbers: Any) -> RunTimeNumber:
        write = getattr(self.builder, name)
        return RunTimeNumber(self, write(*map(self._value, numbers), flags=('contract',)))

    def load(self, address: Any, k: int) -> RunTimeNumber:
        """Emit an instruction that loads number k of the array at an address."""
        return RunTimeNumber(self, self.builder.load(self._pointer(address, k)))

    def store(self, number: Any, address: Any, k: int) -> None:
        self.builder.store(self._value(number), self._pointer(address, k))

    def elementary(self, function: Callable[[float], float]) -> Callable[[Any], Any]:
        """Extend a function of `math` to run-time numbers."""
        call = self.context.get_function(function, numba.float64(numba.float64))

        def write(number: Any) -> Any:
            if not isinstance(number, RunTimeNumber):
                return function(number)
            return RunTimeNumber(self, call(self.builder, [number.value]))

        return write

    def status(self, number: Any) -> Any:
        """Emit instructions for the status: `NOT_FINITE` if a number is NaN, otherwise `OK`."""
        value = self._value(number)
        is_nan = self.builder.fcmp_unordered('uno', value, value)
        return self.builder.select(is_nan, *(self.integer(x) for x in (NOT_FINITE, OK)))

    def _value(self, number: Any) -> Any:
        if isinstance(number, RunTimeNumber):
            return number.value
        return self.context.get_constant(numba.float64, number)

    def integer(self, number: int) -> Any:
        return self.context.get_constant(numba.intp, number)

    def _pointer(self, address: Any, k: int) -> Any:
        kind = self.context.get_value_type(numba.float64).as_pointer()
        first = self.builder.inttoptr(address, kind)
        return self.builder.gep(first, [self.integer(k)])
