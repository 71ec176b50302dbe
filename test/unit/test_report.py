"""The report describes a robot completely and stays readable."""

from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.errors import ConfigurationError, JointStateError, UrdfError
from inverse_dynamics_node.report.robot_tables import model_report, model_tables
from inverse_dynamics_node.report.tables import (
    all_shortened,
    as_text,
    effort_unit,
    shortened,
    Table,
    table_lines,
    warnings_about,
    warnings_as_text,
    WIDTH,
)
from inverse_dynamics_node.robot.model import ModelWarning
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import NOTHING_MOVES, real_robots, ROOT, STANFORD

ARM = load_urdf(STANFORD)


def report_of(robot, **options):
    return model_report(InverseDynamics(robot), **options)


def test_report_contains_masses_limits_and_merged_links():
    text = report_of(ARM)
    assert '20.77 kg' in text
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    assert rows['joint_3'][1:] == ['prismatic', 'z', '0.2032', '0.9144', '1', '200', '4.25']
    assert 'link_6 0.51, tool0' in text
    assert 'No warnings.' in text


def test_masses_of_links_add_up_to_those_of_bodies(urdf_path):
    robot = load_urdf(urdf_path)
    mass = np.zeros(len(robot.mass))
    np.add.at(mass, robot.link_body, robot.link_mass)
    assert mass == pytest.approx(robot.mass)


def test_order_of_the_commands_leads_to_the_urdf():
    text = report_of(ARM, joints=['joint_4', 'joint_2'])
    assert '0        joint_4                  3' in text
    assert '1        joint_2                  1' in text
    assert 'not commanded, but taken into account: joint_1, joint_3, joint_5, joint_6' in text


def test_efforts_at_rest_are_those_of_the_dynamics():
    q = [0.0, 1.3, 0.6, 0.0, 0.6, 0.0]
    table = model_tables(InverseDynamics(ARM), q=q)[-1]
    efforts = [float(row[2].split()[0]) for row in table.rows]
    assert efforts == pytest.approx(InverseDynamics(ARM).gravity_efforts(q), abs=0.006)
    assert table.rows[1][3:5] == ('100', '12%')


def test_joints_beyond_their_limits_are_marked():
    q = [0.0, 1.3, 2.0, 0.0, 0.6, 0.0]
    limits = [60.0, 1.0, 200.0, 10.0, 10.0, 5.0]
    table = model_tables(InverseDynamics(ARM), q=q, effort_limits=limits)[-1]
    assert table.rows[2][-1] == 'outside its range'
    assert table.rows[1][-1] == 'beyond its limit'
    assert table.marked == {1, 2}
    styles = [line.style for line in table_lines(table)]
    assert styles[:5] == ['bold', 'cyan', '', 'bold red', 'bold red']


def test_given_limits_apply_to_the_commanded_joints():
    text = report_of(ARM, joints=['joint_4', 'joint_2'], effort_limits=[7.5, np.inf])
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    assert rows['joint_4'][6] == '7.5'
    assert rows['joint_2'][6] == '-'


@pytest.mark.parametrize(
    ('options', 'error', 'words'),
    [
        ({'joints': ['joint_9']}, ConfigurationError, "joint 'joint_9' does not exist"),
        ({'effort_limits': [1.0]}, ConfigurationError, r'shape \(1,\), expected \(6,\)'),
        ({'q': [1.0]}, JointStateError, 'q has shape'),
    ],
)
def test_invalid_options_are_reported(options, error, words):
    with pytest.raises(error, match=words):
        report_of(ARM, **options)


def test_missing_effort_limits_are_reported_once():
    text = STANFORD.read_text().replace('effort="200"', 'effort="0"')
    (warning,) = warnings_about(load_urdf(text))
    assert warning.text == '0 means unknown, so the effort is not limited'
    robot = load_urdf(ROOT / 'test' / 'robots' / 'continuous.urdf')
    unlimited = int(np.count_nonzero(np.isinf(robot.effort_limits)))
    warnings = [str(warning) for warning in warnings_about(robot)]
    assert sum('effort limit: missing' in text for text in warnings) == unlimited


def test_only_branches_are_indented():
    arm = model_tables(InverseDynamics(ARM))[1]
    assert [row[0] for row in arm.rows] == ['base_link', *ARM.joint_names]
    robot = load_urdf(ROOT / 'test' / 'robots' / 'branched.urdf')
    names = [row[0] for row in model_tables(InverseDynamics(robot))[1].rows]
    assert any(name.startswith('├ ') for name in names)
    assert any('└ ' in name for name in names)


@pytest.mark.parametrize('path', real_robots()[::6], ids=lambda path: path.stem)
def test_report_stays_within_its_width_and_has_a_hint_for_every_warning(path):
    try:
        robot = load_urdf(path)
    except UrdfError:
        pytest.skip('not a valid URDF')
    text = report_of(robot, joints=robot.joint_names[::-1], q=np.zeros(len(robot.joint_names)))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert all(warning.hint for warning in warnings_about(robot))


def test_warnings_with_the_same_hint_are_grouped():
    warnings = [
        ModelWarning('no <axis>', 'write it', "joint 'a'", 3),
        ModelWarning('too long', 'shorten it'),
        ModelWarning('no <axis>', 'write it', "joint 'b'"),
    ]
    assert warnings_as_text(warnings).splitlines() == [
        '3 warnings',
        "  line 3: joint 'a': no <axis>",
        "  joint 'b': no <axis>",
        '    -> write it',
        '  too long',
        '    -> shorten it',
    ]
    assert warnings_as_text([]) == 'No warnings.'


def test_a_joint_may_have_the_name_of_the_base():
    text = (ROOT / 'test' / 'robots' / 'cartesian.urdf').read_text()
    base = load_urdf(text).body_names[0]
    robot = load_urdf(text.replace('x_axis', base))
    assert robot.is_prismatic_joint.tolist() == [True] * 3
    assert effort_unit(robot, 0).strip() == 'N'


def test_robots_without_joints_are_described():
    text = report_of(load_urdf(NOTHING_MOVES), q=[])
    assert 'no joint can move' in text


def test_long_names_are_shortened_in_their_middle():
    assert shortened('gripper_left_finger_1', 15) == 'gripper…inger_1'
    assert shortened('arm_left_1_joint', 12) == 'arm_left_1…'
    assert shortened('gripper_left_joint', 12) == 'gripp…_left…'
    assert shortened('elbow', 15) == 'elbow'
    table = Table('t', ('joint', 'value'), (('a' * 200, '1.0'),))
    assert max(map(len, as_text(table).splitlines())) <= WIDTH


def test_names_are_not_shortened_for_programs():
    names = [f'left_arm_with_a_long_name_{k}_joint' for k in 'ab']
    table = Table('t', ('joint', 'value'), tuple((name, '1' * 80) for name in names))
    assert not any(name in as_text(table) for name in names)
    assert all(name in as_text(table, whole_names=True) for name in names)


def test_names_and_numbers_with_hyphens_are_not_divided():
    words = ['left-arm-joint', 'at', '1.5e-05'] * 20
    lines = as_text(Table('t', notes=(' '.join(words),))).splitlines()[1:]
    assert ' '.join(lines).split() == words


def chain_of(count, limit='{k}', mass='{k}', inertia=(1, 1, 1)):
    """Return a URDF of links in a row, the k-th limit and mass written with k, from 2 on."""
    ixx, iyy, izz = inertia
    links = ''.join(
        f'<link name="l{k}"><inertial><mass value="{mass.format(k=k)}"/><inertia ixx="{ixx}" '
        f'iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<origin xyz="0.2 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" '
        f'effort="{limit.format(k=k)}"/></joint>'
        for k in range(2, count + 2)
    )
    return f'<robot name="chain"><link name="l1"/>{links}</robot>'


@pytest.mark.parametrize(
    ('urdf', 'words'),
    [
        (
            chain_of(5),
            '5 of 5 links with mass have ixx = iyy = izz = 1 kg m^2 (l2, l3, l4, l5, ...)',
        ),
        (
            chain_of(5, inertia=(0.1, 0.2, 0.2)),
            '5 of 5 links with mass have the same inertia (ixx = 0.1 kg m^2)',
        ),
        (
            chain_of(5, inertia=(0.1, 0.1, 0.1), mass='2'),
            '5 of 5 links with mass have the same inertia',
        ),
        (
            chain_of(5, mass='1', inertia=(0.1, 0.2, 0.2)),
            '5 of 5 links with mass have a mass of 1',
        ),
        (chain_of(5, limit='1000'), '5 of 5 effort limits of revolute joints are 1000 N m'),
        (
            chain_of(3, limit='5000{k}'),
            "joint 'j2' effort limit: 50002 N m looks like a placeholder, because holding the",
        ),
    ],
)
def test_placeholders_are_reported(urdf, words):
    found = warnings_about(load_urdf(urdf))
    (warning,) = [warning for warning in found if words in str(warning)]
    assert 'looks like a placeholder' in warning.text
    assert warning.hint


def test_equal_modules_are_not_placeholders():
    urdf = chain_of(6, limit='20', mass='0.5', inertia=(0.001, 0.002, 0.002))
    assert load_urdf(urdf).warnings == ()
    assert warnings_about(load_urdf(urdf)) == ()


def test_only_real_robots_with_placeholders_have_warnings_about_them():
    paths = real_robots()
    if not paths:
        pytest.skip('example-robot-data is not installed')
    warned = set()
    for path in paths:
        try:
            warnings = warnings_about(load_urdf(path))
        except UrdfError:
            continue
        if any('placeholder' in warning.text for warning in warnings):
            warned.add(path.stem)
    # Limits of 1000 N m on legs of 3 kg, of 50000 N m on a neck; inertias of 1 1 1 kg m^2.
    assert warned <= {
        'bolt',
        'finger_edu',
        'quadruped',
        'solo',
        'solo12',
        'baxter',
        'simple_humanoid',
        'simple_humanoid_classical',
        'tiago_dual',
    }
    assert {'solo12', 'baxter', 'simple_humanoid'} <= warned


def test_shortened_names_are_distinct():
    names = [f'scara_{part}_rotation_joint' for part in ('inner_arm', 'outer_arm', 'spindle')]
    short = all_shortened(names, 15)
    assert len(set(short)) == 3
    assert max(map(len, short)) <= 15
    assert [name[1:4] for name in short] == ['inn', 'out', 'spi']
    assert all_shortened(['joint_1', 'joint_2'], 15) == ['joint_1', 'joint_2']
