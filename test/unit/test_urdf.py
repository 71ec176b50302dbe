"""Malformed descriptions are rejected with their problems; odd but valid ones still load."""

import math
import os
from pathlib import Path
import re
import time

from inverse_dynamics_node.errors import escaped, UrdfError
from inverse_dynamics_node.robot.urdf import load_urdf
from inverse_dynamics_node.robot.urdf import xml as urdf_xml
from numpy.testing import assert_allclose
import pytest
from robot_files import NOTHING_MOVES, OUR_ROBOTS

# Loads without a warning. Each test below changes one place of it.
GOOD = """\
<?xml version="1.0"?>
<robot name="good" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base"/>
  <link name="l1">
    <inertial>
      <origin xyz="0 0 0.2" rpy="0 0 0"/>
      <mass value="2.0"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <link name="l2">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.015"/>
    </inertial>
  </link>
  <link name="l3"/>
  <joint name="j1" type="revolute">
    <parent link="base"/>
    <child link="l1"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="10" velocity="3"/>
  </joint>
  <joint name="j2" type="prismatic">
    <parent link="l1"/>
    <child link="l2"/>
    <origin xyz="0 0 0.4" rpy="0 0 0.5"/>
    <axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="20" velocity="1"/>
    <dynamics damping="0.5" friction="0.25"/>
  </joint>
  <joint name="jf" type="fixed">
    <parent link="l2"/>
    <child link="l3"/>
  </joint>
</robot>
"""

ORIGIN = '<origin xyz="0 0 0.4" rpy="0 0 0.5"/>'
AXIS = '<axis xyz="0 0 1"/>'
LIMIT = '<limit lower="0" upper="0.5" effort="20" velocity="1"/>'
J1_LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="3"/>'
MASS = '<mass value="2.0"/>'
INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>'
L2_INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.015"/>'
ZERO = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
L2_INERTIAL = f'<inertial>\n      <mass value="1"/>\n      {L2_INERTIA}\n    </inertial>'
L1_INERTIAL = re.search('<inertial>.*?</inertial>', GOOD, re.S)[0]
BASE, L3, END = '<link name="base"/>', '<link name="l3"/>', '</robot>'
BOX = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
FIXED = '<joint name="j4" type="fixed"><parent link="base"/><child link="l3"/></joint>'


def edited(*edits, text=GOOD):
    """Replace each old text by the new one; each old text must occur exactly once."""
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def problems_of(source):
    with pytest.raises(UrdfError) as caught:
        load_urdf(source)
    assert caught.value.problems
    return caught.value.problems


# ---- Not a file, not XML, not a URDF -------------------------------------------------------


def test_path_and_text_load_the_same_robot(tmp_path):
    path = tmp_path / 'good.urdf'
    path.write_text(GOOD)
    for source in (path, str(path), GOOD, f'\ufeff {GOOD}'):
        assert load_urdf(source).joint_names == ('j1', 'j2')


@pytest.mark.parametrize('make_path', [str, Path])
def test_unreadable_paths_are_reported(tmp_path, make_path):
    missing = tmp_path / 'nope.urdf'
    assert 'cannot be read: No such file' in problems_of(make_path(missing))[0]
    assert 'is a directory' in problems_of(make_path(tmp_path))[0]
    os.mkfifo(tmp_path / 'pipe')
    assert 'is not a regular file' in problems_of(make_path(tmp_path / 'pipe'))[0]
    with pytest.raises(UrdfError, match=r'nope\.urdf'):
        load_urdf(make_path(missing))


LAUGHS = '<!ENTITY a0 "ha">' + ''.join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)
)
DOCTYPE = 'DOCTYPE/DTD is not allowed in a URDF'
ROBOT = '<robot name="r"/>'
# Text, and words of its only problem.
# fmt: off
NOT_A_ROBOT = [
    ('', 'empty: expected a path or XML text'),
    (' \n', 'empty: expected a path or XML text'),
    ('{"a": 1}', "XML text must start with '<'"),
    ('a' * 5000, "XML text must start with '<'"),
    ('a\0b', 'cannot be read: '),
    (f'String value is: {GOOD}', "begins with 'String value is:', which `ros2 param get` prints"),
    ('<sdf version="1.6"><model name="m"/></sdf>', 'is <sdf>, expected <robot> (this is SDF)'),
    ('<mujoco/>', 'root element is <mujoco>, expected <robot> (this is MJCF)'),
    ('<model name="m"/>', 'root element is <model>, expected <robot>'),
    ('<html><p>404</p></html>', 'root element is <html>, expected <robot> (this is HTML)'),
    ('<x:robot xmlns:x="y" name="r"/>', 'root element is <x:robot>, expected <robot>'),
    ('<Robot name="r"/>', 'root element is <Robot>, expected <robot>'),
    (ROBOT, 'the robot has no links'),
    ('<robot name="r"><link name="b"/></robot>', 'one link and no joints: nothing to command'),
    (f'<robot name="r">{"<link/>" * 1001}</robot>', 'line 1: 1001 links, expected at most 1000'),
    (f'<robot name="r">{"<joint/>" * 1001}</robot>', 'line 1: 1001 joints, expected at most 1000'),
    ('<!doctype html>\n<html><p>Not found<br></html>', DOCTYPE),
    (f'<!DOCTYPE robot>{ROBOT}', DOCTYPE),
    (f'<!DOCTYPE robot>{ROBOT[:-2]}>', DOCTYPE),
    (f'<!DOCTYPE robot SYSTEM "http://localhost:9/robot.dtd">{ROBOT}', DOCTYPE),
    (f'<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/hostname">]>{ROBOT}', DOCTYPE),
    (f'<!DOCTYPE robot [<!ATTLIST mass value CDATA "99">]>{ROBOT}', DOCTYPE),
    (f'<!DOCTYPE r [{LAUGHS}]><robot name="r"><link name="&a9;"/></robot>', DOCTYPE),
    (f'<!DOCTYPE r [{LAUGHS}]><robot name="r">&a9;</robot>', DOCTYPE),
]
# fmt: on


@pytest.mark.parametrize(('text', 'words'), NOT_A_ROBOT)
def test_text_that_is_not_a_robot_is_one_problem(text, words):
    started = time.process_time()
    (problem,) = problems_of(text)
    assert words in problem
    assert time.process_time() - started < 1.0


def test_other_types_than_text_and_paths_are_type_errors():
    for source in (None, b'<robot/>', 3):
        with pytest.raises(TypeError):
            load_urdf(source)


# fmt: off
NOT_XML = [
    (GOOD[:400], ''),
    (GOOD.removesuffix('</robot>\n'), 'Premature end of data'),
    (edited((f'</link>\n  {L3}', L3)), 'Opening and ending tag'),
    (edited(('value="2.0"', 'value=2.0')), 'AttValue: " or \' expected, line 7, column 19'),
    (edited(('value="2.0"', 'value="2.0" value="3"')), 'Attribute value redefined'),
    (GOOD + '<robot/>', 'Extra content'),
    (edited(('name="good"', 'name="a & b"')), 'xmlParseEntityRef'),
    (edited(('name="good"', 'name="a &foo; b"')), "Entity 'foo'"),
    (edited(('name="good"', 'name="a\0b"')), ''),
    (edited((AXIS, f'{AXIS}<drake:rotor value=1/>')), ''),
    (GOOD.replace('good', 'g\xe4').encode('latin-1'), 'encoding'),
    (edited(('?>', ' encoding="nope"?>')), 'encoding: nope'),
    (edited(('version="1.0"', 'encoding="utf-8"')), 'declaration expecting version'),
    ('{"a": 1}', 'Start tag expected'),
    ('base: 3\n', 'Start tag expected'),
    (b'\x89PNG\r\n\x1a\n\0\0', 'Start tag expected'),
    ('version https://git-lfs.github.com/spec/v1\noid sha256:0', 'Start tag expected'),
    ('<robot name="r">' + '<a>' * 300 + '</a>' * 300 + '</robot>', 'Excessive depth'),
]
# fmt: on


@pytest.mark.parametrize(('data', 'words'), NOT_XML)
def test_malformed_xml_is_one_problem_with_a_line(tmp_path, data, words):
    path = tmp_path / 'broken.urdf'
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    (problem,) = problems_of(path)
    assert problem.startswith('not well-formed XML: ')
    assert words in problem
    assert 'line ' in problem


@pytest.mark.parametrize('data', [b'', b' \n\t', b'\xef\xbb\xbf'])
def test_empty_file_is_rejected(tmp_path, data):
    path = tmp_path / 'empty.urdf'
    path.write_bytes(data)
    assert problems_of(path) == ('file is empty',)


def test_size_limit_applies_to_files_and_text(tmp_path, monkeypatch):
    assert urdf_xml.MAX_BYTES == 16 * 1024 * 1024
    monkeypatch.setattr(urdf_xml, 'MAX_BYTES', 2**20)
    path = tmp_path / 'large.urdf'
    padded = GOOD + ' ' * (2**20 - len(GOOD))
    path.write_text(padded)
    assert load_urdf(path).joint_names == ('j1', 'j2')
    path.write_text(padded + ' ')
    assert problems_of(path) == ('file is 2 MiB, limit is 1 MiB',)
    assert problems_of(padded + ' ') == ('text is 2 MiB, limit is 1 MiB',)


# ---- Well-formed XML, but not a valid robot ------------------------------------------------

# What is replaced in GOOD, by what, and words of the only problem.
# fmt: off
MISTAKES = [
    # unprocessed xacro
    (BASE, f'<xacro:property name="h" value="1"/>{BASE}',
     'line 3: unprocessed xacro element <xacro:property>; run xacro first'),
    ('<inertial>\n      <origin', '<inertial><xacro:box/>\n      <origin', '<xacro:box>'),
    ('0 0 0.4', '${h}', "line 27: joint 'j2' origin xyz: '${h}' looks like unprocessed xacro"),
    (MASS, '<mass value="$(arg m)"/>', "mass: '$(arg m)' looks like unprocessed xacro"),
    ('"jf"', '"${p}jf"', "joint name '${p}jf' looks like unprocessed xacro"),
    ('link="l2"/>\n    <o', 'link="${p}l2"/>\n    <o', "'${p}l2' looks like unprocessed"),
    # names
    (' name="good"', '', 'line 2: <robot> has no name'),
    (BASE, f'{BASE}<link/>', 'line 3: <link> has no name'),
    (BASE, f'{BASE}<link name=""/>', '<link> has no name'),
    ('<joint name="jf"', '<joint', 'line 32: <joint> has no name'),
    ('"jf"', '"j2"', "line 32: duplicate joint name 'j2'"),
    (END, f'<link name="l2"/>{END}', "line 36: duplicate link name 'l2'"),
    # references
    ('<parent link="l1"/>', '<parent link="nope"/>',
     "line 25: joint 'j2': parent link 'nope' does not exist; links are base, l1, l2, l3"),
    ('<child link="l1"/>', '<child link="no"/>', "joint 'j1': child link 'no' does not exist"),
    ('<parent link="l1"/>', '', 'joint \'j2\': <parent link="..."/> is missing'),
    ('<child link="l1"/>', '<child/>', "joint 'j1': <child> lacks link"),
    ('<parent link="l1"/>', '<parent link="l2"/>', "parent and child are the same link 'l2'"),
    # the tree
    (END, f'{FIXED}{END}', "line 36: link 'l3' has two parent joints: 'jf' and 'j4'"),
    (END, f'<link name="island"/>{END}', "2 root links: 'base', 'island'; expected one"),
    ('<parent link="base"/>', '<parent link="l3"/>',
     "3 links are not connected to root 'base', because of a cycle: 'l1', 'l2', 'l3'"),
    # types
    ('"prismatic"', '"hinge"', "joint 'j2': type 'hinge' is not one of revolute, continuous"),
    ('"prismatic"', '" prismatic "', "type ' prismatic ' is not one of"),
    ('"prismatic"', '"Prismatic"', "type 'Prismatic' is not one of"),
    ('"prismatic"', '""', "type '' is not one of"),
    (' type="prismatic"', '', "line 24: joint 'j2': type is missing, expected one of"),
    ('"prismatic"', '"planar"', "type 'planar' is not supported; use two prismatic joints and a"),
    ('"prismatic"', '"floating"', "joint type 'floating' is not supported; remove this joint"),
    # mass and inertia
    (MASS, '', 'line 5: link \'l1\' inertial: <mass value="..."/> is missing'),
    (MASS, '<mass/>', "link 'l1' inertial: <mass> lacks value"),
    (MASS, '<mass>2</mass>', "link 'l1' inertial: <mass> lacks value"),
    (MASS, '<mass value="-2"/>', "link 'l1' inertial: mass -2 is negative"),
    (MASS, '<mass value="-1"/>', "link 'l1' inertial: mass -1 is negative"),
    (INERTIA, '', "link 'l1' inertial: <inertia> is missing"),
    (INERTIA, '<inertia/>', '<inertia> lacks ixx, ixy, ixz, iyy, iyz, izz'),
    (INERTIA, INERTIA.replace('ixx="0.02" ', ''),
     "line 8: link 'l1' inertial: <inertia> lacks ixx"),
    # origin and axis
    (ORIGIN, '<origin quat_xyzw="0 0 0 1"/>',
     'line 27: joint \'j2\' origin quat_xyzw: is not supported; write rpy="..."'),
    (AXIS, '<axis xyz="0 0 0"/>', "joint 'j2': the length of axis '0 0 0' is almost zero"),
    (AXIS, '<axis xyz="0 1e-9 0"/>', "joint 'j2': the length of axis '0 1e-9 0' is almost"),
    (AXIS, '<axis/>', "joint 'j2': <axis> lacks xyz"),
    (AXIS, '<axis rpy="0 0 1"/>', "joint 'j2': <axis> lacks xyz"),
    # limits
    (LIMIT, '', "line 24: joint 'j2': <limit> is required for prismatic joints"),
    (J1_LIMIT, '', '<limit> is required for revolute joints'),
    (' effort="20"', '', "joint 'j2': <limit> lacks effort"),
    (' effort="20" velocity="1"', '', "joint 'j2': <limit> lacks effort, velocity"),
    ('lower="0" upper="0.5"', 'lower="1" upper="-1"', 'lower limit 1 exceeds upper limit -1'),
    ('lower="-1" upper="1"', 'upper="-1"', 'lower limit 0 exceeds upper limit -1; if there'),
    ('upper="0.5"', 'upper="inf"', "limit upper: 'inf' is not a finite decimal number"),
    ('effort="20"', 'effort="-10"', 'limit effort -10 is negative; if there is no limit, write'),
    ('velocity="1"', 'velocity="-2"', "joint 'j2': limit velocity -2 is negative"),
    # dynamics
    ('damping="0.5"', 'damping="-0.5"', "joint 'j2': dynamics damping -0.5 is negative"),
    ('friction="0.25"', 'friction="-1"', "joint 'j2': dynamics friction -1 is negative"),
    # mimic
    (AXIS, f'{AXIS}<mimic joint="nope"/>',
     "line 28: joint 'j2' mimic: joint 'nope' does not exist; joints are j1, j2, jf"),
    (AXIS, f'{AXIS}<mimic joint="j2"/>', "joint 'j2' mimics itself"),
    (AXIS, f'{AXIS}<mimic joint="jf"/>', "joint 'j2' mimics 'jf', which is fixed"),
    (AXIS, f'{AXIS}<mimic/>', "joint 'j2': <mimic> lacks joint"),
    # the rest
    (L2_INERTIAL, L2_INERTIAL * 2, "line 15: link 'l2': 2 <inertial> elements, expected at most"),
    (MASS, MASS * 3, "link 'l1' inertial: 3 <mass> elements, expected at most one"),
    (AXIS, AXIS * 2, "joint 'j2': 2 <axis> elements, expected at most one"),
]
# fmt: on


@pytest.mark.parametrize(('old', 'new', 'words'), MISTAKES)
def test_one_mistake_is_one_problem(old, new, words):
    (problem,) = problems_of(edited((old, new)))
    assert words in problem


def test_cycle_of_links_or_of_mimicking_joints_is_named():
    text = edited(('<parent link="base"/>', '<parent link="l3"/>'), (BASE, ''))
    assert 'no root link: the links form a cycle' in problems_of(text)[0]
    master = '<axis xyz="0 1 0"/>'
    text = edited((AXIS, AXIS + '<mimic joint="j1"/>'), (master, master + '<mimic joint="j2"/>'))
    assert problems_of(text) == ('line 18: mimic loop: j1 -> j2 -> j1',)


def test_numbers_whose_product_is_infinite_are_named():
    text = edited((MASS, '<mass value="1e308"/>'), ('0 0 0.2', '0 0 1e9'))
    assert "centre of mass of 'j1' is not finite" in problems_of(text)[0]


MIMICKING = edited((AXIS, AXIS + '<mimic joint="j1" multiplier="2" offset="0.1"/>'))
BAD_NUMBERS = (
    *('', 'heavy', '2,5', '2.0kg', 'nan', 'inf', '-inf', 'infinity', '1e400', '1_000', '0x10'),
    *('1 2', '\u0663', '\uff12', '2\xa0', '1e', '.', '--2'),
)
BAD_VECTORS = [
    ('', "expected 3 numbers, got 0 in ''"),
    ('0.3', "expected 3 numbers, got 1 in '0.3'"),
    ('0,0,1', "expected 3 numbers, got 1 in '0,0,1' (use spaces, not commas)"),
    ('0 1', "expected 3 numbers, got 2 in '0 1'"),
    ('0 0 0 1', "expected 3 numbers, got 4 in '0 0 0 1'"),
    ('0 nan 1', "'nan' is not a finite decimal number"),
]


def test_numbers_must_be_finite_decimals():
    places = list(re.finditer(r'\b(?!version)([a-z_]+)="(-?[\d.]+)"', MIMICKING))
    assert len(places) == 26
    for place in places:
        line = MIMICKING[: place.start()].count('\n') + 1
        name = 'mass' if place[1] == 'value' else place[1]
        for bad in BAD_NUMBERS:
            text = f'{MIMICKING[: place.start(2)]}{bad}{MIMICKING[place.end(2) :]}'
            (problem,) = problems_of(text)
            assert problem.startswith(f'line {line}: ')
            assert problem.endswith(f" {name}: '{escaped(bad)}' is not a finite decimal number")


def test_vectors_have_three_finite_decimals():
    vectors = list(re.finditer(r'\b(xyz|rpy)="([^"]*)"', GOOD))
    assert len(vectors) == 6
    for place in vectors:
        for bad, words in BAD_VECTORS:
            (problem,) = problems_of(f'{GOOD[: place.start(2)]}{bad}{GOOD[place.end(2) :]}')
            assert f' {place[1]}: {words}' in problem


def test_all_problems_are_listed_in_file_order():
    text = edited(
        (END, f'<link name="island"/>{END}'),
        (LIMIT, '<limit lower="1" upper="-1" effort="-9" velocity="x"/>'),
        (MASS, '<mass value="two"/>'),
        ('"jf"', '"j1"'),
        ('<child link="l1"/>', '<child link="l1"/><child link="l2"/>'),
    )
    assert problems_of(text) == (
        "line 7: link 'l1' inertial mass: 'two' is not a finite decimal number",
        "line 20: joint 'j1': 2 <child> elements, expected at most one",
        "line 29: joint 'j2': limit effort -9 is negative; if there is no limit, write a large "
        'number',
        "line 29: joint 'j2' limit velocity: 'x' is not a finite decimal number",
        "line 29: joint 'j2': lower limit 1 exceeds upper limit -1",
        "line 32: duplicate joint name 'j1'",
        "2 root links: 'base', 'island'; expected one",
    )


def test_long_lists_and_long_values_are_shortened():
    text = edited(
        (L3, L3 + ''.join(f'<link name="x{i}"/>' for i in range(50))),
        ('<parent link="l1"/>', '<parent link="nope"/>'),
        (MASS, f'<mass value="{"9" * 5000}"/>'),
    )
    problems = problems_of(text)
    assert any('(54 in all)' in problem for problem in problems)
    assert max(map(len, problems)) < 300


# ---- Descriptions that must load -----------------------------------------------------------

SHAPES = [
    '<visual/><collision/>',
    '<visual><geometry><box size="a b"/></geometry></visual><collision><geometry/></collision>',
    '<visual><geometry><capsule radius="1" length="1"/></geometry></visual>',
    '<visual><geometry><mesh filename="/nowhere/a.stl" scale="x"/></geometry></visual>',
    '<collision><geometry><mesh filename="file:///nowhere/a.dae"/></geometry></collision>',
    '<collision><geometry><mesh filename="http://localhost:9/a.stl"/></geometry></collision>',
    '<collision><geometry><mesh filename="$(find x)/a.stl"/></geometry></collision>',
    '<visual><origin xyz="0 nan"/></visual>',
]
# fmt: off
STILL_LOADS = {
    **{shape: (L3, f'<link name="l3">{shape}</link>') for shape in SHAPES},
    'bad colour': (L3, '<material name="m"><color rgba="red"/></material>' + L3),
    'bad calibration': (AXIS, AXIS + '<calibration rising="x"/>'),
    'comments': (AXIS, f'<!-- <axis xyz="bad"/> & <!DOCTYPE x> -->{AXIS}'),
    'CDATA': (AXIS, f'<![CDATA[ <axis xyz="bad"/> & ]]>{AXIS}'),
    'instruction': (AXIS, f'<?pi some & thing?>{AXIS}'),
    'space around a number': (MASS, '<mass value=" 2.0 "/>'),
    'line breaks between attributes': (MASS, '<mass\n\tvalue="2.0"\n/>'),
    'exponents and signs': (MASS, '<mass value="+.2E+01"/>'),
    'link and joint of one name': ('"jf"', '"l1"'),
    'default namespace': ('name="good"', 'name="good" xmlns="http://www.ros.org"'),
    'version': ('name="good"', 'name="good" version="1.2"'),
    'other elements': (L3, '<gazebo><a b="${c}"/></gazebo>' + L3),
    'transmission': (L3, f'<transmission>{2 * """<joint name="j1"/>"""}</transmission>{L3}'),
    'limit attributes of makers': ('effort="20"', 'effort="20" jerk="a lot"'),
    'axis of a fixed joint': ('<child link="l3"/>', '<child link="l3"/><axis xyz="0 0 0"/>'),
    'limit of a fixed joint': ('<child link="l3"/>', '<child link="l3"/><limit lower="x"/>'),
    'safety controller': (AXIS, AXIS + '<safety_controller k_position="x"/>'),
    'undeclared prefixes': (AXIS, '<axis xyz="0 0 1" my:unit="m"/><drake:rotor value="1"/>'),
    'axis of another length': (AXIS, '<axis xyz="0 0 5"/>'),
    'two origins': (ORIGIN, ORIGIN + '<origin xyz="1 2 3" rpy="1 1 1"/>'),
    'frame of 1e-9 kg': (
        L3, f'<link name="l3"><inertial><mass value="1e-9"/>{ZERO}</inertial></link>'),
    'fixed part of a mass of zero': (
        L3, f'<link name="l3"><inertial><mass value="0"/>{ZERO}</inertial>{BOX}</link>'),
    'declaration of version 0.0': ('version="1.0"', 'version="0.0"'),
    'declaration without version': (' version="1.0"', ''),
    'declaration after an empty line': ('<?xml', '\n<?xml'),
}
# fmt: on


@pytest.mark.parametrize('edit', STILL_LOADS.values(), ids=STILL_LOADS.keys())
def test_irrelevant_elements_do_not_prevent_loading(edit):
    robot, good = load_urdf(edited(edit)), load_urdf(GOOD)
    assert all('treated as massless' in warning.text for warning in robot.warnings)
    assert_allclose(robot.p_PL, good.p_PL, rtol=0, atol=0)
    assert_allclose(robot.mass, good.mass, rtol=0, atol=1e-8)


ENCODINGS = {
    'BOM': b'\xef\xbb\xbf' + GOOD.encode(),
    'UTF-16': GOOD.encode('utf-16'),
    'little-endian': GOOD.encode('utf-16-le'),
    'big-endian': GOOD.encode('utf-16-be'),
    'UTF-16 declared': GOOD.replace('?>', ' encoding="UTF-16"?>').encode('utf-16'),
    'Latin-1': GOOD.replace('?>', ' encoding="ISO-8859-1"?>').encode('latin-1'),
    'no declaration': GOOD.removeprefix('<?xml version="1.0"?>').encode(),
    'CRLF': GOOD.replace('\n', '\r\n').encode(),
}


@pytest.mark.parametrize('data', ENCODINGS.values(), ids=ENCODINGS.keys())
def test_encodings_are_recognised(tmp_path, data):
    path = tmp_path / 'encoded.urdf'
    path.write_bytes(data)
    robot = load_urdf(path)
    assert robot.joint_names == ('j1', 'j2')
    assert robot.warnings == ()


@pytest.mark.parametrize('encoding', ['utf-8', 'iso-8859-1', 'utf-16'])
@pytest.mark.parametrize('version', ['1.0', '0.0'])
def test_names_may_contain_non_ascii_letters(tmp_path, encoding, version):
    declaration = f'<?xml version="{version}" encoding="{encoding}"?>'
    text = edited(
        ('<?xml version="1.0"?>', declaration), ('"j1"', '"pivô"'), ('"jf"', '"é &amp; à"')
    )
    path = tmp_path / 'names.urdf'
    path.write_bytes(text.encode(encoding))
    for source in (path, text):
        assert load_urdf(source).joint_names == ('pivô', 'j2')


def chain(count):
    body = f'<inertial><mass value="0.1"/>{INERTIA}</inertial>'
    links = ''.join(f'<link name="l{i}">{body}</link>' for i in range(1, count + 1))
    joints = ''.join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<origin xyz="0 0 0.1" rpy="0.01 0 0"/>{AXIS}{J1_LIMIT}<mimic joint="j{i + 1}"/></joint>'
        for i in range(1, count + 1)
    ).replace(f'<mimic joint="j{count + 1}"/>', '')
    return f'<robot name="chain"><link name="l0"/>{links}{joints}</robot>'


def test_chain_of_999_mimic_joints_loads_quickly():
    load_urdf(GOOD)  # so that imports are not timed
    started = time.process_time()
    robot = load_urdf(chain(999))
    assert time.process_time() - started < 3.0  # 0.3 s on an idle machine
    assert robot.joint_names == ('j999',)
    assert robot.parent.tolist() == list(range(-1, 999))
    assert set(robot.joint_index.tolist()) == {-1, 0}


# ---- Warnings ------------------------------------------------------------------------------

HUGE = '<inertia ixx="200" ixy="0" ixz="0" iyy="300" iyz="0" izz="150"/>'
NOT_A_BODY = "line 5: link 'l1' inertial: no body has the principal moments of inertia"
# fmt: off
WARNINGS = [
    (L3, '<link name="l3"><Inertial/></link>',
     "line 17: link 'l3': <Inertial> is ignored; URDF spells it <inertial>"),
    (L3, L3 + '<Joint/>', 'robot: <Joint> is ignored'),
    (ORIGIN, '<Origin xyz="0 0 1"/>', "joint 'j2': <Origin> is ignored; URDF spells it"),
    (L3, f'<link name="l3">{BOX}</link>',
     "line 17: link 'l3': has a shape but no <inertial>; it is treated as massless"),
    (L1_INERTIAL, f'<inertial><mass value="0"/>{ZERO}</inertial>{BOX}',
     "line 4: link 'l1': has a shape but a mass of zero; it is treated as massless"),
    ('izz="0.01"', 'izz="0.05"', f'{NOT_A_BODY} 0.02, 0.02, 0.05 kg m^2'),
    (INERTIA, INERTIA.replace('ixy="0"', 'ixy="0.03"'), f'{NOT_A_BODY} -0.01, 0.01, 0.05 kg m^2'),
    (MASS, '<mass value="0"/>',
     "link 'l1' inertial: the mass is zero, but the inertia is not; the inertia is kept"),
    (L2_INERTIA, ZERO, "line 12: link 'l2' inertial: the mass is 1 kg, but the inertia is zero"),
    (L2_INERTIA, HUGE, "link 'l2' inertial: radius of gyration is more than 10 m"),
    (MASS, '<mass value="1e-9"/>', "link 'l1' inertial: radius of gyration is more than 10 m"),
    ('rpy="0 0 0.5"', 'rpy="0 0 90"', "joint 'j2' origin rpy: '0 0 90' contains an angle"),
    ('rpy="0 0 0"', 'rpy="-90 0 0"', "link 'l1' inertial origin rpy: '-90 0 0' contains an"),
    ('xyz="0 0 0.4"', 'xyz="0 0\n0.4"',
     'line 27: <origin>: has a line break or a tab inside an attribute; urdfdom'),
    (MASS, "<mass value='\t2.0'/>", 'line 7: <mass>: has a line break or a tab inside'),
    (AXIS, '', "line 24: joint 'j2': <axis> is missing; 1 0 0 is used"),
    ('lower="-1" upper="1"', 'lower="-90" upper="90"', 'angles are in radians'),
    ('lower="0" upper="0.5" ', '', "joint 'j2': <limit> has no lower and no upper; 0 is used"),
    ('lower="0" upper="0.5"', 'upper="0.5"', "joint 'j2': <limit> has no lower; 0 is used"),
    ('effort="20"', 'effort="0"',
     "line 29: joint 'j2' effort limit: 0 means unknown, so the effort is not limited"),
    ('effort="20"', 'effort="-1"', "joint 'j2' effort limit: -1 means unknown, so the effort is"),
    ('velocity="1"', 'velocity="-1"', "joint 'j2' velocity limit: -1 means unknown"),
    ('<joint name="jf" type="fixed">', f'<joint name="jf" type="continuous">{AXIS}',
     "joint 'jf': moves no mass, so its gravity effort is always zero"),
]
# fmt: on


@pytest.mark.parametrize(('old', 'new', 'words'), WARNINGS)
def test_odd_descriptions_have_one_warning_with_a_hint(old, new, words):
    robot = load_urdf(edited((old, new)))
    (warning,) = robot.warnings
    assert words in str(warning)
    assert warning.hint
    assert 'means unknown' not in words or math.inf in (
        robot.effort_limits[1],
        robot.velocity_limits[1],
    )


def test_rounded_inertia_of_a_plate_is_not_reported():
    plate = INERTIA.replace('0.01"', '0.040001"')  # 0.02 + 0.02, and a digit of rounding
    assert load_urdf(edited((INERTIA, plate))).warnings == ()


def test_robots_without_moving_mass_or_joints_are_reported_once():
    lines = GOOD.splitlines()
    text = '\n'.join([*lines[:4], '</link>', '<link name="l2"/>', *lines[16:]])
    for source, words in (
        (text, 'no joint moves any mass, so every gravity effort is zero'),
        (NOTHING_MOVES, 'no joint can move, so there is no effort to compute'),
    ):
        (warning,) = load_urdf(source).warnings
        assert str(warning) == words


def test_warnings_are_in_file_order():
    text = edited((AXIS, ''), (MASS, '<mass value="0"/>'), ('upper="1"', 'upper="99"'))
    assert [warning.line for warning in load_urdf(text).warnings] == [5, 22, 24]


def test_axis_too_large_for_its_square_is_normalised():
    robot = load_urdf(edited((AXIS, '<axis xyz="1e200 0 0"/>')))
    assert robot.axis[2].tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_robots_of_the_tests_load_with_their_intended_warnings(path):
    words = {'fixed_chain': 'the mass is zero'}.get(path.stem)
    robot = load_urdf(path)
    assert bool(robot.warnings) == (words is not None)
    assert all(words in warning.text for warning in robot.warnings)
