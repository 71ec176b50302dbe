"""Processes of a long measurement: start, end, CPU time and memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import FrameType
from typing import Any, NamedTuple

from . import priorities

PATIENCE = 30.0  # [s]; longest time from SIGTERM to the end of a process


class Memory(NamedTuple):
    """Memory of a process and of its children [MB]."""

    resident: float
    """Resident memory of the process without its children, including shared pages."""
    proportional: float
    """Memory with a proportional share of the pages that other processes share."""
    unique: float
    """Memory in pages that no other process uses."""


def heed_signals() -> None:
    """Let SIGTERM and SIGHUP end this program like Ctrl-C, so that ``finally`` blocks run."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)


def start(
    module: Sequence[str], prepare: Callable[[], None] = priorities.normal, **options: Any
) -> subprocess.Popen[str]:
    """
    Start a Python module with its arguments, by default at normal priority.

    Ctrl-C does not reach the new process. This program must end it.
    """
    return subprocess.Popen(
        [sys.executable, '-m', *module],
        preexec_fn=prepare,
        start_new_session=True,
        text=True,
        **options,
    )


def end(processes: Sequence[subprocess.Popen[Any]]) -> None:
    """End processes, first with SIGTERM, so that the processes remove their shared memory."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C would leave processes behind
    for process in processes:
        process.terminate()
    for process in processes:
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def cpu_time(pid: int) -> float:
    """Return the CPU time of all threads of a process [s]."""
    return time.clock_gettime((~pid << 3) | 2)  # clock_getcpuclockid(3)


def waiting_times(pid: int) -> dict[str, float]:
    """Return how long each thread of a process has waited for a CPU [s], by thread number."""
    found = {}
    for path in Path(f'/proc/{pid}/task').iterdir():
        with contextlib.suppress(OSError):  # the thread has ended
            found[path.name] = 1e-9 * int((path / 'schedstat').read_text().split()[1])
    return found


def memory(pid: int) -> Memory:
    """Return the memory of a process and of its children."""
    own = _sizes(pid)
    all_of_them = [own, *map(_sizes, children(pid))]
    unique = sum(each['Private_Clean'] + each['Private_Dirty'] for each in all_of_them)
    return Memory(own['Rss'], sum(each['Pss'] for each in all_of_them), unique)


def total(memories: Sequence[Memory]) -> Memory:
    """Return the sum of the memory of several processes."""
    return Memory(*map(sum, zip(*memories, strict=True)))


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    found = []
    for path in Path(f'/proc/{pid}/task').iterdir():
        with contextlib.suppress(OSError):  # the thread has ended
            found += [int(each) for each in (path / 'children').read_text().split()]
    return found


def resident(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20


def _sizes(pid: int) -> dict[str, float]:
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()[1:]
    return {line.split(':')[0]: int(line.split()[1]) / 1024 for line in lines}
