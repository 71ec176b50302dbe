"""The transports of the middleware: no shared memory, and nothing that leaves the machine."""

import contextlib
import os
from pathlib import Path
import subprocess
import sys

from node_process import shared_memory_of
import numpy as np
import pytest
from robot_side import HOLD, NAMES, PATIENT, Q

LOCAL = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


def udp_ports_of(pid):
    """Return the local UDP ports of a process."""
    sockets = set()
    for entry in Path(f'/proc/{pid}/fd').iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            sockets.add(os.readlink(entry).removeprefix('socket:[').removesuffix(']'))
    rows = [line.split() for line in Path('/proc/net/udp').read_text().splitlines()[1:]]
    return {int(row[1].split(':')[1], 16) for row in rows if row[9] in sockets}


@pytest.fixture
def commanding(run_node, robot):
    """Return a function that starts a node and waits until it commands a robot."""

    def start():
        node = run_node(**PATIENT)
        robot.publish_state(NAMES, Q, np.zeros(6))
        robot.wait_until(
            lambda: robot.commands and np.allclose(robot.commands[-1], HOLD), 'commands'
        )
        return node.process.pid

    return start


# A new subscriber could otherwise stop the commands for 0.33 s.
def test_a_node_that_commands_a_robot_uses_neither_shared_memory_nor_multicast(
    commanding, domain_id
):
    assert shared_memory_of(os.getpid())  # the robot's side has the default transports
    pid = commanding()
    assert shared_memory_of(pid) == []
    ports = udp_ports_of(pid)
    multicast = 7400 + 250 * domain_id
    assert ports
    assert multicast not in ports


def test_the_variable_of_fast_dds_turns_shared_memory_off(run_node, robot, monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')  # like SUBNET, without packets
    node = run_node(**PATIENT)
    robot.wait_for_text(node, 'no command yet')
    assert shared_memory_of(node.process.pid) == []


def test_a_node_keeps_the_transports_that_the_user_has_set(commanding, monkeypatch):
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'DEFAULT')
    assert shared_memory_of(commanding())


def test_watch_uses_no_shared_memory(commanding, run_program, robot):
    commanding()
    command = ['-m', 'inverse_dynamics_node.cli.main', 'watch', '--json']
    process = run_program(*command, stdout=subprocess.PIPE)
    with process.stdout as lines:
        os.set_blocking(lines.fileno(), False)
        robot.wait_until(lines.buffer.readline, 'a line of watch')
        assert shared_memory_of(process.pid) == []


def test_other_programs_inherit_the_range_of_the_user(domain_id):
    code = 'from inverse_dynamics_node.ros import middleware; middleware.start_ros([]);'
    code += 'import os; print(os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"])'
    environment = {**os.environ, **LOCAL, 'ROS_DOMAIN_ID': str(domain_id)}
    command = [sys.executable, '-c', code]
    output = subprocess.run(command, env=environment, check=True, capture_output=True).stdout
    assert output.decode().split() == ['LOCALHOST']
