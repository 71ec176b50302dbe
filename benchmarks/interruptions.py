"""Work of the node outside its loop: trajectories and parameters."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import signal
import subprocess
import sys

from inverse_dynamics_node import load_urdf
import numpy as np
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from .parameter_calls import PATIENCE
from .processes import BusyProcesses, normal
from .wire import Contender

RATE = 1000.0  # [Hz]; rate of the joint states
LEAST = 1.0  # [s]; shortest duration of one measurement
POINTS = 5000  # of a trajectory
CALLS = 1000  # number of parameter calls


def measure(
    contender: Contender, path: Path, rounds: int, is_busy: bool, busy: BusyProcesses
) -> dict[str, list[float]]:
    """
    Measure the longest time without a command while the node does other work.

    The contender is the node, ``path`` its robot description. With ``is_busy``, the processes
    ``busy`` keep the CPUs busy. Return the longest time between two commands in each of the
    ``rounds`` [s], by kind of work.
    """
    trajectory = _trajectory(list(load_urdf(path).joint_names))
    calls = f'{CALLS} parameter calls'
    gaps: dict[str, list[float]] = {}
    for _ in range(rounds):
        for name, interrupt in (
            ('nothing else', lambda: lambda: True),
            (f'a trajectory of {POINTS} points', lambda: contender.fill(trajectory)),
            (calls, lambda: _call(contender.domain)),
        ):
            with busy.running(is_busy):
                gap = contender.interruption(RATE, LEAST, interrupt, name == calls)
            print(f'  {name}: {1e3 * gap:.1f} ms', flush=True)
            gaps.setdefault(name, []).append(gap)
    return gaps


def _trajectory(joints: list[str]) -> bytes:
    message = JointTrajectory(joint_names=joints)
    phases = np.linspace(0.0, 20.0, POINTS)[:, np.newaxis] + np.arange(len(joints))
    for k, row in enumerate(0.5 * np.sin(phases)):
        point = JointTrajectoryPoint(positions=row.tolist())
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(10_000_000 * k, 10**9)
        message.points.append(point)
    return serialize_message(message)


def _call(domain: int) -> Callable[[], bool]:
    """Start a client that sets parameters; return a function that checks whether it has ended."""
    caller = subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.parameter_calls', str(CALLS)],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
        preexec_fn=normal,
    )

    def is_done() -> bool:
        code = caller.poll()
        if code == -signal.SIGALRM:
            print(f'  given up after {PATIENCE} s:', flush=True)
        elif code:
            raise subprocess.CalledProcessError(code, caller.args)
        return code is not None

    return is_done
