"""What can be asked of the status of a node."""

from inverse_dynamics_node.control.status import (
    EffortsStatus,
    JointStatesStatus,
    key,
    Level,
    LoopStatus,
    MessagesStatus,
    ModelStatus,
    NodeStatus,
    Problem,
)

LOOP = LoopStatus(state='active')
MODEL = ModelStatus(joints=('hip', 'knee'))
EFFORTS = EffortsStatus(limits=(5.0, 7.0), measured_scale=(1.0, -2.0))


def test_values_of_the_commanded_joints_are_found_by_name():
    status = NodeStatus(LOOP, efforts=EFFORTS, model=MODEL)
    assert status.limits() == {'hip': 5.0, 'knee': 7.0}
    assert status.measured_scale() == {'hip': 1.0, 'knee': -2.0}


def test_values_are_unknown_if_they_do_not_belong_to_the_joints():
    for values in (NodeStatus.limits, NodeStatus.unscaled_limits, NodeStatus.measured_scale):
        assert values(NodeStatus(LOOP, model=MODEL)) == {}
    assert NodeStatus(LOOP, efforts=EFFORTS).limits() == {}
    assert NodeStatus(LOOP, efforts=EFFORTS).measured_scale() == {}
    other = ModelStatus(joints=('hip', 'knee', 'ankle'))
    assert NodeStatus(LOOP, efforts=EFFORTS, model=other).limits() == {}
    assert NodeStatus(LOOP, efforts=EffortsStatus(), model=MODEL).measured_scale() == {}


def test_a_value_is_declared_with_its_key_format_and_default():
    declared = key('rate [Hz]', '.1f', 'unknown', default=2.0)
    assert declared.default == 2.0
    assert declared.metadata == {'key': 'rate [Hz]', 'form': '.1f', 'absent': 'unknown'}
    assert key('rate [Hz]').default is None


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
