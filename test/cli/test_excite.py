"""The command `excite`, and the files that it writes."""

from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import NOTHING_MOVES, STANFORD

yaml = pytest.importorskip('yaml')

ROBOT = load_urdf(STANFORD)
NAMES = ROBOT.joint_names
pytestmark = pytest.mark.usefixtures('brief')


def excite(*arguments):
    return main(['excite', str(STANFORD), '--no-picture', *arguments])


def test_both_files_contain_the_motion_and_a_third_one_leads_to_its_start(here, capsys):
    assert excite() == 0
    printed = capsys.readouterr().out
    table, _ = read_trajectory(here / 'stanford_excite.csv', NAMES)
    points, _ = read_trajectory(here / 'stanford_excite.yaml', NAMES)
    start, _ = read_trajectory(here / 'stanford_excite_start.yaml', NAMES)
    assert table.joint_names == points.joint_names == start.joint_names == NAMES
    assert table.times[-1] == points.times[-1] == 10.0
    assert_allclose(table.positions[::5], points.positions, atol=1e-8)
    assert_allclose(start.positions, table.positions[:1], atol=1e-8)
    assert start.times[0] >= 5.0
    for whole in (table, points):
        assert not whole.velocities[[0, -1]].any()
        assert not whole.accelerations[[0, -1]].any()
        assert np.abs(whole.velocities).max(axis=0).min() > 0.01
    # A controller without effort interfaces rejects a trajectory with efforts.
    assert 'effort' not in (here / 'stanford_excite.yaml').read_text()
    for words in (
        'Expected standard errors of one run',
        'space that the links need',
        'noise',
        'smallest distances, including the motion to the start pose: ',
        'a radius of 0.',
        'random motions within the same limits',
    ):
        assert words in printed
    # The files are those that `effort` reads.
    assert main(['effort', str(STANFORD), 'stanford_excite.yaml', '--no-picture']) == 0


def test_the_rehearsal_is_the_same_path_five_times_slower(here):
    assert excite() == 0
    fast, _ = read_trajectory(here / 'stanford_excite.yaml', NAMES)
    slow, _ = read_trajectory(here / 'stanford_excite_rehearsal.yaml', NAMES)
    assert slow.times[-1] == 50.0
    assert_allclose(slow.positions[::5], fast.positions, atol=1e-8)
    assert_allclose(slow.velocities[::5], 0.2 * fast.velocities, atol=1e-8)
    assert_allclose(slow.accelerations[::5], 0.04 * fast.accelerations, atol=1e-8)


@pytest.mark.long
def test_the_picture_shows_the_path(here, size_of):
    assert main(['excite', str(STANFORD), '--picture', 'path.png', '--duration', '5']) == 0
    width, height = size_of(here / 'path.png')
    assert width == 900
    assert height > 500


def test_options_restrict_the_motion(here):
    assert (
        excite('--joints', NAMES[1], NAMES[3], '--floor', 'none', '--trajectory-out', 'b.yaml')
        == 0
    )
    trajectory, _ = read_trajectory(here / 'b.csv', NAMES)
    assert trajectory.joint_names == (NAMES[1], NAMES[3])
    names = ['b.csv', 'b.yaml', 'b_rehearsal.yaml', 'b_start.yaml']
    assert sorted(path.name for path in here.iterdir()) == names


def test_the_floor_is_at_the_base_unless_there_is_none(here, capsys):
    assert excite() == 0
    assert ' and floor)' in capsys.readouterr().out
    assert excite('--floor', 'none', '--force') == 0
    assert ' and floor)' not in capsys.readouterr().out


def test_boxes_that_leave_no_room_end_with_a_reason(here, capsys):
    assert excite('--box', '0', '0', '0', '3', '3', '3') == 1
    assert 'widen the ranges, or lower the floor (--floor)' in capsys.readouterr().err
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ('arguments', 'code', 'words'),
    [
        (['--joints', 'hook'], 1, "joint 'hook' does not exist; joints are"),
        (['--floor', '5'], 1, 'or switch it off (--floor none)'),
        (['--floor', 'deep'], 2, "'deep' is not a height or 'none'"),
        (['--box', '0', '0', '0', '1', '1', '0'], 1, 'three lengths above 0'),
    ],
)
def test_invalid_arguments_are_rejected_with_a_reason(here, capsys, arguments, code, words):
    if code == 2:
        with pytest.raises(SystemExit, match='2'):
            excite(*arguments)
    else:
        assert excite(*arguments) == code
    assert words in capsys.readouterr().err
    assert not list(here.iterdir())


def test_a_robot_without_joints_is_rejected(here, capsys):
    (here / 'rock.urdf').write_text(NOTHING_MOVES)
    assert main(['excite', 'rock.urdf']) == 1
    assert "robot 'rock' has no joint to move" in capsys.readouterr().err
