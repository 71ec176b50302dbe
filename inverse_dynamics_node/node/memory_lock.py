"""Keeps the memory of the process from being swapped out."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
import platform
import resource

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # mlockall(2), <asm-generic/mman.h>


def has_realtime_kernel() -> bool:
    """Return whether the kernel is built with PREEMPT_RT."""
    file = Path('/sys/kernel/realtime')
    is_marked = file.exists() and file.read_text().strip() == '1'
    return is_marked or 'PREEMPT_RT' in platform.version().split()


def lock_memory() -> str:
    """
    Lock each page of this process when it is first used; return a description for the log.

    Raises
    ------
    OSError
        If the memory cannot be locked.

    """
    libc = ctypes.CDLL(None, use_errno=True)
    _, limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
    # Beyond a limit, a later allocation would fail, and end the process.
    is_limited = limit != resource.RLIM_INFINITY
    if libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT | (0 if is_limited else _MCL_FUTURE)):
        number = ctypes.get_errno()
        bound = f' (memlock limit {limit >> 10} kB)' if is_limited else ''
        raise OSError(number, f'memory cannot be locked: {os.strerror(number)}{bound}')
    return 'memory in use at the start locked' if is_limited else 'memory locked'
