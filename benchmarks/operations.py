"""
Operation counts of the passes of `newton_euler`, from numbers that record their operations.

Each number stores the operation that produced it. The operations that lead to the efforts can
therefore be counted, or compiled as straight-line code. There are two operation counts:

- as written: every operation that the passes perform;
- folded: the operations that remain for one robot if the constants of its table are inserted.

Folding removes operations on constants, additions of zero, multiplications by zero and one, and
operations without influence on the efforts. It replaces numbers within 1e-9 of an integer by that
integer, because URDFs contain rounded multiples of pi.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
import contextlib
import math
from typing import Any, NamedTuple

from inverse_dynamics_node.dynamics import equations, newton_euler, robot_table
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.robot.model import Floats, RobotModel
import numpy as np

from . import lagrange

NEARLY = 1e-9
_SWEEP = """

def sweep(q, qd, qdd, tau, times):
    for _ in range(times):
        for k in range(len(q)):
            efforts(q[k], qd[k], qdd[k], tau[k])
"""
_STRUCTURE = (robot_table.PARENT, robot_table.JOINT, robot_table.SLIDES)  # indices and flags


class Operations(NamedTuple):
    """Numbers of multiplications, of additions and subtractions, and of sine-cosine pairs."""

    multiplications: int
    additions: int
    sines: int

    @property
    def total(self) -> int:
        """Number of multiplications, additions and subtractions, without sines and cosines."""
        return self.multiplications + self.additions


class Number:
    """A number with its origin: an operation, an input or a constant."""

    def __init__(self, record: Record, operation: str, *operands: Any) -> None:
        self.record = record
        self.operation = operation
        self.operands = operands

    def __add__(self, other: Any) -> Number:
        return self.record.combine('+', self, other)

    def __radd__(self, other: Any) -> Number:
        return self.record.combine('+', other, self)

    def __sub__(self, other: Any) -> Number:
        return self.record.combine('-', self, other)

    def __rsub__(self, other: Any) -> Number:
        return self.record.combine('-', other, self)

    def __mul__(self, other: Any) -> Number:
        return self.record.combine('*', self, other)

    def __rmul__(self, other: Any) -> Number:
        return self.record.combine('*', other, self)


class Record:
    """A record of all operations performed; with folding, in order."""

    def __init__(self, folds: bool) -> None:
        self.folds = folds
        self.kinds: Counter[str] = Counter()
        self.performed: list[Number] = []

    def number(self, operation: str, *operands: Any) -> Number:
        """Create a number, and record its origin."""
        self.kinds[operation] += 1
        if not self.folds:
            return Number(self, operation)
        self.performed.append(Number(self, operation, *operands))
        return self.performed[-1]

    def inputs(self, name: str, count: int) -> list[Any]:
        """Create numbers whose values are known only at run time."""
        return [Number(self, 'input', name, k) for k in range(count)]

    def constant(self, value: float) -> Any:
        """Create a constant."""
        if not self.folds:
            return Number(self, 'constant', value)
        return round(value) if abs(value - round(value)) < NEARLY else value

    def function(self, name: str, x: Any) -> Any:
        """Apply sine or cosine."""
        return self.number(name, x) if isinstance(x, Number) else getattr(math, name)(x)

    def combine(self, operation: str, a: Any, b: Any) -> Any:
        """Add, subtract or multiply; with folding, leave out redundant operations."""
        if self.folds and operation == '*':
            for factor, other in ((a, b), (b, a)):
                if _is(factor, 0.0):
                    return 0.0
                if _is(factor, 1.0):
                    return other
                if _is(factor, -1.0):
                    return self.number('negative', other)
        if self.folds and operation in '+-':
            if _is(b, 0.0):
                return a
            if _is(a, 0.0):
                return b if operation == '+' else self.number('negative', b)
        return self.number(operation, a, b)

    def count(self, results: Sequence[Any]) -> Operations:
        """Count operations; with folding, count only operations that affect the results."""
        kinds = self.kinds
        if self.folds:
            kinds = Counter(x.operation for x in self.behind(results))
        return Operations(kinds['*'], kinds['+'] + kinds['-'], kinds['sin'])

    def behind(self, results: Sequence[Any]) -> list[Number]:
        """List the operations that affect the results, in order."""
        needed: set[int] = set()
        waiting = list(results)
        while waiting:
            x = waiting.pop()
            if isinstance(x, Number) and id(x) not in needed:
                needed.add(id(x))
                waiting += x.operands
        return [x for x in self.performed if id(x) in needed]


def _is(x: Any, value: float) -> bool:
    return not isinstance(x, Number) and x == value


def record_newton_euler(robot: RobotModel, folds: bool) -> tuple[Record, list[Any]]:
    """Run both passes for one robot; return the record and the efforts."""
    record = Record(folds)
    n = len(robot.joint_names)
    rows = [
        [x if k in _STRUCTURE else record.constant(x) for k, x in enumerate(row)]
        for row in table_under_gravity(robot).tolist()
    ]
    q, qd, qdd = (record.inputs(name, n) for name in ('q', 'qd', 'qdd'))
    tau: list[Any] = [0.0] * n
    with uncompiled(record, robot_table, equations, newton_euler):
        newton_euler.outward_pass(q, qd, qdd, rows)
        newton_euler.inward_pass(tau, rows)
    return record, tau


def table_under_gravity(robot: RobotModel) -> Floats:
    """Return the robot table for a base at rest under gravity: LWP (31)."""
    rows = robot_table.table_of(robot)
    rows[0, robot_table.ACCEL : robot_table.ACCEL + 3] = -np.array(STANDARD_GRAVITY)
    return rows


def count_newton_euler(robot: RobotModel, folds: bool) -> Operations:
    """Count the operations of one call."""
    record, tau = record_newton_euler(robot, folds)
    return record.count(tau)


@contextlib.contextmanager
def uncompiled(record: Record, *modules: Any) -> Iterator[None]:
    """Yield the functions of some modules as plain Python for computing with recorded numbers."""
    before = [dict(vars(module)) for module in modules]
    for module, names in zip(modules, before, strict=True):
        for name, function in names.items():
            if hasattr(function, 'py_func'):
                setattr(module, name, function.py_func)
        for name in ('sin', 'cos'):
            setattr(module, name, lambda x, name=name: record.function(name, x))
    try:
        yield
    finally:
        for module, names in zip(modules, before, strict=True):
            vars(module).update(names)


def count_lagrange(robot: RobotModel, keep: bool) -> Operations:
    """Count the operations of one evaluation of equation (2), as written."""
    record = Record(folds=False)
    n = len(robot.joint_names)
    chain = lagrange.chain_of(robot)
    numbers = lagrange.Chain(*(_recorded(array, record) for array in chain))
    numbers = numbers._replace(slides=chain.slides)
    states = [np.array([record.inputs(name, n)]) for name in ('q', 'qd', 'qdd')]
    sweep = 'kept_sweep' if keep else 'multiplied_sweep'
    with uncompiled(record, lagrange):
        getattr(lagrange, sweep)(*states, np.empty((1, n), object), numbers, 1)
    return record.count([])


def _recorded(array: Floats, record: Record) -> Any:
    numbers = [record.constant(x) for x in array.ravel().tolist()]
    return np.array(numbers, object).reshape(array.shape)


def compiled_straight_line(robot: RobotModel) -> Any:
    """Compile the loop over the straight-line code of a robot."""
    names: dict[str, Any] = {'sin': math.sin, 'cos': math.cos}
    exec(straight_line(robot), names)
    names['efforts'] = lagrange.compiled(names['efforts'])
    return lagrange.compiled(names['sweep'])


def straight_line(robot: RobotModel) -> str:
    """Write folded operations as a function `efforts`, and a loop over states as `sweep`."""
    record, tau = record_newton_euler(robot, folds=True)
    names: dict[int, str] = {}

    def name(x: Any) -> str:
        if not isinstance(x, Number):
            return repr(float(x))
        if x.operation == 'input':
            return f'{x.operands[0]}[{x.operands[1]}]'
        return names[id(x)]

    lines = ['def efforts(q, qd, qdd, tau):']
    for k, x in enumerate(record.behind(tau)):
        names[id(x)] = f'x{k}'
        values = [name(operand) for operand in x.operands]
        if x.operation == 'negative':
            right = f'-{values[0]}'
        elif x.operation in ('sin', 'cos'):
            right = f'{x.operation}({values[0]})'
        else:
            right = f'{values[0]} {x.operation} {values[1]}'
        lines.append(f'    x{k} = {right}')
    lines += [f'    tau[{k}] = {name(x)}' for k, x in enumerate(tau)]
    return '\n'.join(lines) + _SWEEP
