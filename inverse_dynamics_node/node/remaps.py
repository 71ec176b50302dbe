"""Mistakes in ROS arguments: remap rules and parameter files without effect, or missing files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import os
import re
from typing import Any

from ..errors import ConfigurationError, did_you_mean

# Names that rcl creates; it lists them after remapping or not at all.
_RCL_NAMES = (
    '/clock',
    '/rosout',
    '/parameter_events',
    '~/transition_event',
    '~/change_state',
    '~/get_state',
    '~/get_available_states',
    '~/get_available_transitions',
    '~/get_transition_graph',
)
_HOME = re.compile(r'/root/|/home/[^/]+/')


def names_of(node: Any) -> list[str]:
    """List the topics and services of a node before remapping."""
    topics = [entity.topic for entity in (*node.publishers, *node.subscriptions)]
    services = [service.srv_name for service in (*node.services, *node.clients)]
    return [*topics, *services, *_RCL_NAMES]


def ineffective_remaps(
    arguments: Sequence[str], names: Sequence[str], node: str, namespace: str
) -> list[str]:
    """
    Describe the remap rules on a command line that match no name of a node.

    Parameters
    ----------
    arguments : sequence of str
        The command line.
    names : sequence of str
        Topics and services of the node, before remapping.
    node, namespace : str
        Name and namespace of the node, after remapping.

    """
    own = {_expanded(name, node, namespace) for name in names}
    problems = []
    for rule in _remaps(arguments):
        given = re.sub(r'(rostopic|rosservice)://', '', rule.partition(':=')[0])
        given = given.removeprefix(f'{node}:')
        name = _expanded(given, node, namespace)
        if name not in own and '*' not in name and not re.match(r'(\w+:)?__', given):
            hint = _explain_tilde(rule) or did_you_mean(given, names)
            problems.append(
                f'-r {rule} has no effect: this node has no topic or service {name}{hint}'
            )
    return problems


def expanded_tildes(arguments: Sequence[str]) -> list[str]:
    """Explain the remap rules in which the shell replaced a tilde by the home directory."""
    hints = {rule: _explain_tilde(rule) for rule in _remaps(arguments)}
    return [f'-r {rule}{hint}' for rule, hint in hints.items() if hint]


def with_parameter_files(arguments: Sequence[str]) -> list[str]:
    """
    Return a command line with the home directory in place of ``~`` in names of parameter files.

    No shell expands it after ``:=``.

    Raises
    ------
    ConfigurationError
        Naming every parameter file that does not exist.

    """
    found, problems = list(arguments), []
    for k, given in _operands(arguments, '--params-file'):
        found[k] = os.path.expanduser(given)
        if not given or not os.path.exists(found[k]):
            path = os.path.abspath(found[k]) if given else "''"
            problems.append(f'no such parameter file: {path} (--params-file {given})')
    if problems:
        raise ConfigurationError(*problems)
    return found


def ineffective_files(arguments: Sequence[str], name: str) -> list[str]:
    """
    Describe the parameter files that are for other nodes: their limits would not apply.

    Parameters
    ----------
    arguments : sequence of str
        The command line, accepted by rcl.
    name : str
        Fully qualified name of the node.

    """
    import yaml  # which rclpy needs too

    problems = []
    for _, file in _operands(arguments, '--params-file'):
        if not os.path.isfile(file):  # a pipe has been read already
            continue
        with open(file, 'rb') as stream:
            try:
                sections = _sections(yaml.safe_load(stream))
            except (yaml.YAMLError, ValueError, RecursionError):  # PyYAML is stricter than rcl
                continue
        if sections and not any(re.fullmatch(_pattern(section), name) for section in sections):
            problems.append(
                f'--params-file {file} has no effect: it is for {", ".join(sections)}, this node '
                f'is {name}'
            )
    return problems


def _sections(content: Any, path: str = '') -> list[str]:
    """List the names of nodes, with their wildcards, for which a file has parameters."""
    if not isinstance(content, dict):
        return []
    found = [path] if 'ros__parameters' in content else []
    for key, value in content.items():
        found += _sections(value, f'{path}/{str(key).strip("/")}')
    return found


def _pattern(section: str) -> str:
    words = (re.escape(word) for word in section.split('/'))
    return '/'.join(words).replace(r'/\*\*', '(/.*)?').replace(r'\*', '[^/]*')


def _remaps(arguments: Sequence[str]) -> Iterator[str]:
    """Find the rules among the ROS arguments."""
    return (rule for _, rule in _operands(arguments, '-r', '--remap'))


def _operands(arguments: Sequence[str], *options: str) -> Iterator[tuple[int, str]]:
    """Find what follows some ROS options, with its index."""
    is_ros = is_operand = False
    for k, argument in enumerate(arguments):
        if is_operand:
            yield k, argument
            is_operand = False
        elif argument in ('--ros-args', '--'):
            is_ros = argument == '--ros-args'
        else:
            is_operand = is_ros and argument in options


def _explain_tilde(rule: str) -> str:
    name, _, target = rule.partition(':=')
    home = os.path.expanduser('~').rstrip('/') + '/'
    if home == '/' or not name.startswith(home):  # the rule may come from another user's shell
        match = _HOME.match(name)
        if match is None:
            return ''
        home = match[0]
    original = f'~/{name[len(home) :]}:={target}'
    return f"; if the shell replaced ~ by the home directory, quote the rule: -r '{original}'"


def _expanded(name: str, node: str, namespace: str) -> str:
    """Expand a relative or private name as rcl does."""
    parent = namespace.rstrip('/')
    if name.startswith('~'):
        return f'{parent}/{node}{name[1:]}'
    return name if name.startswith('/') else f'{parent}/{name}'
