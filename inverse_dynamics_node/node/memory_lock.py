"""Keeps the memory of the process from being swapped out."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
import platform
import resource

# mlockall(2), <asm-generic/mman.h>
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14  # capabilities(7)


class MemoryLockError(Exception):
    """The memory cannot be locked."""


def has_realtime_kernel() -> bool:
    """Return whether the kernel is built with PREEMPT_RT."""
    try:
        if Path('/sys/kernel/realtime').read_text().strip() == '1':
            return True
    except OSError:
        pass
    return 'PREEMPT_RT' in platform.version().split()


def lock_memory() -> str:
    """
    Lock the memory of this process, as far as it is permitted.

    Pages are locked when they are first used. Python reserves far more memory than it uses, most
    of it for the stacks of threads and for libraries: locking all of it at once would occupy it.

    Returns
    -------
    text : str
        Describes the locked memory.

    Raises
    ------
    MemoryLockError
        If the memory cannot be locked.

    """
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, 'mlockall'):
        raise MemoryLockError(f'memory cannot be locked on {platform.system()}')
    limit = _limit()
    flags, text = _MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT, 'memory locked'
    if limit is not None:
        # An allocation beyond the limit would fail, and end the process.
        flags, text = _MCL_CURRENT | _MCL_ONFAULT, 'memory in use at the start locked'
    if libc.mlockall(flags):
        reason = os.strerror(ctypes.get_errno())
        bound = '' if limit is None else f' (memlock limit {limit >> 10} kB, expected unlimited)'
        raise MemoryLockError(f'memory cannot be locked: {reason}{bound}')
    return text


def _limit() -> int | None:
    """Return how much memory may be locked [bytes]; None if there is no limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    if hard == resource.RLIM_INFINITY or _may_exceed_limit():
        return None
    return hard


def _may_exceed_limit() -> bool:
    try:
        status = Path('/proc/self/status').read_text()
    except OSError:
        return False
    lines = [line.split() for line in status.splitlines() if line.startswith('CapEff:')]
    return any(int(value, 16) >> _CAP_IPC_LOCK & 1 for _, value in lines)
