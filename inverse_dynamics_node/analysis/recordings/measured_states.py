"""Reads measured joint states from rosbag2 recordings and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...robot.model import Floats
from .files import Bag, BAG_SUFFIXES, JOINT_STATE, open_bag, read_csv
from .signals import Recording

_QUANTITIES = ('position', 'velocity', 'effort')
_FIRST_MESSAGES = 100
"""Number of messages at the start of a topic that are searched for efforts."""


def read_measured_states(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
    mimic_names: Sequence[str] = (),
) -> tuple[Recording, tuple[str, ...]]:
    """
    Read joint states from a rosbag2 folder, or from an .mcap, .db3 or .csv file.

    `topic` has the type sensor_msgs/msg/JointState. The default is the only topic of this type, or
    the only one with efforts. `progress` is called regularly with the fraction read so far, 0 to
    1. `mimic_names` are joints of the robot that mimic other joints.

    Return the recording, and notes about ignored and missing data. The joints have the order of
    `joint_names`, and the times start at zero. Joints that the robot does not have are ignored. A
    joint without any position and effort was not recorded, even if its columns exist.
    Raise RecordingError if the recording is unreadable or contains no effort of the robot.
    """
    if not path.exists():
        raise RecordingError(f'{path}: no such file or folder, expected a recording')
    if path.suffix == '.csv':
        if topic is not None:
            raise RecordingError(
                f'{path}: a CSV file has no topics, but topic {topic} was requested'
            )
        return _from_csv(path, joint_names, mimic_names)
    if path.is_file() and path.suffix not in BAG_SUFFIXES:
        raise RecordingError(
            f"{path}: is a '{path.suffix or path.name}' file, expected a rosbag2 folder, or a "
            '.mcap, .db3 or .csv file'
        )
    with open_bag(path) as bag:
        chosen = _choose_topic(bag, topic)
        messages = bag.messages(chosen, progress)
        return _from_messages(f'{path} {chosen}', messages, joint_names, mimic_names)


def _from_csv(
    path: Path, joint_names: Sequence[str], mimic_names: Sequence[str]
) -> tuple[Recording, tuple[str, ...]]:
    times, columns, _ = read_csv(path, joint_names, _QUANTITIES, allow_empty=True)
    if not len(times):
        raise RecordingError(f'{path}: has no rows below the header')
    values = np.full((len(times), 3, len(joint_names)), np.nan)
    index = {name: j for j, name in enumerate(joint_names)}
    for (joint, quantity), column in columns.items():
        if joint in index:
            values[:, _QUANTITIES.index(quantity), index[joint]] = column
    recorded = dict.fromkeys(joint for joint, _ in columns)
    return _recording(str(path), times, values, joint_names, recorded, mimic_names)


def _choose_topic(bag: Bag, requested: str | None) -> str:
    topics = sorted(name for name, kind in bag.types.items() if kind == JOINT_STATE)
    if requested is not None:
        topic = bag.find_topic(requested)
        if topic is None:
            raise RecordingError(
                f'{bag.path}: has no topic {requested}; topics of type {JOINT_STATE}: '
                f'{", ".join(topics) or "none"}'
            )
        if bag.types[topic] != JOINT_STATE:
            raise RecordingError(
                f'{bag.path}: topic {topic} is of type {bag.types[topic]}, expected {JOINT_STATE}'
            )
        return topic
    if not topics:
        found = ', '.join(f'{name} ({kind})' for name, kind in sorted(bag.types.items()))
        raise RecordingError(
            f'{bag.path}: has no topic of type {JOINT_STATE}; topics: {found or "none"}'
        )
    return topics[0] if len(topics) == 1 else _only_topic_with_efforts(bag, topics)


def _only_topic_with_efforts(bag: Bag, topics: list[str]) -> str:
    useful = []
    for topic in topics:
        first = islice(bag.messages(topic), _FIRST_MESSAGES)
        if any(len(message.position) and len(message.effort) for _, message in first):
            useful.append(topic)
    if len(useful) == 1:
        return useful[0]
    found = f'of which {", ".join(useful)} have efforts' if useful else 'none of which has efforts'
    raise RecordingError(
        f'{bag.path}: has several topics of type {JOINT_STATE} ({", ".join(topics)}), {found}; '
        'choose one with --topic'
    )


def _from_messages(
    where: str,
    messages: Iterable[tuple[int, Any]],
    joint_names: Sequence[str],
    mimic_names: Sequence[str],
) -> tuple[Recording, tuple[str, ...]]:
    """Convert messages to a recording. A message may contain any joints in any order."""
    index = {name: j for j, name in enumerate(joint_names)}
    layouts: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
    stamps: list[tuple[int, int]] = []
    rows: list[Floats] = []
    for k, (received, message) in enumerate(messages):
        names = tuple(message.name)
        layout = layouts.get(names)
        if layout is None:
            columns = [i for i, name in enumerate(names) if name in index]
            joints = [index[names[i]] for i in columns]
            repeated = [joint_names[j] for j in sorted(joints) if joints.count(j) > 1]
            if repeated:
                raise RecordingError(
                    f"{where}: message {k} names joint '{repeated[0]}' more than once"
                )
            layout = layouts[names] = columns, joints
        columns, joints = layout
        row = np.full((3, len(joint_names)), np.nan)
        for quantity, target in zip(_QUANTITIES, row, strict=True):
            values = getattr(message, quantity)
            if len(values) == 0:
                continue
            if len(values) != len(names):
                raise RecordingError(
                    f'{where}: message {k} has {len(names)} names, but {len(values)} values in '
                    f"'{quantity}'"
                )
            target[joints] = np.asarray(values, dtype=float)[columns]
        stamp = message.header.stamp  # 0 if the driver does not set it
        stamps.append((stamp.sec * 1_000_000_000 + stamp.nanosec, received))
        rows.append(row)
    if not rows:
        raise RecordingError(f'{where}: has no messages')
    recorded = dict.fromkeys(name for names in layouts for name in names)
    stamped_and_received = np.array(stamps)
    is_stamped = bool(stamped_and_received[:, 0].any())
    nanoseconds = stamped_and_received[:, 0 if is_stamped else 1]
    # Subtract integers, because a float of seconds since 1970 is only exact to 0.2 us.
    times = 1e-9 * (nanoseconds - nanoseconds[0])
    recording, notes = _recording(where, times, np.array(rows), joint_names, recorded, mimic_names)
    if not is_stamped:
        notes += ('the messages have no time stamps; the times of recording were used instead',)
    return recording, notes


def _recording(
    where: str,
    times: Floats,
    values: Floats,
    joint_names: Sequence[str],
    recorded: Iterable[str],
    mimic_names: Sequence[str],
) -> tuple[Recording, tuple[str, ...]]:
    """Select the recorded joints of the robot, and describe all other joints in notes."""
    recorded = list(recorded)
    named = [j for j, name in enumerate(joint_names) if name in recorded]
    if not named:
        found = 'no joint names'
        if recorded:
            found = f'no joint of this robot, only {", ".join(recorded)}'
        raise RecordingError(f'{where}: has {found}; expected some of {", ".join(joint_names)}')
    finite = np.isfinite(values)
    if not finite[:, 2, named].any():
        raise RecordingError(
            f'{where}: all efforts of the joints of this robot are empty or NaN, expected '
            'measured efforts'
        )
    # Drivers report NaN for a joint without sensor; its speed alone does not say where it is.
    known = [j for j in named if finite[:, (0, 2), j].any()]
    without_position = [j for j in known if not finite[:, 0, j].any()]
    if without_position:
        name = joint_names[without_position[0]]
        raise RecordingError(
            f"{where}: all positions of joint '{name}' are empty or NaN, expected numbers"
        )
    velocities = values[:, 1, known] if finite[:, 1, known].any() else None
    recording = Recording(
        tuple(joint_names[j] for j in known),
        times - times[0],
        values[:, 0, known],
        velocities,
        values[:, 2, known],
    )
    lists = {
        'ignored joints that the robot does not have': [
            name for name in recorded if name not in joint_names and name not in mimic_names
        ],
        'ignored mimic joints, whose efforts are part of those of the joints that they mimic': [
            name for name in recorded if name in mimic_names
        ],
        'joints that were not recorded and are assumed to rest at zero': [
            name for j, name in enumerate(joint_names) if j not in known
        ],
        'joints without measured efforts, which are not evaluated': [
            joint_names[j] for j in known if not finite[:, 2, j].any()
        ],
    }
    notes = (f'{text}: {", ".join(names)}' for text, names in lists.items() if names)
    return recording, tuple(notes)
