"""What README and gallery show of the commands is what the commands print."""

import re
import shlex
import shutil

from inverse_dynamics_node.cli.main import main
import pytest
from robot_files import ROOT

README = (ROOT / 'README.md').read_text().split('## See it and trust it')[1].split('\n## ')[0]
GALLERY = (ROOT / 'doc' / 'gallery.md').read_text()
EXAMPLES = re.findall(r'```console\n\$ inverse_dynamics (.*?)\n(.*?)```', GALLERY, re.S)


@pytest.fixture
def run(tmp_path, capsys):
    shutil.copytree(ROOT / 'config', tmp_path / 'config')

    def run(command):
        assert main(shlex.split(command)) == 0
        return capsys.readouterr().out

    return run


# Another numpy, scipy or processor may round the last digit shown another way.
@pytest.mark.parametrize(('command', 'output'), EXAMPLES, ids=[each[0] for each in EXAMPLES])
def test_the_gallery_shows_what_is_printed(run, command, output):
    shown, printed = output.split(), run(command).split()
    assert len(shown) == len(printed)
    for word, found in zip(shown, printed, strict=True):
        assert same(word, found), f'{word} is {found} now'


def test_the_readme_shows_parts_of_the_gallery():
    blocks = re.findall(r'(?:^    .*\n|^\n)+', README, re.M)
    tables = [block for block in blocks if 'joint_1' in block]
    assert len(tables) == 2
    gallery = {line.removeprefix('$').strip() for line in GALLERY.splitlines()}
    for line in ''.join(tables).splitlines():
        assert line.strip() in gallery


def test_the_gallery_shows_every_picture_it_has():
    names = re.findall(r'\]\(images/(\w+\.png)\)', GALLERY)
    assert {'check.png', 'effort.png'} <= set(names)
    assert all((ROOT / 'doc' / 'images' / name).exists() for name in names)
    assert all((ROOT / 'doc' / path).resolve().exists() for path in links())


def links():
    return list(re.findall(r'\]\(([^)#:]+)\)', GALLERY))


def same(word, found):
    """Compare words, and numbers to what is shown of them."""
    try:
        shown, now = (float(text.rstrip('%,;.')) for text in (word, found))
        return now == pytest.approx(shown, rel=2e-3, abs=2e-3)
    except ValueError:
        return word == found
