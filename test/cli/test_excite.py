"""The command `excite`, and the files that it writes."""

import sys

from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import NOTHING_MOVES, STANFORD

pytest.importorskip('coal')
yaml = pytest.importorskip('yaml')

SHAPED = STANFORD.read_text().replace(
    '</inertial>',
    '</inertial><collision><geometry><sphere radius="0.01"/></geometry></collision>',
)
ROBOT = load_urdf(STANFORD)
NAMES = ROBOT.joint_names
pytestmark = pytest.mark.usefixtures('brief')


def excite(*arguments):
    return main(['excite', str(STANFORD), *arguments])


def test_the_files_contain_the_motion_and_a_rehearsal(here, capsys):
    assert excite() == 0
    printed = capsys.readouterr().out
    motion, _ = read_trajectory(here / 'stanford_excite.yaml', NAMES)
    slow, _ = read_trajectory(here / 'stanford_excite_rehearsal.yaml', NAMES)
    assert motion.joint_names == slow.joint_names == NAMES
    assert motion.times[0] == slow.times[0] >= 5.0  # the time to get to the start pose
    assert np.ptp(motion.times) == pytest.approx(10.0)
    assert np.ptp(slow.times) == pytest.approx(50.0)
    for speed, each in ((1.0, motion), (0.2, slow)):
        step = round(1.0 / speed)
        assert_allclose(each.positions[::step], motion.positions, atol=1e-8)
        assert_allclose(each.velocities[::step], speed * motion.velocities, atol=1e-8)
        assert_allclose(each.accelerations[::step], speed**2 * motion.accelerations, atol=1e-8)
        assert not each.velocities[[0, -1]].any()
        assert not each.accelerations[[0, -1]].any()
    assert np.abs(motion.velocities).max(axis=0).min() > 0.01
    # A controller without effort interfaces rejects a trajectory with efforts.
    assert 'effort' not in (here / 'stanford_excite.yaml').read_text()
    for words in (
        'Expected standard errors of one run',
        'collisions were NOT checked: no links have shapes that could collide',
        'not checked, because they have no readable shape: ',
        'noise',
    ):
        assert words in printed
    # The files are those that `effort` reads.
    assert main(['effort', str(STANFORD), 'stanford_excite.yaml', '--no-picture']) == 0


def test_options_restrict_the_motion(here):
    assert (
        excite('--joints', NAMES[1], NAMES[3], '--floor', 'none', '--trajectory-out', 'b.yaml')
        == 0
    )
    trajectory, _ = read_trajectory(here / 'b.yaml', NAMES)
    assert trajectory.joint_names == (NAMES[1], NAMES[3])
    names = ['b.yaml', 'b_rehearsal.yaml']
    assert sorted(path.name for path in here.iterdir()) == names


def test_the_output_says_so_if_collisions_cannot_be_checked(here, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'coal', None)  # as if it were not installed
    assert excite() == 0
    assert 'collisions were NOT checked: the package coal is missing' in capsys.readouterr().out
    assert excite('--box', '1', '0', '0', '1', '1', '1', '--force') == 1
    assert '--box needs the package coal: pip install coal' in capsys.readouterr().err


def test_the_output_says_what_the_links_keep_from(here, capsys):
    (here / 'arm.urdf').write_text(SHAPED)
    assert main(['excite', 'arm.urdf', '--floor', '-1', '--joints', *NAMES[:2]]) == 0
    printed = capsys.readouterr().out
    assert (
        'the links keep 5 mm from each other, and 20 mm from the floor and from boxes' in printed
    )
    assert 'space that the links need: x ' in printed


def test_boxes_that_leave_no_room_end_with_a_reason(here, capsys):
    (here / 'arm.urdf').write_text(SHAPED)
    assert main(['excite', 'arm.urdf', '--box', '0', '0', '0', '3', '3', '3']) == 1
    assert 'these collide: ' in capsys.readouterr().err
    assert [path.name for path in here.iterdir()] == ['arm.urdf']


@pytest.mark.parametrize(
    ('arguments', 'code', 'words'),
    [
        (['--joints', 'hook'], 1, "joint 'hook' does not exist; joints are"),
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
