"""An excitation motion has no collisions, and what is not checked is named."""

import math

from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.excitation.limits import (
    default_and_random_poses,
    motion_limits,
    whole_positions,
)
from inverse_dynamics_node.analysis.excitation.search import find_excitation
from inverse_dynamics_node.robot.urdf.shapes import read_shapes
import numpy as np
from numpy.testing import assert_allclose
import pytest

pytest.importorskip('coal')
from inverse_dynamics_node.analysis.excitation.collisions import APART, Collisions

POST = 0.1  # half of the width of the base [m]
ARM = f"""<robot name="r">
<link name="post"><collision><origin xyz="0 0 0.3"/><geometry>
  <box size="{2 * POST} {2 * POST} 0.6"/></geometry></collision></link>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0.2 0 0"/>
  <geometry><box size="0.2 0.04 0.04"/></geometry></collision></link>
<link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0.2 0 0" rpy="0 1.5707963 0"/>
  <geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="post"/><child link="upper"/>
  <origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
<joint name="fold" type="revolute"><parent link="upper"/><child link="fore"/>
  <origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" velocity="2" effort="20"/></joint>
</robot>"""
CYLINDER = '<cylinder radius="0.02" length="0.3"/>'


def collisions_of(urdf, *obstacles):
    robot = load_urdf(urdf)
    return Collisions(robot, urdf, default_and_random_poses(motion_limits(robot)), *obstacles)


def positions_of(excitation):
    q, _, _ = excitation.series.sample(np.linspace(0.0, excitation.series.duration, 2001))
    return whole_positions(excitation.limits, q)


def distance_of_fore_to_post(q):
    """Return the distance from the square post to the end faces and axis of the fore-arm."""
    turn, both = q[:, :1], q[:, :1] + q[:, 1:]
    along, across = (x.ravel() for x in np.meshgrid(np.linspace(0.05, 0.35, 200), [-0.02, 0.02]))
    x = 0.3 * np.cos(turn) + along * np.cos(both) - across * np.sin(both)
    y = 0.3 * np.sin(turn) + along * np.sin(both) + across * np.cos(both)
    beyond = np.maximum(np.abs(np.stack([x, y], axis=2)) - POST, 0.0)
    return np.min(np.linalg.norm(beyond, axis=2), axis=1)


def test_collisions_are_those_of_the_distance(rng):
    collisions = collisions_of(ARM)
    assert collisions.unchecked == collisions.shapeless == []
    q = rng.uniform(-3.0, 3.0, (1000, 2))
    distance = distance_of_fore_to_post(q)
    is_clear = np.abs(distance - APART) > 1e-3  # the cylinder is a prism with 32 sides
    hit = np.isin(np.arange(len(q)), [pose for pose, _ in collisions.hits(q)])
    assert 50 < hit.sum() < 950
    assert (hit == (distance < APART))[is_clear].all()
    assert collisions.is_free(q[distance > 1.3 * APART])
    assert not collisions.is_free(q)


def test_a_motion_and_the_way_to_its_start_do_not_hit_the_base(brief):
    robot = load_urdf(ARM)
    dynamics = InverseDynamics(robot)
    limits = motion_limits(robot)
    limits.lower[1], limits.upper[1] = 1.8, 3.0
    free = find_excitation(dynamics, limits)
    assert distance_of_fore_to_post(positions_of(free)).min() == 0.0
    collisions = Collisions(robot, ARM, default_and_random_poses(limits), 0.0)
    q = positions_of(find_excitation(dynamics, limits, collisions))
    way = limits.rest + np.linspace(0.0, 1.0, 300)[:, np.newaxis] * (q[0] - limits.rest)
    assert min(distance_of_fore_to_post(part).min() for part in (q, way)) > 0.9 * APART
    assert np.ptp(q, axis=0).min() > 0.1


def test_boxes_and_the_floor_are_avoided(brief):
    robot = load_urdf(ARM)
    box = np.array([[0.3, 0.3, 0.2], [0.7, 0.7, 0.6]])
    collisions = collisions_of(ARM, 0.3, [box])
    assert not collisions.unchecked
    q = positions_of(find_excitation(InverseDynamics(robot), motion_limits(robot), collisions))
    tips = 0.3 * np.array([np.cos(q[:, 0]), np.sin(q[:, 0])])
    tips += 0.35 * np.array([np.cos(q.sum(axis=1)), np.sin(q.sum(axis=1))])
    assert not ((tips > 0.3) & (tips < 0.7)).all(axis=0).any()


def test_the_links_that_collide_in_most_poses_are_named():
    robot = load_urdf(ARM)
    box = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
    collisions = collisions_of(ARM, 0.0, [box])
    with pytest.raises(ConfigurationError, match=r'collide: (fore|upper) and box, .*--floor'):
        find_excitation(InverseDynamics(robot), motion_limits(robot), collisions)


def test_links_that_touch_by_design_are_not_checked_but_named():
    always = ARM.replace('length="0.3"', 'length="1.1"')
    robot = load_urdf(always)
    poses = np.random.default_rng(0).uniform(-0.02, 0.02, (20, 2))
    collisions = Collisions(robot, always, poses)
    assert collisions.unchecked == ['post and fore']
    assert collisions.is_free(poses)


LIFT = """<robot name="r"><link name="base"/>
<link name="plate"><inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="plate"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="50"/></joint></robot>"""


@pytest.mark.parametrize(
    ('heights', 'is_free'),
    [
        (np.linspace(-0.2, 0.2, 100), True),
        (np.linspace(0.2, 0.0, 100), False),
        (np.r_[np.linspace(-0.2, 0.2, 100), 0.0], False),
    ],
    ids=['rises', 'sinks', 'rises and sinks'],
)
def test_what_begins_below_the_floor_may_rise(heights, is_free):
    collisions = collisions_of(LIFT, 0.0)
    assert not collisions.is_free(heights[:, np.newaxis])
    assert collisions.is_way_free(heights[:, np.newaxis]) is is_free


def test_the_space_of_the_links_contains_their_shapes():
    q = np.array([[0.0, 0.0], [math.pi / 2, 0.0]])
    low, high = collisions_of(ARM).extent(q)
    assert_allclose(high, [0.65, 0.65, 0.42], atol=1e-6)
    assert_allclose(low, [-0.02, -0.02, 0.38], atol=1e-6)
    bare = '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
    bare += '<parent link="a"/><child link="b"/></joint></robot>'
    assert collisions_of(bare).extent(np.zeros((1, 1))) is None


def test_links_that_do_not_move_are_not_compared():
    below = ARM.replace('<origin xyz="0 0 0.4"/>', '<origin xyz="0 0 -0.4"/>')  # the floor
    robot = load_urdf(below)
    limits = motion_limits(robot, ['fold'])
    collisions = Collisions(robot, below, default_and_random_poses(limits), -0.1)
    hits = {pair for _, pair in collisions.hits(np.zeros((1, 2)))}
    assert collisions.most_frequent(np.zeros((1, 2))) == 'fore and floor'
    assert len(hits) == 1


def test_a_link_that_turns_on_the_floor_may_touch_it():
    assert collisions_of(ARM, 0.4).unchecked == ['upper and floor']


# Shapes


@pytest.mark.parametrize('name', ['package://my_arm/meshes/fore.stl', '../meshes/fore.stl'])
def test_a_mesh_is_found_near_the_description(tmp_path, name):
    import trimesh

    folder = tmp_path / 'my_arm'
    (folder / 'urdf').mkdir(parents=True)
    (folder / 'meshes').mkdir()
    trimesh.creation.box((0.3, 0.04, 0.04)).export(folder / 'meshes' / 'fore.stl')
    urdf = ARM.replace(CYLINDER, f'<mesh filename="{name}"/>')
    (folder / 'urdf' / 'arm.urdf').write_text(urdf)
    shapes, unreadable = read_shapes(folder / 'urdf' / 'arm.urdf')
    assert not unreadable
    assert_allclose(np.ptp(shapes[-1].vertices, axis=0), (0.04, 0.04, 0.3), atol=1e-6)


@pytest.mark.parametrize(
    ('solid', 'reason'),
    [
        ('<mesh filename="package://lost/fore.stl"/>', "mesh 'package://lost/fore.stl' not found"),
        ('<cone radius="1"/>', '<cone> is not a URDF shape'),
        ('<sphere/>', '<sphere> lacks radius'),
        ('<sphere radius="wide"/>', 'could not convert'),
    ],
)
def test_a_shape_that_cannot_be_read_is_named(solid, reason):
    (link,) = collisions_of(ARM.replace(CYLINDER, solid)).shapeless
    assert link.startswith('fore (')
    assert reason in link


@pytest.mark.parametrize('solid', ['<box size="0 0 0"/>', '<box size="0.3 0.1 0"/>'])
def test_flat_shapes_are_checked(solid):
    collisions = collisions_of(ARM.replace(CYLINDER, solid))
    q = np.array([[0.0, 3.0], [0.0, 0.0]])
    assert not collisions.is_free(q)
    assert collisions.is_free(q[1:])


def test_links_with_mass_and_without_shape_are_named():
    start = ARM.index('<collision><origin xyz="0.2 0 0"/>')
    end = ARM.index('</collision>', start) + len('</collision>')
    assert collisions_of(ARM[:start] + ARM[end:]).shapeless == ['upper']
