"""Position controller, hand-over to commands, and supervision of the velocities of a robot."""

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

pytest.importorskip('mujoco')
from inverse_dynamics_node.simulation.drivers import Actuation, Command, IDEAL
from inverse_dynamics_node.simulation.hand_over import HandOver, LONGEST, velocity_bounds
from inverse_dynamics_node.simulation.mujoco import MujocoRobot

START = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
PERIOD = 0.002
RELEASE = 0.1


def link(name, mass, com, inertia):
    tensor = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<mass value="{mass}"/><origin xyz="{com} 0 0"/>{tensor}'
    return f'<link name="{name}"><inertial>{inertial}</inertial></link>'


def joint(name, parent, child, attributes, kind='revolute', axis='0 1 0', xyz='0.2 0 0'):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit {attributes}/></joint>'
    )


RANGE = 'lower="-2" upper="2"'
LIGHT_WRIST = (
    '<robot name="light_wrist"><link name="base"/>'
    + link('upper', 1.0, 0.1, 0.005)
    + link('fore', 0.5, 0.1, 0.002)
    + link('wrist', 0.4, 0.02, 0.0001)
    + link('hand', 0.7, 0.01, 0.0002)
    + link('finger', 0.01, 0.02, 1e-7)
    + joint('turn', 'base', 'upper', 'effort="80" velocity="0.63"', 'continuous', '0 0.6 0.8')
    + joint('bend', 'upper', 'fore', f'{RANGE} effort="40" velocity="0.63"')
    + joint('roll', 'fore', 'wrist', 'effort="20" velocity="0.84"', 'continuous', '1 0 0')
    + joint('pitch', 'wrist', 'hand', 'effort="20" velocity="0.84"', 'continuous', xyz='0 0 0')
    + joint('grip', 'hand', 'finger', f'{RANGE} effort="25" velocity="0"', axis='0 0 1')
    + '</robot>'
)
ROBOTS = {
    'light wrist': LIGHT_WRIST,
    **{path.stem: path for path in [STANFORD, ROOT / 'test' / 'robots' / 'gripper_arm.urdf']},
    'mimic_gripper': ROOT / 'test' / 'robots' / 'mimic_gripper.urdf',
    'cartesian': ROOT / 'test' / 'robots' / 'cartesian.urdf',
}


class Log:
    """Stores what is logged."""

    def __init__(self):
        self.infos, self.errors = [], []
        self.info, self.error = self.infos.append, self.errors.append


class Bench:
    """A simulated robot, and a controller that sends a command for every state."""

    def __init__(self, urdf, start=None, sways=False):
        self.robot = load_urdf(urdf)
        self.dynamics = InverseDynamics(self.robot)
        inside = np.clip(0.1, self.robot.lower + 0.05, self.robot.upper - 0.05)
        self.start = inside if start is None else start
        self.simulation = MujocoRobot(self.robot, self.start, friction=False)
        self.log = Log()
        actuation = Actuation(self.simulation, IDEAL)
        self.hand_over = HandOver(actuation, self.log, sways, RELEASE)
        self.bounds = velocity_bounds(self.robot)
        self.now = 0.0

    def gravity(self, factor=1.0):
        """Return the efforts that hold the robot, times a factor."""
        return factor * self.dynamics.gravity_efforts(self.simulation.positions())

    def run(self, duration, command=None):
        """Advance; return positions and velocities. Without a command none are sent."""
        rows = []
        end = self.now + duration
        while self.now < end:
            if command is not None:
                self.hand_over.command(Command(command()), self.now)
            self.hand_over.advance(self.now, PERIOD)
            self.now += PERIOD
            rows.append((self.simulation.positions(), self.simulation.velocities()))
        return (np.array(part) for part in zip(*rows, strict=True))

    def release(self):
        """Let the robot follow commands that hold it."""
        self.run(0.3, self.gravity)
        assert self.log.infos == ['the robot follows the commands']


def measured(bench):
    order = [bench.simulation.state_names.index(name) for name in bench.robot.joint_names]
    return bench.simulation.state()[2][order]


@pytest.mark.parametrize('load', [0.0, 2.0])
def test_the_position_controller_holds_the_arm_with_real_efforts(load):
    bench = Bench(STANFORD, START)
    unloaded = bench.gravity()
    for side in (bench.simulation, bench.dynamics):
        side.set_payload('link_6', load, [0.0, 0.0, 0.1], np.eye(3) * 1e-3)
    positions, _ = bench.run(0.5)
    assert positions[-1] == pytest.approx(START, abs=1e-3)
    assert abs(bench.gravity()).max() > 10.0
    assert (abs(bench.gravity() - unloaded).max() > 5.0) == (load > 0.0)
    assert measured(bench) == pytest.approx(bench.gravity(), abs=0.05)


def test_every_joint_sways_within_its_limits_until_commands_arrive():
    bench = Bench(STANFORD, START, sways=True)
    positions, velocities = bench.run(8.0)
    assert (np.ptp(positions, axis=0) > [0.2] * 2 + [0.05] + [0.2] * 3).all()
    assert (positions > bench.robot.lower).all()
    assert (positions < bench.robot.upper).all()
    assert abs(np.diff(positions, axis=0)).max() < 1e-3
    assert abs(velocities[-1]).max() > 1e-2
    positions, _ = bench.run(0.09, bench.gravity)
    assert not bench.log.infos
    assert np.ptp(positions, axis=0).max() < 1e-4


def test_a_falling_robot_is_stopped_where_it_is():
    bench = Bench(STANFORD, START)
    bench.release()
    bench.run(0.1, lambda: bench.gravity(0.9))
    positions, velocities = bench.run(0.4)
    assert abs(velocities[-1]).max() > 0.5
    assert abs(positions[-1] - START).max() > 0.1
    positions, velocities = bench.run(0.5)
    assert bench.log.infos[1:] == [
        'no commands arrive, so the position controller holds the robot'
    ]
    assert abs(velocities[-1]).max() < 1e-3
    assert np.ptp(positions[-100:], axis=0).max() < 1e-4


def excessive(bench):
    """Return commands of which each is an error that users make."""
    limits = np.minimum(bench.robot.effort_limits, 1e3)
    rng = np.random.default_rng(1979)
    return {
        'opposite sign': lambda: bench.gravity(-1.0),
        'ten times gravity': lambda: bench.gravity(10.0),
        'the limits': lambda: limits,
        'noise': lambda: rng.uniform(-limits, limits),
        'overflow': lambda: np.full(len(limits), 1e300),
    }


@pytest.mark.parametrize(
    'name',
    [
        *('light wrist', 'gripper_arm'),
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ('stanford', 'mimic_gripper', 'cartesian')
        ),
    ],
)
def test_no_command_makes_a_robot_faster_than_its_bounds(name):
    for case in excessive(Bench(ROBOTS[name])):
        bench = Bench(ROBOTS[name])
        bench.release()
        wrong = excessive(bench)[case]
        positions, velocities = bench.run(1.5, wrong)
        assert np.isfinite(positions).all()
        assert (np.abs(velocities) <= bench.bounds).all(), case
        if bench.log.errors:
            assert 'the position controller brakes the robot' in bench.log.errors[0]
            assert np.abs(velocities[-50:]).max() < 1e-3, case
            assert np.ptp(positions[-50:], axis=0).max() < 1e-4, case
        else:  # friction of a stop, or no gravity on this joint
            assert case in ('opposite sign', 'ten times gravity', 'noise'), case


def test_the_error_names_joint_speed_and_bound_and_the_way_out():
    bench = Bench(LIGHT_WRIST)
    bench.release()
    efforts = bench.gravity()
    efforts[2] += 5.0
    bench.run(0.5, lambda: efforts)
    (error,) = bench.log.errors
    assert error.startswith("joint 'roll' reaches ")
    assert 'more than 1.68 rad/s, so the position controller brakes the robot' in error
    assert 'Commands are ignored until they pause for 0.5 s, such as while the parameter' in error


def test_bounds_are_twice_the_velocity_limits_within_reason():
    urdf = LIGHT_WRIST.replace('"0.63"', '"0.1"', 1).replace('"0.63"', '"1000"', 1)
    assert velocity_bounds(load_urdf(urdf)) == pytest.approx([1.0, 40.0, 1.68, 1.68, 40.0])
    slides = load_urdf(ROOT / 'test' / 'robots' / 'cartesian.urdf')
    limits = slides.velocity_limits[slides.is_prismatic_joint]
    expected = np.clip(2.0 * limits, 0.25, 5.0)
    assert velocity_bounds(slides)[slides.is_prismatic_joint] == pytest.approx(expected)


def test_motions_at_the_velocity_limits_are_not_faults():
    bench = Bench(STANFORD, START)
    bench.release()
    limits = bench.robot.velocity_limits
    frequency = 2.0 * np.pi * np.array([0.9, 0.8, 3.0, 1.1, 0.7, 1.0])
    began = bench.now

    def efforts():
        phase = frequency * (bench.now - began)
        q, qd = bench.simulation.positions(), bench.simulation.velocities()
        wanted = bench.start + limits / frequency * (1.0 - np.cos(phase)) * 0.5
        speed, acceleration = (
            0.5 * limits * np.sin(phase),
            0.5 * limits * frequency * np.cos(phase),
        )
        feedback = 400.0 * (wanted - q) + 40.0 * (speed - qd)
        return bench.dynamics.efforts(q, qd, acceleration + feedback)

    _, velocities = bench.run(1.5, efforts)
    assert (np.abs(velocities).max(axis=0) > 0.4 * limits).all()
    assert not bench.log.errors


@pytest.mark.parametrize('mass', [5.0, 500.0])
def test_load_that_only_the_robot_carries_stops_it(mass):
    bench = Bench(STANFORD, START)
    bench.release()
    bench.simulation.set_payload('link_6', mass, (0.0, 0.0, 0.1))
    positions, velocities = bench.run(3.0, bench.gravity)
    assert (np.abs(velocities) <= bench.bounds).all()
    (error,) = bench.log.errors
    assert "joint 'joint_" in error
    assert 'Check signs, units, payloads and effort limits' in error
    if mass == 5.0:
        assert np.ptp(positions[-50:], axis=0).max() < 1e-4


def test_commands_are_ignored_after_a_fault_until_they_pause():
    bench = Bench(STANFORD)
    bench.release()
    bench.run(1.0, lambda: bench.gravity(-1.0))
    assert len(bench.log.errors) == 1
    positions, _ = bench.run(1.0, bench.gravity)
    bench.run(0.3)  # too short
    assert bench.hand_over.hold(False, bench.now) == (
        False,
        'commands are ignored until they pause for 0.5 s',
    )
    bench.run(1.0, bench.gravity)
    assert bench.log.infos == ['the robot follows the commands']
    bench.run(0.6)
    bench.run(1.0, bench.gravity)
    assert bench.log.infos[1:] == [
        'the commands have paused; the robot will follow the next commands',
        'the robot follows the commands',
    ]
    assert bench.simulation.positions() == pytest.approx(positions[-1], abs=1e-3)


def test_the_robot_is_held_until_the_efforts_have_risen():
    bench = Bench(STANFORD, START)
    positions, _ = bench.run(3.0, lambda: bench.gravity(min(bench.now / 2.0, 1.0)))
    assert bench.log.infos == ['the robot follows the commands']
    assert positions[-1] == pytest.approx(bench.start, abs=1e-4)


def test_commands_that_never_become_steady_take_over_in_the_end():
    bench = Bench(ROOT / 'test' / 'robots' / 'pendulum.urdf')
    bench.run(LONGEST - 0.5, lambda: np.sin([8.0 * bench.now]))
    assert not bench.log.infos
    bench.run(1.0, lambda: np.sin([8.0 * bench.now]))
    assert bench.log.infos == ['the robot follows the commands']


def test_the_position_controller_holds_the_robot_on_request():
    bench = Bench(STANFORD)
    bench.release()
    bench.hand_over.hold(True, bench.now)
    bench.simulation.set_payload('link_6', 2.0, (0.0, 0.0, 0.1))
    positions, _ = bench.run(1.0, bench.gravity)
    assert np.abs(positions - positions[0]).max() < 2e-3
    bench.dynamics.set_payload('link_6', 2.0, (0.0, 0.0, 0.1))
    bench.hand_over.hold(False, bench.now)
    bench.log.infos.clear()
    positions, _ = bench.run(2.0, bench.gravity)
    assert bench.log.infos == ['the robot follows the commands']
    assert np.abs(positions - positions[0]).max() < 2e-3
    assert not bench.log.errors
