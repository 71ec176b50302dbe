"""The outputs in the gallery are those that the commands print."""

import re
import shlex
import shutil

from inverse_dynamics_node.cli.main import main
import pytest
from robot_files import ROOT
from simulated_runs import simulate_with_a_gripper, write_bag

GALLERY = (ROOT / 'doc' / 'command_line.md').read_text()
EXAMPLES = re.findall(r'```console\n\$ inverse_dynamics (.*?)\n(.*?)```', GALLERY, re.S)


@pytest.fixture
def run(tmp_path, capsys):
    for folder in ('config', 'doc'):
        shutil.copytree(ROOT / folder, tmp_path / folder)

    def run(command):
        if command.startswith('compare'):
            pytest.importorskip('mujoco')
            write_bag(tmp_path / 'run', simulate_with_a_gripper())
        assert main(shlex.split(command)) == 0
        return capsys.readouterr().out

    return run


# Another numpy, scipy or processor may round the last digit shown another way.
@pytest.mark.parametrize(('command', 'output'), EXAMPLES, ids=[each[0] for each in EXAMPLES])
def test_a_command_prints_the_output_shown_in_the_gallery(run, command, output):
    shown, printed = words_of(output), words_of(run(command))
    assert len(shown) == len(printed)
    # A simulated robot that sticks and slips does so a little differently on every machine.
    tolerance = 5e-2 if command.startswith('compare') else 2e-3
    for word, found in zip(shown, printed, strict=True):
        assert same(word, found, tolerance), f'{word} is {found} now'


def test_a_bad_description_is_rejected_as_shown_in_the_gallery(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    urdf, problems = re.search(r'```xml\n(.*?)```\n\n```text\n(.*?)```', GALLERY, re.S).groups()
    (tmp_path / 'arm.urdf').write_text(urdf)
    assert main(['check', 'arm.urdf']) == 1
    assert capsys.readouterr().err == problems


def test_the_gallery_shows_the_pictures_of_all_commands():
    names = re.findall(r'\]\(images/(\w+\.png)\)', GALLERY)
    assert {'check.png', 'effort.png', 'compare.png'} <= set(names)


def words_of(text):
    return text.replace(',', ' ').split()


def same(word, found, tolerance):
    """Compare two words, numbers within a tolerance."""
    try:
        shown, now = (float(text.strip('>()%,;.')) for text in (word, found))
        return now == pytest.approx(shown, rel=tolerance, abs=tolerance)
    except ValueError:
        return word == found
