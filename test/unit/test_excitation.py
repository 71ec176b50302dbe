"""Excitation motions: at rest at both ends, within all limits, and better than random ones."""

import math

from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.excitation.fourier import FourierSeries
from inverse_dynamics_node.analysis.excitation.information import SAMPLES_PER_SECOND, Unknowns
from inverse_dynamics_node.analysis.excitation.limits import (
    FRACTION,
    motion_limits,
    States,
    whole_states,
)
from inverse_dynamics_node.analysis.excitation.search import find_excitation
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import random_chain, urdf_of
from robot_files import ROOT, STANFORD

ROBOTS = ROOT / 'test' / 'robots'
PLANAR = ROBOTS / 'planar_2r.urdf'
NAMES = 'planar_2r', 'cartesian', 'continuous', 'mimic_gripper'
SOME = [*(ROBOTS / f'{name}.urdf' for name in NAMES), STANFORD]


def dynamics_of(path):
    return InverseDynamics(load_urdf(path))


def states_of(excitation, count=2001):
    times = np.linspace(0.0, excitation.series.duration, count)
    return States(*excitation.series.sample(times))


def arm(limit='lower="-1" upper="1" velocity="2" effort="50"', kind='revolute'):
    """Return a robot of one joint that swings 1 kg at 0.5 m, with limits as attributes."""
    return load_urdf(
        f'<robot name="r"><link name="base"/><link name="arm"><inertial>'
        f'<origin xyz="0.5 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" '
        f'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hinge" type="{kind}">'
        f'<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/><limit {limit}/></joint>'
        '</robot>'
    )


# Fourier series


@pytest.mark.parametrize('harmonics', [2, 3, 5, 8])
def test_a_series_is_at_rest_at_both_ends_and_its_derivatives_agree(harmonics, rng):
    series = FourierSeries(('a', 'b'), 7.0, rng.normal(size=(2, 2 * harmonics - 1)))
    assert series.harmonics == harmonics
    q, qd, qdd = series.sample(np.array([0.0, 7.0]))
    assert_allclose(q[0], q[1], atol=1e-12)
    assert_allclose([qd, qdd], 0.0, atol=1e-11)
    step = 1e-5
    times = np.linspace(0.5, 6.5, 20)
    before, now, after = (series.sample(times + k * step) for k in (-1, 0, 1))
    assert np.abs(now[1]).min(axis=0).max() > 1e-3
    assert_allclose((after[0] - before[0]) / (2.0 * step), now[1], atol=1e-6)
    assert_allclose((after[1] - before[1]) / (2.0 * step), now[2], atol=1e-6)


# Limits


@pytest.mark.parametrize('path', SOME, ids=lambda path: path.stem)
def test_a_motion_is_within_all_limits(path, brief):
    dynamics = dynamics_of(path)
    limits = motion_limits(dynamics.robot)
    excitation = find_excitation(dynamics, limits)
    states = states_of(excitation)
    robot, index = dynamics.robot, limits.index
    assert np.ptp(states.q, axis=0).min() > 1e-3
    assert (states.q >= robot.lower[index] - 1e-12).all()
    assert (states.q <= robot.upper[index] + 1e-12).all()
    assert (np.abs(states.qd) <= robot.velocity_limits[index]).all()
    efforts = dynamics.efforts(*whole_states(limits, states))
    assert (np.abs(efforts) <= robot.effort_limits).all()
    assert_allclose([states.qd[[0, -1]], states.qdd[[0, -1]]], 0.0, atol=1e-9)
    # Every joint with a purpose uses most of its speed or range.
    used = np.maximum(
        np.max(np.abs(states.q - limits.middle) / limits.half, axis=0),
        np.max(np.abs(states.qd) / limits.speeds, axis=0),
    )
    assert used.max() > 0.5


@pytest.mark.parametrize('seed', range(3))
def test_a_motion_of_a_random_robot_is_within_weak_drives(seed, brief):
    links = random_chain(np.random.default_rng(seed), 3)
    dynamics = InverseDynamics(load_urdf(urdf_of(links)))
    limits = motion_limits(dynamics.robot)
    # Drives that hold the robot in its worst pose, but hardly accelerate it.
    poses = np.random.default_rng(seed).uniform(limits.lower, limits.upper, (500, 3))
    weak = np.max(np.abs(dynamics.gravity_efforts(poses)), axis=0) + 1e-3
    object.__setattr__(limits, 'efforts', weak)
    states = states_of(find_excitation(dynamics, limits))
    efforts = np.abs(dynamics.efforts(*states))
    assert (efforts <= weak).all()
    assert (np.max(efforts, axis=0) > 0.2 * weak).any()


def test_missing_limits_are_assumed_and_reported():
    limits = motion_limits(arm('effort="0" velocity="0"', 'continuous'))
    assert (limits.lower, limits.upper) == (-FRACTION * math.pi, FRACTION * math.pi)
    assert limits.speeds == FRACTION
    assert np.isinf(limits.efforts).all()
    notes = ' '.join(limits.notes)
    assert 'joints with a range of more than one turn move within one turn: hinge' in notes
    assert 'joints without a speed limit move with at most 1 rad/s or 0.25 m/s: hinge' in notes
    slide = load_urdf(ROBOTS / 'cartesian.urdf')
    assert slide.is_prismatic_joint.any()
    object.__setattr__(slide, 'lower', np.full_like(slide.lower, -np.inf))
    open_ended = motion_limits(slide)
    assert_allclose(
        open_ended.upper - open_ended.lower,
        FRACTION * np.where(slide.is_prismatic_joint, 1, 2 * math.pi),
    )
    assert (open_ended.upper <= slide.upper).all()


def test_only_chosen_joints_move_and_the_others_stay(brief):
    dynamics = dynamics_of(STANFORD)
    names = dynamics.robot.joint_names
    limits = motion_limits(dynamics.robot, names[3:1:-1])
    assert limits.joint_names == names[2:4]
    excitation = find_excitation(dynamics, limits)
    assert excitation.series.joint_names == names[2:4]
    whole = whole_states(limits, states_of(excitation))
    assert not whole.q[:, [0, 1, 4, 5]].any()
    assert not whole.qd[:, [0, 1, 4, 5]].any()


def moved_by(name, kind, parent, child, axis, mass='1'):
    """Return a link, and a joint that moves it, as URDF text."""
    inertial = (
        f'<inertial><origin xyz="0.1 0.02 0.1"/><mass value="{mass}"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return (
        f'<link name="{child}">{inertial * (mass != "0")}</link><joint name="{name}" '
        f'type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-2" upper="2" effort="500" velocity="3"/></joint>'
    )


DRIVES = (
    ('left_wheel', 'continuous', 'base', 'left', '0 1 0'),
    ('right_wheel', 'continuous', 'base', 'right', '0 1 0'),
    ('caster', 'continuous', 'base', 'fork', '0 0 1'),
    ('caster_wheel', 'continuous', 'fork', 'roll', '0 1 0'),
)
ARM = (
    ('shoulder', 'revolute', 'base', 'upper', '0 0 1'),
    ('elbow', 'revolute', 'upper', 'fore', '0 1 0'),
    ('wrist', 'continuous', 'fore', 'hand', '1 0 0'),
)
MOBILE = ''.join(moved_by(*row) for row in (*DRIVES, *ARM))
NAMES_OF_ARM = 'shoulder', 'elbow', 'wrist'


def test_wheels_do_not_move_unless_they_are_named():
    robot = load_urdf(f'<robot name="r"><link name="base"/>{MOBILE}</robot>')
    limits = motion_limits(robot)
    assert limits.joint_names == NAMES_OF_ARM
    (note,) = (note for note in limits.notes if 'do not move' in note)
    assert note.startswith(
        'joints that do not move: left_wheel, right_wheel, caster, caster_wheel'
    )
    assert motion_limits(robot, link='fore').joint_names == NAMES_OF_ARM[:2]
    assert motion_limits(robot, ['left_wheel']).joint_names == ('left_wheel',)
    # The joints of an arm turn without limits, too.
    endless = load_urdf(ROBOTS / 'continuous.urdf')
    assert motion_limits(endless).joint_names == endless.joint_names


def test_joints_that_carry_the_whole_robot_do_not_move_unless_they_are_named():
    virtual = (
        ('x', 'prismatic', 'world', 'lx', '1 0 0', '0'),
        ('y', 'prismatic', 'lx', 'ly', '0 1 0', '0'),
        ('yaw', 'continuous', 'ly', 'base', '0 0 1'),
    )
    base = ''.join(moved_by(*row) for row in virtual)
    robot = load_urdf(f'<robot name="r"><link name="world"/>{base}{MOBILE}</robot>')
    limits = motion_limits(robot)
    assert limits.joint_names == NAMES_OF_ARM
    assert 'joints that do not move: x, y, yaw' in ' '.join(limits.notes)
    # A robot of sliding joints with mass has no virtual base.
    gantry = load_urdf(ROBOTS / 'cartesian.urdf')
    assert motion_limits(gantry).joint_names == gantry.joint_names


def test_the_effort_limits_are_those_of_joints_that_the_motion_loads():
    robot = load_urdf(f'<robot name="r"><link name="base"/>{MOBILE}</robot>')
    limits = motion_limits(robot, ['elbow'])
    has_limit = np.isfinite(limits.efforts)
    names = [name for name, has in zip(robot.joint_names, has_limit, strict=True) if has]
    assert names == list(NAMES_OF_ARM)


def test_a_joint_that_cannot_move_is_named():
    robot = arm('lower="0" upper="0" velocity="2" effort="50"')
    for joints in ([], ['hinge']):
        with pytest.raises(ConfigurationError, match=r'hinge.*its range is only 0 to 0'):
            motion_limits(robot, joints)


def test_drives_that_are_too_weak_are_named():
    robot = arm('lower="-0.5" upper="0.5" velocity="2" effort="1"')
    with pytest.raises(ConfigurationError, match=r"N m.*'hinge' needs .*, limit 0.8"):
        find_excitation(InverseDynamics(robot), motion_limits(robot))


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        ({'duration': 0.0}, 'duration is 0.0, expected a finite time above 0 s'),
        ({'duration': math.inf}, 'duration is inf'),
    ],
)
def test_invalid_options_are_rejected(options, words):
    dynamics = dynamics_of(PLANAR)
    with pytest.raises(ConfigurationError, match=words):
        find_excitation(dynamics, motion_limits(dynamics.robot), **options)


# Information


@pytest.fixture(scope='module')
def planar():
    """Return an excitation motion of a planar arm."""
    dynamics = dynamics_of(PLANAR)
    return find_excitation(dynamics, motion_limits(dynamics.robot))


def test_the_information_is_more_than_that_of_random_motions(planar, rng):
    """Compared without the code of the search: random series, scaled up to the limits."""
    limits, dynamics = planar.limits, planar.unknowns.dynamics

    def log_det(series):
        states = States(*series.sample(np.arange(100) * (series.duration / 100)))
        information = planar.unknowns.information(states, series.duration)
        return np.linalg.slogdet(np.eye(len(information)) + information)[1]

    best = log_det(planar.series)
    in_search = np.linalg.slogdet(np.eye(len(planar.information)) + planar.information)[1]
    assert best == pytest.approx(in_search, abs=0.5)
    for _ in range(20):
        x = rng.normal(size=planar.series.coefficients.shape)
        x[:, 0] = 0.0
        series = FourierSeries(limits.joint_names, planar.series.duration, x)
        q, qd, _ = (np.abs(v).max(axis=0) for v in series.sample(np.linspace(0, 10, 500)))
        x /= np.maximum(q / limits.half, qd / limits.speeds)[:, np.newaxis]
        x[:, 0] = limits.middle
        efforts = np.abs(dynamics.efforts(*series.sample(np.linspace(0, 10, 500))))
        assert (efforts < limits.efforts).all()  # the same limits
        assert log_det(series) < best - 2.0


def test_expected_errors_are_those_of_simulated_recordings(planar, rng):
    """Errors of unknowns that are wrong by their usual errors before each recording."""
    unknowns = planar.unknowns
    count = round(SAMPLES_PER_SECOND * planar.series.duration)
    states = States(*planar.series.sample(np.arange(count) / SAMPLES_PER_SECOND))
    matrix = unknowns.weighted(states).reshape(-1, len(unknowns.columns))
    truth = rng.normal(size=(len(unknowns.columns), 1000))
    measured = matrix @ truth + rng.normal(size=(len(matrix), 1000))
    fitted = np.linalg.solve(np.eye(len(truth)) + matrix.T @ matrix, matrix.T @ measured)
    spread = unknowns.usual.copy()
    spread[unknowns.columns] *= np.std(fitted - truth, axis=1)
    of_joints, of_bodies = unknowns.expected_errors(planar.information)
    spread_of_joints = spread[unknowns.rigid_count :].reshape(4, -1).T
    is_known = np.isfinite(of_joints)
    assert is_known.sum() >= 6
    assert_allclose(of_joints[is_known], spread_of_joints[is_known], rtol=0.25)
    masses = spread[: unknowns.rigid_count : 10]
    usual = unknowns.usual[: unknowns.rigid_count : 10]
    # The masses of a planar arm are known through their first moments only.
    assert np.isnan(of_bodies[:, 0]).all()
    assert (masses > 0.45 * usual).all()
    assert np.isfinite(of_bodies[:, 1]).all()


def test_rounding_in_a_description_shows_no_unknown(planar):
    """A planar arm whose axes are parallel except for the rounding of its angles."""
    text = PLANAR.read_text()
    exact = load_urdf(text)
    rounded = load_urdf(
        text.replace('<origin xyz="0.4 0 0"/>', '<origin xyz="0.4 0 0" rpy="1e-6 0 0"/>')
    )
    assert not (exact.R_PL == rounded.R_PL).all()
    errors = []
    for robot in (exact, rounded):
        unknowns = Unknowns(InverseDynamics(robot), motion_limits(robot))
        information = unknowns.information(states_of(planar, 100), 10.0)
        errors.append(np.concatenate(unknowns.expected_errors(information), axis=None))
    assert np.isfinite(errors[0]).any()
    assert_allclose(*errors, rtol=1e-3)


def test_the_search_finds_the_same_motion_again(planar):
    dynamics = planar.unknowns.dynamics
    again = find_excitation(dynamics, motion_limits(dynamics.robot))
    assert (again.series.coefficients == planar.series.coefficients).all()
