"""Malformed descriptions are rejected with their problems; odd but valid ones still load."""

import math
import os
from pathlib import Path
import re
import time

from inverse_dynamics_node.errors import escaped, UrdfError
from inverse_dynamics_node.robot.urdf import load_urdf
from inverse_dynamics_node.robot.urdf import xml as urdf_xml
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import NOTHING_MOVES, OUR_ROBOTS
from scipy.spatial.transform import Rotation

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

J2_ORIGIN = '<origin xyz="0 0 0.4" rpy="0 0 0.5"/>'
L1_ORIGIN = '<origin xyz="0 0 0.2" rpy="0 0 0"/>'
J2_AXIS = '<axis xyz="0 0 1"/>'
J2_LIMIT = '<limit lower="0" upper="0.5" effort="20" velocity="1"/>'
J2_DYNAMICS = '<dynamics damping="0.5" friction="0.25"/>'
NAME = 'name="good"'
VERSION_1_1 = NAME, NAME + ' version="1.1"'
L1_MASS = '<mass value="2.0"/>'
L2_INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.015"/>'
L2_INERTIAL = f'<inertial>\n      <mass value="1"/>\n      {L2_INERTIA}\n    </inertial>'
L3 = '<link name="l3"/>'
J1_LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="3"/>'
L1_INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>'


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


def link(name, inertial=''):
    return f'<link name="{name}">{inertial}</link>'


def fixed(name, parent, child):
    return (
        f'<joint name="{name}" type="fixed">'
        f'<parent link="{parent}"/><child link="{child}"/></joint>'
    )


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


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('', 'empty: expected a path or XML text'),
        (' \n', 'empty: expected a path or XML text'),
        ('{"a": 1}', "XML text must start with '<'"),
        ('a' * 5000, "XML text must start with '<'"),
        ('a\0b', 'cannot be read: '),
        ('<sdf version="1.6"><model name="m"/></sdf>', 'is <sdf>, expected <robot> (this is SDF)'),
        ('<mujoco/>', 'root element is <mujoco>, expected <robot> (this is MJCF)'),
        ('<model name="m"/>', 'root element is <model>, expected <robot>'),
        ('<html><p>404</p></html>', 'root element is <html>, expected <robot> (this is HTML)'),
        ('<!doctype html>\n<html><p>Not found<br></html>', 'DOCTYPE/DTD is not allowed'),
        ('<x:robot xmlns:x="y" name="r"/>', 'root element is <x:robot>, expected <robot>'),
        ('<Robot name="r"/>', 'root element is <Robot>, expected <robot>'),
        ('<robot name="r"/>', 'the robot has no links'),
        ('<robot name="r"><link name="b"/></robot>', 'one link and no joints: nothing to command'),
    ],
)
def test_text_that_is_neither_a_path_nor_a_robot_is_rejected(text, words):
    assert words in problems_of(text)[0]


def test_other_types_than_text_and_paths_are_type_errors():
    for source in (None, b'<robot/>', 3):
        with pytest.raises(TypeError):
            load_urdf(source)


@pytest.mark.parametrize('data', [b'', b' \n\t', b'\xef\xbb\xbf'])
def test_empty_file_is_rejected(tmp_path, data):
    path = tmp_path / 'empty.urdf'
    path.write_bytes(data)
    assert problems_of(path) == ('file is empty',)


@pytest.mark.parametrize(
    ('data', 'words'),
    [
        (GOOD[:400], 'not well-formed XML: '),
        (GOOD.removesuffix('</robot>\n'), 'not well-formed XML: Premature end of data'),
        (edited(('</link>\n  <link name="l3"/>', '<link name="l3"/>')), 'Opening and ending tag'),
        (edited(('value="2.0"', 'value=2.0')), 'AttValue'),
        (edited(('value="2.0"', 'value=2.0')), 'line 7, column 19'),
        (edited(('value="2.0"', 'value="2.0" value="3"')), 'Attribute value redefined'),
        (GOOD + '<robot/>', 'not well-formed XML: Extra content'),
        (edited(('name="good"', 'name="a & b"')), 'not well-formed XML: xmlParseEntityRef'),
        (edited(('name="good"', 'name="a &foo; b"')), "not well-formed XML: Entity 'foo'"),
        (edited(('name="good"', 'name="a\0b"')), 'not well-formed XML: '),
        (GOOD.replace('good', 'g\xe4').encode('latin-1'), 'encoding'),
        (edited(('?>', ' encoding="nope"?>')), "unknown encoding 'nope'"),
        ('{"a": 1}', 'not well-formed XML: Start tag expected'),
        ('base: 3\n', 'not well-formed XML: Start tag expected'),
        (b'\x89PNG\r\n\x1a\n\0\0', 'not well-formed XML: Start tag expected'),
        ('version https://git-lfs.github.com/spec/v1\noid sha256:0', 'Start tag expected'),
        ('<robot name="r">' + '<a>' * 300 + '</a>' * 300 + '</robot>', 'Excessive depth'),
    ],
)
def test_malformed_xml_is_one_problem_with_a_line(tmp_path, data, words):
    path = tmp_path / 'broken.urdf'
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    (problem,) = problems_of(path)
    assert problem.startswith('not well-formed XML: ')
    assert words in problem
    assert 'line ' in problem


LAUGHS = '<!ENTITY a0 "ha">' + ''.join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)
)


@pytest.mark.parametrize(
    'doctype',
    [
        '<!DOCTYPE robot>',
        '<!DOCTYPE robot SYSTEM "http://localhost:9/robot.dtd">',
        '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE robot [<!ATTLIST mass value CDATA "99">]>',
        '<!DOCTYPE robot [<!ENTITY e "3">]>',
    ],
)
def test_doctype_is_rejected(doctype):
    for text in (
        edited(('<robot name', f'{doctype}<robot name')),
        edited(('<robot name', f'{doctype}<robot name')).replace('</robot>', ''),
    ):
        assert problems_of(text)[0] == 'DOCTYPE/DTD is not allowed in a URDF'


@pytest.mark.parametrize('body', ['<link name="&a9;"/>', '&a9;'])
def test_billion_laughs_are_rejected_quickly(body):
    started = time.process_time()
    problems = problems_of(f'<!DOCTYPE r [{LAUGHS}]><robot name="r">{body}</robot>')
    assert any('DOCTYPE' in problem or 'amplification' in problem for problem in problems)
    assert time.process_time() - started < 1.0


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


@pytest.mark.parametrize('kind', ['link', 'joint'])
def test_too_many_elements_are_an_error_before_the_slow_steps(kind):
    text = f'<robot name="r">{f"<{kind}/>" * 1001}</robot>'
    assert problems_of(text) == (f'line 1: 1001 {kind}s, expected at most 1000',)


# ---- Well-formed XML, but not a valid robot ------------------------------------------------

# What is replaced in GOOD, by what, and words of the only problem.
ELEMENT_PROBLEMS = [
    # unprocessed xacro
    (
        '<link name="base"/>',
        '<xacro:property name="h" value="1"/><link name="base"/>',
        'line 3: unprocessed xacro element <xacro:property>; run xacro first',
    ),
    ('<inertial>\n      <origin', '<inertial><xacro:box/>\n      <origin', '<xacro:box>'),
    ('0 0 0.4', '${h}', "line 27: joint 'j2' origin xyz: '${h}' looks like unprocessed xacro"),
    (L1_MASS, '<mass value="$(arg m)"/>', "mass: '$(arg m)' looks like unprocessed xacro"),
    ('"jf"', '"${p}jf"', "joint name '${p}jf' looks like unprocessed xacro"),
    ('link="l2"/>\n    <o', 'link="${p}l2"/>\n    <o', "'${p}l2' looks like unprocessed"),
    # names
    (' name="good"', '', 'line 2: <robot> has no name'),
    ('<link name="base"/>', '<link name="base"/><link/>', 'line 3: <link> has no name'),
    ('<link name="base"/>', '<link name="base"/><link name=""/>', '<link> has no name'),
    ('<joint name="jf"', '<joint', 'line 32: <joint> has no name'),
    ('"jf"', '"j2"', "line 32: duplicate joint name 'j2'"),
    ('</robot>', '<link name="l2"/></robot>', "line 36: duplicate link name 'l2'"),
    # references
    (
        '<parent link="l1"/>',
        '<parent link="nope"/>',
        "line 25: joint 'j2': parent link 'nope' does not exist; links are base, l1, l2, l3",
    ),
    ('<child link="l1"/>', '<child link="no"/>', "joint 'j1': child link 'no' does not exist"),
    ('<parent link="l1"/>', '', 'joint \'j2\': <parent link="..."/> is missing'),
    ('<child link="l1"/>', '<child/>', "joint 'j1': <child> lacks link"),
    ('<parent link="l1"/>', '<parent link="l2"/>', "parent and child are the same link 'l2'"),
    # the tree
    (
        '</robot>',
        fixed('j4', 'base', 'l3') + '</robot>',
        "line 36: link 'l3' has two parent joints: 'jf' and 'j4'",
    ),
    ('</robot>', link('island') + '</robot>', "2 root links: 'base', 'island'; expected one"),
    (
        '<parent link="base"/>',
        '<parent link="l3"/>',
        "3 links are not connected to root 'base', because of a cycle: 'l1', 'l2', 'l3'",
    ),
    # types
    ('"prismatic"', '"hinge"', "joint 'j2': type 'hinge' is not one of revolute, continuous"),
    ('"prismatic"', '" prismatic "', "type ' prismatic ' is not one of"),
    ('"prismatic"', '"Prismatic"', "type 'Prismatic' is not one of"),
    ('"prismatic"', '""', "type '' is not one of"),
    (' type="prismatic"', '', "line 24: joint 'j2': type is missing, expected one of"),
    (
        '"prismatic"',
        '"planar"',
        "joint type 'planar' is not supported; use two prismatic joints and a continuous one",
    ),
    ('"prismatic"', '"floating"', "joint type 'floating' is not supported; remove this joint"),
    # mass and inertia
    (L1_MASS, '', 'line 5: link \'l1\' inertial: <mass value="..."/> is missing'),
    (L1_MASS, '<mass/>', "link 'l1' inertial: <mass> lacks value"),
    (L1_MASS, '<mass>2</mass>', "link 'l1' inertial: <mass> lacks value"),
    (L1_MASS, '<mass value="-2"/>', "link 'l1' inertial: mass -2 is negative"),
    (L1_INERTIA, '', "link 'l1' inertial: <inertia> is missing"),
    (L1_INERTIA, '<inertia/>', '<inertia> lacks ixx, ixy, ixz, iyy, iyz, izz'),
    (
        L1_INERTIA,
        L1_INERTIA.replace('ixx="0.02" ', ''),
        "line 8: link 'l1' inertial: <inertia> lacks ixx",
    ),
    # versions
    (
        J2_ORIGIN,
        '<origin quat_xyzw="0 0 0 1"/>',
        'line 27: joint \'j2\' origin: quat_xyzw needs <robot version="1.1"> instead of 1.0',
    ),
    # axis
    (J2_AXIS, '<axis xyz="0 0 0"/>', "joint 'j2': the length of axis '0 0 0' is almost zero"),
    (J2_AXIS, '<axis xyz="0 1e-9 0"/>', "joint 'j2': the length of axis '0 1e-9 0' is almost"),
    (J2_AXIS, '<axis/>', "joint 'j2': <axis> lacks xyz"),
    (J2_AXIS, '<axis rpy="0 0 1"/>', "joint 'j2': <axis> lacks xyz"),
    # limits
    (J2_LIMIT, '', "line 24: joint 'j2': <limit> is required for prismatic joints"),
    (J1_LIMIT, '', '<limit> is required for revolute joints'),
    (' effort="20"', '', "joint 'j2': <limit> lacks effort"),
    (' effort="20" velocity="1"', '', "joint 'j2': <limit> lacks effort, velocity"),
    ('lower="0" upper="0.5"', 'lower="1" upper="-1"', 'lower limit 1 exceeds upper limit -1'),
    ('lower="-1" upper="1"', 'upper="-1"', 'lower limit 0 exceeds upper limit -1; if there'),
    ('upper="0.5"', 'upper="inf"', "limit upper: 'inf' is not a finite decimal number"),
    ('effort="20"', 'effort="-10"', "joint 'j2': limit effort -10 is negative"),
    ('effort="20"', 'effort="-1"', 'limit effort -1 is negative; if there is no limit, write'),
    ('velocity="1"', 'velocity="-1"', "joint 'j2': limit velocity -1 is negative"),
    # dynamics
    ('damping="0.5"', 'damping="-0.5"', "joint 'j2': dynamics damping -0.5 is negative"),
    ('friction="0.25"', 'friction="-1"', "joint 'j2': dynamics friction -1 is negative"),
    # mimic
    (
        J2_AXIS,
        J2_AXIS + '<mimic joint="nope"/>',
        "line 28: joint 'j2' mimic: joint 'nope' does not exist; joints are j1, j2, jf",
    ),
    (J2_AXIS, J2_AXIS + '<mimic joint="j2"/>', "joint 'j2' mimics itself"),
    (J2_AXIS, J2_AXIS + '<mimic joint="jf"/>', "joint 'j2' mimics 'jf', which is fixed"),
    (J2_AXIS, J2_AXIS + '<mimic/>', "joint 'j2': <mimic> lacks joint"),
    # the rest
    (L2_INERTIAL, L2_INERTIAL * 2, "line 15: link 'l2': 2 <inertial> elements, expected at most"),
    (L1_MASS, L1_MASS * 3, "link 'l1' inertial: 3 <mass> elements, expected at most one"),
    (J2_AXIS, J2_AXIS * 2, "joint 'j2': 2 <axis> elements, expected at most one"),
]


@pytest.mark.parametrize(('old', 'new', 'words'), ELEMENT_PROBLEMS)
def test_one_mistake_is_one_problem(old, new, words):
    (problem,) = problems_of(edited((old, new)))
    assert words in problem


QUATERNION_PROBLEMS = [
    (J2_ORIGIN, 'rpy="0 0 0" quat_xyzw="0 0 0 1"', 'origin has both rpy and quat_xyzw'),
    (J2_ORIGIN, 'quat_xyzw="0 0 1"', "quat_xyzw: expected 4 numbers, got 3 in '0 0 1'"),
    (J2_ORIGIN, 'quat_xyzw="0 0 0 0"', "quat_xyzw: '0 0 0 0' has norm 0, expected 1"),
    (L1_ORIGIN, 'quat_xyzw="0 0 90 1"', "quat_xyzw: '0 0 90 1' has norm 90.0056, expected 1"),
]


@pytest.mark.parametrize(('origin', 'attributes', 'words'), QUATERNION_PROBLEMS)
def test_bad_quaternion_is_one_problem(origin, attributes, words):
    (problem,) = problems_of(edited(VERSION_1_1, (origin, f'<origin {attributes}/>')))
    line, subject = {J2_ORIGIN: (27, "joint 'j2'"), L1_ORIGIN: (6, "link 'l1' inertial")}[origin]
    assert problem.startswith(f'line {line}: {subject} origin')
    assert words in problem


def test_quaternions_need_the_version():
    text = edited((NAME, NAME + ' version="1.0"'), ('rpy="0 0 0"', 'quat_xyzw="0 0 0 1"'))
    assert "line 6: link 'l1' inertial origin: quat_xyzw needs" in problems_of(text)[0]


def test_cycle_of_links_or_of_mimicking_joints_is_named():
    text = edited(('<parent link="base"/>', '<parent link="l3"/>'), ('<link name="base"/>', ''))
    assert 'no root link: the links form a cycle' in problems_of(text)[0]
    master = '<axis xyz="0 1 0"/>'
    text = edited(
        (J2_AXIS, J2_AXIS + '<mimic joint="j1"/>'), (master, master + '<mimic joint="j2"/>')
    )
    assert problems_of(text) == ('line 18: mimic loop: j1 -> j2 -> j1',)


def test_numbers_whose_product_is_infinite_are_named():
    text = edited((L1_MASS, '<mass value="1e308"/>'), ('0 0 0.2', '0 0 1e9'))
    assert "centre of mass of 'j1' is not finite" in problems_of(text)[0]


MIMICKING = edited((J2_AXIS, J2_AXIS + '<mimic joint="j1" multiplier="2" offset="0.1"/>'))
BAD_NUMBERS = (
    *('', 'heavy', '2,5', '2.0kg', 'nan', 'inf', '-inf', 'infinity', '1e400', '1_000', '0x10'),
    *('1 2', '\u0663', '\uff12', '2\xa0', '1e', '.', '--2'),
)


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
        for bad, words in (
            ('', "expected 3 numbers, got 0 in ''"),
            ('0.3', "expected 3 numbers, got 1 in '0.3'"),
            ('0,0,1', "expected 3 numbers, got 1 in '0,0,1' (use spaces, not commas)"),
            ('0 1', "expected 3 numbers, got 2 in '0 1'"),
            ('0 0 0 1', "expected 3 numbers, got 4 in '0 0 0 1'"),
            ('0 nan 1', "'nan' is not a finite decimal number"),
        ):
            (problem,) = problems_of(f'{GOOD[: place.start(2)]}{bad}{GOOD[place.end(2) :]}')
            assert f' {place[1]}: {words}' in problem


def test_all_problems_are_listed_in_file_order():
    text = edited(
        ('</robot>', link('island') + '</robot>'),
        (J2_LIMIT, '<limit lower="1" upper="-1" effort="-1" velocity="x"/>'),
        (L1_MASS, '<mass value="two"/>'),
        ('"jf"', '"j1"'),
        ('<child link="l1"/>', '<child link="l1"/><child link="l2"/>'),
    )
    assert problems_of(text) == (
        "line 7: link 'l1' inertial mass: 'two' is not a finite decimal number",
        "line 20: joint 'j1': 2 <child> elements, expected at most one",
        "line 29: joint 'j2': limit effort -1 is negative; if there is no limit, write a large "
        'number',
        "line 29: joint 'j2' limit velocity: 'x' is not a finite decimal number",
        "line 29: joint 'j2': lower limit 1 exceeds upper limit -1",
        "line 32: duplicate joint name 'j1'",
        "2 root links: 'base', 'island'; expected one",
    )


def test_broken_references_are_listed_in_file_order():
    text = edited(('<child link="l1"/>', '<child link="nope"/>'), ('"jf"', '"j1"'))
    assert [problem.partition(':')[0] for problem in problems_of(text)] == ['line 20', 'line 32']


def test_long_lists_and_long_values_are_shortened():
    text = edited(
        ('<link name="l3"/>', '<link name="l3"/>' + ''.join(link(f'x{i}') for i in range(50))),
        ('<parent link="l1"/>', '<parent link="nope"/>'),
        (L1_MASS, f'<mass value="{"9" * 5000}"/>'),
    )
    problems = problems_of(text)
    assert any('(54 in all)' in problem for problem in problems)
    assert max(map(len, problems)) < 300


# ---- Descriptions that must load -----------------------------------------------------------

SHAPE = '<visual>{}</visual><collision>{}</collision>'
SHAPES = [
    ('', ''),
    ('<geometry><box size="a b"/></geometry>', '<geometry/>'),
    ('<geometry><capsule radius="1" length="1"/></geometry>', '<geometry/>'),
    ('<geometry><mesh filename="/nowhere/a.stl" scale="x"/></geometry>', '<geometry/>'),
    ('<geometry><mesh filename="file:///nowhere/a.dae"/></geometry>', ''),
    ('<geometry><mesh filename="http://localhost:9/a.stl"/></geometry>', ''),
    ('<geometry><mesh filename="$(find x)/a.stl"/></geometry>', ''),
    ('<origin xyz="0 nan"/>', ''),
]
STILL_LOADS = {
    **{str(shape): (L3, link('l3', SHAPE.format(*shape))) for shape in SHAPES},
    'bad colour': (L3, '<material name="m"><color rgba="red"/></material>' + L3),
    'bad calibration': (J2_AXIS, J2_AXIS + '<calibration rising="x"/>'),
    'comments': (J2_AXIS, f'<!-- <axis xyz="bad"/> & <!DOCTYPE x> -->{J2_AXIS}'),
    'CDATA': (J2_AXIS, f'<![CDATA[ <axis xyz="bad"/> & ]]>{J2_AXIS}'),
    'instruction': (J2_AXIS, f'<?pi some & thing?>{J2_AXIS}'),
    'tabs and newlines in xyz': ('xyz="0 0 0.4"', 'xyz="\t0\n0   0.4 "'),
    'space around a number': (L1_MASS, '<mass value=" 2.0 "/>'),
    'exponents and signs': (L1_MASS, '<mass value="+.2E+01"/>'),
    'link and joint of one name': ('"jf"', '"l1"'),
    'default namespace': ('name="good"', 'name="good" xmlns="http://www.ros.org"'),
    'other elements': (L3, '<gazebo><a b="${c}"/></gazebo>' + L3),
    'transmission': (L3, f'<transmission>{2 * """<joint name="j1"/>"""}</transmission>{L3}'),
    'limit attributes of makers': ('effort="20"', 'effort="20" jerk="a lot"'),
    'axis of a fixed joint': ('<child link="l3"/>', '<child link="l3"/><axis xyz="0 0 0"/>'),
    'safety controller': (J2_AXIS, J2_AXIS + '<safety_controller k_position="x"/>'),
    'undeclared prefixes': (J2_AXIS, '<axis xyz="0 0 1" my:unit="m"/><drake:rotor value="1"/>'),
    'axis of another length': (J2_AXIS, '<axis xyz="0 0 5"/>'),
    'limit of a fixed joint': ('<child link="l3"/>', '<child link="l3"/><limit lower="x"/>'),
}


@pytest.mark.parametrize('edit', STILL_LOADS.values(), ids=STILL_LOADS.keys())
def test_irrelevant_elements_do_not_prevent_loading(edit):
    robot, good = load_urdf(edited(edit)), load_urdf(GOOD)
    assert all('treated as massless' in warning.text for warning in robot.warnings)
    np.testing.assert_array_equal(robot.p_PL, good.p_PL)
    np.testing.assert_array_equal(robot.mass, good.mass)


@pytest.mark.parametrize(
    'data',
    [
        b'\xef\xbb\xbf' + GOOD.encode(),
        GOOD.encode('utf-16'),
        GOOD.encode('utf-16-le'),
        GOOD.encode('utf-16-be'),
        GOOD.replace('?>', ' encoding="UTF-16"?>').encode('utf-16'),
        GOOD.replace('?>', ' encoding="ISO-8859-1"?>').encode('latin-1'),
        GOOD.removeprefix('<?xml version="1.0"?>').encode(),
        GOOD.replace('\n', '\r\n').encode(),
    ],
    ids=[
        'BOM',
        'UTF-16',
        'little-endian',
        'big-endian',
        'UTF-16 declared',
        'Latin-1',
        'no declaration',
        'CRLF',
    ],
)
def test_encodings_are_recognised(tmp_path, data):
    path = tmp_path / 'encoded.urdf'
    path.write_bytes(data)
    robot = load_urdf(path)
    assert robot.joint_names == ('j1', 'j2')
    assert robot.warnings == ()


@pytest.mark.parametrize('encoding', ['utf-8', 'iso-8859-1', 'utf-16'])
def test_names_may_contain_non_ascii_letters(tmp_path, encoding):
    text = edited(('?>', f' encoding="{encoding}"?>'), ('"j1"', '"pivô"'), ('"jf"', '"é &amp; à"'))
    path = tmp_path / 'names.urdf'
    path.write_bytes(text.encode(encoding))
    for source in (path, text):
        assert load_urdf(source).joint_names == ('pivô', 'j2')


def chain(count):
    body = (
        '<inertial><origin xyz="0 0 0.05"/><mass value="0.1"/>'
        '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-5"/></inertial>'
    )
    links = ''.join(link(f'l{i}', body) for i in range(1, count + 1))
    joints = ''.join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        '<origin xyz="0 0 0.1" rpy="0.01 0 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
        f'<mimic joint="j{i + 1}"/></joint>'
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

NO_INERTIA = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
WARNINGS = [
    (
        L3,
        link('l3', '<Inertial/>'),
        "line 17: link 'l3': <Inertial> is ignored; URDF spells it <inertial>",
    ),
    (L3, L3 + '<Joint/>', 'robot: <Joint> is ignored'),
    (J2_ORIGIN, '<Origin xyz="0 0 1"/>', "joint 'j2': <Origin> is ignored; URDF spells it"),
    (
        J2_ORIGIN,
        '<origin xzy="0 0 1"/>',
        "line 27: joint 'j2' origin: attribute 'xzy' is unknown and ignored",
    ),
    (
        'izz="0.01"',
        'izz="0.05"',
        "line 5: link 'l1' inertial: no body has the principal moments of inertia 0.02, 0.02, "
        '0.05 kg m^2',
    ),
    (
        L1_INERTIA,
        L1_INERTIA.replace('ixy="0"', 'ixy="0.03"'),
        'no body has the principal moments of inertia -0.01, 0.01, 0.05 kg m^2',
    ),
    (
        L1_MASS,
        '<mass value="0"/>',
        "link 'l1' inertial: the mass is zero, but the inertia is not; the inertia is kept",
    ),
    (
        L2_INERTIA,
        NO_INERTIA,
        "line 12: link 'l2' inertial: the mass is 1 kg, but the inertia is zero",
    ),
    (
        L2_INERTIA,
        '<inertia ixx="200" ixy="0" ixz="0" iyy="300" iyz="0" izz="150"/>',
        "link 'l2' inertial: radius of gyration is more than 10 m",
    ),
    ('rpy="0 0 0.5"', 'rpy="0 0 90"', "joint 'j2' origin rpy: '0 0 90' contains an angle"),
    ('rpy="0 0 0"', 'rpy="-90 0 0"', "link 'l1' inertial origin rpy: '-90 0 0' contains an"),
    (J2_AXIS, '', "line 24: joint 'j2': <axis> is missing; 1 0 0 is used"),
    ('lower="-1" upper="1"', 'lower="-90" upper="90"', 'angles are in radians'),
    ('lower="0" upper="0.5" ', '', "joint 'j2': <limit> has no lower and no upper; 0 is used"),
    ('lower="0" upper="0.5"', 'upper="0.5"', "joint 'j2': <limit> has no lower; 0 is used"),
    (
        'effort="20"',
        'effort="0"',
        "line 29: joint 'j2' effort limit: 0 means unknown, so the effort is not limited",
    ),
    ('velocity="1"', 'velocity="0"', "joint 'j2' velocity limit: 0 means unknown"),
    (
        J2_ORIGIN,
        J2_ORIGIN + '<origin xyz="1 2 3"/>',
        '2 <origin> elements; only the first one is used',
    ),
    (
        '<joint name="jf" type="fixed">',
        '<joint name="jf" type="continuous"><axis xyz="0 0 1"/>',
        "joint 'jf': moves no mass, so its gravity effort is always zero",
    ),
]


@pytest.mark.parametrize(('old', 'new', 'words'), WARNINGS)
def test_odd_descriptions_have_one_warning_with_a_hint(old, new, words):
    (warning,) = load_urdf(edited((old, new))).warnings
    assert words in str(warning)
    assert warning.hint


@pytest.mark.parametrize('origin', [J2_ORIGIN, L1_ORIGIN])
def test_first_of_two_origins_is_used(origin):
    other = '<origin xyz="1 2 3" rpy="1 1 1"/>'
    good, first, swapped = (
        load_urdf(edited((origin, new))) for new in (origin, origin + other, other + origin)
    )
    for field in ('p_PL', 'R_PL', 'com', 'inertia'):
        assert_allclose(getattr(first, field), getattr(good, field), atol=1e-15)
    assert np.abs(swapped.p_PL - good.p_PL).max() + np.abs(swapped.com - good.com).max() > 0.1


def test_rounded_inertia_of_a_plate_is_not_reported():
    plate = L1_INERTIA.replace('0.01"', '0.040001"')  # 0.02 + 0.02, and a digit of rounding
    assert load_urdf(edited((L1_INERTIA, plate))).warnings == ()


def test_robot_that_moves_no_mass_is_reported_once():
    text = '\n'.join(
        [*GOOD.splitlines()[:4], '</link>', '<link name="l2"/>', *GOOD.splitlines()[16:]]
    )
    (warning,) = load_urdf(text).warnings
    assert str(warning) == 'no joint moves any mass, so every gravity effort is zero'


def test_robot_without_movable_joints_loads_with_a_warning():
    robot = load_urdf(NOTHING_MOVES)
    assert robot.joint_names == ()
    (warning,) = robot.warnings
    assert str(warning) == 'no joint can move, so there is no effort to compute'


def test_warnings_are_in_file_order():
    text = edited((J2_AXIS, ''), (L1_MASS, '<mass value="0"/>'), ('upper="1"', 'upper="99"'))
    assert [warning.line for warning in load_urdf(text).warnings] == [5, 22, 24]


@pytest.mark.parametrize(
    'declaration',
    ['<?xml version="0.0" ?>', '<?xml?>', '\n<?xml version="1.0"?>', '<?xml encoding="utf-8"?>'],
)
def test_invalid_declarations_are_ignored(declaration):
    robot = load_urdf(edited(('<?xml version="1.0"?>', declaration)))
    assert robot.joint_names == ('j1', 'j2')
    assert robot.warnings == ()


def test_invalid_declaration_keeps_line_numbers():
    text = edited(('<?xml version="1.0"?>', '\n\n<?xml?>'), (L1_MASS, '<mass value="-1"/>'))
    assert problems_of(text) == ("line 9: link 'l1' inertial: mass -1 is negative",)


def test_encoding_of_an_invalid_declaration_is_used(tmp_path):
    path = tmp_path / 'odd.urdf'
    path.write_bytes(
        edited(('"1.0"?>', '"0.0" encoding="iso-8859-1"?>'), ('"j1"', '"pivô"')).encode('latin-1')
    )
    assert load_urdf(path).joint_names == ('pivô', 'j2')


def test_undeclared_prefix_beside_another_error_is_an_error():
    text = edited((J2_AXIS, f'{J2_AXIS}<drake:rotor value=1/>'))
    assert 'not well-formed XML' in problems_of(text)[0]


@pytest.mark.parametrize('version', ['1.0', '1.1', '1.2'])
def test_versions_load_without_a_warning(version):
    assert load_urdf(edited((NAME, f'{NAME} version="{version}"'))).warnings == ()


@pytest.mark.parametrize('scale', [1.0, -1.0, 1.0004])
@pytest.mark.parametrize(
    'rpy',
    [
        (0.3, -0.4, 2.0),
        (-2.5, 1.2, -3.0),
        (math.pi, 0.0, 0.0),
        (0.7, math.pi / 2, -0.2),
        (0.7, -math.pi / 2, -0.2),
        (0.7, math.pi / 2 - 1e-9, -0.2),
    ],
)
def test_quaternion_and_rpy_of_one_rotation_load_the_same_robot(rpy, scale):
    def robot_with(rotation, *edits):
        return load_urdf(
            edited(
                *edits,
                (J2_ORIGIN, f'<origin {rotation} xyz="0 0 0.4"/>'),
                ('xyz="0 0 0.2" rpy="0 0 0"', f'xyz="0 0 0.2" {rotation}'),
                ('<child link="l3"/>', f'<child link="l3"/><origin {rotation}/>'),
            )
        )

    quaternion = Rotation.from_euler('xyz', rpy).as_quat()
    words = ' '.join(map(repr, (scale * quaternion).tolist()))
    robot = robot_with(f'quat_xyzw="{words}"', VERSION_1_1)
    expected = robot_with(f'rpy="{" ".join(map(repr, rpy))}"')
    for field in ('R_PL', 'p_PL', 'inertia', 'com', 'link_rotation'):
        actual = getattr(robot, field)
        assert_allclose(actual, getattr(expected, field), atol=1e-14, err_msg=field)


def test_axis_too_large_for_its_square_is_normalised():
    robot = load_urdf(edited((J2_AXIS, '<axis xyz="1e200 0 0"/>')))
    np.testing.assert_array_equal(robot.axis[2], [1.0, 0.0, 0.0])


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_robots_of_the_tests_load_with_their_intended_warnings(path):
    words = {'fixed_chain': 'the mass is zero'}.get(path.stem)
    robot = load_urdf(path)
    assert bool(robot.warnings) == (words is not None)
    assert all(words in warning.text for warning in robot.warnings)


SHAPED = """
<robot name="r">
  <link name="ground"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="finger"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="frame"/>
  <joint name="a" type="continuous"><parent link="ground"/><child link="arm"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="b" type="fixed"><parent link="arm"/><child link="finger"/></joint>
  <joint name="c" type="fixed"><parent link="finger"/><child link="frame"/></joint>
</robot>"""


def test_a_link_with_a_shape_but_no_mass_is_a_warning():
    words = "line 6: link 'finger': has a shape but no <inertial>; it is treated as massless"
    (warning,) = load_urdf(SHAPED).warnings
    assert str(warning) == words
    assert (warning.line, warning.subject) == (6, "link 'finger'")
