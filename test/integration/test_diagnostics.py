"""Diagnostics are published in every lifecycle state, with the right level."""

import math

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Inertia, InertiaStamped
from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
import rclpy
from robot_files import ROOT, STANFORD
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

NAMES = list(load_urdf(STANFORD).joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
FAST = {'robot_description_file': STANFORD, 'start_ramp': 0.0, 'stop_ramp': 0.1}
PATIENT = {**FAST, 'state_timeout': 5.0, 'reference_timeout': 5.0}
LOSING = {**FAST, 'state_timeout': 1.0}  # longer than the usual pauses of a busy machine
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture
def wait_for_status(robot):
    """Return a function that waits for a status of a part, and returns its values."""
    heard = robot.listen(DiagnosticArray, '/diagnostics')

    def wait(part, level, words, key='', value=''):
        def find(array):
            for status in array.status:
                values = {pair.key: pair.value for pair in status.values}
                if status.name != f'inverse_dynamics: {part}' or status.level != level:
                    continue
                if words in status.message and value in values.get(key, ''):
                    return values
            return None

        try:
            robot.wait_until(lambda: any(map(find, heard)), f'{part}: {words}')
        except AssertionError as error:
            raise AssertionError(f'{error}; last was {heard[-1:]}') from error
        found = next(filter(None, map(find, heard)))
        heard.clear()
        return found

    return wait


def test_missing_inputs_are_reported_from_the_start(run_node, robot, wait_for_status):
    node = run_node()
    wait_for_status('loop', OK, 'unconfigured')
    text = STANFORD.read_text()
    robot.publish_description(text)
    words = f'waiting for the positions of {NAMES[0]}'
    values = wait_for_status('joint states', ERROR, words, 'publishers', '1')
    assert values['age [s]'] == 'never'
    assert node.process.poll() is None


def test_rates_and_ages_are_reported_while_active(run_node, robot, wait_for_status):
    run_node(**PATIENT, update_rate=100)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.publish_accelerations(np.zeros(6))
    values = wait_for_status('loop', OK, 'following the reference', 'rate [Hz]', '')
    assert values['state'] == 'active'
    assert values['mode'] == 'inverse_dynamics'
    assert values['requested rate [Hz]'] == '100'
    # The first report may cover a part of a second only.
    values = wait_for_status('loop', OK, 'following the reference', 'rate [Hz]', '')
    assert float(values['compute time p99 [ms]']) > 0.0
    assert float(values['period worst [ms]']) >= float(values['period p99 [ms]']) > 0.0
    assert float(values['rate [Hz]']) > 0.0
    assert values['overruns'].isdigit()
    values = wait_for_status('joint states', OK, 'fresh')
    assert 0.0 <= float(values['age [s]']) < 5.0
    wait_for_status('efforts', OK, '', 'receivers', '1')
    assert 0.0 <= float(wait_for_status('reference', OK, 'followed')['age [s]']) < 5.0
    values = wait_for_status('model', OK, 'stanford')
    assert values['payload'] == 'none'
    assert values['gravity [m/s^2]'] == '0.000, 0.000, -9.807'


def test_a_lost_state_is_an_error(run_node, robot, wait_for_status):
    run_node(**LOSING)
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('joint states', OK, 'fresh')
    robot.state = None
    wait_for_status('joint states', ERROR, f'lost: {NAMES[0]}')


def test_limited_efforts_and_dropped_messages_are_counted(run_node, robot, wait_for_status):
    run_node(**PATIENT, effort_limits=1.0)
    robot.publish_state(NAMES, Q, np.zeros(6))
    key = f'{NAMES[1]} cut to limit'
    first = int(wait_for_status('efforts', WARN, NAMES[1])[key])
    assert int(wait_for_status('efforts', WARN, NAMES[1])[key]) > first > 0
    robot.publish_accelerations([math.nan] * 6)
    key = f"~/desired_accelerations: acceleration of joint '{NAMES[0]}' is nan"
    first = int(wait_for_status('messages', WARN, 'rejected since the last report', key)[key])
    assert (
        int(wait_for_status('messages', WARN, 'rejected since the last report', key)[key])
        > first
        > 0
    )


def test_payload_and_warnings_about_the_model_are_reported(run_node, robot, wait_for_status):
    odd = ROOT / 'test/robots/planar_2r.urdf'
    model = load_urdf(odd)
    run_node(**{**PATIENT, 'robot_description_file': odd})
    body = Inertia(m=1.25)
    link = model.link_names[-1]
    robot.publish_once(
        'inverse_dynamics/payload', InertiaStamped(header=Header(frame_id=link), inertia=body)
    )
    level = WARN if model.warnings else OK
    values = wait_for_status('model', level, '', 'payload', f'1.25 kg on {link}')
    assert [v for k, v in values.items() if k.startswith('warning')] == [
        str(warning) for warning in model.warnings
    ]


def test_every_lifecycle_state_is_reported(run_node, robot, wait_for_status):
    run_node(**PATIENT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('loop', OK, 'floating: no reference')
    assert robot.change_state('deactivate')
    wait_for_status('loop', OK, 'inactive')
    wait_for_status('joint states', OK, 'fresh')
    assert robot.change_state('cleanup')
    wait_for_status('loop', OK, 'unconfigured')


def test_an_unknown_motion_of_the_base_is_an_error(run_node, robot, wait_for_status):
    run_node(**PATIENT, base_motion='imu')
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('model', ERROR, 'motion of the base is unknown: no message on imu yet')
    wait_for_status('joint states', OK, 'fresh')


def test_a_slow_joint_that_is_not_commanded_is_reported_while_the_arm_is_held(
    run_node, robot, wait_for_status
):
    node = run_node(**PATIENT, joints=f'[{", ".join(NAMES[:5])}]')
    hold = InverseDynamics(load_urdf(STANFORD)).gravity_efforts(Q)[:5]
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(hold)
    robot.publish_state(NAMES[:5], Q[:5], np.zeros(5))
    values = wait_for_status('joint states', WARN, f'locked_positions.{NAMES[5]}')
    assert values['late, not commanded'] == NAMES[5]
    robot.wait_for_text(node, f"joint '{NAMES[5]}' (not commanded) was last reported")
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 10, 'further commands')
    assert all(command == pytest.approx(list(hold)) for command in robot.commands[count:])
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('joint states', OK, 'fresh')


def test_misnamed_joints_and_degrees_are_reported(run_node, robot, wait_for_status):
    node = run_node(**PATIENT)
    robot.publish_state(['joint1', *NAMES[1:]], Q, np.zeros(6))
    similar = "(received similar names: 'joint1')"
    wait_for_status('joint states', ERROR, similar)
    robot.wait_for_text(node, similar)
    robot.publish_state(NAMES, [Q[0], 57.3, *Q[2:]], np.zeros(6))
    text = f'{NAMES[1]} is at 57.3 rad, outside its limits -1.745 to 1.745 (in degrees?)'
    wait_for_status('joint states', WARN, text)
    robot.wait_for_text(node, text)
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('joint states', OK, 'fresh')


def test_two_publishers_of_different_positions_are_named(run_node, robot, wait_for_status):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(InverseDynamics(load_urdf(STANFORD)).gravity_efforts(Q))
    other = rclpy.create_node('second_publisher', context=robot.context)
    try:
        publisher = other.create_publisher(JointState, 'joint_states', 10)
        elsewhere = JointState(name=NAMES, position=[0.3, 0.8, 0.5, 1.4, 0.6, 0.2])
        elsewhere.velocity = [0.0] * 6
        robot.node.create_timer(0.0037, lambda: publisher.publish(elsewhere))
        words = f'positions of {NAMES[3]} alternate between -0.4 and 1.4'
        wait_for_status('joint states', ERROR, words)
        wait_for_status('joint states', ERROR, 'published by /robot, /second_publisher')
        robot.wait_for_text(node, '(published by /robot, /second_publisher)')
        robot.wait_until(lambda: robot.commands[-1] == [0.0] * 6, 'zeros')
    finally:
        other.destroy_node()


def test_contradictions_end_with_the_publishers_of_a_joint(run_node, robot, wait_for_status):
    run_node(**PATIENT, joints=f'[{", ".join(NAMES[:5])}]')
    robot.publish_state(NAMES[:5], Q[:5], np.zeros(5))
    publications = [
        robot.keep_publishing('joint_states', JointState(name=NAMES[5:], position=[position]))
        for position in (0.2, 1.4)
    ]
    words = f'positions of {NAMES[5]} alternate between 0.2 and 1.4'
    wait_for_status('joint states', ERROR, words)
    for publication in publications:
        robot.cease(publication)
    wait_for_status('joint states', WARN, f"joint '{NAMES[5]}' (not commanded) was last reported")


def test_silent_publishers_are_reported(run_node, robot, wait_for_status):
    node = run_node(**LOSING)
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_status('joint states', OK, 'fresh')
    robot.state = None  # the publisher stays connected
    wait_for_status('joint states', ERROR, 'although 1 publisher is connected')
    robot.wait_for_text(
        node, '(a killed publisher stays connected for up to 20 s); if ros2 topic hz'
    )
