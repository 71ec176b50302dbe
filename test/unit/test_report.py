"""The report describes a robot completely and stays readable."""

from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.errors import ConfigurationError, JointStateError, UrdfError
from inverse_dynamics_node.report.robot_tables import model_report, model_tables
from inverse_dynamics_node.report.tables import (
    effort_unit,
    fraction,
    table,
    warnings_about,
    warnings_as_text,
    WIDTH,
)
from inverse_dynamics_node.robot.model import ModelWarning
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import real_robots, ROOT, STANFORD

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


def test_order_of_the_commands_leads_to_the_urdf():
    text = report_of(ARM, joints=['joint_4', 'joint_2'])
    assert '0        joint_4                  3' in text
    assert '1        joint_2                  1' in text
    assert 'not commanded, but taken into account: joint_1, joint_3, joint_5, joint_6' in text


def test_efforts_at_rest_are_those_of_the_dynamics():
    q = [0.0, 1.3, 0.6, 0.0, 0.6, 0.0]
    rows = [line.split() for line in model_tables(InverseDynamics(ARM), q=q)[-1].splitlines()[2:]]
    efforts = [float(row[2]) for row in rows]
    assert efforts == pytest.approx(InverseDynamics(ARM).gravity_efforts(q), abs=0.006)
    assert rows[1][5:] == ['100', '12%']


def test_joints_beyond_their_limits_are_marked():
    q = [0.0, 1.3, 2.0, 0.0, 0.6, 0.0]
    limits = [60.0, 1.0, 200.0, 10.0, 10.0, 5.0]
    rows = model_tables(InverseDynamics(ARM), q=q, effort_limits=limits)[-1].splitlines()[2:]
    assert rows[2].endswith('  outside its range')
    assert rows[1].endswith('  beyond its limit')
    assert rows[0].endswith('%')


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


def names_in(robot):
    """Return the first word of each row of the tree."""
    lines = model_tables(InverseDynamics(robot))[1].splitlines()
    rows = lines[2 : 3 + len(robot.parent) - 1]
    return [row.split()[0] for row in rows]


def test_only_branches_are_indented():
    assert names_in(ARM) == ['base_link', *ARM.joint_names]
    robot = load_urdf(ROOT / 'test' / 'robots' / 'branched.urdf')
    assert {'├', '└'} <= {*names_in(robot)}


@pytest.mark.parametrize('path', real_robots()[::6], ids=lambda path: path.stem)
def test_every_warning_has_a_hint_and_stays_within_its_width(path):
    try:
        robot = load_urdf(path)
    except UrdfError:
        pytest.skip('not a valid URDF')
    warnings = warnings_about(robot)
    assert max(map(len, warnings_as_text(warnings).splitlines())) <= WIDTH
    assert all(warning.hint for warning in warnings)


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


@pytest.mark.parametrize(
    ('effort', 'text'),
    [(0, '0%'), (99.4, '99%'), (-99.6, '99.6%'), (100, '100%'), (100.4, '100.4%'), (101, '101%')],
)
def test_percentages_near_the_limit_have_a_decimal(effort, text):
    assert fraction(effort, 100.0) == text
    assert fraction(effort, np.inf) == '-'


def test_a_joint_may_have_the_name_of_the_base():
    text = (ROOT / 'test' / 'robots' / 'cartesian.urdf').read_text()
    base = load_urdf(text).body_names[0]
    robot = load_urdf(text.replace('x_axis', base))
    assert robot.is_prismatic_joint.tolist() == [True] * 3
    assert effort_unit(robot, 0).strip() == 'N'


def test_a_table_aligns_words_to_the_left_and_leaves_out_empty_columns():
    rows = [('a', '1.0', 'x', ''), ('long', '22.0', 'yy', '')]
    assert table('t', ('joint', 'value', 'word', ''), rows, ['note'], [2]).splitlines() == [
        't',
        '  joint  value  word',
        '  a        1.0  x',
        '  long    22.0  yy',
        '  note',
    ]


def test_names_and_numbers_with_hyphens_are_not_divided():
    words = ['left-arm-joint', 'at', '1.5e-05'] * 20
    lines = table('t', notes=[' '.join(words)]).splitlines()[1:]
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
    # Limits of 1000 N m on legs of 3 kg, of 50000 N m on a neck; inertias of 1 1 1 kg m^2; equal
    # limits of 10 and 35 N m at all joints of arms of 0.5 kg.
    assert warned <= {
        'bolt',
        'finger_edu',
        'quadruped',
        'so100',
        'so101',
        'solo',
        'solo12',
        'baxter',
        'simple_humanoid',
        'simple_humanoid_classical',
        'tiago_dual',
    }
    assert {'solo12', 'baxter', 'simple_humanoid'} <= warned
