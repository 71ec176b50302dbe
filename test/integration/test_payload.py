"""`inverse_dynamics payload` beside a running node: --record and --apply."""

import json
import signal
import subprocess
import threading

from fork_server import SERVER
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
import numpy as np
from payload_runs import Arm, motion_of, random_load
import pytest
from robot_files import ROOT
from simulated_runs import write_csv

URDF = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
ROBOT = load_urdf(URDF)
NAMES = list(ROBOT.joint_names)


@pytest.fixture
def payload(domain_id, tmp_path):
    """Return a function that starts the command in a folder of its own."""

    def start(*arguments, urdf=URDF):
        command = ['-m', 'inverse_dynamics_node.cli.main', 'payload', urdf, *arguments, '--json']
        if '--link' not in arguments:
            command += ['--link', 'tool0']
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        processes.append(SERVER.run(command, environment, tmp_path, stdout=subprocess.PIPE))
        return processes[-1]

    processes = []
    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def ended(robot):
    """Return a function that waits for the end of a command; it returns code and output."""

    def wait(process):
        outputs = []
        thread = threading.Thread(target=lambda: outputs.append(process.stdout.read()))
        thread.start()
        # The robot publishes only while it waits.
        robot.wait_until(lambda: not thread.is_alive(), 'end of the command')
        return process.wait(), outputs[0]

    return wait


def report_of(output):
    """Return the report, which follows the messages about the recording."""
    return json.loads(output.splitlines()[-1])


def test_the_node_takes_the_payload(run_node, robot, payload, ended, tmp_path):
    rng = np.random.default_rng(0)
    arm, (times, *signals) = Arm(ROBOT, rng), motion_of(ROBOT, rng, 16.0)
    motion = times[::3], *(signal[::3] for signal in signals)
    write_csv(tmp_path / 'empty.csv', arm.record(motion))
    write_csv(tmp_path / 'loaded.csv', arm.record(motion, random_load('tool0', rng, 2.0)))
    node = run_node(robot_description_file=URDF, state_timeout=5.0)
    robot.publish_state(NAMES, np.full(7, 0.5), np.zeros(7))
    robot.wait_for_text(node, 'floating')
    code, output = ended(
        payload('loaded.csv', '--empty', 'empty.csv', '--apply', '/inverse_dynamics')
    )
    mass = report_of(output)['mass']
    assert code == 0
    assert mass == pytest.approx(2.0, rel=0.02)
    assert f"payload of {mass:g} kg on link 'tool0'" in node.output
    # On another link, it would be carried a second time.
    again = 'loaded.csv', '--empty', 'empty.csv', '--apply', '--link', 'link_7'
    code, output = ended(payload(*again))
    assert code == 1
    assert f'carries another payload: {mass:.3g}' in output
    assert '--replace to remove it' in output
    code, output = ended(payload(*again, '--replace'))
    assert code == 0
    robot.wait_for_text(node, "payload on link 'tool0' removed")
    assert f"payload of {report_of(output)['mass']:g} kg on link 'link_7'" in node.output


def hold(robot, efforts):
    """Publish the state of an arm at rest."""
    robot.publish_state(NAMES, np.full(7, 0.5), np.zeros(7), efforts)


def test_ctrl_c_ends_the_recording(run_node, robot, payload, ended, tmp_path):
    (tmp_path / 'run.csv').write_text('mine')
    hold(robot, np.arange(7.0))
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    process = payload('run.csv', '--record', '1000', '--force')
    partial = tmp_path / 'run_partial.csv'
    robot.wait_until(lambda: partial.exists() and partial.stat().st_size > 10_000, 'rows')
    process.send_signal(signal.SIGINT)
    code, output = ended(process)
    assert code == 130
    assert 'recording /joint_states for 1000 s\nrun_partial.csv: ' in output
    assert (tmp_path / 'run.csv').read_text() == 'mine'  # an early end replaces no recording
    recording, _ = read_measured_states(partial, NAMES)
    assert set(np.diff(recording.times) > 0.0) == {True}
    assert np.all(recording.efforts == np.arange(7.0))


def test_a_second_recording_of_a_file_is_refused(run_node, robot, payload, ended, tmp_path):
    hold(robot, np.arange(7.0))
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    first = payload('run.csv', '--record', '1000')
    robot.wait_until((tmp_path / 'run_partial.csv').exists, 'the first recording')
    code, output = ended(payload('run.csv', '--record', '1000', '--force'))
    assert code == 2
    assert 'run_partial.csv already exists: another recording writes it' in output
    first.send_signal(signal.SIGINT)
    assert ended(first)[0] == 130
    assert [path.name for path in tmp_path.iterdir()] == ['run.csv']


def test_the_description_has_to_be_that_of_the_node(run_node, robot, payload, ended, tmp_path):
    short = URDF.read_text().replace('wrist_roll', 'last')
    (tmp_path / 'other.urdf').write_text(short)
    hold(robot, np.arange(7.0))
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    code, output = ended(payload('run.csv', '--record', '1', urdf='other.urdf'))
    assert code == 1
    assert 'uses another robot description, with joints shoulder_pan' in output
    assert not (tmp_path / 'run.csv').exists()


def test_joint_states_have_to_contain_efforts(run_node, robot, payload, ended, tmp_path):
    hold(robot, ())
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    code, output = ended(payload('run.csv', '--record', '1'))
    assert code == 1
    assert 'the joint states on /joint_states have no efforts; configure the driver' in output
    assert not [*tmp_path.iterdir()]
