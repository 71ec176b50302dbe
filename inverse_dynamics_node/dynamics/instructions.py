"""Arithmetic that emits instructions instead of computing, for functions traced by `codegen`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .jit import IS_COMPILED
from .newton_euler import NOT_FINITE, OK

if IS_COMPILED:
    import numba


class RunTimeNumber:
    """
    A number that is known only at run time: arithmetic on it emits an instruction.

    Sums with 0 and products with 0 or 1 emit none. It never equals a plain number, so that the
    code takes the branch for nonzero numbers wherever `newton_euler` compares it with zero.

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
    """Emits instructions for plain and run-time numbers into a function that numba compiles."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context = context
        self.builder = builder

    def operation(self, name: str, *numbers: Any) -> RunTimeNumber:
        write = getattr(self.builder, name)
        return RunTimeNumber(self, write(*map(self._value, numbers), flags=('contract',)))

    def load(self, address: Any, k: int) -> RunTimeNumber:
        """Load number k of an array at an address."""
        return RunTimeNumber(self, self.builder.load(self._pointer(address, k)))

    def store(self, number: Any, address: Any, k: int) -> None:
        self.builder.store(self._value(number), self._pointer(address, k))

    def elementary(self, function: Callable[[float], float]) -> Callable[[Any], Any]:
        """Return a function of `math` for plain and run-time numbers."""
        call = self.context.get_function(function, numba.float64(numba.float64))

        def write(number: Any) -> Any:
            if not isinstance(number, RunTimeNumber):
                return function(number)
            return RunTimeNumber(self, call(self.builder, [number.value]))

        return write

    def status(self, number: Any) -> Any:
        """Return the status NOT_FINITE if a number is NaN, otherwise OK."""
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
