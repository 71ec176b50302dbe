"""The examples that command arms, with real nodes and arms at rest or moved by hand."""

import signal
import subprocess

from node_process import PATIENCE
import numpy as np
from robot_files import ROOT
from robot_side import DYNAMICS, HOLD, NAMES, PATIENT, Q, ZERO
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PUSH = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])


def test_a_leader_feels_what_its_follower_touches_and_the_follower_does_what_it_does(
    run_node, run_program, robot
):
    remaps = {side: ['-r', f'__ns:=/{side}'] for side in ('leader', 'follower')}
    run_node(*remaps['leader'], **PATIENT)
    run_node(*remaps['follower'], mode='computed_torque', **PATIENT)
    pose, efforts = Q.copy(), HOLD + PUSH

    def state(positions, measured=()):
        return JointState(
            name=NAMES, position=list(positions), velocity=[0.0] * 6, effort=list(measured)
        )

    robot.keep_publishing('leader/joint_states', lambda: state(pose), JointState)
    robot.keep_publishing('follower/joint_states', state(Q, efforts))
    leader, follower = (
        robot.listen(Float64MultiArray, f'{side}/inverse_dynamics/commands') for side in remaps
    )
    run_program(ROOT / 'examples/leader_follower.py', 0.5)

    def is_near(messages, expected):
        return bool(messages) and np.allclose(messages[-1].data, expected, atol=1e-6)

    robot.wait_until(lambda: is_near(leader, HOLD + 0.5 * -PUSH), 'the push')
    pose[0] += 0.02
    pull = DYNAMICS.efforts(Q, ZERO, np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    robot.wait_until(lambda: is_near(follower, pull), 'the way of the follower')


def test_a_motion_that_was_shown_by_hand_is_recorded_and_replayed(run_node, run_program, robot):
    node = run_node(**PATIENT)
    phases = iter(np.linspace(0.0, 1e3, 100_000))

    def state():
        swing = 0.05 * np.sin(next(phases))
        return JointState(name=NAMES, position=list(Q + swing), velocity=[0.0] * 6)

    robot.keep_publishing('joint_states', state, JointState)
    recorded = robot.listen(JointState, 'joint_states')
    example = run_program(ROOT / 'examples/record_and_replay.py', 2.0, stdout=subprocess.PIPE)
    # The program listens to these, once it records.
    topic = '/inverse_dynamics/joint_efforts'
    robot.wait_until(lambda: robot.node.count_subscribers(topic), 'the recording')
    count = len(recorded)
    robot.wait_until(lambda: len(recorded) > count + 400, 'four seconds')
    example.send_signal(signal.SIGINT)
    robot.wait_for_text(node, '~/joint_trajectory: a trajectory of ')
    assert robot.get_parameter('mode') == 'computed_torque'
    example.send_signal(signal.SIGINT)
    robot.wait_until(lambda: example.poll() is not None, 'end of the example')
    output, _ = example.communicate(PATIENCE)
    assert (example.wait(), 'replayed within' in output) == (0, True), output
