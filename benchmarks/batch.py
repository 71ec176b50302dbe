"""Benchmarks of calls that compute many states at once."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from .peers import Pinocchio
from .robots import Robot
from .timing import Contender

COUNT = 4096
REFERENCE = 'pin.rneaInParallel'


def whole(
    name: str,
    call: Callable[[], Any],
    result: Callable[[], Floats],
    clock: Callable[[], float] = perf_counter,
) -> Contender:
    """Make a contender from a call that takes all states at once."""

    def seconds(sweeps: int) -> float:
        start = clock()
        for _ in range(sweeps):
            call()
        return (clock() - start) / sweeps

    return Contender(name, result, seconds, 1)


def ours(robot: Robot, states: Floats) -> Contender:
    """Time this package on arrays with one row per state."""
    efforts = InverseDynamics(robot.model).efforts
    q, qd, qdd = states
    out = np.empty_like(q)
    return whole('ours', lambda: efforts(q, qd, qdd, out=out), lambda: efforts(q, qd, qdd))


def pinocchio(robot: Robot, states: Floats) -> Contender:
    """Time Pinocchio's own loop on arrays with one column per state and the same memory layout."""
    from pinocchio import ModelPool, rneaInParallel

    peer = Pinocchio(robot)
    pool = ModelPool(peer.model, 1)
    q, v, a = (x.T for x in peer.states(states))
    out = np.empty_like(v)
    return whole(
        REFERENCE,
        lambda: rneaInParallel(1, pool, q, v, a, out),
        lambda: rneaInParallel(1, pool, q, v, a).T[:, peer.inverse],
    )


def pinocchio_loop(robot: Robot, states: Floats) -> Contender:
    """Time a Python loop over Pinocchio's function for a single state."""
    from pinocchio import rnea

    peer = Pinocchio(robot)
    model, data = peer.model, peer.data
    arrays = peer.states(states)
    out = np.empty_like(arrays[1])

    def call() -> Floats:
        for k, (q, v, a) in enumerate(zip(*arrays, strict=True)):
            out[k] = rnea(model, data, q, v, a)
        return out

    return whole('pin.rnea in a loop', call, lambda: call()[:, peer.inverse])
