"""The command `check`."""

import io
import json
import sys

from inverse_dynamics_node.cli.main import main
import pytest
from robot_files import NOTHING_MOVES, ROOT, STANFORD

ROBOTS = ROOT / 'test' / 'robots'


def test_begins_with_a_verdict(capsys):
    assert main(['check', str(STANFORD)]) == 0
    output = capsys.readouterr().out
    verdict, _, rest = output.partition('\n\n')
    assert ' '.join(verdict.split()) == (
        'Usable, no warnings. Gravity takes at most 32% of an effort limit (joint_2, joint_3). '
        "Largest payload at link 'tool0': 3.44 kg."
    )
    assert rest.startswith("robot 'stanford'\n")
    assert "can hold up to 3.44 kg at the origin of link 'tool0'" in output
    assert 'joint_5 reaches its limit first' in ' '.join(output.split())


def test_the_result_is_also_json(tmp_path, capsys):
    urdf = tmp_path / 'weak.urdf'
    urdf.write_text(STANFORD.read_text().replace('effort="100"', 'effort="0"'))
    assert main(['check', str(urdf), '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert result['verdict'].startswith('Usable, with 1 warning. Gravity takes at most 32% of')
    assert result['warnings'][0]['subject'] == "joint 'joint_2' effort limit"
    assert result['warnings'][0]['line'] > 0
    assert result['worst']['joint_2']['effort'] == pytest.approx(32.18, abs=0.01)
    assert result['worst']['joint_2']['limit'] is None
    assert result['payload']['mass'] == pytest.approx(3.44, abs=0.01)
    assert main(['check', str(STANFORD), '--json', '--gravity', '0', '0', '0']) == 0
    assert json.loads(capsys.readouterr().out)['payload']['mass'] is None


def test_warns_without_limits(tmp_path, capsys):
    urdf = tmp_path / 'lift.urdf'
    text = (ROBOTS / 'pendulum.urdf').read_text()
    urdf.write_text(text.replace('effort="10"', 'effort="0"'))
    assert main(['check', str(urdf)]) == 0
    assert main(['check', str(urdf), '--strict']) == 3
    output = capsys.readouterr().out
    assert output.startswith('Usable, with 1 warning. No joint has an effort limit.\n')
    assert '0 means unknown' in output
    assert '-> write the largest effort of the joint' in output


def test_gravity_beyond_a_limit_is_a_warning(tmp_path, capsys):
    urdf = tmp_path / 'weak.urdf'
    urdf.write_text(STANFORD.read_text().replace('effort="100"', 'effort="20"'))
    assert main(['check', str(urdf), '--strict']) == 3
    output = capsys.readouterr().out
    assert ' '.join(output.split()).startswith(
        'Usable, with 1 warning. Gravity takes at most 161% of an effort limit (joint_2). '
        'In some poses, the robot cannot hold itself. '
    )
    assert "joint 'joint_2': gravity takes 161% of the effort limit in the worst pose" in output
    assert 'none, because gravity alone exceeds a limit' in ' '.join(output.split())


def test_gravity_can_be_set(capsys):
    assert main(['check', str(STANFORD), '--gravity', '0', '0', '0']) == 0
    output = capsys.readouterr().out
    assert 'gravity: 0 0 0 m/s^2' in output
    assert 'unlimited, because it loads no joint' in ' '.join(output.split())
    assert "A payload at link 'tool0' loads no joint." in ' '.join(output.split())


def test_long_names_are_not_shortened(tmp_path, capsys):
    names = {
        f'joint_{i}': f'the_joint_number_{i}_of_the_arm_on_the_left_side' for i in range(1, 7)
    }
    text = STANFORD.read_text()
    for short, long in names.items():
        text = text.replace(f'"{short}"', f'"{long}"')
    (tmp_path / 'long.urdf').write_text(text)
    assert main(['check', 'long.urdf']) == 0
    output = capsys.readouterr().out
    assert '…' not in output
    rows = output.split('Efforts that hold the robot')[1].split('Worst pose')[0]
    assert all(name in rows for name in names.values())


def test_reads_standard_input(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'stdin', io.StringIO(STANFORD.read_text()))
    assert main(['check', '-']) == 0
    monkeypatch.setattr(sys, 'stdin', io.StringIO('xacro: command not found'))
    assert main(['check', '-']) == 1
    assert capsys.readouterr().err == 'inverse_dynamics: standard input: is not XML\n'
    monkeypatch.setattr(sys, 'stdin', io.StringIO(f'String value is: {STANFORD.read_text()}'))
    assert main(['check', '-']) == 1
    assert 'use `ros2 param get --hide-type`' in capsys.readouterr().err


def test_a_robot_without_movable_joints_is_reported(tmp_path, capsys):
    urdf = tmp_path / 'bolt.urdf'
    urdf.write_text(NOTHING_MOVES)
    assert main(['check', str(urdf)]) == 0
    assert 'no joint can move' in capsys.readouterr().out
