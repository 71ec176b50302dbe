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
    return json.loads(output[output.index('{') :])


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
    assert f'carries another payload: {mass:g} kg on' in output
    assert '--replace to remove it' in output
    code, output = ended(payload(*again, '--replace'))
    assert code == 0
    robot.wait_for_text(node, "payload on link 'tool0' removed")
    assert f"payload of {report_of(output)['mass']:g} kg on link 'link_7'" in node.output


def hold(robot, efforts, names=NAMES):
    """Publish the state of an arm at rest."""
    count = len(names)
    robot.publish_state(names, np.full(count, 0.5), np.zeros(count), efforts)


def test_ctrl_c_ends_the_recording(run_node, robot, payload, ended, tmp_path):
    hold(robot, np.arange(7.0))
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    process = payload('run.csv', '--record', '1000')
    path = tmp_path / 'run.csv'
    robot.wait_until(lambda: path.exists() and path.stat().st_size > 10_000, 'rows')
    # Another recording does not replace the file.
    code, output = ended(payload('run.csv', '--record', '1000', '--force'))
    assert code == 2
    assert '--record run.csv already exists' in output
    process.send_signal(signal.SIGINT)
    code, output = ended(process)
    assert code == 130
    assert 'recording /joint_states for 1000 s\nrun.csv: ' in output
    recording, _ = read_measured_states(path, NAMES)
    assert set(np.diff(recording.times) > 0.0) == {True}
    assert np.all(recording.efforts == np.arange(7.0))


def test_a_joint_that_is_never_published_delays_no_recording(
    run_node, robot, payload, ended, tmp_path
):
    hold(robot, np.arange(6.0), NAMES[:6])
    node = run_node(robot_description_file=URDF, state_timeout=5.0)
    robot.wait_for_text(node, NAMES[6])
    code, output = ended(payload('run.csv', '--record', '0.5'))
    assert code == 0, output
    recording, _ = read_measured_states(tmp_path / 'run.csv', NAMES)
    assert recording.joint_names == tuple(NAMES[:6])
    assert np.all(recording.efforts == np.arange(6.0))


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
    assert 'the joint states on /joint_states have no efforts of shoulder_pan' in output
    assert not [*tmp_path.iterdir()]
