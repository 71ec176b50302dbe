"""Positions far outside the limits are reported, with a hint if they look like degrees."""

import dataclasses
import math

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.robot.limit_checks import (
    effort_limit_warnings,
    implausible_positions,
    position_warnings,
)
import numpy as np
import pytest

URDF = """
<robot name="arm">
  <link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="l4"/>
  <joint name="joint1" type="continuous">
    <parent link="base"/><child link="l1"/><axis xyz="0 0 1"/></joint>
  <joint name="joint2" type="revolute">
    <parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>
    <limit lower="-2.97" upper="2.97" effort="10" velocity="2"/></joint>
  <joint name="slide" type="prismatic">
    <parent link="l2"/><child link="l3"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.04" effort="10" velocity="2"/></joint>
  <joint name="stuck" type="revolute">
    <parent link="l3"/><child link="l4"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0" effort="10" velocity="2"/></joint>
</robot>
"""


@pytest.fixture(scope='module')
def robot():
    return load_urdf(URDF)


def sentences(robot, positions, names=()):
    findings = implausible_positions(robot, positions, names)
    return [str(finding) for finding in findings]


def worst(values):
    """Return a table of positions of joint2."""
    table = np.zeros((len(values), 4))
    table[:, 1] = values
    return table


AT_57 = 'joint2 is at 57.3 rad, outside its limits -2.97 to 2.97 (in degrees?)'
BEYOND = 'joint2 is at {} rad, outside its limits -2.97 to 2.97'
SLIDES = 'slide is at {} m, outside its limits 0 to 0.04'
# fmt: off
POSITIONS = [
    # positions, names of their columns, sentences
    ([0.0, 57.3, 0.0, 0.0], (), [AT_57]),
    # close to the limits, no number, no limits, and a joint that cannot move
    *(([1000.0, q2, 0.049, 5.0], (), []) for q2 in (-3.5, 2.97, 3.5, math.nan, math.inf)),
    # outside of the limits, but not in degrees
    ([0.0, 4.0, -0.5, 0.0], (), [BEYOND.format(4), SLIDES.format(-0.5)]),
    ([0.0, 300.0, 0, 0], (), [BEYOND.format(300)]),
    # degrees slightly outside
    ([0, -180, 0, 0], (), [BEYOND.format(-180) + ' (in degrees?)']),
    ([0, 180, 0, 0], (), [BEYOND.format(180) + ' (in degrees?)']),
    # the worst of many, on either side
    (worst([-4.2, 4.1]), (), [BEYOND.format(-4.2)]),
    (worst([-4.1, 4.2]), (), [BEYOND.format(4.2)]),
    (worst([math.nan, 4.0, 4.3]), (), [BEYOND.format(4.3)]),
    (np.zeros((3, 0, 4)), (), []),
    # by names
    ([[57.3, 0.02, 57.3], [0.0, 2.0, 57.3]], ('joint2', 'slide', 'wheel'),
     [AT_57, SLIDES.format(2)]),
    ([5.0, 100.0, 4.0], ('stuck', 'joint1', 'joint2'), [BEYOND.format(4)]),
]
# fmt: on


@pytest.mark.parametrize(('positions', 'names', 'expected'), POSITIONS)
def test_positions_outside_the_limits_are_reported(robot, positions, names, expected):
    assert sentences(robot, positions, names) == expected


def test_findings_have_numbers(robot):
    (finding,) = implausible_positions(robot, [0.0, 57.3, 0.0, 0.0])
    assert finding[:5] == ('joint2', 57.3, -2.97, 2.97, True)
    with pytest.raises(ValueError, match=r'shape \(2, 3\), expected \(\.\.\., 4\)'):
        implausible_positions(robot, np.zeros((2, 3)))


def test_a_base_link_with_the_name_of_a_joint_does_not_matter():
    robot = load_urdf(URDF.replace('"base"', '"slide"'))
    assert sentences(robot, [0.0, 0.0, 0.5, 0.0]) == [
        'slide is at 0.5 m, outside its limits 0 to 0.04'
    ]


def test_warnings_about_degrees_come_first_with_their_own_hint(robot):
    degrees, other = position_warnings(robot, [2.0, 57.3], ['slide', 'joint2'])
    assert str(degrees) == AT_57
    assert degrees.hint == 'convert the positions to radians'
    assert str(other) == 'slide is at 2 m, outside its limits 0 to 0.04'
    assert other.hint.startswith('check units (rad, m), zero positions, the order of the joints')
    assert position_warnings(robot, [0.0, 0.0, 0.0, 0.0]) == ()


def reaching_arm(limits, weights=(2.0, 3.0)):
    """Return an arm that turns, turns without end, and slides; the base is heavy."""
    masses = [100.0, *weights, 1.0]
    coms = ['0 0 5', '0 0 0.2', '0 0.1 0', '0 0 0']
    links = ''.join(
        f'<link name="l{k}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for k, (mass, com) in enumerate(zip(masses, coms, strict=True))
    )
    return load_urdf(
        f"""<robot name="arm">{links}
  <joint name="turn" type="revolute"><origin xyz="0.5 0 0"/>
    <parent link="l0"/><child link="l1"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="{limits[0]}" velocity="2"/></joint>
  <joint name="slide" type="prismatic"><origin xyz="0 0 1"/>
    <parent link="l1"/><child link="l2"/><axis xyz="1 0 0"/>
    <limit lower="-0.6" upper="0.2" effort="{limits[1]}" velocity="2"/></joint>
  <joint name="spin" type="continuous"><origin xyz="0 0 0.3"/>
    <parent link="l2"/><child link="l3"/><axis xyz="0 0 1"/>
    <limit effort="{limits[2]}" velocity="2"/></joint>
</robot>"""
    )


# Arms of 0.7, 0.5 + 1 + 0.6 + 0.1 and 2.1 + 0.3 m carry 2, 3 and 1 kg.
MOST = 9.81 * (2.0 * 0.7 + 3.0 * 2.2 + 1.0 * 2.4)


def test_effort_limits_are_compared_with_the_weight_of_the_stretched_robot():
    found = effort_limit_warnings(reaching_arm([50.1 * MOST, 1e7, 49.9 * MOST]))
    (warning,) = found
    assert warning.subject == "joint 'turn' effort limit"
    assert warning.text.endswith(f'stretched out takes at most {MOST:.3g} N m')
    assert warning.text.startswith(f'{50.1 * MOST:.7g} N m looks like a placeholder')
    assert warning.hint.startswith('write the largest effort of the joint')
    assert f'{MOST:.3g}' == '102'
    assert effort_limit_warnings(reaching_arm([49.9 * MOST, 1e7, 49.8 * MOST])) == ()


def test_masses_that_are_too_small_are_named_before_the_limits():
    robot = reaching_arm([1e5, 1e7, 1e5])
    light = dataclasses.replace(robot, mass=robot.mass * [1.0, 1e-3, 1e-3, 1e-3])
    (warning,) = effort_limit_warnings(light)
    # The last link is 0.5 + 1 + 0.3 m away; the travel of the slide is not part of the size.
    assert str(warning).startswith(
        'the moving links weigh only 0.006 kg together, but reach 1.8 m'
    )
    assert warning.hint.startswith('write masses in kg')
    assert 'placeholder' in str(effort_limit_warnings(robot)[0])
    massless = dataclasses.replace(robot, mass=robot.mass * 0.0)
    assert effort_limit_warnings(massless) == ()


def test_a_limit_that_is_missing_is_not_a_placeholder():
    robot = reaching_arm([0.0, 1e7, 49.9 * MOST])
    assert robot.effort_limits[0] == math.inf
    assert effort_limit_warnings(robot) == ()  # the loader has warned
    (warning,) = effort_limit_warnings(dataclasses.replace(robot, warnings=()))
    assert (warning.text, warning.subject) == ('missing', "joint 'turn' effort limit")
    assert 'effort_limits of the node' in warning.hint


@pytest.mark.parametrize(('lower', 'upper', 'travel'), [
    (-0.6, 0.2, 0.6), (-0.1, 0.2, 0.2), (-math.inf, math.inf, 0.0)])  # fmt: skip
def test_the_longer_travel_is_part_of_the_reach(lower, upper, travel):
    robot = reaching_arm([50.1 * MOST, 1e7, 1.0])
    ends = {'lower': [-3.0, lower, -math.inf], 'upper': [3.0, upper, math.inf]}
    robot = dataclasses.replace(robot, **{name: np.array(each) for name, each in ends.items()})
    (warning,) = effort_limit_warnings(robot)
    # The travel moves the second and the third link, of 4 kg.
    assert f'takes at most {MOST - 9.81 * (0.6 - travel) * 4.0:.3g} N m' in warning.text


TEXT = ' effort limits of revolute joints are {} N m, which looks like a placeholder'
EQUAL = [
    # the limits of a chain of revolute and, with "p", prismatic joints; the warning
    ('100 100 100', '3 of 3', '100'),
    ('100 100 100 7p 8p 9p', '3 of 3', '100'),
    ('100 100 100p 100p 100p', '', ''),
    # round: at least 80 % of five joints
    ('100 100 100 100 30', '4 of 5', '100'),
    ('100 100 100 30 30', '', ''),
    # not round: all joints of a chain of five
    ('30 30 30 30 30', '5 of 5', '30'),
    ('30 30 30p 30 30 30', '5 of 5', '30'),
    ('30 30 30 30', '', ''),
    ('30 30 30 30 30 29', '', ''),
]


@pytest.mark.parametrize(('limits', 'count', 'value'), EQUAL)
def test_equal_limits_are_placeholders(limits, count, value):
    kinds = {'': 'revolute', 'p': 'prismatic'}
    joints = ''.join(
        f'<link name="l{k}"/><joint name="j{k}" type="{kinds[limit.strip("0123456789")]}">'
        f'<parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="0 0 1"/>'
        f'<limit lower="0" upper="1" effort="{limit.strip("p")}" velocity="2"/></joint>'
        for k, limit in enumerate(limits.split(), 1)
    )
    robot = load_urdf(f'<robot name="arm"><link name="l0"/>{joints}</robot>')
    found = effort_limit_warnings(robot)
    assert [warning.text for warning in found] == ([count + TEXT.format(value)] if count else [])
    assert all(warning.hint.startswith('write the largest effort') for warning in found)


def test_equal_limits_of_four_legs_are_no_placeholders():
    legs = ''.join(
        f'<link name="{leg}{k}"/><joint name="{leg}{k}" type="revolute"><child link="{leg}{k}"/>'
        f'<parent link="{f"{leg}{k - 1}" if k else "l0"}"/><axis xyz="0 0 1"/>'
        '<limit lower="0" upper="1" effort="30" velocity="2"/></joint>'
        for leg in 'abcd'
        for k in range(3)
    )
    robot = load_urdf(f'<robot name="dog"><link name="l0"/>{legs}</robot>')
    assert effort_limit_warnings(robot) == ()
