"""Trajectories: derived quantities, and efforts."""

import contextlib

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from inverse_dynamics_node import InverseDynamics, load_urdf, TrajectoryError
from inverse_dynamics_node.dynamics import batch
from inverse_dynamics_node.dynamics.trajectory import complete, Trajectory, trajectory_efforts
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

TIMES = np.linspace(0.0, 2.0, 41)


def cosine(times=TIMES):
    """Return positions, velocities and accelerations of a joint from 0 to 2, from rest to rest."""
    w = np.pi / 2.0
    return [x[:, None] for x in (1 - np.cos(w * times), w * np.sin(w * times))] + [
        (w * w * np.cos(w * times))[:, None]
    ]


def test_derives_velocities_and_accelerations_from_positions():
    q, qd, qdd = cosine()
    whole, derived = complete(Trajectory(('a',), TIMES, q))
    assert whole.velocities == pytest.approx(qd, abs=2e-5)
    assert whole.accelerations == pytest.approx(qdd, abs=5e-3)
    assert len(derived) == 2
    assert 'velocities' in derived[0]
    assert 'accelerations' in derived[1]


def test_derives_accelerations_from_velocities():
    q, qd, qdd = cosine()
    whole, derived = complete(Trajectory(('a',), TIMES, q, qd))
    assert whole.velocities is qd
    assert whole.accelerations == pytest.approx(qdd, abs=2e-4)
    assert derived == ('accelerations derived from a cubic spline through the velocities',)


def test_does_not_change_a_complete_trajectory():
    trajectory = Trajectory(('a',), TIMES, *cosine())
    assert complete(trajectory) == (trajectory, ())


@pytest.mark.parametrize('points', [1, 2, 3])
def test_few_points_are_enough(points):
    q = np.linspace(0.0, 1.0, points)[:, None]
    whole, _ = complete(Trajectory(('a',), TIMES[:points], q))
    assert np.isfinite(whole.accelerations).all()
    assert whole.velocities[[0, -1]] == pytest.approx(0.0, abs=1e-12)


def test_irregular_times_are_accepted():
    times = np.cumsum(np.random.default_rng(3).uniform(0.02, 0.08, 41))
    times *= 2.0 / times[-1]
    times[0] = 0.0
    q, qd, _ = cosine(times)
    whole, _ = complete(Trajectory(('a',), times, q))
    assert whole.velocities == pytest.approx(qd, abs=2e-4)


def test_efforts_equal_those_of_each_point_by_name():
    dynamics = InverseDynamics(load_urdf(STANFORD))
    rng = np.random.default_rng(5)
    q, qd, qdd = rng.uniform(-1.0, 1.0, (3, 7, 6))
    order = [4, 2, 0, 1, 5, 3]
    names = tuple(dynamics.robot.joint_names[i] for i in order)
    trajectory = Trajectory(names, TIMES[:7], q[:, order], qd[:, order], qdd[:, order])
    expected = [dynamics.efforts(*state)[order] for state in zip(q, qd, qdd, strict=True)]
    assert trajectory_efforts(dynamics, trajectory) == pytest.approx(np.array(expected))


def test_other_joints_rest_at_their_positions():
    robot = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
    dynamics = InverseDynamics(robot)
    trajectory = Trajectory(robot.joint_names[:1], TIMES, *cosine())
    others = np.array([9.0, 0.7])
    k = 11
    expected = dynamics.efforts(
        [trajectory.positions[k, 0], 0.7],
        [trajectory.velocities[k, 0], 0.0],
        [trajectory.accelerations[k, 0], 0.0],
    )
    efforts = trajectory_efforts(dynamics, trajectory, others)
    assert efforts.shape == (41, 1)
    assert efforts[k, 0] == pytest.approx(expected[0])


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'times': np.empty(0), 'positions': np.empty((0, 1))}, 'no points'),
        ({'times': TIMES[::-1]}, '1.95 s, expected a time later than 2 s, the time of point 0'),
        ({'times': np.zeros(41)}, 'point 1 is at 0 s, expected a time later than'),
        ({'times': np.full(41, np.nan)}, 'one of the times is nan'),
        ({'positions': np.zeros((41, 2))}, r'positions have shape \(41, 2\), expected \(41, 1\)'),
        ({'velocities': np.full((41, 1), np.inf)}, "velocities of joint 'a' are inf at point 0"),
    ],
)
def test_rejects_invalid_trajectories(change, words):
    trajectory = Trajectory(('a',), TIMES, *cosine())._replace(**change)
    with pytest.raises(TrajectoryError, match=words):
        complete(trajectory)


@pytest.mark.parametrize(
    ('names', 'words'),
    [
        ((), 'no joint names'),
        (('nope',), "joint 'nope' does not exist; joints are joint_1"),
        (('joint_1', 'joint_1'), "'joint_1' is named twice"),
    ],
)
def test_rejects_invalid_joint_names(names, words):
    q = np.zeros((2, len(names)))
    with pytest.raises(TrajectoryError, match=words):
        trajectory_efforts(
            InverseDynamics(load_urdf(STANFORD)), Trajectory(names, TIMES[:2], q, q, q)
        )


@given(
    arrays(float, (4, 1), elements=st.floats(-1e308, 1e308)),
    arrays(float, 3, elements=st.floats(1e-9, 1e9)),
    st.booleans(),
)
def test_finite_trajectories_are_completed_or_rejected(numbers, steps, has_velocities):
    times = np.concatenate([[0.0], np.cumsum(steps)])
    velocities = numbers[::-1] if has_velocities else None
    with contextlib.suppress(TrajectoryError):
        whole, _ = complete(Trajectory(('a',), times, numbers, velocities))
        assert np.isfinite(whole.velocities).all()
        assert np.isfinite(whole.accelerations).all()


def test_overflowing_splines_are_rejected():
    jumps = np.array([[1e308], [-1e308], [1e308]])
    with pytest.raises(TrajectoryError, match='too far apart for the time between'):
        complete(Trajectory(('a',), np.array([0.0, 1e-9, 2e-9]), jumps))


def test_a_long_trajectory_compiles_nothing(monkeypatch):
    dynamics = InverseDynamics(load_urdf(STANFORD))
    states = np.random.default_rng(6).uniform(-1.0, 1.0, (3, 200, 6))
    names = dynamics.robot.joint_names
    expected = dynamics.efforts(*states)

    def compile_now(*_):
        raise AssertionError('in a control loop')

    monkeypatch.setattr(batch, 'inverse_dynamics_many', compile_now)
    efforts = trajectory_efforts(dynamics, Trajectory(names, np.arange(200.0), *states))
    assert efforts == pytest.approx(expected)
