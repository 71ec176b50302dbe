"""Remap rules without effect and missing parameter files are found on the command line."""

from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.node.remaps import (
    expanded_tildes,
    NodeNames,
    with_parameter_files,
)
import pytest

NAMES = ['joint_states', 'imu', '/diagnostics', '~/commands', '~/joint_efforts', '~/enable']


def problems(*rules, namespace='/left'):
    arguments = ['node', '--ros-args']
    for rule in ('__node:=arm', f'__ns:={namespace}', *rules):
        arguments += ['-r', rule]
    return NodeNames(arguments).ineffective_remaps(NAMES)


@pytest.mark.parametrize(
    'rule',
    [
        '__node:=other',
        '__ns:=/left',
        'arm:__node:=other',
        'joint_states:=/x',
        '/left/joint_states:=/x',
        'arm:joint_states:=/x',
        '~/commands:=/x',
        'arm:~/commands:=/x',
        '/left/arm/commands:=/x',
        'rostopic://~/commands:=/x',
        'rosservice://~/enable:=/x',
        '/diagnostics:=/x',
    ],
)
def test_rules_that_match_are_not_reported(rule):
    assert problems(rule) == []


def test_namespace_at_the_root():
    assert problems('/joint_states:=/x', '/arm/commands:=/x', namespace='/') == []


@pytest.mark.parametrize(
    ('rule', 'words'),
    [
        ('commands:=/x', "no topic or service /left/commands; did you mean '~/commands'?"),
        ('/joint_states:=/x', "did you mean 'joint_states'?"),
        ('joint_state:=/x', "did you mean 'joint_states'?"),
        ('~/joint_effort:=/x', "did you mean '~/joint_efforts'?"),
        ('wheels:=/x', 'this node has no topic or service /left/wheels'),
        ('other:imu:=/x', 'this node has no topic or service /left/other:imu'),
    ],
)
def test_rules_without_effect_are_explained(rule, words):
    (problem,) = problems('~/commands:=/x', rule)
    assert problem.startswith(f'-r {rule} has no effect: ')
    assert words in problem


@pytest.mark.parametrize('home', ['/root', '/home/jane', '/srv/people/jane'])
def test_a_tilde_replaced_by_the_shell_is_recognised(monkeypatch, home):
    monkeypatch.setenv('HOME', '/srv/people/jane')
    (problem,) = problems(f'{home}/commands:=/x')
    assert f'no topic or service {home}/commands; ' in problem
    assert "quote the rule: -r '~/commands:=/x'" in problem


def test_a_rule_that_rcl_cannot_parse_is_explained():
    arguments = ['node', '--ros-args', '--remap', '/home/jane.doe/commands:=/x', '-p', 'a:=1']
    (words,) = expanded_tildes(arguments)
    assert words.endswith("quote the rule: -r '~/commands:=/x'")
    assert expanded_tildes(['node', '--ros-args', '-r', '~/commands:=/x']) == []


def test_only_ros_arguments_are_rules():
    arguments = ['node', '-r', 'a:=b', '--ros-args', '-p', 'a:=1', '--', '-r', 'c:=d']
    assert NodeNames(arguments).ineffective_remaps(NAMES) == []


def test_parameter_files_are_found_in_home_directories(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'a.yaml').touch()
    given = ['node', '--params-file', '~/x', '--ros-args', '-p', 'a:=~/x', '--params-file']
    assert with_parameter_files([*given, '~/a.yaml']) == [*given, str(tmp_path / 'a.yaml')]


def test_every_parameter_file_that_does_not_exist_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = ['a.yaml', '', '/dev/null', '~nobody-here/b.yaml']
    given = [word for name in files for word in ('--params-file', name)]
    with pytest.raises(ConfigurationError) as error:
        with_parameter_files(['node', '--ros-args', *given])
    assert str(error.value).splitlines() == [
        f'no such parameter file: {tmp_path}/a.yaml (--params-file a.yaml)',
        "no such parameter file: '' (--params-file )",
        f'no such parameter file: {tmp_path}/~nobody-here/b.yaml (--params-file '
        '~nobody-here/b.yaml)',
    ]


@pytest.mark.parametrize(
    ('sections', 'has_effect'),
    [
        ('/**:', True),
        ('/left/arm:', True),
        ('left/arm:', True),
        ('/left:\n arm:', True),
        ('/left/*:', True),
        ('/*/arm:', True),
        ('/**/arm:', True),
        ('/**/*:', True),
        ('/other:\n  ros__parameters: {a: 1}\n/left/arm:', True),
        ('/arm:', False),
        ('arm:', False),
        ('/*:', False),
        ('/left/arms:', False),
        ('/right/*:', False),
        ('/left/arm/*:', False),
    ],
)
def test_a_parameter_file_for_other_nodes_is_reported(sections, has_effect, tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(f'{sections}\n  ros__parameters:\n    kp: 1.0\n')
    arguments = ['--ros-args', '--params-file', str(path), '-r', '__ns:=/left']
    found = NodeNames([*arguments, '-r', '__node:=arm']).ineffective_files()
    assert bool(found) != has_effect
    if found:
        assert found[0].startswith(f'--params-file {path} has no effect: it is for /')
        assert found[0].endswith(', but this node is /left/arm')


@pytest.mark.parametrize('text', ['', '# nothing', '- a list', 'a: [', '/**:\n'])
def test_files_without_sections_are_not_reported(text, tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(text)
    assert NodeNames(['--ros-args', '--params-file', str(path)]).ineffective_files() == []


def test_names_are_those_of_the_default_node_without_arguments():
    names = NodeNames(['node'])
    assert (names.full_name, names.uses_sim_time) == ('/inverse_dynamics', False)
    assert names.resolve('imu') == '/imu'
    assert names.resolve('~/commands') == '/inverse_dynamics/commands'


@pytest.mark.parametrize(
    ('rules', 'name', 'resolved'),
    [
        (['__ns:=/left'], 'imu', '/left/imu'),
        (['arm:__ns:=/left', '__name:=arm'], '~/enable', '/left/arm/enable'),
        (['inverse_dynamics:__ns:=/left', '__name:=arm'], '~/enable', '/arm/enable'),
        (['other:__node:=arm'], '~', '/inverse_dynamics'),
        (['imu:=a', 'imu:=b'], 'imu', '/a'),
        (['__ns:=/left', '/left/imu:=~/a'], 'imu', '/left/inverse_dynamics/a'),
        (['__node:=arm', 'arm:~/commands:=/x'], '~/commands', '/x'),
        (['/diagnostics:=diagnostics', '__ns:=/left'], '/diagnostics', '/left/diagnostics'),
    ],
)
def test_names_are_remapped(rules, name, resolved):
    arguments = ['node', '--ros-args', *(x for rule in rules for x in ('-r', rule))]
    assert NodeNames(arguments).resolve(name) == resolved


@pytest.mark.parametrize(
    ('arguments', 'uses_sim_time'),
    [
        (['-p', 'use_sim_time:=true'], True),
        (['-p', 'use_sim_time:=True', '-p', 'use_sim_time:=false'], False),
        (['-p', 'other:use_sim_time:=true'], False),
        (['-p', 'inverse_dynamics:use_sim_time:=true'], True),
        (['--params-file', 'all.yaml'], True),
        (['--params-file', 'all.yaml', '-p', 'use_sim_time:=false'], False),
        (['--params-file', 'other.yaml'], False),
    ],
)
def test_simulated_time_is_found(arguments, uses_sim_time, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file, section in (('all.yaml', '/**'), ('other.yaml', 'other')):
        (tmp_path / file).write_text(f'{section}:\n  ros__parameters:\n    use_sim_time: true\n')
    assert NodeNames(['node', '--ros-args', *arguments]).uses_sim_time is uses_sim_time
