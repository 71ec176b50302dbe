"""The requirements of a trajectory, and states between its points."""

from inverse_dynamics_node.analysis.sizing import effort_requirements
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.dynamics.trajectory import (
    complete,
    refine,
    Trajectory,
)
from inverse_dynamics_node.errors import TrajectoryError
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import STANFORD

ARM = InverseDynamics(load_urdf(STANFORD))


def swing(count=400, names=('joint_4', 'joint_2')):
    """Go to and fro, with all derivatives given."""
    times = np.linspace(0.0, 2.0, count)
    phase = np.pi * times[:, np.newaxis] * [1.0, 2.0]
    w = np.pi * np.array([1.0, 2.0])
    return Trajectory(names, times, np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase))


def test_results_match_their_definitions():
    trajectory = swing()
    requirements = effort_requirements(ARM, trajectory)
    q, qd, qdd = np.zeros((3, 400, 6))
    for whole, part in zip((q, qd, qdd), trajectory[2:], strict=True):
        whole[:, [3, 1]] = part
    efforts = ARM.efforts(q, qd, qdd)[:, [3, 1]]
    assert requirements.efforts == pytest.approx(efforts)
    assert sum(requirements.terms) == pytest.approx(efforts)
    assert np.abs(requirements.peak) == pytest.approx(np.max(np.abs(efforts), axis=0))
    power = efforts * trajectory.velocities
    assert requirements.power == pytest.approx(np.max(power, axis=0))
    assert requirements.braking == pytest.approx(-np.min(power, axis=0))
    assert requirements.speed == pytest.approx([np.pi, 2.0 * np.pi])
    assert requirements.is_beyond['speed'].tolist() == [False, True]
    for k in range(2):
        at = np.searchsorted(trajectory.times, requirements.peak_time[k])
        assert efforts[at, k] == requirements.peak[k]


def test_means_do_not_depend_on_the_spacing_of_points():
    def lowered(times):
        times = times[:, np.newaxis]
        return Trajectory(
            ('joint_2',), times[:, 0], -0.75 * times, np.full_like(times, -0.75), 0.0 * times
        )

    even = effort_requirements(ARM, lowered(np.linspace(0.0, 2.0, 2001)))
    # The first half, with smaller efforts, has ten times as many points.
    fine, coarse = np.linspace(0.0, 1.0, 5000, endpoint=False), np.linspace(1.0, 2.0, 500)
    uneven = effort_requirements(ARM, lowered(np.concatenate([fine, coarse])))
    assert uneven.rms == pytest.approx(even.rms, rel=1e-3)
    assert np.sqrt(np.mean(uneven.efforts**2)) < 0.8 * even.rms


def test_a_single_point_has_requirements():
    point = Trajectory(('joint_2',), np.zeros(1), np.array([[-1.5]]))
    requirements = effort_requirements(ARM, complete(point)[0])
    assert requirements.rms == pytest.approx(np.abs(requirements.peak))
    assert requirements.power == requirements.braking == 0.0


def test_exceeded_limits_are_marked():
    trajectory = Trajectory(('joint_2',), np.array([0.0, 0.1]), np.array([[0.0], [2.5]]))
    requirements = effort_requirements(ARM, refine(complete(trajectory)[0], 0.001)[0])
    assert all(each.all() for each in requirements.is_beyond.values())
    calm = effort_requirements(ARM, complete(trajectory._replace(positions=np.zeros((2, 1))))[0])
    assert not any(each.any() for each in calm.is_beyond.values())


def test_refining_keeps_the_points_and_follows_the_curve():
    coarse, exact = swing(21), swing(2001)
    fine, points = refine(coarse, 0.001)
    assert fine.times[points] == pytest.approx(coarse.times)
    assert np.array_equal(fine.positions[points], coarse.positions)
    assert np.array_equal(fine.accelerations[points], coarse.accelerations)
    assert np.max(np.diff(fine.times)) <= 0.001 + 1e-12
    assert fine.times == pytest.approx(exact.times)
    assert fine.positions == pytest.approx(exact.positions, abs=1e-5)
    assert fine.accelerations == pytest.approx(exact.accelerations, abs=0.1)


def test_refining_a_derived_spline_changes_nothing():
    from scipy.interpolate import CubicSpline

    times = np.array([0.0, 0.4, 1.0, 1.3])
    positions = np.array([[0.0], [0.5], [-0.2], [0.1]])
    fine, _ = refine(complete(Trajectory(('joint_1',), times, positions))[0], 0.01)
    spline = CubicSpline(times, positions, bc_type='clamped')
    assert fine.positions == pytest.approx(spline(fine.times))
    assert fine.velocities == pytest.approx(spline(fine.times, 1))
    assert fine.accelerations == pytest.approx(spline(fine.times, 2), abs=1e-9)


def test_refining_does_not_change_a_fine_trajectory():
    trajectory = swing()
    fine, points = refine(trajectory, np.inf)
    assert fine is trajectory
    assert points.tolist() == list(range(400))
    one = complete(Trajectory(('joint_1',), np.zeros(1), np.zeros((1, 1))))[0]
    assert refine(one, 0.01)[1].tolist() == [0]
    with pytest.raises(TrajectoryError, match='lacks velocities or accelerations'):
        refine(trajectory._replace(accelerations=None), 0.01)
