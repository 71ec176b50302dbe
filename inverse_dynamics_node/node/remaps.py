"""Remaps names, and finds remap rules and parameter files that have no effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import os
import re
from typing import Any

from ..errors import ConfigurationError, did_you_mean

NODE_NAME = 'inverse_dynamics'
"""Default name of the node."""
PUBLISHED_BY_ROS = '~/transition_event', '/rosout', '/parameter_events'
LIFECYCLE_SERVICES = (
    '~/change_state',
    '~/get_state',
    '~/get_available_states',
    '~/get_available_transitions',
    '~/get_transition_graph',
)
# Names that rcl creates, but does not list under their original names.
_RCL_NAMES = '/clock', *PUBLISHED_BY_ROS, *LIFECYCLE_SERVICES
_PREFIX = re.compile(r'(rostopic|rosservice)://')
_HOME = re.compile(r'/root/|/home/[^/]+/')


class NodeNames:
    """Applies the remap rules of a command line to names, as rcl does."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._arguments = arguments
        self._rules = [rule.partition(':=')[::2] for rule in _remaps(arguments)]
        self.node = NODE_NAME
        self.node = self._remapped('__node', '__name') or NODE_NAME
        self.namespace = f'/{self._remapped("__ns").strip("/")}'
        self.full_name = self._expanded('~')

    def resolve(self, name: str) -> str:
        """Return the absolute name of a topic or service, after remapping."""
        full_name = self._expanded(name)
        for given, target in self._rules:
            if self._expanded(_PREFIX.sub('', self._own(given))) == full_name:
                return self._expanded(_PREFIX.sub('', target))
        return full_name

    def ineffective_remaps(self, names: Sequence[str]) -> list[str]:
        """Describe the remap rules that match none of the topics and services in `names`."""
        own = set(map(self._expanded, names))
        problems = []
        for rule, target in self._rules:
            given = self._own(_PREFIX.sub('', rule))
            name = self._expanded(given)
            if name not in own and '*' not in name and not re.match(r'(\w+:)?__', given):
                hint = _explain_tilde(f'{rule}:={target}') or did_you_mean(given, names)
                problems.append(
                    f'-r {rule}:={target} has no effect: this node has no topic or service '
                    f'{name}{hint}'
                )
        return problems

    def ineffective_files(self) -> list[str]:
        """
        Describe the parameter files that contain only parameters of other nodes.

        Call this method after rcl has accepted all files.
        """
        problems = []
        for _, file in _operands(self._arguments, '--params-file'):
            sections = _sections(_content(file))
            if sections and not any(map(self._matches, sections)):
                problems.append(
                    f'--params-file {file} has no effect: it is for {", ".join(sections)}, but '
                    f'this node is {self.full_name}'
                )
        return problems

    def _remapped(self, *names: str) -> str:
        """Return the target of the first remap rule for any of these names, or an empty string."""
        return next((target for given, target in self._rules if self._own(given) in names), '')

    def _own(self, given: str) -> str:
        """Remove the prefix that limits a rule to this node."""
        return given.removeprefix(f'{self.node}:')

    def _expanded(self, name: str) -> str:
        """Expand a relative or private name as rcl does."""
        parent = self.namespace.rstrip('/')
        if name.startswith('~'):
            return f'{parent}/{self.node}{name[1:]}'
        return name if name.startswith('/') else f'{parent}/{name}'

    def _matches(self, section: str) -> bool:
        """Return whether a section of a parameter file is for this node."""
        words = (re.escape(word) for word in section.split('/'))
        pattern = '/'.join(words).replace(r'/\*\*', '(/.*)?').replace(r'\*', '[^/]*')
        return re.fullmatch(pattern, self.full_name) is not None

    @property
    def uses_sim_time(self) -> bool:
        """Whether a parameter on the command line or in a file turns on simulated time."""
        value: Any = False
        for k, given in _operands(self._arguments, '-p', '--param', '--params-file'):
            if self._arguments[k - 1] == '--params-file':
                for section, parameters in _sections(_content(given)).items():
                    if self._matches(section) and isinstance(parameters, dict):
                        value = parameters.get('use_sim_time', value)
            else:
                name, _, text = given.partition(':=')
                if self._own(name) == 'use_sim_time':
                    value = text.lower() == 'true'
        return value is True


def names_of(node: Any) -> list[str]:
    """Return the names of the topics and services of a node, before remapping."""
    topics = [entity.topic for entity in (*node.publishers, *node.subscriptions)]
    services = [service.srv_name for service in (*node.services, *node.clients)]
    return [*topics, *services, *_RCL_NAMES]


def expanded_tildes(arguments: Sequence[str]) -> list[str]:
    """Return hints on remap rules in which the shell has replaced ~ with the home directory."""
    hints = {rule: _explain_tilde(rule) for rule in _remaps(arguments)}
    return [f'-r {rule}{hint}' for rule, hint in hints.items() if hint]


def with_parameter_files(arguments: Sequence[str]) -> list[str]:
    """
    Return a command line with ``~`` expanded in the names of parameter files.

    The shell does not expand ``~`` in a launch argument such as ``params_file:=~/arm.yaml``. Raise
    a ConfigurationError that names every missing parameter file.
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


def _content(file: str) -> Any:
    """Read a parameter file that rcl accepts; return None if the stricter PyYAML rejects it."""
    import yaml  # rclpy needs this module, too

    if not os.path.isfile(file):  # a pipe has been read already
        return None
    with open(file, 'rb') as stream:
        try:
            return yaml.safe_load(stream)
        except (yaml.YAMLError, ValueError, RecursionError):
            return None


def _sections(content: Any, path: str = '') -> dict[str, Any]:
    """Return the parameters in a file by node name; a node name may contain wildcards."""
    if not isinstance(content, dict):
        return {}
    found = {path: content['ros__parameters']} if 'ros__parameters' in content else {}
    for key, value in content.items():
        found |= _sections(value, f'{path}/{str(key).strip("/")}')
    return found


def _remaps(arguments: Sequence[str]) -> Iterator[str]:
    return (rule for _, rule in _operands(arguments, '-r', '--remap'))


def _operands(arguments: Sequence[str], *options: str) -> Iterator[tuple[int, str]]:
    """Yield the arguments that follow these ROS options, each with its index."""
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
    return f"; if the shell replaced ~ with the home directory, quote the rule: -r '{original}'"
