"""
Starts Python programs as copies of a process that has imported their libraries.

A node needs two seconds of CPU to start, most of them to import rclpy, numpy, scipy and numba. A
copy needs none of these. Everything else is as with `python -m`: a process of its own, with its
own environment, signals, pipes and exit code. Tests of the start itself run `python -m`.

Nothing of ROS is initialized before the copy, so that the server has no threads. What a copy
starts by `python -m` is a copy too, if no thread would be missing in it.

The processes of pytest-xdist share a server if the process that starts them has already started
one, as `integration/conftest.py` does. Otherwise, each starts its own.
"""

from __future__ import annotations

import atexit
import contextlib
from functools import partial
import gc
from importlib import import_module
import inspect
import json
import os
from pathlib import Path
import runpy
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import weakref

from late_compilation import report_late_compilation
from robot_files import STANFORD

MODULES = (
    'inverse_dynamics_node.cli.console',
    'inverse_dynamics_node.cli.watch',
    'inverse_dynamics_node.node.node',
    'inverse_dynamics_node.simulation.demo',
    'inverse_dynamics_node.simulation.robot',
    'rclpy.experimental.events_executor',
    'rich.live',
    'scipy.interpolate',
    'yourdfpy',
)
MAIN = 'inverse_dynamics_node.node.main'
ADDRESS = 'FORK_SERVER'  # environment variable with the path of the server's socket
_LIBRARIES = sys.path[1:]
_INTEGER = struct.Struct('i')
_SIZE = 1 << 20  # of a request: arguments and environment


class ForkedProcess:
    """A program with the interface of `subprocess.Popen`, as far as the tests use it."""

    def __init__(self, pid, results, stdout):
        self.pid, self.stdout = pid, stdout
        self.returncode = None
        self._results = results

    def wait(self, timeout=None):
        if self.returncode is None:
            with selectors.DefaultSelector() as selector:
                selector.register(self._results, selectors.EVENT_READ)
                if not selector.select(timeout):
                    raise subprocess.TimeoutExpired(f'process {self.pid}', timeout)
            (self.returncode,) = _receive(self._results)
            os.close(self._results)
        return self.returncode

    def poll(self):
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def communicate(self, timeout=None):
        """Return the rest of the output, and None, after the end of the process."""
        output = []
        reader = threading.Thread(target=lambda: output.append(self.stdout.read()), daemon=True)
        reader.start()
        reader.join(timeout)
        if not output:
            raise subprocess.TimeoutExpired(f'process {self.pid}', timeout)
        self.stdout.close()
        self.wait(timeout)
        return output[0], None

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)


def _socket():
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class ForkServer:
    """A connection to the process that copies itself; made by `start` or the first request."""

    def __init__(self):
        self._socket = None

    def start(self):
        """Connect to the server of another process, or start one, without waiting for it."""
        if self._socket is not None:
            return
        client = _socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SIZE)
        if ADDRESS in os.environ:
            client.connect(os.environ[ADDRESS])
        else:
            folder = tempfile.TemporaryDirectory()  # only this user may connect
            address = f'{folder.name}/fork_server'
            with _socket() as listener:
                listener.bind(address)
                listener.listen()
                client.connect(address)
                server = subprocess.Popen(
                    [sys.executable, __file__, str(listener.fileno())],
                    pass_fds=[listener.fileno()],
                    stdin=subprocess.DEVNULL,
                )
            os.environ[ADDRESS] = address
            atexit.register(self._stop, server, folder)
        self._socket = client

    def _stop(self, server, folder):
        del os.environ[ADDRESS]
        self._socket.close()
        server.wait()
        folder.cleanup()

    def run(self, arguments, environment=None, folder=None, stdin=None, stdout=None, stderr=None):
        """
        Start a program.

        Parameters
        ----------
        arguments : sequence
            Those of `python`: ``-m module ...``, ``-c code ...`` or ``path ...``.
        environment : mapping of str to str, optional
            What to change in the environment of this process.
        folder : path, optional
            Where it runs; by default where this process does.
        stdin, stdout, stderr : int, optional
            Open files; by default nothing is read, and the output is that of this process.
            ``stdout=subprocess.PIPE`` is for both outputs.

        Returns
        -------
        process : ForkedProcess

        """
        self.start()
        request = {
            'arguments': [str(argument) for argument in arguments],
            'environment': {**os.environ, **(environment or {})},
            'folder': str(folder or os.getcwd()),
        }
        output, lines = stdout, None
        if stdout == subprocess.PIPE:
            reader, output = os.pipe()
            lines = os.fdopen(reader, errors='replace')
            stderr = output
        results, answers = os.pipe()
        with open(os.devnull) as nothing:
            files = [nothing.fileno() if stdin is None else stdin]
            files += [1 if output is None else output, 2 if stderr is None else stderr, answers]
            socket.send_fds(self._socket, [json.dumps(request).encode()], files)
        os.close(answers)
        if lines:
            os.close(output)
        (pid,) = _receive(results)
        return ForkedProcess(pid, results, lines)

    def call(self, arguments, environment=None, folder=None, timeout=None):
        """Run a program to its end; return code and outputs like `subprocess.run`."""
        with tempfile.TemporaryFile() as stdout, tempfile.TemporaryFile() as stderr:
            files = stdout.fileno(), stderr.fileno()
            process = self.run(arguments, environment, folder, None, *files)
            try:
                code = process.wait(timeout)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
            texts = [os.pread(file, 1 << 26, 0).decode() for file in files]
        return subprocess.CompletedProcess(arguments, code, *texts)


def _receive(results):
    data = os.read(results, _INTEGER.size)
    assert data, 'the fork server has ended'
    return _INTEGER.unpack(data)


SERVER = ForkServer()


class CopyingPopen(subprocess.Popen):
    """In a copy, `python -m ...` becomes another copy; everything else starts as usual."""

    def __init__(self, command, *arguments, preexec_fn=None, env=None, **options):
        is_copied = list(command[:2]) == [sys.executable, '-m'] and not has_foreign_threads()
        if is_copied:
            request = {'arguments': command[1:], 'environment': env or {**os.environ}}
            preexec_fn = partial(self._become, request, preexec_fn)
        super().__init__(command, *arguments, preexec_fn=preexec_fn, env=env, **options)

    @staticmethod
    def _become(request, prepare):
        """Run the program in the new process, whose standard files are already connected."""
        if prepare:
            prepare()
        for finalizer in list(weakref.finalize._registry):
            finalizer.detach()  # it belongs to the other process, such as a temporary folder
        os.closerange(3, os.sysconf('SC_OPEN_MAX'))  # also tells `Popen` that the program starts
        run_to_the_end({**request, 'folder': os.getcwd()})


def has_foreign_threads():
    """Return whether libraries have threads here; a copy has none of them."""
    return len(os.listdir('/proc/self/task')) > threading.active_count()


def warm_up():
    """Fill the caches of modules, compiled code, message types and source files."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    for module in MODULES:
        import_module(module)
    from inverse_dynamics_node import load_urdf
    from inverse_dynamics_node.control.loop import ControlLoop

    ControlLoop(load_urdf(STANFORD)).dynamics.gravity_efforts([0.0] * 6)
    for name, module in list(sys.modules.items()):
        if name.endswith(('.msg', '.srv')):
            for kind in vars(module).values():
                if hasattr(type(kind), '__import_type_support__'):
                    type(kind).__import_type_support__()
    inspect.stack()  # as for every line of rclpy's log
    gc.freeze()


def serve(number):
    """
    Copy this process for each request; return the request in the copy.

    Return None when the process that started the server, which is the first to connect, has ended.

    """
    warm_up()
    # Ctrl-C is for the tests, which end this process. A signal to a copy waits for its handler.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    selector = selectors.DefaultSelector()
    listener = socket.socket(fileno=number)
    owner, _ = listener.accept()
    for each in (listener, owner):
        selector.register(each, selectors.EVENT_READ)
    while True:
        for key, _ in selector.select():
            if key.data:
                selector.unregister(key.fileobj)
                _report_end(key.fileobj, *key.data)
                continue
            if key.fileobj is listener:
                selector.register(listener.accept()[0], selectors.EVENT_READ)
                continue
            data, files, _, _ = socket.recv_fds(key.fileobj, _SIZE, 4)
            if not data:
                if key.fileobj is owner:
                    return None
                selector.unregister(key.fileobj)
                key.fileobj.close()
                continue
            *channels, answers = files
            pid = os.fork()
            if pid == 0:
                for other in selector.get_map().values():
                    if other.data:
                        os.close(other.fd)
                        os.close(other.data[1])
                    else:
                        other.fileobj.close()
                os.close(answers)
                selector.close()
                return json.loads(data), channels
            for file in channels:
                os.close(file)
            _answer(answers, pid)
            selector.register(os.pidfd_open(pid), selectors.EVENT_READ, (pid, answers))


def _answer(answers, number):
    with contextlib.suppress(BrokenPipeError):  # nobody waits for it
        os.write(answers, _INTEGER.pack(number))


def _report_end(pidfd, pid, answers):
    _, status = os.waitpid(pid, 0)
    os.close(pidfd)
    _answer(answers, os.waitstatus_to_exitcode(status))
    os.close(answers)


def become(request):
    """Run the program of a request, as `python` does."""
    for number in (signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.chdir(request['folder'])
    os.environ.clear()
    os.environ.update(request['environment'])
    first, *arguments = request['arguments']
    folder = request['folder']
    if first not in ('-m', '-c'):
        sys.argv = [first, *arguments]
        sys.path[:] = [str(Path(folder, first).parent), *_LIBRARIES]
        runpy.run_path(first, run_name='__main__')
        return
    program, *arguments = arguments
    sys.argv = [first, *arguments]
    sys.path[:] = [folder if first == '-m' else '', *_LIBRARIES]
    if program == MAIN:
        report_late_compilation()
    if first == '-m':
        runpy.run_module(program, run_name='__main__', alter_sys=True)
    else:
        exec(program, {'__name__': '__main__'})


def end(code):
    """End as `python` does, but leave the modules to the kernel: to free them takes 0.2 s."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def run_to_the_end(request):
    """Run the program of a request, and end this process."""
    code = 0
    try:
        become(request)
    except SystemExit as error:
        code = error.code or 0
        if not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    except Exception:
        sys.excepthook(*sys.exc_info())
        code = 1
    end(code)


if __name__ == '__main__':
    accepted = serve(int(sys.argv[1]))
    if accepted:
        wanted, files = accepted
        for number, file in enumerate(files):
            os.dup2(file, number)
            os.close(file)
        subprocess.Popen = CopyingPopen
        run_to_the_end(wanted)
