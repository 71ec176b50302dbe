"""The documents show outputs that the commands print, and commands that exist."""

from importlib import import_module
import re
import shlex
import shutil

from inverse_dynamics_node.cli.main import COMMANDS, main
from inverse_dynamics_node.node.parameters import PARAMETERS
import pytest
from robot_files import ROOT
from simulated_runs import simulate_with_a_gripper, write_bag

PAGES = [*sorted(ROOT.glob('*.md')), *sorted((ROOT / 'doc').rglob('*.md'))]
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
    beginning, *is_cut = output.split('\n...\n')
    shown, printed = words_of(beginning), words_of(run(command))
    if is_cut:
        printed = printed[: len(shown)]
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
    assert {'effort.png', 'compare.png'} <= set(names)


def commands_of(page):
    """Yield the words of each command in the shell blocks of a page, without comments."""
    for block in re.findall(r'^```sh\n(.*?)^```', page.read_text(), re.M | re.S):
        text = re.sub(r"<<'END'.*?^END$", '', block, flags=re.M | re.S).replace('\\\n', ' ')
        for line in re.split(r'\n| && |&$', text):
            if words := shlex.split(line, comments=True):
                yield words


def parse(command, options):
    import_module(f'inverse_dynamics_node.cli.{command}').make_parser().parse_args(options)


def test_commands_in_the_documents_exist():
    pytest.importorskip('rclpy')
    targets = re.search(r'^\.PHONY: (.*(?:\\\n.*)*)', (ROOT / 'Makefile').read_text(), re.M)[1]
    found = set()
    for page in PAGES:
        for words in commands_of(page):
            match words:
                case ['inverse_dynamics', command, *options] if command in COMMANDS:
                    parse(command, options[: [*options, '--ros-args'].index('--ros-args')])
                    found.add(command)
                case ['make', 'demo', *settings]:
                    options = dict(x.split('=', 1) for x in settings).get('ARGS', '')
                    parse('demo', ['my_arm.urdf', *shlex.split(options)])
                case ['make', target, *_]:
                    assert target in targets.split()
                case ['ros2', 'param', 'set', '/inverse_dynamics', parameter, _]:
                    assert parameter in PARAMETERS
    assert found == {*COMMANDS}


def words_of(text):
    return text.replace(',', ' ').split()


def same(word, found, tolerance):
    """Compare two words, numbers within a tolerance."""
    try:
        shown, now = (float(text.strip('>()%,;.')) for text in (word, found))
        return now == pytest.approx(shown, rel=tolerance, abs=tolerance)
    except ValueError:
        return word == found
