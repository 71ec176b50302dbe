"""The launch file, and the arguments of the node that launch makes from it."""

import re
import shlex
import xml.etree.ElementTree as ElementTree

from robot_files import ROOT

FOLDER = ROOT / 'launch'
LAUNCH = ElementTree.parse(FOLDER / 'inverse_dynamics.launch.xml').getroot()
NODE = LAUNCH.find('node')
ARGUMENTS = {arg.get('name'): arg for arg in LAUNCH.findall('arg')}
SUBSTITUTIONS = {
    'dirname': lambda values: str(FOLDER),
    'var': lambda values, name: values[name],
    'not-equals': lambda values, left, right: 'false' if left == right else 'true',
    'if': lambda values, condition, then: then if condition == 'true' else '',
}


def words(text, values):
    """Perform the substitutions and divide the text, but not the results, as launch does."""
    parts, results = _performed(text, values)
    return [_restored(word, results) for word in shlex.split(parts)]


def performed(text, values):
    """Perform the substitutions in a text."""
    return _restored(*_performed(text, values))


def _performed(text, values):
    """Replace each outer substitution by one character; return the text and the results."""
    results = []

    def perform(match):
        kind, *operands = [_restored(word, results) for word in shlex.split(match[1])]
        results.append(SUBSTITUTIONS[kind](values, *operands))
        return chr(0xE000 + len(results) - 1)

    while '$(' in text:
        text = re.sub(r'\$\(([^()$]*)\)', perform, text)
    return text, results


def _restored(text, results):
    return re.sub('[\ue000-\uf8ff]', lambda match: results[ord(match[0]) - 0xE000], text)


def ros_arguments(folder, **given):
    """
    Return the arguments that launch passes to the node, and write the file named by them.

    Like launch, ignore unknown arguments.

    """
    values = dict(given)
    for name, argument in ARGUMENTS.items():
        values.setdefault(name, performed(argument.get('default'), values))
    arguments = [
        *words(NODE.get('ros_args'), values),
        *('--ros-args', '-r', f'__node:={performed(NODE.get("name"), values)}'),
        *('-r', f'__ns:=/{performed(NODE.get("namespace"), values)}'),
    ]
    for number, param in enumerate(NODE.findall('param')):
        template = performed(param.get('from'), values)
        file = folder / f'launch_params_{number}.yaml'
        with open(template) as text:
            file.write_text(performed(text.read(), values))
        arguments += ['--params-file', str(file)]
    for remap in NODE.findall('remap'):
        arguments += ['-r', f'{remap.get("from")}:={performed(remap.get("to"), values)}']
    return arguments
