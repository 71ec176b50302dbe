"""The simulated hardware has the dynamics of the model and responds to loads as the core does."""

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from loads import box_inertia, random_box
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from robot_files import OUR_ROBOTS, real_robots, ROOT

pytest.importorskip('mujoco')

from inverse_dynamics_node import InverseDynamics, load_urdf, UrdfError
from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.simulation.mujoco import MujocoRobot, SimulationError
from inverse_dynamics_node.simulation.trajectory import (
    EFFORT_USED,
    effort_used,
    Oscillation,
    plan,
    SPEED_USED,
    start_pose,
)
from simulated_arm import accelerations

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
    return MujocoRobot(robot, start_of(robot) if start is None else start, friction)


def start_of(robot):
    """Return a pose away from the limits, and from the middle, where many robots are singular."""
    bounded = np.isfinite(robot.lower)
    lower, upper = np.where(bounded, robot.lower, -1.0), np.where(bounded, robot.upper, 1.0)
    return lower + 0.6 * (upper - lower)


def state_of(simulation):
    """Return position, velocity and effort in the order of our joints."""
    order = [simulation.state_names.index(name) for name in simulation.robot.joint_names]
    return tuple(values[order] for values in simulation.state())


@pytest.fixture
def moving(urdf_path, rng):
    """Return a moving simulated robot, and the core's dynamics of the same robot."""
    simulation = simulated(urdf_path)
    dynamics = InverseDynamics(simulation.robot)
    q = start_of(simulation.robot)
    nudge = rng.uniform(0.5, 2.0, len(q)) * dynamics.mass_matrix(q).diagonal()
    simulation.command(dynamics.gravity_efforts(q) + nudge)
    simulation.advance(0.1)
    return simulation, dynamics


def assert_same(simulation, dynamics):
    """All terms agree if the efforts computed from MuJoCo's motion are those applied."""
    q, qd, applied = state_of(simulation)
    assert abs(qd).min() > 1e-4, 'the test needs velocities'
    efforts = dynamics.efforts(q, qd, accelerations(simulation))
    # MuJoCo couples mimicking joints by a constraint of high but finite stiffness.
    tolerance = 3e-2 if simulation.robot.mimic_names else 1e-9
    assert_allclose(efforts, applied, rtol=0, atol=tolerance * abs(applied).max())


class TestSameRobot:
    def test_mass_matrix_and_gravity_efforts_agree_with_the_core(self, urdf_path, rng):
        robot = load_urdf(urdf_path)
        dynamics = InverseDynamics(robot)
        q = rng.uniform(-1.0, 1.0, len(robot.joint_names))
        simulation, inertia = MujocoRobot(robot, q), dynamics.mass_matrix(q)
        gravity = dynamics.gravity_efforts(q)
        assert_allclose(simulation.mass_matrix(), inertia, rtol=1e-9, atol=1e-12)
        assert_allclose(simulation.bias_efforts(), gravity, rtol=1e-9, atol=1e-10)

    def test_inverse_dynamics_of_the_motion_gives_the_applied_efforts(self, moving):
        assert_same(*moving)

    def test_payloads_and_pushes_agree_with_the_core(self, moving, rng):
        simulation, dynamics = moving
        for link in simulation.robot.link_names:
            mass, com, box, rpy = random_box(rng)
            wrench = rng.uniform(-3.0, 3.0, (2, 3))
            for side in moving:
                side.set_payload(link, mass, com, box_inertia(mass, box, rpy))
                side.set_external_wrench(link, *wrench)
        assert_same(*moving)
        q = start_of(simulation.robot)
        before = InverseDynamics(simulation.robot).mass_matrix(q)
        assert abs(dynamics.mass_matrix(q) - before).max() > 0.01, 'the test needs a difference'

    def test_removed_payload_has_no_effect(self, moving):
        simulation, _ = moving
        accelerations(simulation)
        before = simulation.mass_matrix()
        link = simulation.robot.link_names[-1]
        for mass, is_changed in ((3.0, True), (0.0, False)):
            simulation.set_payload(link, mass, (0.1, 0.2, 0.3))
            accelerations(simulation)
            change = abs(simulation.mass_matrix() - before).max()
            assert change > 1e-3 if is_changed else change < 1e-9

    @pytest.mark.parametrize(
        'middle',
        [
            '',
            SHAPE.format(0, 0.1, 0.2, 0.2),
            SHAPE.format(1, 0, 0, 0),
            '<origin xyz="0.1 0 0.2" rpy="0.5 -0.3 1.1"/>' + SHAPE.format(1, 0.1, 0.9, 0.2),
            '<origin xyz="0.1 0 0.2" rpy="0.5 -0.3 1.1"/>' + SHAPE.format(1, -0.01, 0.2, 0.1),
        ],
        ids=['none', 'massless', 'point', 'no triangle', 'negative'],
    )
    def test_inertias_that_mujoco_rejects_are_simulated(self, middle):
        q = np.array([0.3, -0.8, 0.5])
        simulation = simulated(arm(BODY, middle, BODY), q)
        dynamics = InverseDynamics(simulation.robot)
        assert_allclose(simulation.mass_matrix(), dynamics.mass_matrix(q), rtol=1e-12)
        assert_allclose(simulation.bias_efforts(), dynamics.gravity_efforts(q), rtol=1e-12)

    def test_mimics_follow_their_master(self):
        simulation = simulated(MIMIC)
        robot = simulation.robot
        for i in range(20):
            simulation.command(np.sin(i + np.arange(len(robot.joint_names))))
            simulation.advance(0.02)
            positions = dict(zip(simulation.state_names, simulation.state()[0], strict=True))
            for body in range(1, len(robot.body_names)):
                master = robot.joint_names[robot.joint_index[body]]
                expected = robot.multiplier[body] * positions[master] + robot.offset[body]
                assert positions[robot.body_names[body]] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ('urdf', 'text'),
    [
        (arm(BODY, BODY, ''), "no mass resists the motion of joint 'j3'"),
        (
            arm(BODY, '', BODY).replace('xyz="0.3 0 0" rpy="0.4 0 0"', 'xyz="0 0 0"'),
            "joint 'j2', 'j3'",
        ),
    ],
)
def test_joints_without_inertia_of_their_own_are_named(urdf, text):
    with pytest.raises(SimulationError, match=text):
        simulated(urdf)


def test_diverging_simulation_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation = simulated(arm(BODY).replace('effort="90"', 'effort="1e200"'))
    simulation.command([1e200])
    with pytest.raises(SimulationError, match='unstable'):
        simulation.advance(1.0)
    assert not list(tmp_path.iterdir()), 'MuJoCo left a file'


def test_efforts_are_limited_and_the_last_command_applies():
    simulation = simulated(arm(BODY, BODY))
    simulation.command([500.0, -500.0])
    for _ in range(2):
        simulation.advance(0.001)
        assert_array_equal(state_of(simulation)[2], [90.0, -90.0])


def test_joints_stop_at_their_limits():
    simulation = simulated(arm(BODY, limit='lower="-0.3" upper="0.3" effort="90" velocity="3"'))
    simulation.command([90.0])
    simulation.advance(1.0)
    assert simulation.positions() == pytest.approx([0.3], abs=0.05)


def test_states_are_sorted_by_name(urdf_path):
    simulation = simulated(urdf_path)
    assert list(simulation.state_names) == sorted(simulation.state_names)
    assert set(simulation.robot.joint_names) <= set(simulation.state_names)


@pytest.mark.parametrize('friction', [True, False])
def test_friction_holds_a_joint_if_enabled(friction):
    urdf = arm(BODY, axis='0 0 1', extra='<dynamics damping="1" friction="2"/>')
    simulation = simulated(urdf.replace('rpy="0.4 0 0"', ''), [0.0], friction)
    simulation.command([1.0])
    simulation.advance(0.2)
    moved = abs(simulation.state()[0][0])
    assert moved < 1e-4 if friction else moved > 1e-2


def test_joints_without_commands_stay_and_measure_what_holds_them():
    robot = load_urdf(MIMIC)
    simulation = MujocoRobot(robot, [0.1, 0.4], friction=False, joints=['lift'])
    gravity = InverseDynamics(robot).gravity_efforts([0.1, 0.4])
    simulation.command(gravity[:1])
    simulation.advance(2.0)
    positions, _, efforts = state_of(simulation)
    assert positions == pytest.approx([0.1, 0.4], abs=0.002)
    assert abs(gravity[1]) > 0.01
    assert efforts == pytest.approx(gravity, rel=0.01)


def test_commands_come_in_the_order_of_the_given_joints():
    robot = load_urdf(MIMIC)
    simulation = MujocoRobot(robot, [0.1, 0.4], joints=robot.joint_names[::-1])
    simulation.command([0.2, 0.3])
    assert_array_equal(state_of(simulation)[2], [0.3, 0.2])


@pytest.mark.parametrize(
    ('link', 'mass', 'com', 'inertia', 'text'),
    [
        ('nope', 1.0, np.zeros(3), np.eye(3), "link 'nope' does not exist"),
        ('bob', np.nan, np.zeros(3), np.eye(3), 'mass is nan'),
        ('bob', 1.0, [0.0, np.inf, 0.0], np.eye(3), 'com is'),
        ('bob', 1.0, np.zeros(3), -np.eye(3), 'no negative principal moment'),
    ],
)
def test_loads_that_no_body_has_are_rejected(link, mass, com, inertia, text):
    simulation = simulated(PENDULUM)
    link = simulation.robot.link_names[-1] if link == 'bob' else link
    before = simulation.mass_matrix()
    with pytest.raises(ConfigurationError, match=text):
        simulation.set_payload(link, mass, com, inertia)
    with pytest.raises(ConfigurationError, match='force is'):
        simulation.set_external_wrench(link, (np.nan, 0.0, 0.0))
    accelerations(simulation)
    assert_array_equal(simulation.mass_matrix(), before)


def all_robots():
    """Return our robots, and the real ones that can be loaded."""
    paths = [*OUR_ROBOTS, *real_robots()]
    return [pytest.param(path, id=path.stem) for path in paths if loads(path)]


def loads(path):
    try:
        return len(load_urdf(path).joint_names) > 0
    except UrdfError:
        return False


@st.composite
def trajectories(draw):
    n = draw(st.integers(1, 4))

    def numbers(low, high):
        return draw(arrays(float, n, elements=st.floats(low, high)))

    moving = draw(st.floats(1.0, 30.0))
    return Oscillation(numbers(-3, 3), numbers(0, 1), numbers(0.1, 0.5), moving)


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
            r"too small .* 'j1' needs \S+ against gravity, its limit is 0\.1\. Write the limits"
        )
        with pytest.raises(SimulationError, match=message):
            start_pose(robot, InverseDynamics(robot))

    def test_robot_without_room_is_rejected(self):
        robot = load_urdf(arm(BODY, limit='lower="0.1" upper="0.1" effort="90" velocity="3"'))
        with pytest.raises(SimulationError, match='no joint can move'):
            plan(robot, InverseDynamics(robot), np.array([0.1]), 6.0)
