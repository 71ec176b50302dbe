"""Copies of the fork server behave like programs that `python` starts."""

import os
from pathlib import Path
import signal
import subprocess

from fork_server import ForkServer, SERVER
import pytest


@pytest.mark.parametrize(
    ('code', 'expected', 'output'),
    [
        ('import sys; print(sys.argv)', 0, "['-c', 'one']"),
        ('import sys; sys.exit(3)', 3, ''),
        ('import sys; sys.exit("in words")', 1, 'in words'),
        ('1 / 0', 1, 'ZeroDivisionError'),
        ('import os; os.kill(os.getpid(), 9)', -9, ''),
        ('import os; print(os.environ["COLOUR"], os.getcwd())', 0, 'green /'),
    ],
)
def test_a_program_ends_with_its_own_code_and_output(code, expected, output):
    process = SERVER.run(
        ['-c', code, 'one'], {'COLOUR': 'green'}, folder='/', stdout=subprocess.PIPE
    )
    text, _ = process.communicate(timeout=60.0)
    assert process.wait(60.0) == expected
    assert output in text


def test_the_server_outlives_a_client_that_ends():
    SERVER.start()
    client = ForkServer()
    process = client.run(['-c', 'import time; time.sleep(1000.0)'])
    try:
        client._socket.close()
        other = SERVER.run(['-c', 'import os; print(os.getppid())'], stdout=subprocess.PIPE)
        parent = int(other.communicate(timeout=60.0)[0])
        assert parent == int(Path(f'/proc/{process.pid}/stat').read_text().split()[3])
    finally:
        process.kill()
    assert process.wait(60.0) == -signal.SIGKILL


PROGRAM = """
import os, sys
print(sys.argv[1:], os.environ['COLOUR'], os.getppid() == int(sys.argv[1]), 'rclpy' in sys.modules)
sys.exit(3)
"""
CALLER = """
import os, subprocess, sys
command = [sys.executable, '-m', 'program', str(os.getpid())]
done = subprocess.run(command, env={**os.environ, 'COLOUR': 'green'}, capture_output=True)
assert not done.stderr, done.stderr
print(done.returncode, done.stdout.decode())
"""


def test_a_program_started_by_a_copy_is_a_copy(tmp_path):
    (tmp_path / 'program.py').write_text(PROGRAM)
    done = SERVER.call(['-c', CALLER], {'COLOUR': 'red'}, folder=tmp_path, timeout=60.0)
    assert done.stdout.startswith('3 ['), done
    assert done.stdout.endswith('] green True True\n\n')


def test_signals_reach_a_program():
    code = 'import time; print("ready", flush=True); time.sleep(1000.0)'
    process = SERVER.run(['-c', code], stdout=subprocess.PIPE)
    assert process.stdout.readline() == 'ready\n'
    assert process.poll() is None
    os.kill(process.pid, signal.SIGTERM)
    assert process.wait(60.0) == -signal.SIGTERM
    process.stdout.close()


@pytest.mark.flaky(reruns=2)  # Python discards an interrupt that arrives in a finalizer
def test_a_signal_right_after_the_start_reaches_a_program():
    for _ in range(10):
        process = SERVER.run(['-c', 'import time; time.sleep(60.0)'])
        process.send_signal(signal.SIGINT)
        assert process.wait(30.0) == -signal.SIGINT
