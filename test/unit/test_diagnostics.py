"""What the node writes to /diagnostics is what `watch` reads, and what the status answers."""

from collections.abc import Mapping
from dataclasses import fields, replace
import math
from types import SimpleNamespace
from typing import get_args, get_origin, get_type_hints

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node.control.settings import Mode
from inverse_dynamics_node.control.status import (
    EffortsStatus,
    JointStatesStatus,
    Level,
    LoopStatus,
    MessagesStatus,
    ModelStatus,
    NodeNames,
    NodeStatus,
    Payload,
    Problem,
    SchedulingStatus,
)
from inverse_dynamics_node.control.supervision import Phase
import pytest

pytest.importorskip('diagnostic_msgs')

from builtin_interfaces.msg import Time
from inverse_dynamics_node.ros.diagnostics import (
    read_status,
    write_status,
    write_values,
)

COUNTS = st.integers(0, 10**6)
NAMES = st.text('abc_/ 9', min_size=1, max_size=8)
DECIMALS = {'.1f': 1, '.3f': 3, 'g': 3, '.4g': 2}  # of numbers that are printed with all digits
VALUES = {
    str: NAMES,
    int: COUNTS,
    bool: st.booleans(),
    Mode: st.sampled_from(Mode),
    Phase: st.sampled_from(Phase),
    Payload: st.builds(Payload, st.integers(0, 999), NAMES),
    NodeNames: st.lists(NAMES, max_size=8).map(NodeNames.of),
}


def numbers(form, factor):
    most = 9999 if form == '.4g' else 999_999
    decimals = 10 ** DECIMALS[form]
    found = st.integers(-most, most).map(lambda k: k / decimals / factor)
    return found | st.just(math.inf) if form == 'g' else found


def values_of(hint, metadata):
    """Return a strategy for the values of a field."""
    if type(None) in get_args(hint):
        values = values_of(get_args(hint)[0], metadata)
        return values if get_origin(get_args(hint)[0]) is Mapping else st.none() | values
    if get_origin(hint) is Mapping:
        return st.dictionaries(NAMES, COUNTS, max_size=3)
    if get_origin(hint) is tuple:
        return st.lists(values_of(get_args(hint)[0], metadata), max_size=3).map(tuple)
    if hint is float:
        return numbers(metadata['form'], 1e3 if '[ms]' in metadata['key'] else 1.0)
    return VALUES[hint]


def part_of(hint):
    """Return a strategy for one part of the status; the loop is never None."""
    kind = get_args(hint)[0] if get_args(hint) else hint
    hints = get_type_hints(kind)
    values = {
        field.name: values_of(hints[field.name], field.metadata)
        for field in fields(kind)
        if 'key' in field.metadata
    }
    found = st.builds(kind, level=st.sampled_from(Level), message=NAMES, **values)
    return st.none() | found if get_args(hint) else found


STATUSES = st.builds(
    NodeStatus, **{name: part_of(hint) for name, hint in get_type_hints(NodeStatus).items()}
)


@given(STATUSES)
def test_what_is_written_is_what_is_read(written):
    assert read_status(write_status(Time(), '/left/arm', written), '/left/arm') == written


def test_a_message_of_another_node_is_not_read():
    message = write_status(Time(), '/left/arm', NodeStatus(LoopStatus()))
    for name in ('/arm', '/left', '/left/arm_2', '/right/arm'):
        assert read_status(message, name) is None


LOOP = LoopStatus(state='active')
MODEL = ModelStatus(joints=('hip', 'knee'))
EFFORTS = EffortsStatus(limits=(5.0, 7.0), measured_scale=(1.0, -2.0))


def test_values_of_the_commanded_joints_are_found_by_name():
    status = NodeStatus(LOOP, efforts=EFFORTS, model=MODEL)
    assert status.limits() == {'hip': 5.0, 'knee': 7.0}
    assert status.measured_scale() == {'hip': 1.0, 'knee': -2.0}
    efforts = EffortsStatus(scale=(500.0, 0.0), limits=(1000.0, 3.0))
    assert NodeStatus(LOOP, efforts=efforts, model=MODEL).unscaled_limits() == {'hip': 2.0}


def test_values_are_unknown_if_they_do_not_belong_to_the_joints():
    for values in (NodeStatus.limits, NodeStatus.unscaled_limits, NodeStatus.measured_scale):
        assert values(NodeStatus(LOOP, model=MODEL)) == {}
    assert NodeStatus(LOOP, efforts=EFFORTS).limits() == {}
    assert NodeStatus(LOOP, efforts=EFFORTS).measured_scale() == {}
    other = ModelStatus(joints=('hip', 'knee', 'ankle'))
    assert NodeStatus(LOOP, efforts=EFFORTS, model=other).limits() == {}
    assert NodeStatus(LOOP, efforts=EffortsStatus(), model=MODEL).measured_scale() == {}


def test_problems_are_the_parts_that_are_not_ok_errors_first():
    status = NodeStatus(
        LOOP,
        messages=MessagesStatus(Level.WARN, 'one dropped'),
        joint_states=JointStatesStatus(Level.ERROR, 'none'),
        efforts=EFFORTS,
        model=ModelStatus(Level.WARN, '3 warnings'),
    )
    assert status.problems() == (
        Problem('joint states', 'ERROR', 'none'),
        Problem('messages', 'WARN', 'one dropped'),
        Problem('model', 'WARN', '3 warnings'),
    )
    assert NodeStatus(LOOP, model=MODEL).problems() == ()


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
            EffortsStatus,
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
            SchedulingStatus,
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
