"""Broken descriptions of any kind end in a UrdfError or in a robot of finite numbers."""

from copy import deepcopy

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node.errors import UrdfError
from inverse_dynamics_node.robot.urdf import load_urdf
from lxml import etree
import numpy as np
from robot_files import OUR_ROBOTS

SOURCES = {path.stem: path.read_bytes() for path in OUR_ROBOTS}
TREES = {
    name: etree.fromstring(source, etree.XMLParser(remove_comments=True, remove_blank_text=True))
    for name, source in SOURCES.items()
}
BAD_VALUES = (
    *('', ' ', 'nan', 'inf', '-inf', '1e400', '-1e400', '1e308', '-1e308', '5e-324', '-0', '0'),
    *('-1', '1_000', '0x10', '2,5', '2.0kg', '\u0663', '\uff12', '1e', '.', '-', '1 2', '0 0 0'),
    *('1 2 3', '1e200 1e200 1e200', '0 0 nan', '0,0,1', '${x}', '$(arg x)', '"', '<', '&', '\n'),
    *('fixed', 'revolute', 'planar', 'base', '0' * 400 + '1', '9' * 400, '1e-400'),
)

FINITE = (
    *('damping', 'friction', 'multiplier', 'offset', 'R_PL', 'p_PL', 'axis', 'mass', 'com'),
    *('inertia', 'link_rotation', 'link_position'),
)
LIMITS = ('lower', 'upper', 'velocity_limits', 'effort_limits')


def loads_or_raises_urdf_error(source):
    """Return whether it loaded; fail unless the result is a valid robot or a UrdfError."""
    problems = ()
    try:
        robot = load_urdf(source)
    except UrdfError as error:
        problems, robot = error.problems, None
    if robot is None:
        assert problems
        assert all(isinstance(problem, str) and problem for problem in problems)
        return False
    for name in FINITE:
        assert np.isfinite(getattr(robot, name)).all(), name
    for name in LIMITS:
        assert not np.isnan(getattr(robot, name)).any(), name
    assert (robot.mass >= 0.0).all()
    assert (robot.effort_limits > 0.0).all()
    assert (robot.lower <= robot.upper).all()
    return True


def text_of(root):
    return etree.tostring(root, encoding='unicode')


@st.composite
def mutated(draw):
    """Return the text of a test robot with one to three changes."""
    root = deepcopy(TREES[draw(st.sampled_from(sorted(TREES)))])
    for _ in range(draw(st.integers(1, 3))):
        elements = list(root.iter())
        element = draw(st.sampled_from(elements))
        change = draw(st.sampled_from(sorted(CHANGES)))
        CHANGES[change](draw, element, elements)
    return text_of(root)


def drop_element(_, element, __):
    if element.getparent() is not None:
        element.getparent().remove(element)


def duplicate_element(_, element, __):
    if element.getparent() is not None:
        element.addnext(deepcopy(element))


def move_element(draw, element, elements):
    target = draw(st.sampled_from(elements))
    if element is not target and element not in target.iterancestors():
        target.append(element)


def rename_element(draw, element, elements):
    element.tag = draw(st.sampled_from([other.tag for other in elements] + ['x', 'Joint']))


def drop_attribute(draw, element, _):
    if element.attrib:
        del element.attrib[draw(st.sampled_from(sorted(element.attrib)))]


def rename_attribute(draw, element, elements):
    if element.attrib:
        old = draw(st.sampled_from(sorted(element.attrib)))
        names = sorted({name for other in elements for name in other.attrib})
        element.set(draw(st.sampled_from(names)), element.attrib.pop(old))


def swap_values(draw, element, _):
    if len(element.attrib) > 1:
        one, two = draw(st.permutations(sorted(element.attrib)))[:2]
        element.attrib[one], element.attrib[two] = element.attrib[two], element.attrib[one]


def bad_value(draw, element, _):
    if element.attrib:
        element.set(draw(st.sampled_from(sorted(element.attrib))), draw(VALUES))


def value_from_elsewhere(draw, element, elements):
    values = sorted({value for other in elements for value in other.attrib.values()})
    if element.attrib:
        name = draw(st.sampled_from(sorted(element.attrib)))
        element.set(name, draw(st.sampled_from(values)))


VALUES = st.sampled_from(BAD_VALUES) | st.floats().map(str) | st.text('0123456789+-.eE ')
CHANGES = {
    change.__name__: change
    for change in (
        drop_element,
        duplicate_element,
        move_element,
        rename_element,
        drop_attribute,
        rename_attribute,
        swap_values,
        bad_value,
        value_from_elsewhere,
    )
}


@settings(max_examples=4 * settings.default.max_examples)
@given(mutated())
def test_mutated_elements_load_or_raise_urdf_error(text):
    loads_or_raises_urdf_error(text)


@settings(max_examples=2 * settings.default.max_examples)
@given(st.data())
def test_mutated_bytes_load_or_raise_urdf_error(tmp_path_factory, data):
    source = bytearray(SOURCES[data.draw(st.sampled_from(sorted(SOURCES)))])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(source) - 1))
        source[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=4))
    path = tmp_path_factory.getbasetemp() / 'mutated.urdf'
    path.write_bytes(source)
    loads_or_raises_urdf_error(path)


@given(st.text() | st.text('<>/="robot &;!?[]-'))
def test_random_text_raises_urdf_error(text):
    assert not loads_or_raises_urdf_error(f'<{text}')


def test_truncated_file_raises_urdf_error(tmp_path):
    source = SOURCES['mimic_gripper'].rstrip()
    path = tmp_path / 'cut.urdf'
    for end in range(0, len(source), 3):
        path.write_bytes(source[:end])
        assert not loads_or_raises_urdf_error(path), end
    path.write_bytes(source)
    assert loads_or_raises_urdf_error(path)
