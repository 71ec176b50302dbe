"""Work that the node does beside its loop: robot descriptions, trajectories and parameters."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

from inverse_dynamics_node import load_urdf
import numpy as np
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from .parameter_calls import PATIENCE
from .priorities import BusyProcesses, normal
from .wire import Contender

RATE = 1000.0  # [Hz]; of the states
LEAST = 1.0  # [s]; of one measurement
POINTS = 5000
CALLS = 1000


def measure(
    contender: Contender, path: Path, rounds: int, is_busy: bool, busy: BusyProcesses
) -> dict[str, list[float]]:
    """
    Measure the longest time without a command while the node has something else to do.

    Parameters
    ----------
    contender : Contender
        The node.
    path : Path
        Its robot description.
    rounds : int
        Number of repetitions.
    is_busy : bool
        Whether other processes keep the CPUs busy meanwhile.
    busy : BusyProcesses
        These processes.

    Returns
    -------
    gaps : dict
        Longest time between two commands in each repetition [s], by kind of work.

    """
    urdf = path.read_text()
    # The same robot, but another text: a description that has not changed is ignored.
    texts = [re.sub('(<robot[^>]*>)', rf'\1<!-- {k} -->', urdf, count=1) for k in range(rounds)]
    trajectory = _trajectory(list(load_urdf(path).joint_names))
    calls = f'{CALLS} parameter calls'
    gaps: dict[str, list[float]] = {}
    for k in range(rounds):
        for name, interrupt in (
            ('nothing else', lambda: lambda: True),
            ('a new robot description', lambda k=k: contender.reload(texts[k])),
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
    """Start a client that calls; return a function that returns whether it has ended."""
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
