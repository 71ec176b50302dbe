"""What the node writes to /diagnostics is what `watch` reads."""

from dataclasses import replace
import math
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node.control import status
from inverse_dynamics_node.control.settings import Mode
from inverse_dynamics_node.control.status import Level, LoopStatus, NodeStatus
from inverse_dynamics_node.control.supervision import Phase
import pytest

pytest.importorskip('diagnostic_msgs')

from builtin_interfaces.msg import Time
from inverse_dynamics_node.ros.diagnostics import (
    read_status,
    write_status,
    write_values,
)

TEXTS = st.text('abc ,:/-9', max_size=20)
NAMES = st.text('abc_/ 9', min_size=1, max_size=8)
SEVERAL = st.lists(NAMES, max_size=3).map(tuple)
SOME = st.lists(NAMES, min_size=1, max_size=3).map(tuple)
COUNTS = st.integers(0, 10**6)


def numbers(decimals, least=0):
    """Return numbers that are printed with all of their at most six digits."""
    return st.integers(least, 999_999).map(lambda k: k / 10**decimals)


def optional(values):
    return st.none() | values


def part(kind, **values):
    return st.builds(kind, level=st.sampled_from(Level), message=TEXTS, **values)


NODES = st.lists(NAMES, max_size=8).map(status.NodeNames.of)
TOTALS = st.dictionaries(NAMES, COUNTS, max_size=3)
TIMES = numbers(3).map(lambda milliseconds: milliseconds / 1e3)
MODES = st.sampled_from(Mode)
STATUSES = st.builds(
    NodeStatus,
    loop=part(
        LoopStatus,
        state=TEXTS,
        rate=numbers(1),
        requested_rate=optional(numbers(3)),
        period_p99=optional(TIMES),
        period_worst=optional(TIMES),
        compute_time_p99=optional(TIMES),
        overruns=COUNTS,
        mode=optional(MODES),
        phase=optional(st.sampled_from(Phase)),
        is_dry_run=optional(st.booleans()),
        gain=optional(numbers(3)),
    ),
    messages=optional(part(status.MessagesStatus, rejected=st.dictionaries(TEXTS, COUNTS))),
    other_nodes=optional(
        part(
            status.OtherNodesStatus,
            commands=TEXTS,
            subscribers=NODES,
            rivals=NODES,
            namesakes=COUNTS,
        )
    ),
    clock=optional(
        part(status.ClockStatus, time=numbers(3), unchanged_for=numbers(1), publishers=COUNTS)
    ),
    joint_states=optional(
        part(
            status.JointStatesStatus,
            topic=TEXTS,
            rate=numbers(1),
            age=optional(numbers(3, -999_999)),
            timeout=numbers(3),
            publishers=COUNTS,
            late=SEVERAL,
            locked=SEVERAL,
            without_velocity=SEVERAL,
        )
    ),
    reference=optional(
        part(status.ReferenceStatus, age=optional(numbers(3)), timeout=numbers(3), mode=MODES)
    ),
    efforts=optional(
        part(
            status.EffortsStatus,
            receivers=COUNTS,
            topic=TEXTS,
            external_topic=TEXTS,
            measures_gravity=optional(st.booleans()),
            scale=st.lists(numbers(3, -999_999), max_size=7).map(tuple),
            measured_scale=st.lists(numbers(3, -999_999), max_size=7).map(tuple),
            limits=st.lists(numbers(3) | st.just(math.inf), min_size=1, max_size=7).map(tuple),
            cut=SEVERAL,
            cut_counts=TOTALS,
            slowed_counts=TOTALS,
        )
    ),
    model=optional(
        part(
            status.ModelStatus,
            robot=TEXTS,
            mass=st.integers(0, 9999).map(lambda k: k / 100),
            joints=SOME,
            payloads=st.lists(st.builds(status.Payload, numbers(3), NAMES), max_size=2).map(tuple),
            payload_coms=st.lists(st.sampled_from([0.0, -0.12, 1.5]), max_size=6).map(tuple),
            gravity=optional(st.tuples(*[numbers(3, -999_999)] * 3)),
            gravity_at_root=optional(st.tuples(*[numbers(3, -999_999)] * 3)),
            warnings=st.lists(TEXTS, max_size=2).map(tuple),
        )
    ),
    scheduling=optional(
        part(
            status.SchedulingStatus,
            policy=optional(NAMES),
            priority=optional(COUNTS),
        )
    ),
)


@given(STATUSES)
def test_what_is_written_is_what_is_read(written):
    assert read_status(write_status(Time(), '/left/arm', written), '/left/arm') == written


def test_a_message_of_another_node_is_not_read():
    message = write_status(Time(), '/left/arm', NodeStatus(LoopStatus()))
    for name in ('/arm', '/left', '/left/arm_2', '/right/arm'):
        assert read_status(message, name) is None


def test_limits_of_currents_are_those_of_the_efforts_of_the_model():
    efforts = status.EffortsStatus(scale=(500.0, -2.0, 0.0), limits=(1000.0, 8.0, 3.0))
    model = status.ModelStatus(joints=('hip', 'knee', 'toe'))
    arm = NodeStatus(LoopStatus(), efforts=efforts, model=model)
    assert arm.unscaled_limits() == {'hip': 2.0, 'knee': 4.0}


def test_values_that_cannot_be_read_are_left_out():
    fine = LoopStatus(Level.WARN, 'words', state='active', rate=5.0, phase=Phase.RUNNING)
    message = write_status(Time(), 'arm', NodeStatus(fine))
    values = message.status[0].values
    values += [SimpleNamespace(key='new key', value='new'), SimpleNamespace(key='gain', value='?')]
    for pair in values:
        if pair.key in ('rate [Hz]', 'phase'):
            pair.value = 'of another version'
    message.status.append(SimpleNamespace(name='arm: new part', values=values))
    found = read_status(SimpleNamespace(status=message.status), 'arm')
    assert found == NodeStatus(replace(fine, rate=None, phase=None))
    assert not found.is_computing


@pytest.mark.parametrize(
    ('kind', 'values', 'texts'),
    [
        (
            LoopStatus,
            {'state': 'active', 'rate': 1.26, 'period_p99': 0.0123456, 'is_dry_run': True},
            {
                'state': 'active',
                'rate [Hz]': '1.3',
                'requested rate [Hz]': 'that of the joint states',
                'period p99 [ms]': '12.346',
                'period worst [ms]': 'none',
                'compute time p99 [ms]': 'none',
                'dry run': 'yes',
            },
        ),
        (
            status.EffortsStatus,
            {'limits': (87.0, math.inf), 'cut_counts': {'elbow': 3}, 'slowed_counts': {'hip': 2}},
            {
                'topic with names': '',
                'topic of the external efforts': '',
                'scale': 'none',
                'scale of the measured efforts': 'none',
                'limits [N m, N]': '87, inf',
                'cut to limit since the last report': 'none',
                'elbow cut to limit': '3',
                'hip slowed': '2',
            },
        ),
        (
            status.SchedulingStatus,
            {'policy': 'SCHED_FIFO', 'priority': 40},
            {
                'policy': 'SCHED_FIFO',
                'priority': '40',
            },
        ),
    ],
)
def test_the_texts_are_those_of_the_interface(kind, values, texts):
    assert write_values(kind(**values)) == texts
