"""Simulated runs without ROS, faster than real time, and bags and tables of them."""

import csv
import re

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.recordings.signals import Recording
import numpy as np
from robot_files import STANFORD

KP, KD = 400.0, 40.0  # gains of the loop
# Friction of the Stanford arm. More would hold joint 6, whose commanded efforts are small.
DAMPING = [1.5, 2.0, 20.0, 0.2, 0.15, 0.02]
COULOMB = [1.0, 2.5, 8.0, 0.3, 0.2, 0.002]
START_STAMP = 1_700_000_000_000_000_000  # [ns]


def with_friction(urdf, damping, coulomb):
    """Return the text of a URDF whose joints have friction, in the order of the model."""
    text = urdf.read_text()
    names = load_urdf(urdf).joint_names
    for name, d, c in zip(names, damping, coulomb, strict=True):
        joint = re.search(rf'<joint name="{name}".*?</joint>', text, re.S).group()
        bare = re.sub(r'<dynamics[^>]*/>', '', joint)
        dynamics = f'<dynamics damping="{d}" friction="{c}"/></joint>'
        text = text.replace(joint, bare.replace('</joint>', dynamics))
    return text


def with_load(text, link, mass, com):
    """Return the text of a URDF whose massless link carries a point mass."""
    x, y, z = com
    load = (
        f'<link name="{link}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{mass}"/>'
        '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    loaded, count = re.subn(rf'<link name="{link}"\s*/>', load, text)
    assert count == 1
    return loaded


def simulate(urdf, real, duration=20.0, rate=500.0):
    """
    Record a run of one robot under a controller that has the URDF of another one.

    Joint states are those of `MujocoRobot.state`: the effort is the one applied until then.
    """
    from inverse_dynamics_node.simulation.mujoco import MujocoRobot
    from inverse_dynamics_node.simulation.trajectory import plan, start_pose

    robot = load_urdf(urdf)
    dynamics = InverseDynamics(robot)
    start = start_pose(robot, dynamics)
    trajectory = plan(robot, dynamics, start, 0.9 * duration)
    hardware = MujocoRobot(load_urdf(real), start)
    order = [hardware.state_names.index(name) for name in robot.joint_names]
    times = np.arange(round(duration * rate)) / rate
    states = np.zeros((3, len(times), len(hardware.state_names)))
    for k, reference in enumerate(zip(*trajectory.sample(times), strict=True)):
        states[:, k] = hardware.state()
        q, qd = states[0, k, order], states[1, k, order]
        q_ref, qd_ref, qdd_ref = reference
        qdd = qdd_ref + KD * (qd_ref - qd) + KP * (q_ref - q)
        hardware.command(dynamics.efforts(q, qd, qdd))
        hardware.advance(1.0 / rate)
    # Leave out the first state, which has no effort yet.
    return Recording(hardware.state_names, times[1:], *states[:, 1:])


def simulate_with_a_gripper():
    """Record the Stanford arm with friction and a gripper that its URDF does not know."""
    rubbing = with_friction(STANFORD, DAMPING, COULOMB)
    return simulate(STANFORD, with_load(rubbing, 'tool0', 1.2, (0.0, 0.03, 0.06)))


def write_bag(
    path,
    recording,
    storage='mcap',
    topic='/joint_states',
    extra=(),
    has_efforts=True,
    is_stamped=True,
    kind='sensor_msgs/msg/JointState',
):
    """
    Write joint states as rosbag2 does; those on extra topics have no efforts.

    Messages of another kind contain only a header.
    """
    types = typestore().types
    velocities = recording.velocities
    if velocities is None:
        velocities = np.full_like(recording.positions, np.nan)
    rows = zip(recording.times, recording.positions, velocities, recording.efforts, strict=True)
    messages = []
    for time, positions, speeds, efforts in rows:
        now = START_STAMP + round(time * 1e9)
        stamp = types['builtin_interfaces/msg/Time'](*divmod(now * is_stamped, 10**9))
        message = header = types['std_msgs/msg/Header'](stamp=stamp, frame_id='')
        for name in (topic, *extra):
            if kind == 'sensor_msgs/msg/JointState':
                measured = efforts if has_efforts and name == topic else np.zeros(0)
                names = list(recording.joint_names)
                message = types[kind](header, names, positions, speeds, measured)
            # Messages reach the recorder late, with varying delays.
            messages.append((name, message, now + 300_000 + now // 1000 % 7 * 100_000))
    write_messages(path, messages, storage)


def typestore():
    from rosbags.typesys import get_typestore, Stores

    return get_typestore(Stores.ROS2_JAZZY)


def write_messages(path, messages, storage='mcap'):
    """Write topics, messages and times [ns] as rosbag2 does."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    store, topics = typestore(), {}
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        for topic, message, time in messages:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], time, store.serialize_cdr(message, kind))


def write_csv(path, recording):
    """Write joint states as a table."""
    fields = {'position': recording.positions, 'effort': recording.efforts}
    if recording.velocities is not None:
        fields['velocity'] = recording.velocities
    with path.open('w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(
            ['time', *(f'{name}.{field}' for field in fields for name in recording.joint_names)]
        )
        for k, time in enumerate(recording.times):
            rows.writerow([time, *(x for values in fields.values() for x in values[k])])
