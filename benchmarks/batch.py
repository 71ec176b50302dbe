"""Many states in one call."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from inspect import signature
from time import perf_counter
from typing import Any

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from .peers import Pinocchio
from .robots import Robot
from .timing import Contender, CORES, on_cores

COUNT = 4096
REFERENCE = 'pin.rneaInParallel'
HAS_THREADS = 'threads' in signature(InverseDynamics.efforts).parameters


def whole(
    name: str,
    call: Callable[[], Any],
    result: Callable[[], Floats],
    threads: int = 1,
    clock: Callable[[], float] = perf_counter,
) -> Contender:
    """Make a contender from a call that takes all states at once."""

    def where() -> contextlib.AbstractContextManager[None]:
        # Threads inherit the cores of the thread that starts them, at the first call.
        return on_cores(CORES) if threads > 1 else contextlib.nullcontext()

    def results() -> Floats:
        with where():
            return result()

    def seconds(sweeps: int) -> float:
        with where():
            if threads > 1:
                call()  # gives the threads time to spread over the cores
            start = clock()
            for _ in range(sweeps):
                call()
            return (clock() - start) / sweeps

    return Contender(name, results, seconds, 1)


def ours(robot: Robot, states: Floats, threads: int = 1) -> Contender:
    """Time this package on arrays of shape (count, n)."""
    efforts = InverseDynamics(robot.model).efforts
    q, qd, qdd = states
    out = np.empty_like(q)
    options: dict[str, Any] = {'threads': threads} if HAS_THREADS else {}
    name = 'ours' if threads == 1 else f'ours, {threads} threads'
    return whole(
        name,
        lambda: efforts(q, qd, qdd, out=out, **options),
        lambda: efforts(q, qd, qdd, **options),
        threads,
    )


def pinocchio(robot: Robot, states: Floats, threads: int = 1) -> Contender:
    """Time Pinocchio's own loop; its arrays have one column per state, the same memory layout."""
    from pinocchio import ModelPool, rneaInParallel

    peer = Pinocchio(robot)
    pool = ModelPool(peer.model, threads)
    q, v, a = (x.T for x in peer.states(states))
    out = np.empty_like(v)
    name = REFERENCE if threads == 1 else f'{REFERENCE}, {threads} threads'
    return whole(
        name,
        lambda: rneaInParallel(threads, pool, q, v, a, out),
        lambda: rneaInParallel(threads, pool, q, v, a).T[:, peer.inverse],
        threads,
    )


def pinocchio_loop(robot: Robot, states: Floats) -> Contender:
    """Time a loop in Python over Pinocchio's single call."""
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
