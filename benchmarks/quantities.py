"""
All quantities of this package, each timed relative to Pinocchio's function for the same quantity.

Both libraries are timed for one call and for a batch. For one call, this package writes to an
existing array. For a batch, a Python loop calls Pinocchio and stores all results in one array.
"""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time
from typing import Any, NamedTuple

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.dynamics.batch import LANES
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from .batch import whole
from .peers import Pinocchio, rows
from .robots import random_states, Robot
from .timing import Contender, contender, States

MOST_STATES = 512  # largest number of states in a batch
MOST_NUMBERS = 1 << 20  # largest number of values in the results of a batch: 8 MB

OURS, THEIRS = 'ours', 'pin'

Call = Callable[..., Any]


class Counterpart(NamedTuple):
    """Calls of Pinocchio that compute a quantity."""

    call: Call
    """Function of Pinocchio's model, its data and the arguments."""
    read: Callable[[Any], Floats]
    """Converts the result of a call to an array with the joint order of this package."""
    store: Callable[[Floats, Any], None]
    """Stores the result of a call as one element of the results of a batch."""


class Quantity(NamedTuple):
    """A quantity of this package and its counterpart."""

    method: str
    """Name of the method of this package's dynamics."""
    label: str
    """Names of Pinocchio's functions."""
    arity: int
    """Number of arguments: 1 for q; 2 for q and qd; 3 for q, qd and qdd."""
    counterpart: Callable[[Pinocchio], Counterpart]

    @property
    def name(self) -> str:
        """Label of the row in the table."""
        return f'`{self.method}`'


def one_call(quantity: Quantity, robot: Robot) -> list[Contender]:
    """Time one call of this package and of Pinocchio."""
    states = random_states(robot.n)[: quantity.arity]
    method = getattr(InverseDynamics(robot.model), quantity.method)
    out = np.empty_like(method(*states[:, 0]))
    peer = Pinocchio(robot)
    found = quantity.counterpart(peer)
    theirs = peer.states(random_states(robot.n))[: quantity.arity]
    return [
        contender(
            OURS,
            rows(*states),
            _our_sweep(method, out, quantity.arity),
            method,
        ),
        contender(
            THEIRS,
            rows(*theirs),
            _their_sweep(found.call, peer, quantity.arity),
            lambda *state: found.read(found.call(peer.model, peer.data, *state)),
        ),
    ]


def batches(quantity: Quantity, robot: Robot) -> list[Contender]:
    """Time a batch in this package, and a Python loop over Pinocchio's call."""
    method = getattr(InverseDynamics(robot.model), quantity.method)
    size = method(*np.zeros((quantity.arity, robot.n))).size
    count = min(MOST_STATES, max(LANES, MOST_NUMBERS // size))
    states = random_states(robot.n, count)
    peer = Pinocchio(robot)
    call, read, store = quantity.counterpart(peer)
    model, data = peer.model, peer.data
    theirs = rows(*peer.states(states)[: quantity.arity])
    states = states[: quantity.arity]
    out = np.empty_like(method(*states))
    results = np.empty((count, *read(call(model, data, *theirs[0])).shape))

    def loop() -> None:
        for k, state in enumerate(theirs):
            store(results[k], call(model, data, *state))

    return [
        whole(
            OURS,
            lambda: method(*states, out=out),
            lambda: method(*states),
            clock=thread_time,
        ),
        whole(
            THEIRS,
            loop,
            lambda: np.array([read(call(model, data, *state)) for state in theirs]),
            clock=thread_time,
        ),
    ]


def _our_sweep(method: Call, out: Floats, arity: int) -> Callable[[States], None]:
    def one(states: States) -> None:
        for (q,) in states:
            method(q, out=out)

    def two(states: States) -> None:
        for q, qd in states:
            method(q, qd, out=out)

    def three(states: States) -> None:
        for q, qd, qdd in states:
            method(q, qd, qdd, out=out)

    return (one, two, three)[arity - 1]


def _their_sweep(call: Call, peer: Pinocchio, arity: int) -> Callable[[States], None]:
    model, data = peer.model, peer.data

    def one(states: States) -> None:
        for (q,) in states:
            call(model, data, q)

    def two(states: States) -> None:
        for q, v in states:
            call(model, data, q, v)

    def three(states: States) -> None:
        for q, v, a in states:
            call(model, data, q, v, a)

    return (one, two, three)[arity - 1]


# The quantities


def _assign(target: Floats, found: Any) -> None:
    target[...] = found


def _vector(peer: Pinocchio, call: Call) -> Counterpart:
    return Counterpart(call, lambda found: found[peer.inverse], _assign)


def _gravity(peer: Pinocchio) -> Counterpart:
    from pinocchio import computeGeneralizedGravity

    return _vector(peer, computeGeneralizedGravity)


def _coriolis(peer: Pinocchio) -> Counterpart:
    from pinocchio import nonLinearEffects

    peer.model.gravity.setZero()
    return _vector(peer, nonLinearEffects)


def _mass_matrix(peer: Pinocchio) -> Counterpart:
    from pinocchio import crba

    def full(found: Floats) -> Floats:
        upper = np.triu(found)  # Pinocchio does not always set the lower half
        return (upper + np.triu(upper, 1).T)[np.ix_(peer.inverse, peer.inverse)]

    return Counterpart(crba, full, _assign)


def _regressor(peer: Pinocchio) -> Counterpart:
    from pinocchio import computeJointTorqueRegressor

    def read(found: Floats) -> Floats:
        n = len(peer.inverse)
        blocks = found.reshape(n, n, 10)[np.ix_(peer.inverse, peer.inverse)]
        return blocks.reshape(n, 10 * n)

    return Counterpart(computeJointTorqueRegressor, read, _assign)


QUANTITIES = (
    Quantity('gravity_efforts', '`computeGeneralizedGravity`', 1, _gravity),
    Quantity('coriolis_efforts', '`nonLinearEffects`, no gravity', 2, _coriolis),
    Quantity('mass_matrix', '`crba`', 1, _mass_matrix),
    Quantity('regressor', '`computeJointTorqueRegressor`', 3, _regressor),
)
