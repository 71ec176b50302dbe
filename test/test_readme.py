"""The README, doc/install.md, doc/interface.md and doc/python.md agree with the code."""

import contextlib
import io
import os
import re
import subprocess
import sys

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.cli.main import COMMANDS
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

README = (ROOT / 'README.md').read_text()
FIRST_HOUR, INSTALL, INTERFACE = (
    (ROOT / 'doc' / name).read_text() for name in ('first_hour.md', 'install.md', 'interface.md')
)


def run_python_examples(text):
    """Run all Python blocks in one namespace; compare the output of each with the block below."""
    names = {}
    blocks = re.findall(r'```python\n(.*?)```\n(?:\n```text\n(.*?)```)?', text, re.S)
    assert blocks
    for code, expected in blocks:
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            exec(code, names)
        assert output.getvalue() == expected
    return names


def test_python_page_prints_the_output_below_each_example(monkeypatch):
    monkeypatch.chdir(ROOT)
    names = run_python_examples((ROOT / 'doc' / 'python.md').read_text())
    q, qd, qdd = names['q'], names['qd'], names['qdd']
    total = sum(names['dynamics'].effort_terms(q, qd, qdd))
    assert total == pytest.approx(names['dynamics'].efforts(q, qd, qdd))


def test_names_in_the_table_of_tasks_are_in_the_rest_of_the_page():
    tasks, rest = INTERFACE.split('| you want to |')[1].split('\n\n', 1)
    names = re.findall(r'`~/([\w/]+)', tasks) + re.findall(r'`(\w+)`', tasks)
    assert len(names) > 20
    for name in names:
        assert name in rest, name


def shell_blocks(page):
    return re.findall(r'^```sh\n(.*?)^```', page, re.M | re.S)


def test_commands_for_a_robot_are_those_of_the_first_hour():
    on_a_robot = README.split('## On a robot')[1].split('## Why trust it?')[0]
    assert set(shell_blocks(on_a_robot)) <= set(shell_blocks(FIRST_HOUR))
    assert on_a_robot.index('the arm falls') < on_a_robot.index('dry_run false')


def test_the_page_about_the_command_line_lists_every_command():
    block = shell_blocks((ROOT / 'doc' / 'command_line.md').read_text())[0]
    assert {line.split()[1] for line in block.splitlines()} == set(COMMANDS)


def test_commands_after_the_demo_print_the_efforts_at_rest(tmp_path):
    pytest.importorskip('rclpy')
    pytest.importorskip('matplotlib')
    domain_coordinator = pytest.importorskip('domain_coordinator')
    (script,) = shell_blocks(INSTALL.split('After `make demo`')[1].split('\n## ')[0])
    assert len(script.splitlines()) == 5
    # The same place as a fresh clone after `make demo`, without another installation.
    (tmp_path / '.venv').symlink_to(sys.prefix)
    (tmp_path / 'examples').symlink_to(ROOT / 'examples')
    (tmp_path / 'my_arm.urdf').write_text(STANFORD.read_text())
    with domain_coordinator.domain_id() as domain:
        result = subprocess.run(
            ['sh', '-e', '-c', script + 'wait $!'],
            cwd=tmp_path,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
            capture_output=True,
            text=True,
            timeout=240,
        )
    assert result.returncode == 0, result.stderr
    assert 'the robot can hold up to' in result.stdout
    efforts = dict(re.findall(r'^(joint_\d) +(-?\d+\.\d+)$', result.stdout, re.M))
    assert len(efforts) == 6
    robot = load_urdf(STANFORD)
    at_rest = InverseDynamics(robot).gravity_efforts(np.clip(0.0, robot.lower, robot.upper))
    assert [float(x) for x in efforts.values()] == pytest.approx(at_rest, abs=6e-4)
    assert 'stopped, zeros sent' in result.stderr


def test_verdict_shown_for_the_demo_is_the_verdict_of_the_demo():
    pytest.importorskip('mujoco')
    pytest.importorskip('rclpy')
    from inverse_dynamics_node.cli.demo import PASSED

    assert f'\n{PASSED}\n' in README
