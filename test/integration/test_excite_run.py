"""`inverse_dynamics excite --run` lets a node move a simulated arm, and records it."""

import signal

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
from inverse_dynamics_node.cli.main import main
import numpy as np
import pytest
from robot_files import ROOT
from sensor_msgs.msg import JointState

pytest.importorskip('mujoco')

ARM = ROOT / 'test/robots/seven_dof.urdf'
CLI = '-m', 'inverse_dynamics_node.cli.main'
NAMES = list(load_urdf(ARM).joint_names)
MOVING = [NAMES[3], NAMES[5]]
INDEX = [3, 5]
CLOSE = 5e-3  # [rad]
pytestmark = pytest.mark.real_time


class Campaign:
    """The command beside a simulated arm and a node that drives it."""

    def __init__(self, drive_arm, run_program, robot, folder):
        self.robot, self.path = robot, folder / 'motion.csv'
        self.states = robot.listen(JointState, 'joint_states')
        settings = {'reference_timeout': 0.1, 'state_timeout': 1.0, 'start_ramp': 0.1}
        drive_arm(ARM, mode='computed_torque', **settings)
        self.start = self.positions()
        options = '--run', '--floor', 'none', '--duration', '2', '--joints', *MOVING
        output = '--trajectory-out', folder / 'motion.yaml'
        self.process = run_program(*CLI, 'excite', ARM, *options, *output)

    def positions(self):
        state = self.states[-1]
        return np.array([state.position[state.name.index(name)] for name in NAMES])

    def wait_for_end(self):
        self.robot.wait_until(lambda: self.process.poll() is not None, 'end of the command')
        return self.process.wait()

    def recording(self):
        return read_measured_states(self.path, NAMES)[0]


@pytest.fixture
def campaign(drive_arm, run_program, robot, tmp_path):
    return Campaign(drive_arm, run_program, robot, tmp_path)


def test_ctrl_c_holds_the_arm_and_keeps_what_was_recorded(campaign):
    robot = campaign.robot
    robot.wait_until(
        lambda: np.abs(campaign.positions() - campaign.start)[INDEX].max() > 0.05, 'motion'
    )
    campaign.process.send_signal(signal.SIGINT)
    assert campaign.wait_for_end() == 130
    count = len(campaign.states)
    robot.wait_until(lambda: len(campaign.states) > count + 100, 'an arm at rest')
    resting, count = campaign.positions(), len(campaign.states)
    robot.wait_until(lambda: len(campaign.states) > count + 300, 'states')
    assert campaign.positions() == pytest.approx(resting, abs=CLOSE)
    recording = campaign.recording()
    assert np.ptp(recording.positions, axis=0)[INDEX].max() > 0.04
    assert np.isfinite(recording.efforts).all()


@pytest.mark.long
def test_the_recording_is_identified(campaign, capsys):
    assert campaign.wait_for_end() == 0
    assert campaign.positions() == pytest.approx(campaign.start, abs=CLOSE)
    recording = campaign.recording()
    assert np.ptp(recording.positions, axis=0)[INDEX].min() > 0.1
    others = np.delete(np.ptp(recording.positions, axis=0), INDEX)
    assert others.max() < 0.05
    arguments = [str(ARM), str(campaign.path), '--no-picture']
    assert main(['identify', *arguments]) == 0
    # The description is exact.
    assert 'The identified model is not clearly better on unseen data' in capsys.readouterr().out
