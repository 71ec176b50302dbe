"""The launch file, and the arguments of the node that launch makes from it."""

import re
import xml.etree.ElementTree as ElementTree

from robot_files import ROOT
import yaml

LAUNCH = ElementTree.parse(ROOT / 'launch' / 'inverse_dynamics.launch.xml').getroot()
NODE = LAUNCH.find('node')
ARGUMENTS = {arg.get('name'): arg for arg in LAUNCH.findall('arg')}
SHARE = '$(find-pkg-share inverse_dynamics_node)'
TYPES = {'str': str, 'bool': bool}


def substituted(text, values):
    """Replace $(var ...) as launch does."""
    return re.sub(r'\$\(var (\w+)\)', lambda match: values[match[1]], text)


def ros_arguments(**given):
    """Return the arguments that launch passes to the node."""
    unknown = sorted(set(given) - set(ARGUMENTS))
    assert not unknown, f'{unknown} are not arguments of the launch file'
    values = {
        name: arg.get('default').replace(SHARE, str(ROOT)) for name, arg in ARGUMENTS.items()
    }
    values |= given
    arguments = ['-r', f'__node:={NODE.get("name")}']
    namespace = substituted(NODE.get('namespace'), values)
    arguments += ['-r', f'__ns:=/{namespace}'] * bool(namespace)
    for element in NODE:
        get = {key: substituted(value, values) for key, value in element.attrib.items()}
        if element.tag == 'remap':
            arguments += ['-r', f'{get["from"]}:={get["to"]}']
        elif 'from' in get:
            arguments += ['--params-file', get['from']]
        else:
            value = get['value']
            text = f'"{value}"' if get['type'] == 'str' else value
            assert type(yaml.safe_load(text)) is TYPES[get['type']]
            arguments += ['-p', f'{get["name"]}:={text}']
    return arguments
