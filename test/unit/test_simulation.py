"""The simulated hardware has the dynamics of the URDF and responds to loads as the core does."""

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from loads import box_inertia, random_box
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from robot_files import OUR_ROBOTS, real_robots, ROOT

pytest.importorskip('mujoco')

from accelerated_robot import AcceleratedRobot
from inverse_dynamics_node import InverseDynamics, load_urdf, UrdfError
from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot
from inverse_dynamics_node.simulation.mujoco.model import SimulationError
from inverse_dynamics_node.simulation.mujoco.world import rotation, Tilt
from inverse_dynamics_node.simulation.trajectory import (
    EFFORT_USED,
    effort_used,
    Oscillation,
    plan,
    SPEED_USED,
    start_pose,
)

CARTESIAN = ROOT / 'test' / 'robots' / 'cartesian.urdf'
MIMIC = ROOT / 'test' / 'robots' / 'mimic_gripper.urdf'
PENDULUM = ROOT / 'test' / 'robots' / 'pendulum.urdf'
SHAPE = '<mass value="{}"/><inertia ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/>'
BODY = '<origin xyz="0.1 0.02 0.05"/>' + SHAPE.format(2, 0.3, 0.2, 0.25)


def arm(*inertials, axis='0 1 0', extra='', limit='lower="-2" upper="2" effort="90" velocity="3"'):
    """Write a URDF of a chain: one revolute joint per link, j1 and so on, 0.3 m apart."""
    text = '<robot name="arm"><link name="base"/>'
    for i, inertial in enumerate(inertials, start=1):
        parent = f'l{i - 1}' if i > 1 else 'base'
        text += (
            f'<link name="l{i}">{inertial and f"<inertial>{inertial}</inertial>"}</link>'
            f'<joint name="j{i}" type="revolute"><origin xyz="0.3 0 0" rpy="0.4 0 0"/>'
            f'<parent link="{parent}"/><child link="l{i}"/><axis xyz="{axis}"/>'
            f'<limit {limit}/>{extra}</joint>'
        )
    return f'{text}</robot>'


def simulated(urdf, start=None, friction=False):
    robot = load_urdf(urdf)
    return AcceleratedRobot(urdf, robot, start_of(robot) if start is None else start, friction)


def start_of(robot):
    """Return a pose away from the limits, and from the middle, where many robots are singular."""
    bounded = np.isfinite(robot.lower)
    lower, upper = np.where(bounded, robot.lower, -1.0), np.where(bounded, robot.upper, 1.0)
    return lower + 0.6 * (upper - lower)


def state_of(simulation):
    """Return position, velocity and effort in the order of our joints."""
    order = [simulation.state_names.index(name) for name in simulation.robot.joint_names]
    return tuple(values[order] for values in simulation.state())


def all_robots():
    """Return our robots, and the real ones that can be loaded."""
    paths = [*OUR_ROBOTS, *real_robots()]
    return [pytest.param(path, id=path.stem) for path in paths if loads(path)]


def loads(path):
    try:
        return len(load_urdf(path).joint_names) > 0
    except UrdfError:
        return False


class TestSameRobot:
    def test_mass_matrix_and_gravity_efforts_agree_with_the_core(self, urdf_path, rng):
        robot = load_urdf(urdf_path)
        dynamics = InverseDynamics(robot)
        q = rng.uniform(-1.0, 1.0, len(robot.joint_names))
        simulation = simulated(urdf_path, q)
        inertia = dynamics.mass_matrix(q)
        assert_allclose(simulation.mass_matrix(), inertia, rtol=1e-9, atol=1e-12)
        assert_allclose(
            simulation.bias_efforts(), dynamics.gravity_efforts(q), rtol=1e-9, atol=1e-10
        )

    def test_inverse_dynamics_of_the_motion_gives_the_applied_efforts(self, urdf_path, rng):
        """All terms agree if the efforts computed from MuJoCo's motion are those applied."""
        robot = load_urdf(urdf_path)
        dynamics = InverseDynamics(robot)
        simulation = simulated(urdf_path)
        simulation.brakes_on = False
        q = start_of(robot)
        nudge = rng.uniform(0.5, 2.0, len(q)) * dynamics.mass_matrix(q).diagonal()
        simulation.command(dynamics.gravity_efforts(q) + nudge)
        simulation.advance(0.2)
        simulation.command(dynamics.gravity_efforts(q) - nudge)
        q, qd, applied = state_of(simulation)
        assert abs(qd).min() > 1e-3, 'the test needs velocities'
        efforts = dynamics.efforts(q, qd, simulation.accelerations())
        # MuJoCo couples mimicking joints by a constraint of high but finite stiffness.
        tolerance = 1e-9 if len(simulation.state_names) == len(q) else 2e-2
        assert_allclose(efforts, applied, rtol=0, atol=tolerance * abs(applied).max())

    def test_quaternions_rotate_the_links(self):
        rotated = arm(BODY, BODY).replace('rpy="0.4 0 0"', 'quat_xyzw="{} 0 0 {}"')
        half = 0.5 * 0.4 * np.array([1.0, 1.0])
        words = np.array([np.sin(half), np.cos(half)]).T.ravel().tolist()
        urdf = rotated.format(*words).replace('name="arm"', 'name="arm" version="1.1"')
        q = np.array([0.3, -0.8])
        inertia = simulated(urdf, q).mass_matrix()
        assert_allclose(inertia, simulated(arm(BODY, BODY), q).mass_matrix(), rtol=1e-9)
        assert_allclose(inertia, InverseDynamics(load_urdf(urdf)).mass_matrix(q), rtol=1e-9)

    @pytest.mark.parametrize(
        'middle',
        [
            '',
            SHAPE.format(0, 0, 0, 0),
            SHAPE.format(0, 0.1, 0.2, 0.2),
            SHAPE.format(1, 0, 0, 0),
            '<origin xyz="0.1 0 0.2" rpy="0.5 -0.3 1.1"/>' + SHAPE.format(1, 0.1, 0.9, 0.2),
            '<origin xyz="0.1 0 0.2" rpy="0.5 -0.3 1.1"/>' + SHAPE.format(1, -0.01, 0.2, 0.1),
        ],
        ids=['none', 'zero', 'massless', 'point', 'no triangle', 'negative'],
    )
    def test_inertias_that_mujoco_rejects_are_simulated(self, middle):
        urdf = arm(BODY, middle, BODY)
        q = np.array([0.3, -0.8, 0.5])
        simulation = simulated(urdf, q)
        dynamics = InverseDynamics(load_urdf(urdf))
        assert_allclose(simulation.mass_matrix(), dynamics.mass_matrix(q), rtol=1e-12)
        assert_allclose(simulation.bias_efforts(), dynamics.gravity_efforts(q), rtol=1e-12)

    def test_shapes_are_ignored(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        shape = '<visual><geometry><mesh filename="package://none/x.stl"/></geometry></visual>'
        urdf = arm(BODY).replace('</inertial>', f'</inertial>{shape}')
        assert_array_equal(simulated(urdf).mass_matrix(), simulated(arm(BODY)).mass_matrix())
        assert not list(tmp_path.iterdir()), 'MuJoCo left a file'

    def test_default_namespace_makes_no_difference(self):
        urdf = arm(BODY).replace('<robot ', '<robot xmlns="http://www.ros.org" ')
        assert_array_equal(simulated(urdf).mass_matrix(), simulated(arm(BODY)).mass_matrix())

    def test_mimics_follow_their_master(self):
        simulation = simulated(MIMIC)
        robot = simulation.robot
        simulation.brakes_on = False
        for i in range(20):
            simulation.command(np.sin(i + np.arange(len(robot.joint_names))))
            simulation.advance(0.02)
            positions = dict(zip(simulation.state_names, simulation.state()[0], strict=True))
            for body in range(1, len(robot.body_names)):
                master = robot.joint_names[robot.joint_index[body]]
                expected = robot.multiplier[body] * positions[master] + robot.offset[body]
                assert positions[robot.body_names[body]] == pytest.approx(expected, abs=1e-5)


class TestRefusals:
    def test_joint_without_inertia_is_named(self):
        with pytest.raises(SimulationError, match=r"no mass resists the motion of joint 'j3'"):
            simulated(arm(BODY, BODY, ''))

    def test_joints_that_move_the_same_mass_are_named(self):
        urdf = arm(BODY, '', BODY).replace('xyz="0.3 0 0" rpy="0.4 0 0"', 'xyz="0 0 0"')
        with pytest.raises(SimulationError, match=r"joint 'j2', 'j3'"):
            simulated(urdf)

    def test_mujoco_versions_that_misread_urdfs_are_rejected(self, monkeypatch):
        monkeypatch.setattr('mujoco.__version__', '3.9.0')
        with pytest.raises(SimulationError, match=r'3\.9\.0, expected 3\.17'):
            simulated(PENDULUM)

    def test_diverging_simulation_is_an_error(self):
        urdf = arm(BODY).replace('effort="90"', 'effort="1e200"')
        simulation = simulated(urdf)
        simulation.brakes_on = False
        simulation.command([1e200])
        with pytest.raises(SimulationError, match='unstable'):
            simulation.advance(1.0)


class TestDrives:
    def test_brakes_hold_against_any_effort(self, urdf_path):
        simulation = simulated(urdf_path)
        before = simulation.state()
        simulation.command(np.ones(len(simulation.robot.joint_names)))
        simulation.advance(0.5)
        assert_array_equal(simulation.state()[:2], before[:2])

    def test_without_brakes_gravity_acts(self):
        simulation = simulated(PENDULUM, [0.5])
        simulation.brakes_on = False
        simulation.advance(0.1)
        assert abs(simulation.state()[1]) > 0.1

    def test_efforts_are_limited(self):
        simulation = simulated(arm(BODY, BODY))
        simulation.command([500.0, -500.0])
        assert_array_equal(state_of(simulation)[2], [90.0, -90.0])

    def test_last_command_is_held(self):
        simulation = simulated(PENDULUM, [0.0])
        simulation.brakes_on = False
        simulation.command([0.01])
        simulation.advance(0.1)
        simulation.advance(0.1)
        assert_array_equal(simulation.state()[2], [0.01])

    def test_states_are_sorted_by_name(self, urdf_path):
        simulation = simulated(urdf_path)
        assert list(simulation.state_names) == sorted(simulation.state_names)
        assert set(simulation.robot.joint_names) <= set(simulation.state_names)

    @pytest.mark.parametrize('friction', [True, False])
    def test_friction_holds_a_joint_if_enabled(self, friction):
        urdf = arm(BODY, axis='0 0 1', extra='<dynamics damping="1" friction="2"/>')
        simulation = simulated(urdf.replace('rpy="0.4 0 0"', ''), [0.0], friction)
        simulation.brakes_on = False
        simulation.command([1.0])
        simulation.advance(0.2)
        moved = abs(simulation.state()[0][0])
        assert moved < 1e-4 if friction else moved > 1e-2


@st.composite
def trajectories(draw):
    n = draw(st.integers(1, 4))

    def numbers(low, high):
        return draw(arrays(float, n, elements=st.floats(low, high)))

    moving = draw(st.floats(1.0, 30.0))
    return Oscillation(numbers(-3, 3), numbers(0, 1), numbers(0.1, 0.5), moving)


class TestWorld:
    """Loads on the simulated robot act as the same loads do in the core."""

    @pytest.fixture
    def moving(self, urdf_path, rng):
        """Return a moving simulated robot, and the core's dynamics of the same robot."""
        robot = load_urdf(urdf_path)
        if not robot.joint_names:
            pytest.skip('nothing moves')
        simulation = simulated(urdf_path)
        simulation.brakes_on = False
        dynamics = InverseDynamics(robot)
        q = start_of(robot)
        nudge = rng.uniform(0.5, 2.0, len(q)) * dynamics.mass_matrix(q).diagonal()
        simulation.command(dynamics.gravity_efforts(q) + nudge)
        simulation.advance(0.1)
        return simulation, dynamics

    def assert_same(self, moving):
        """Compare the applied efforts with those that the core computes from the motion."""
        simulation, dynamics = moving
        q, qd, applied = state_of(simulation)
        efforts = dynamics.efforts(q, qd, simulation.accelerations())
        # MuJoCo couples mimicking joints by a constraint of high but finite stiffness.
        has_mimics = len(simulation.state_names) > len(q)
        tolerance = 3e-2 if has_mimics else 1e-9
        assert_allclose(efforts, applied, rtol=0, atol=tolerance * abs(applied).max())

    def test_payload_agrees_with_the_core(self, moving, rng):
        simulation, dynamics = moving
        for link in simulation.robot.link_names:
            mass, com, box, rpy = random_box(rng)
            for side in (simulation.world, dynamics):
                side.set_payload(link, mass, com, box_inertia(mass, box, rpy))
        q = start_of(simulation.robot)
        self.assert_same(moving)
        before = InverseDynamics(simulation.robot).mass_matrix(q)
        assert abs(dynamics.mass_matrix(q) - before).max() > 0.01, 'the test needs a difference'

    def test_removed_payload_has_no_effect(self, moving):
        simulation, _ = moving
        simulation.accelerations()
        before = simulation.mass_matrix()
        link = simulation.robot.link_names[-1]
        simulation.world.set_payload(link, 3.0, (0.1, 0.2, 0.3))
        simulation.accelerations()
        assert abs(simulation.mass_matrix() - before).max() > 1e-3
        simulation.world.set_payload(link, 0.0)
        simulation.accelerations()
        assert_allclose(simulation.mass_matrix(), before, rtol=1e-9, atol=1e-12)

    def test_push_agrees_with_the_core(self, moving, rng):
        simulation, dynamics = moving
        for link in simulation.robot.link_names:
            wrench = rng.uniform(-3.0, 3.0, (2, 3))
            for side in (simulation.world, dynamics):
                side.set_external_wrench(link, *wrench)
        self.assert_same(moving)

    def test_rotating_base_agrees_with_the_core(self, moving, rng):
        simulation, dynamics = moving
        gravity, omega, omega_dot = rng.uniform(-3.0, 3.0, (3, 3))
        simulation.world.set_base_motion(gravity, omega, omega_dot)
        dynamics.set_gravity(gravity)
        dynamics.set_base_motion(omega, omega_dot)
        self.assert_same(moving)

    def test_push_along_an_axis_moves_the_joint_in_its_direction(self):
        simulation = simulated(CARTESIAN)
        simulation.brakes_on = False
        robot = simulation.robot
        simulation.command(InverseDynamics(robot).gravity_efforts(start_of(robot)))
        before = state_of(simulation)[0]
        simulation.world.set_external_wrench(robot.link_names[-1], (5.0, -5.0, 0.0))
        simulation.advance(0.1)
        moved = state_of(simulation)[0] - before
        axes = [robot.axis[robot.body_names.index(name)] for name in robot.joint_names]
        assert moved[np.argmax(np.abs(axes), axis=0)[0]] > 1e-4
        assert moved[np.argmax(np.abs(axes), axis=0)[1]] < -1e-4

    def test_unknown_link_is_reported(self):
        simulation = simulated(PENDULUM)
        with pytest.raises(SimulationError, match="link 'nope' does not exist; links are"):
            simulation.world.set_payload('nope', 1.0)

    @pytest.mark.parametrize(
        ('mass', 'com', 'inertia', 'text'),
        [
            (np.nan, np.zeros(3), np.eye(3), 'mass is nan'),
            (-1.0, np.zeros(3), np.eye(3), r'mass is -1\.0'),
            (1.0, [0.0, np.inf, 0.0], np.eye(3), 'com is'),
            (1.0, np.zeros(3), -np.eye(3), 'no negative principal moment'),
        ],
    )
    def test_loads_that_no_body_has_are_rejected(self, mass, com, inertia, text):
        simulation = simulated(PENDULUM)
        link = simulation.robot.link_names[-1]
        before = simulation.mass_matrix()
        with pytest.raises(ConfigurationError, match=text):
            simulation.world.set_payload(link, mass, com, inertia)
        with pytest.raises(ConfigurationError, match='force is'):
            simulation.world.set_external_wrench(link, (np.nan, 0.0, 0.0))
        simulation.accelerations()
        assert_array_equal(simulation.mass_matrix(), before)

    def test_held_joints_stay_and_are_not_commanded(self):
        robot = load_urdf(MIMIC)
        simulation = MujocoRobot(MIMIC, robot, [0.1, 0.4], friction=False, held=['right_finger'])
        simulation.brakes_on = False
        assert simulation.command_names == ('lift',)
        gravity = InverseDynamics(robot).gravity_efforts([0.1, 0.4])
        simulation.command(gravity[:1])
        simulation.advance(2.0)
        positions, _, efforts = state_of(simulation)
        assert positions == pytest.approx([0.1, 0.4], abs=0.002)
        assert abs(gravity[1]) > 0.01
        assert efforts == pytest.approx(gravity, rel=0.01)  # a held joint measures what holds it

    def test_unknown_held_joint_is_reported(self):
        with pytest.raises(SimulationError, match="joint 'nope' does not exist; joints are"):
            MujocoRobot(PENDULUM, load_urdf(PENDULUM), [0.0], held=['nope'])

    def test_brakes_stop_a_moving_joint(self):
        simulation = simulated(PENDULUM, [0.5])
        simulation.brakes_on = False
        simulation.advance(0.1)
        simulation.brakes_on = True
        simulation.advance(0.1)
        assert simulation.state()[1] == [0.0]


class TestTilt:
    def test_base_turns_to_an_attitude_and_stays(self):
        tilt = Tilt()
        assert_array_equal(tilt.motion(5.0)[0], [0.0, 0.0, -9.80665])
        tilt.turn_to([0.5, 0.0, 0.0], 10.0)
        gravity, omega, omega_dot = tilt.motion(20.0)
        assert_allclose(gravity, 9.80665 * np.array([0.0, -np.sin(0.5), -np.cos(0.5)]))
        assert_array_equal([omega, omega_dot], np.zeros((2, 3)))

    def test_successive_turns_reach_their_attitudes(self):
        tilt = Tilt()
        for i, attitude in enumerate([[0.5, 0.2, 0.0], [0.0, -0.3, 1.0], [0.0, 0.0, 0.0]]):
            tilt.turn_to(attitude, 10.0 * i)
            assert_allclose(tilt.attitude(10.0 * i + 9.0), rotation(attitude), atol=1e-12)

    @given(time=st.floats(10.01, 12.99))
    def test_motion_is_the_derivative_of_the_attitude(self, time):
        tilt = Tilt()
        tilt.turn_to([0.5, 0.2, -0.1], 0.0)
        tilt.turn_to([-0.2, 0.4, 0.3], 10.0)
        step = 1e-5
        before, now, after = (tilt.attitude(time + step * i) for i in (-1, 0, 1))
        gravity, omega, omega_dot = tilt.motion(time)
        turning = now.T @ (after - before) / (2 * step)
        assert_allclose(turning, np.cross(np.eye(3), omega), atol=1e-8)
        assert_allclose(gravity, now.T @ [0.0, 0.0, -9.80665])
        faster = (tilt.motion(time + step)[1] - tilt.motion(time - step)[1]) / (2 * step)
        assert_allclose(omega_dot, faster, atol=1e-8)


class TestTrajectory:
    @given(trajectory=trajectories(), fraction=st.floats(-0.1, 1.1))
    def test_derivatives_agree_with_differences(self, trajectory, fraction):
        step = 1e-5
        times = fraction * trajectory.moving + np.array([-step, 0.0, step])
        q, qd, qdd = trajectory.sample(times)
        assert_allclose((q[2] - q[0]) / (2 * step), qd[1], atol=1e-6)
        assert_allclose((qd[2] - qd[0]) / (2 * step), qdd[1], atol=2e-2)  # where jerk jumps

    @given(trajectory=trajectories(), after=st.floats(0.0, 100.0))
    def test_rests_at_its_start_before_and_after(self, trajectory, after):
        for time in (-after, 0.0, trajectory.moving, trajectory.moving + after):
            q, qd, qdd = trajectory.sample(time)
            assert_allclose(q, trajectory.start, atol=1e-9)
            assert_allclose(qd, 0.0, atol=1e-9)
            assert_allclose(qdd, 0.0, atol=1e-7)

    @given(trajectory=trajectories())
    def test_never_exceeds_its_swing(self, trajectory):
        q, _, _ = trajectory.sample(np.linspace(0.0, trajectory.moving, 500))
        assert (abs(q - trajectory.start) <= trajectory.swing + 1e-12).all()

    @pytest.mark.parametrize('path', all_robots())
    def test_plan_is_within_the_limits_of_any_robot(self, path):
        robot = load_urdf(path)
        dynamics = InverseDynamics(robot)
        try:
            start = start_pose(robot, dynamics)
            trajectory = plan(robot, dynamics, start, moving=6.0)
        except SimulationError:
            assert path not in OUR_ROBOTS
            return  # too weak, or no room; other tests check the messages
        q, qd, qdd = trajectory.sample(np.linspace(0.0, 6.0, 1000))
        assert (q >= robot.lower).all()
        assert (q <= robot.upper).all()
        assert (abs(qd) <= SPEED_USED * robot.velocity_limits).all()
        # The planner checks the efforts at some times only.
        assert effort_used(robot, dynamics.efforts(q, qd, qdd)) <= EFFORT_USED + 0.05
        assert trajectory.swing.max() > 0.005

    def test_weak_drives_are_named(self):
        robot = load_urdf(arm(BODY, limit='lower="-0.2" upper="0.2" effort="0.1" velocity="3"'))
        message = (
            r"too small .* 'j1' needs \S+ \(limit: 0\.1\) N m against gravity\. Write the limits"
        )
        with pytest.raises(SimulationError, match=message):
            start_pose(robot, InverseDynamics(robot))

    def test_robot_without_room_is_rejected(self):
        robot = load_urdf(arm(BODY, limit='lower="0.1" upper="0.1" effort="90" velocity="3"'))
        with pytest.raises(SimulationError, match='no joint can move'):
            plan(robot, InverseDynamics(robot), np.array([0.1]), 6.0)
