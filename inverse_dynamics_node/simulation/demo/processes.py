"""Child processes that end with their parent, and settings that keep ROS traffic local."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import ctypes
import os
import random
import signal
import socket
import subprocess
import sys
import threading

from ..mujoco.model import SimulationError

LOCK_PORT = 32768  # domain_coordinator reserves a domain by binding to the port LOCK_PORT + domain
STOP_TIMEOUT = 5.0  # [s]: time for a node to ramp its efforts down
PR_SET_PDEATHSIG = 1  # option of Linux's prctl(2)

Processes = dict[str, 'subprocess.Popen[bytes]']


@contextmanager
def running(
    commands: Mapping[str, Sequence[str]], print_line: Callable[[str], None] | None = None
) -> Iterator[Processes]:
    """
    Run child processes within a context; on exit, end the processes in reverse order.

    ``commands`` maps the name of each process to the arguments of ``python -m`` that start the
    process. ``print_line`` is called with every line that a process prints, in one thread per
    process. If ``print_line`` is None, the processes inherit standard output.
    """
    processes: Processes = {}
    try:
        for name, command in commands.items():
            # Each child has its own session, so that Ctrl-C reaches only the parent.
            processes[name] = subprocess.Popen(
                [sys.executable, '-m', *command],
                start_new_session=True,
                stdout=subprocess.PIPE if print_line else None,
                stderr=subprocess.STDOUT if print_line else None,
                preexec_fn=_end_with_parent if sys.platform == 'linux' else None,
            )
            if print_line:
                threading.Thread(target=_forward, args=(processes[name], print_line)).start()
        yield processes
    finally:
        for process in reversed(processes.values()):
            _end(process)


def _forward(process: subprocess.Popen[bytes], print_line: Callable[[str], None]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        print_line(line.decode(errors='replace').rstrip())


def _end_with_parent() -> None:
    """Let the kernel end this process when the parent ends, even if the parent is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def stay_on_this_machine() -> None:
    """Keep ROS traffic on this machine, unless the user has set a discovery range."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


@contextmanager
def unused_domain() -> Iterator[int]:
    """
    Reserve a ROS domain from 1 to 100 that no other process on this machine uses.

    Within the context, other demos avoid this domain, and so do tests with domain_coordinator.
    Raise a `SimulationError` if all domains are in use.
    """
    for domain in random.sample(range(1, 101), 100):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as reservation:
            try:
                reservation.bind(('', LOCK_PORT + domain))
            except OSError:
                continue
            if _is_unused(domain):
                yield domain
                return
    raise SimulationError('all ROS domains from 1 to 100 are in use; choose another with --domain')


def _is_unused(domain: int) -> bool:
    first_participant = 7400 + 250 * domain + 10  # unicast discovery port by DDSI-RTPS 9.6.1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('127.0.0.1', first_participant))
        except OSError:
            return False
    return True
