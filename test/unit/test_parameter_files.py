"""The declaration of the parameters: checks of values, and the files generated from it."""

from dataclasses import replace
import math
import re

from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.control.settings import setting, StalePolicy
from inverse_dynamics_node.node.configure import check_configuration, launch_warning, make_loop
from inverse_dynamics_node.node.parameters import LOCKED_POSITION, PARAMETERS
from inverse_dynamics_node.node.ros_parameters import _REMOVED
import numpy as np
from parameter_values import configured
import pytest
from robot_files import ROOT, STANFORD

from doc.parameters import parameter_files, parameter_table

PER_JOINT = 'expected a finite number, or a list with one number for each commanded joint'
VECTOR = 'expected three finite numbers, all with a decimal point or all without'


@pytest.mark.parametrize(
    ('name', 'value', 'expected'),
    [
        ('kp', 5, 5.0),
        ('kp', [5, 6.0], (5.0, 6.0)),
        ('joints', ['a', '', 'b'], ('a', 'b')),
        ('joints', None, ()),  # what rclpy makes of an empty list
        ('gravity', [0, 0, -9], (0.0, 0.0, -9.0)),
        ('on_stale_state', 'hold', StalePolicy.HOLD),
        ('update_rate', 0, 0.0),
        ('damping', [-1, 0.5], (-1.0, 0.5)),
        ('effort_limits', 0, math.inf),
        ('effort_rate_limits', [3, 0], (3.0, math.inf)),
        ('kp', -1, 'is -1, expected at least 0'),
        ('kp', [1.0, -1.0], 'is [1.0, -1.0], expected at least 0'),
        ('kp', [2e9, 0.0], 'is [2000000000.0, 0.0], expected at most 1e+09'),
        ('kp', math.nan, f'is nan, {PER_JOINT}'),
        ('kp', [], f'is [], {PER_JOINT}'),
        ('kp', True, f'is True, {PER_JOINT}'),
        ('kp', '1e3', f"is '1e3', {PER_JOINT}; YAML reads 1e3 as text, write 1000.0"),
        ('effort_scale', -2e9, 'is -2000000000.0, expected at least -1e+09'),
        ('stop_ramp', 1e3, 'is 1000.0, expected 0 to 60'),
        ('update_rate', 0.5, 'is 0.5, expected 0 or 1 to 10000'),
        ('update_rate', -1.0, 'is -1.0, expected 0 or 1 to 10000'),
        ('damping', [-1.0, -0.5], 'is [-1.0, -0.5], expected -1 or at least 0'),
        ('velocity_limits', -2, 'is -2, expected -1 or at least 0'),
        ('thread_priority', 1.0, 'is 1.0, expected an integer'),
        ('thread_priority', 100, 'is 100, expected 0 to 99'),
        ('dry_run', 1, 'is 1, expected true or false'),
        ('base_link', 3, 'is 3, expected text'),
        ('joints', 'a', "is 'a', expected a list of names"),
        ('gravity', [0.0, -9.8], f'is [0.0, -9.8], {VECTOR}'),
        ('base_motion', 'on', "is 'on', expected one of fixed, imu"),
    ],
)
def test_values_are_converted_or_refused_with_what_was_expected(name, value, expected):
    if isinstance(expected, str):
        with pytest.raises(ConfigurationError) as error:
            PARAMETERS[name].check(value)
        assert str(error.value) == expected
    else:
        assert PARAMETERS[name].check(value) == expected


@pytest.mark.parametrize(
    ('default', 'in_file'),
    [(2.0, 2.0), (math.inf, 0.0), (StalePolicy.HOLD, 'hold'), (True, True)],
)
def test_a_setting_keeps_its_value_and_declares_that_of_a_parameter_file(default, in_file):
    declared = setting(default, 'summary', 'details', unit='s')
    assert declared.default is default
    words = {'summary': 'summary', 'details': 'details', 'unit': 's'}
    assert declared.metadata == {'default': in_file, **words}


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        (
            {'joints': ['nose']},
            "parameter joints: joint 'nose' does not exist; joints are joint_1",
        ),
        ({'joints': ['joint_1'] * 2}, 'parameter joints lists a joint twice: joint_1, joint_1'),
        ({'kp': [1.0, 2.0]}, 'kp has 2 numbers, expected one, or one for each of 6 joints'),
        ({'drive_coupling': 1.0}, "coupling of joint 'joint_1' is 1.0, expected 0"),
        ({'base_link': 'nose'}, "base_link is 'nose', expected a link that no joint moves"),
    ],
)
def test_values_that_do_not_fit_the_robot_are_refused(values, words):
    with pytest.raises(ConfigurationError, match=words):
        make_loop(configured(**values), load_urdf(STANFORD), '')


def test_friction_is_added_only_if_it_is_included():
    q, qd = np.full(6, 0.3), np.full(6, 0.2)
    for is_included, share in ((False, 0.0), (True, 2.0)):
        given = configured(damping=2.0, coulomb=0.0, include_friction=is_included)
        loop = make_loop(given, load_urdf(STANFORD), '')
        terms = loop.dynamics.effort_terms(q, qd, 0.0 * q)
        assert terms.friction == pytest.approx(share * qd)


@pytest.mark.parametrize(
    ('ramp', 'damping', 'words'),
    [
        (0.2, 50.0, 'stop_ramp plus the time for stop_damping is 20.2 s, but ros2 launch sends'),
        (5.0, 0.0, 'stop_ramp is 5 s, but ros2 launch sends SIGTERM 5 s after SIGINT'),
        (4.9, 0.0, ''),
    ],
)
def test_a_stop_that_launch_cuts_short_is_named(ramp, damping, words):
    warning = launch_warning(configured(stop_ramp=ramp, stop_damping=damping))
    assert warning.startswith(words)
    assert bool(warning) is bool(words)


def test_the_frame_of_gravity_is_a_link_of_the_robot():
    text = (ROOT / 'test/robots/pendulum.urdf').read_text()
    base = load_urdf(text).body_names[0]
    mount = (
        f'<link name="mount"/><joint name="tilt" type="fixed"><parent link="{base}"/>'
        '<child link="mount"/><origin rpy="0 0 1.5707963267948966"/></joint></robot>'
    )
    robot = load_urdf(text.replace('</robot>', mount))
    loop = make_loop(configured(base_link='mount', gravity=[1.0, 2.0, -3.0]), robot, '')
    assert loop.base_link == 'mount'
    assert loop.loads.gravity_at_root == pytest.approx([-2.0, 1.0, -3.0])
    q = np.full(len(robot.joint_names), 0.4)
    expected = InverseDynamics(robot, gravity=(-2.0, 1.0, -3.0)).gravity_efforts(q)
    assert np.abs(expected).max() > 0.1
    assert loop.dynamics.gravity_efforts(q) == pytest.approx(expected)


def test_locked_joints_are_joints_of_the_robot():
    locked = replace(configured(), locked_positions={'jiont_6': 0.2})
    with pytest.raises(ConfigurationError, match="lists 'jiont_6', expected only joints of"):
        make_loop(locked, load_urdf(STANFORD), '')


def test_a_continuous_joint_has_no_spring_whose_effort_would_jump_after_a_turn():
    urdf = STANFORD.read_text().replace('type="revolute"', 'type="continuous"', 1)
    robot, defaults = load_urdf(urdf), configured()
    (joint,) = (i for i, is_continuous in enumerate(robot.is_continuous) if is_continuous)
    loop = make_loop(defaults, robot, urdf)
    springs = tuple(0.0 if i == joint else 5.0 for i in range(6))
    for given in (springs, 0.0):
        check_configuration(loop, replace(defaults, spring_stiffness=given))
    words = f"spring_stiffness of joint '{robot.joint_names[joint]}' is 5, expected 0"
    impossible = replace(defaults, spring_stiffness=5.0)
    with pytest.raises(ConfigurationError, match=words):
        check_configuration(loop, impossible)
    with pytest.raises(ConfigurationError, match=words):
        make_loop(impossible, robot, urdf)


@pytest.mark.parametrize('path', parameter_files(), ids=lambda path: path.name)
def test_the_generated_parts_are_up_to_date(path):
    assert path.read_text() == parameter_files()[path], 'run `make parameters`'


def test_cells_of_the_table_are_short():
    for row in parameter_table().splitlines():
        for cell in row.strip('|').split('|'):
            assert len(cell) < 120


@pytest.mark.parametrize('name', PARAMETERS)
def test_every_default_is_valid_and_described(name):
    parameter = PARAMETERS[name]
    parameter.check(parameter.default)
    assert parameter.summary
    for text in (parameter.summary, parameter.details):
        assert not text.endswith('.')
        assert text.count('`') % 2 == 0
    # Each number is a quantity with a unit, except for factors and priorities.
    factors = ('effort_scale', 'measured_effort_scale', 'friction_scale', 'load_friction')
    has_none = name in (*factors, 'guiding_speed', 'drive_coupling', 'thread_priority')
    assert bool(parameter.unit) == (parameter.kind.is_numeric and not has_none)


def test_the_unit_follows_the_first_sentence():
    assert PARAMETERS['kp'].description == 'Position gain of computed_torque [1/s^2]'
    description = PARAMETERS['effort_limits'].description
    assert description.startswith('Effort limits in addition to those of the URDF [N m, N]. 0:')
    assert re.search(r'reports it \[rad, m\]\. ', LOCKED_POSITION.description)


@pytest.mark.parametrize('name', _REMOVED)
def test_the_changelog_names_each_removed_parameter(name):
    assert name not in PARAMETERS
    assert f'``{name}``' in (ROOT / 'CHANGELOG.rst').read_text().partition('0.1.0, the')[0]
