"""Reports machine code that a node compiles or loads after its configuration."""

import os
import sys
import traceback

from numba.core import event

REPORT = 'machine code was compiled or loaded after the configuration'
_ALLOWED = 'make_loop'


class LateCompilation(event.Listener):
    """Prints where a function was compiled, unless the control loop was being made."""

    def __init__(self):
        self._process = os.getpid()

    def on_start(self, event):
        """Print the calls; numba takes this lock to compile, and to load from its cache."""
        calls = traceback.extract_stack()
        is_worker = os.getpid() != self._process  # it does not delay the commands
        if not is_worker and all(call.name != _ALLOWED for call in calls):
            print(REPORT, *traceback.format_list(calls), sep='\n', file=sys.stderr)

    def on_end(self, event):
        """Do nothing."""


def report_late_compilation():
    """Report to stderr from now on, in this process."""
    event.register('numba:compiler_lock', LateCompilation())
