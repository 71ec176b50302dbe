"""The node as a process."""

import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading

from fork_server import SERVER

RUNNING = []  # nodes of the test; an error in one of them ends the waiting
PATIENCE = 120.0  # [s]; ten times as long as a loaded machine needs


def heed_signals():
    """Reset signals that nohup, or a shell with background jobs, ignores in its children."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def shared_memory_of(pid):
    """Return the files in shared memory that a process has opened for the middleware."""
    lines = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return sorted({line.split()[-1] for line in lines if '/dev/shm/fastrtps_' in line})


class NodeProcess:
    """The node: a copy of the fork server, or started as `ros2 run` does."""

    def __init__(self, domain_id, arguments, parameters, program, prepare, may_crash):
        settings = [x for k, v in parameters.items() for x in ('-p', f'{k}:={v}')]
        self.may_crash = may_crash
        self.may_end = may_crash
        self.output = ''
        command = [*program, '--ros-args', *map(str, arguments), *settings]
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        if prepare is None:
            self.process = SERVER.run(command, environment, stdout=subprocess.PIPE)
        else:
            self.process = subprocess.Popen(
                [sys.executable, *command],
                env={**os.environ, **environment},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                preexec_fn=prepare,
            )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        with self.process.stdout as lines:
            for line in lines:
                self.output += line

    def wait(self):
        """Wait for the process to end; return its exit code."""
        self.may_end = True
        code = self.process.wait(PATIENCE)
        self._reader.join(PATIENCE)
        return code

    def interrupt(self, number=signal.SIGINT):
        self.may_end = self.may_end or number not in (signal.SIGSTOP, signal.SIGCONT)
        self.process.send_signal(number)

    def kill(self):
        """End the process; SIGTERM first, so that it removes its shared memory."""
        for patience in (10.0, PATIENCE):  # the second signal cuts a long stop ramp short
            if self.process.poll() is None:
                self.process.terminate()
                self.process.send_signal(signal.SIGCONT)  # a test may have suspended it
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self.process.wait(patience)
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._reader.join(PATIENCE)
