"""What README and gallery show of the commands is what the commands print."""

import re
import shlex
import shutil

from inverse_dynamics_node.cli.main import main
import pytest
from robot_files import ROOT
from simulated_runs import simulate_with_a_gripper, write_bag

README = (ROOT / 'README.md').read_text().split('## See it and trust it')[1].split('\n## ')[0]
GALLERY = (ROOT / 'doc' / 'gallery.md').read_text()
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
def test_the_gallery_shows_what_is_printed(run, command, output):
    shown, printed = words_of(output), words_of(run(command))
    assert len(shown) == len(printed)
    # A simulated robot that sticks and slips does so a little differently on every machine.
    tolerance = 5e-2 if command.startswith('compare') else 2e-3
    for word, found in zip(shown, printed, strict=True):
        assert same(word, found, tolerance), f'{word} is {found} now'


def test_the_readme_shows_parts_of_the_gallery():
    blocks = re.findall(r'(?:^    .*\n|^\n)+', README, re.M)
    tables = [block for block in blocks if 'joint_1' in block]
    assert len(tables) == 2
    gallery = {line.removeprefix('$').strip() for line in GALLERY.splitlines()}
    for line in ''.join(tables).splitlines():
        assert line.strip() in gallery


def test_the_gallery_shows_every_picture_it_has():
    names = re.findall(r'\]\(images/(\w+\.png)\)', GALLERY)
    assert {'check.png', 'effort.png', 'compare.png'} <= set(names)
    assert all((ROOT / 'doc' / 'images' / name).exists() for name in names)
    links = re.findall(r'\]\(([^)#:]+)\)', GALLERY)
    assert all((ROOT / 'doc' / link).resolve().exists() for link in links)


def words_of(text):
    return text.replace(',', ' ').split()


def same(word, found, tolerance):
    """Compare words, and numbers to what is shown of them."""
    try:
        shown, now = (float(text.strip('>()%,;.')) for text in (word, found))
        return now == pytest.approx(shown, rel=tolerance, abs=tolerance)
    except ValueError:
        return word == found
