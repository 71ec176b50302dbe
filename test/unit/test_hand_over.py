"""Position controller of a simulated robot, and hand-over to commands."""

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

pytest.importorskip('mujoco')
from inverse_dynamics_node.simulation.drivers import Actuation, Command, IDEAL
from inverse_dynamics_node.simulation.hand_over import HandOver, LONGEST
from inverse_dynamics_node.simulation.mujoco import MujocoRobot

START = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
PERIOD = 0.002
RELEASE = 0.1


class Log:
    """Stores what is logged."""

    def __init__(self):
        self.infos = []
        self.info = self.infos.append


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
