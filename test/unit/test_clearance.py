"""Capsules contain the shapes of a robot, and an excitation motion keeps them clear."""

from dataclasses import replace

from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.excitation import clearance as clearances
from inverse_dynamics_node.analysis.excitation.clearance import CLEARANCE, find_clearance
from inverse_dynamics_node.analysis.excitation.limits import (
    keep_clear,
    motion_limits,
    whole_positions,
)
from inverse_dynamics_node.analysis.excitation.search import find_excitation
from inverse_dynamics_node.robot.capsules import body_capsules
from inverse_dynamics_node.robot.kinematics import body_frames
from inverse_dynamics_node.robot.urdf.shapes import read_shapes
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import STANFORD

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


def capsules_of(urdf, robot):
    return body_capsules(robot, *read_shapes(urdf))


def link(geometry):
    return load_urdf(f'<robot name="r"><link name="a">{geometry}</link></robot>')


def positions_of(excitation):
    q, _, _ = excitation.series.sample(np.linspace(0.0, excitation.series.duration, 2001))
    return whole_positions(excitation.limits, q)


def distance_of_fore_to_post(q):
    """Return the distance of the fore-arm's axis from the square post, minus its radius."""
    turn, both = q[:, :1], q[:, :1] + q[:, 1:]
    along = np.linspace(0.05, 0.35, 200)
    places = np.stack([0.3 * f(turn) + along * f(both) for f in (np.cos, np.sin)], axis=2)
    beyond = np.maximum(np.abs(places) - POST, 0.0)
    return np.min(np.linalg.norm(beyond, axis=2), axis=1) - 0.02


SHAPES = (
    '<box size="0.4 0.1 0.2"/>',
    '<cylinder radius="0.05" length="0.3"/>',
    '<sphere radius="0.1"/>',
    '<capsule radius="0.05" length="0.3"/>',
    '<cylinder radius="0.001" length="0.5"/>',
    '<box size="0 0 0"/>',
)


@pytest.mark.parametrize('solid', SHAPES, ids=lambda solid: solid.split()[0][1:])
def test_capsules_contain_a_shape_and_little_else(solid):
    urdf = (
        '<robot name="r"><link name="a"/><link name="b"><collision>'
        f'<origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><geometry>{solid}</geometry></collision>'
        '</link><joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
        '</robot>'
    )
    capsules = capsules_of(urdf, load_urdf(urdf))
    (shape,), unreadable = read_shapes(urdf)
    assert not unreadable
    corners = shape.vertices[shape.faces]
    points = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
    of_shape = capsules.body == 1
    distances = [
        np.linalg.norm(points - nearest(points, *ends), axis=1) - radius
        for ends, radius in zip(capsules.ends[of_shape], capsules.radii[of_shape], strict=True)
    ]
    assert np.min(distances, axis=0).max() <= 1e-9
    reach = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    assert capsules.radii[of_shape].max() < 1.05 * reach


def nearest(points, a, b):
    along = b - a
    t = np.clip((points - a) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return a + np.outer(t, along)


def test_the_distance_of_capsules_is_that_of_their_points(rng):
    robot = load_urdf(ARM)
    capsules = capsules_of(ARM, robot)
    clearance = find_clearance(robot, capsules, rng.uniform(-3.0, 3.0, (50, 2)))
    q = rng.uniform(-3.0, 3.0, (3, 2))
    found = clearance.contacts(q, 10.0)
    assert len(found.row) == 3 * len(clearance.pairs)
    rotations, positions = body_frames(robot, q)
    along = np.linspace(0.0, 1.0, 201)[:, np.newaxis]
    for pose, row, distance in zip(found.pose, found.row, found.distance, strict=True):
        sides = []
        for k in clearance.pairs[row]:
            body, (a, b) = capsules.body[k], capsules.ends[k]
            points = a + along * (b - a)
            sides.append(points @ rotations[pose, body].T + positions[pose, body])
        apart = np.linalg.norm(sides[0][:, np.newaxis] - sides[1], axis=2).min()
        radii = capsules.radii[clearance.pairs[row]].sum()
        assert distance == pytest.approx(apart - radii, abs=2e-3)


def test_slopes_of_the_violation_are_its_derivatives(rng):
    urdf = STANFORD.read_text()
    robot = load_urdf(urdf)
    box = np.array([[0.2, -0.3, -0.3], [0.9, 0.5, 0.9]])
    poses = rng.uniform(-1.0, 1.0, (30, 6))
    clearance = find_clearance(robot, capsules_of(urdf, robot), poses, -0.1, [box])
    q = rng.uniform(-1.0, 1.0, (4, 6))
    violation, slopes = clearance.violation(q)
    assert (violation > 0.0).sum() >= 3
    step = 1e-6
    for j in range(6):
        ends = [clearance.violation(q + sign * step * np.eye(6)[j])[0] for sign in (1.0, -1.0)]
        assert_allclose(slopes[:, j], (ends[0] - ends[1]) / (2.0 * step), rtol=1e-3, atol=1e-3)
    assert np.abs(slopes).max() > 1.0


def test_a_motion_does_not_hit_the_base(brief):
    robot = load_urdf(ARM)
    dynamics = InverseDynamics(robot)
    limits = motion_limits(robot)
    limits.lower[1], limits.upper[1] = 1.8, 3.0
    free = find_excitation(dynamics, limits)
    assert distance_of_fore_to_post(positions_of(free)).min() < 0.0
    clear = keep_clear(robot, limits, capsules_of(ARM, robot), 0.0)
    excitation = find_excitation(dynamics, clear)
    q = positions_of(excitation)
    way = np.linspace(0.0, 1.0, 300)[:, np.newaxis] * q[0]
    smallest = min(distance_of_fore_to_post(part).min() for part in (q, way))
    assert smallest > 0.9 * CLEARANCE
    assert np.ptp(q, axis=0).min() > 0.1
    assert excitation.nearest[0].names == ('post', 'fore')
    assert excitation.nearest[0].distance == pytest.approx(smallest, abs=0.01)


@pytest.mark.parametrize('floor', [0.0, 0.2])
def test_links_of_unknown_shape_stay_above_the_floor_with_an_assumed_radius(brief, floor):
    urdf = STANFORD.read_text()
    robot = load_urdf(urdf)
    capsules = capsules_of(urdf, robot)
    assert 'is assumed for' in capsules.notes[0]
    assert 'it has no collision shape' in capsules.notes[0]
    limits = keep_clear(robot, motion_limits(robot), capsules, floor)
    q = positions_of(find_excitation(InverseDynamics(robot), limits))
    _, places = body_frames(robot, q)
    assert places[:, 3:, 2].min() > floor + capsules.radii[0]


def test_a_box_is_avoided(brief):
    robot = load_urdf(ARM)
    box = np.array([[0.3, 0.3, 0.2], [0.7, 0.7, 0.6]])
    limits = keep_clear(robot, motion_limits(robot), capsules_of(ARM, robot), 0.0, [box])
    q = positions_of(find_excitation(InverseDynamics(robot), limits))
    tips = 0.3 * np.array([np.cos(q[:, 0]), np.sin(q[:, 0])])
    tips += 0.35 * np.array([np.cos(q.sum(axis=1)), np.sin(q.sum(axis=1))])
    assert not ((tips > 0.3) & (tips < 0.7)).all(axis=0).any()


def test_a_box_around_the_robot_leaves_no_motion():
    robot = load_urdf(ARM)
    box = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
    limits = keep_clear(robot, motion_limits(robot), capsules_of(ARM, robot), 0.0, [box])
    with pytest.raises(ConfigurationError, match=r'sampled poses .* collision'):
        find_excitation(InverseDynamics(robot), limits)


@pytest.mark.parametrize('name', ['package://my_arm/meshes/fore.stl', '../meshes/fore.stl'])
def test_a_mesh_is_found_near_the_description(tmp_path, name):
    import trimesh

    folder = tmp_path / 'my_arm'
    (folder / 'urdf').mkdir(parents=True)
    (folder / 'meshes').mkdir()
    trimesh.creation.box((0.3, 0.04, 0.04)).export(folder / 'meshes' / 'fore.stl')
    urdf = ARM.replace('<cylinder radius="0.02" length="0.3"/>', f'<mesh filename="{name}"/>')
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
def test_a_shape_that_cannot_be_read_is_named_and_replaced(solid, reason):
    urdf = ARM.replace('<cylinder radius="0.02" length="0.3"/>', solid)
    robot = load_urdf(urdf)
    capsules = capsules_of(urdf, robot)
    assert reason in capsules.notes[0]
    assert 'is assumed for fore' in capsules.notes[0]
    assert_allclose(capsules.radii[capsules.body == 2], 0.05 * (0.4 + 0.3))


def test_a_small_part_does_not_stand_for_the_link_that_carries_it():
    shape = '<collision><origin xyz="0.2 0 0" rpy="0 1.5707963 0"/>'
    arm = ARM.replace('<cylinder radius="0.02" length="0.3"/>', '<box size="0.04 0.04 0.3"/>')
    before, _, after = arm.partition(shape)
    body = before + '</link><link name="camera">' + shape.replace('0.2 0 0', '0.1 0.1 0') + after
    urdf = body.replace(
        '</robot>',
        '<joint name="screw" type="fixed"><parent link="fore"/><child link="camera"/></joint>'
        '</robot>',
    )
    capsules = capsules_of(urdf, load_urdf(urdf))
    assert 'is assumed for fore (it has no shape around its centre of mass)' in capsules.notes[0]
    is_assumed = np.isclose(capsules.radii, 0.05 * (0.4 + 0.3))
    assert is_assumed.any()
    assert (capsules.body[is_assumed] == 2).all()
    # The shape of a link may be that of another one, with the same place.
    around = urdf.replace('0.1 0.1 0', '0.2 0 0')
    assert not capsules_of(around, load_urdf(around)).notes


def test_the_smallest_distance_is_that_of_all_poses(rng):
    robot = load_urdf(ARM)
    clearance = find_clearance(robot, capsules_of(ARM, robot), rng.uniform(-3.0, 3.0, (50, 2)))
    q = rng.uniform(-3.0, 3.0, (100, 2))
    rotations, positions = body_frames(robot, q)
    smallest = min(
        clearance.between_surfaces(row, R, p, np.inf)
        for row in range(len(clearance.pairs))
        for R, p in zip(rotations, positions, strict=True)
    )
    (found,) = clearance.nearest(q)
    assert found.distance == smallest


LIFT = """<robot name="r"><link name="base"/>
<link name="plate"><inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="plate"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="50"/></joint></robot>"""


@pytest.mark.parametrize(
    ('heights', 'is_kept'),
    [
        (np.linspace(-0.2, 0.2, 100), True),
        (np.linspace(-0.2, 0.0, 100), False),
        (np.linspace(-0.2, 0.2, 100) - 0.1 * np.linspace(0.0, np.pi, 100), False),
        (np.maximum(np.linspace(-1.0, 0.2, 100), -0.2), False),
    ],
    ids=['rises', 'ends below', 'falls', 'rises late'],
)
def test_what_begins_below_the_floor_has_to_rise(heights, is_kept):
    robot = load_urdf(LIFT)
    poses = np.linspace(-1.0, 1.0, 50)[:, np.newaxis]
    clearance = find_clearance(robot, capsules_of(LIFT, robot), poses, 0.0)
    way = heights[:, np.newaxis]
    assert not clearance.is_kept(way)
    assert clearance.is_kept(way, is_way=True) is is_kept
    assert clearance.violation(way, is_way=True)[0].any() != is_kept


def test_parts_that_touch_in_all_poses_are_not_checked(rng):
    long = ARM.replace('length="0.3"', 'length="1.1"')
    robot = load_urdf(long)
    poses = rng.uniform(-0.02, 0.02, (20, 2))
    clearance = find_clearance(robot, capsules_of(long, robot), poses)
    assert clearance.unchecked == ('post and fore',)


def test_capsules_come_only_as_near_as_in_poses_that_were_looked_at(rng, monkeypatch):
    monkeypatch.setattr(clearances, '_MOST_LOOKS', 2)
    robot = load_urdf(ARM)
    capsules = capsules_of(ARM, robot)
    q = rng.uniform(-3.0, 3.0, (2000, 2))
    distance = distance_of_fore_to_post(q)
    # The capsule of the post reaches beyond its sides, and the two poses there are looked at.
    beside = q[(distance > CLEARANCE) & (distance < 0.03)][:2]
    inside = q[distance < -0.015][:10]
    away = q[distance > 0.2][:100]
    clearance = find_clearance(robot, capsules, np.concatenate([beside, inside, away]))
    assert clearance.is_kept(beside)
    assert not any(clearance.is_kept(pose[np.newaxis]) for pose in inside)


def test_shapes_that_are_known_are_checked_beside_an_unknown_one(rng):
    robot = load_urdf(ARM)
    capsules = capsules_of(ARM, robot)
    fore = np.flatnonzero(capsules.body == 2)[0]
    capsules = replace(
        capsules,
        body=np.r_[2, capsules.body],
        ends=np.concatenate([capsules.ends[[fore]], capsules.ends]),
        radii=np.r_[capsules.radii[fore], capsules.radii],
        names=('fore', *capsules.names),
        surfaces=(np.empty((0, 3)), *capsules.surfaces),
    )
    q = rng.uniform(-3.0, 3.0, (2000, 2))
    distance = distance_of_fore_to_post(q)
    beside = q[(distance > CLEARANCE) & (distance < 0.03)][:8]
    away, inside = q[distance > 0.2][:8], q[distance < -0.015]
    clearance = find_clearance(robot, capsules, np.concatenate([beside, away]))
    assert clearance.unchecked == ()
    assert clearance.is_kept(beside)
    assert not any(clearance.is_kept(pose[np.newaxis]) for pose in inside[:10])
