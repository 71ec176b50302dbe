"""Copies of the fork server behave like programs that `python` starts."""

import signal
import subprocess

from fork_server import SERVER
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


@pytest.mark.flaky(reruns=2)  # Python discards an interrupt that arrives in a finalizer
def test_a_signal_right_after_the_start_reaches_a_program():
    for _ in range(10):
        process = SERVER.run(['-c', 'import time; time.sleep(60.0)'])
        process.send_signal(signal.SIGINT)
        assert process.wait(30.0) == -signal.SIGINT
