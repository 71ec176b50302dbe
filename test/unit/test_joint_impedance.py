"""Springs and dampers hold the joints at the reference, or where they were when it began."""

from dataclasses import replace

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
from inverse_dynamics_node.control.supervisor import Phase
from inverse_dynamics_node.node.status_text import describe_unstable_gains
import numpy as np
import pytest
from states import Arm, PLANAR, Q, reference, REST, store_state, unobserved

NAMES = PLANAR.joint_names
DYNAMICS = InverseDynamics(PLANAR)
PUSHED = Q + np.array([0.02, -0.03])
K, D = np.array([30.0, 20.0]), np.array([2.0, 1.0])
HELD = Settings(
    mode=Mode.JOINT_IMPEDANCE,
    stiffness=(30.0, 20.0),
    impedance_damping=(2.0, 1.0),
    start_ramp=0.0,
    stop_ramp=0.5,
    use_urdf_effort_limits=False,
)
SMOOTH = replace(HELD, start_ramp=0.5)
OTHERS = [mode for mode in Mode if mode is not Mode.JOINT_IMPEDANCE]


def arm(settings=HELD, **changes):
    return Arm(is_observed=False, settings=settings, **changes)


def repeat(arm, begin, end, *inputs):
    for now in np.arange(begin, end, 0.01):
        efforts = arm.at(now, *inputs)
    return efforts


def spring(q, equilibrium=Q):
    """Return the efforts that hold joints at rest."""
    return DYNAMICS.gravity_efforts(q) + K * (equilibrium - q)


def test_without_a_reference_the_first_measured_position_is_held():
    robot = arm()
    assert robot.at(0.0) == pytest.approx(DYNAMICS.gravity_efforts(Q))
    assert robot.phase is Phase.HOLDING
    assert robot.at(0.01, PUSHED) == pytest.approx(spring(PUSHED))


def test_a_reference_without_positions_leaves_the_equilibrium_where_it_is():
    robot = arm()
    robot.at(0.0)
    robot.at(0.01, PUSHED, REST, reference(0.01, None, None, [1.0, -2.0]))
    assert robot.phase is Phase.RUNNING
    assert robot.at(0.02, PUSHED) == pytest.approx(spring(PUSHED))


def test_the_end_of_a_reference_causes_no_step():
    robot = arm(reference_timeout=0.5)
    last = reference(0.0, Q + 0.1)
    followed = robot.at(0.5, Q, REST, last)
    assert robot.phase is Phase.RUNNING
    assert robot.at(0.51, Q, REST, last) == pytest.approx(followed)
    assert robot.phase is Phase.HOLDING
    assert robot.at(9.0, PUSHED) == pytest.approx(spring(PUSHED, Q + 0.1))


def test_the_largest_step_is_that_of_the_equilibrium():
    robot = arm(max_tracking_error=0.1)
    pushed, beyond = (Q + way * np.eye(2)[0] for way in (0.09, 0.15))
    robot.at(0.0)
    for now, target, held, phase in (
        (0.01, Q, Q, Phase.RUNNING),
        # Near the arm, but far from where it is held.
        (0.02, beyond, Q, Phase.HOLDING_TOO_FAR),
        (0.03, pushed, pushed, Phase.RUNNING),
    ):
        efforts = robot.at(now, pushed, REST, reference(now, target))
        assert efforts == pytest.approx(spring(pushed, held))
        assert robot.phase is phase


@pytest.mark.parametrize('mode', OTHERS)
def test_a_reference_after_a_switch_is_compared_with_the_measured_position(mode):
    robot = arm(mode=mode, max_tracking_error=0.0)
    robot.at(0.0, Q, REST, reference(0.0, Q + 0.4))
    robot.change(mode=Mode.JOINT_IMPEDANCE, max_tracking_error=0.1)
    assert robot.at(0.01, Q, REST, reference(0.01, Q + 0.4)) == pytest.approx(spring(Q))
    assert robot.phase is Phase.HOLDING_TOO_FAR
    robot.change(mode=Mode.COMPUTED_TORQUE)
    robot.at(0.02, Q + 0.4, REST, reference(0.02, Q + 0.4))
    assert robot.phase is Phase.RUNNING


def restarted(robot):
    robot.loop.start()
    return 0.02


def stopped(robot):
    robot.loop.stop()
    repeat(robot, 0.02, 0.7, PUSHED)
    robot.loop.resume()
    return 0.69


def lost(robot):
    for now in np.arange(0.02, 2.0, 0.01):
        robot.at(now, PUSHED, received=0.01 if now < 1.0 else now)
    return now


def switched(robot):
    robot.change(mode=Mode.GRAVITY_COMPENSATION)
    robot.at(0.02, PUSHED)
    robot.change(mode=Mode.JOINT_IMPEDANCE)
    return 0.02


def set_back(robot):
    robot.at(-50.0, PUSHED, received=0.01)
    return -50.0


@pytest.mark.parametrize('interrupt', [restarted, stopped, lost, switched, set_back])
@pytest.mark.parametrize('policy', StalePolicy)
def test_after_an_interruption_the_arm_is_held_where_it_is_without_a_step(interrupt, policy):
    robot = arm(SMOOTH, on_stale_state=policy)
    robot.at(-1.0)
    before = repeat(robot, -0.99, 0.011, PUSHED)
    now = interrupt(robot)
    steps = np.array([robot.at(now + 0.01 * k, PUSHED) for k in range(1, 120)])
    assert robot.phase is Phase.HOLDING
    assert steps[-1] == pytest.approx(DYNAMICS.gravity_efforts(PUSHED))
    assert np.abs(before - steps[-1]).max() > 0.5
    assert np.abs(np.diff(steps, axis=0)).max() < 0.04 * np.abs(before).max()


@pytest.mark.parametrize('policy', StalePolicy)
def test_a_brief_loss_changes_nothing(policy):
    robot = arm(SMOOTH, on_stale_state=policy, state_timeout=0.102)
    robot.at(0.0)
    phases = set()
    for k in range(1, 700):  # every 5 ms, with a new state every 110 ms
        found = robot.at(0.005 * k, PUSHED, received=0.11 * (k // 22))
        phases.add(robot.phase)
    assert phases == {Phase.HOLDING, Phase.STATE_LOST}
    assert found == pytest.approx(spring(PUSHED))


def test_payloads_gravity_and_friction_do_not_move_the_equilibrium():
    robot = arm()
    robot.at(0.0)
    robot.at(0.01, PUSHED)
    expected = InverseDynamics(PLANAR, (0.0, 2.0, -9.0))
    for dynamics in (robot.loop.dynamics, expected):
        dynamics.set_gravity((0.0, 2.0, -9.0))
        dynamics.set_payload(PLANAR.link_names[-1], 0.5)
        dynamics.set_friction(1.0, 1.0)
    robot.loop.blend()
    found = robot.at(0.02, PUSHED)
    assert found == pytest.approx(expected.gravity_efforts(PUSHED) + K * (Q - PUSHED))


def test_a_suspension_does_not_move_the_equilibrium():
    robot = arm(SMOOTH)
    robot.at(0.0)
    before = repeat(robot, 0.01, 1.0, PUSHED)
    assert robot.at(9.0, PUSHED) == pytest.approx(before)
    assert repeat(robot, 9.01, 10.0, PUSHED) == pytest.approx(before)


def test_positions_that_jump_are_held_where_they_are_from_then_on():
    """After an encoder was reset, the old equilibrium is somewhere else."""
    loop = unobserved(ControlLoop(PLANAR, settings=SMOOTH))
    loop.dynamics.set_gravity((0.0, 0.0, 0.0))
    loop.loads.set_gravity((0.0, 0.0, 0.0))
    for k in range(300):
        now = 0.01 * k
        q = Q if k < 100 else Q + 0.4 * np.eye(2)[0]
        store_state(loop.collector, now, NAMES, q, REST)
        efforts = loop.step(now).efforts
        assert np.abs(efforts).max() < 1e-9
    store_state(loop.collector, 3.0, NAMES, q + 0.01 * np.eye(2)[0], REST)
    assert loop.step(3.0).efforts == pytest.approx([-0.3, 0.0])


def test_a_late_joint_that_is_not_commanded_does_not_move_the_equilibrium():
    loop = ControlLoop(PLANAR, NAMES[:1], replace(HELD, stiffness=30.0, impedance_damping=0.0))
    for k in range(200):
        is_late = k >= 2
        q = Q if k == 0 else Q + np.array([0.02, 0.0])
        store_state(
            loop.collector, 0.01 * k, NAMES[: 1 if is_late else 2], q[: 1 if is_late else 2], []
        )
        efforts = loop.step(0.01 * k).efforts
    assert list(loop.collector.late(2.0)) == list(NAMES[1:])
    assert efforts == pytest.approx(DYNAMICS.gravity_efforts(q)[:1] - 30.0 * 0.02)


@pytest.mark.parametrize('change', [{'stiffness': 5.0}, {'impedance_damping': 0.0}])
def test_a_live_change_of_the_gains_is_blended_while_motion_acts_at_once(change):
    robot, qd = arm(SMOOTH), np.array([0.1, 0.2])
    robot.at(0.0)
    before = repeat(robot, 0.01, 1.0, PUSHED, qd)
    robot.change(**change)
    stiffness, damping = change.get('stiffness', K), change.get('impedance_damping', D)
    further = PUSHED + 0.01
    first = robot.at(1.0, further, qd)
    model = DYNAMICS.efforts(further, qd, REST) - DYNAMICS.efforts(PUSHED, qd, REST)
    assert first - before == pytest.approx(model - 0.01 * stiffness)
    found = repeat(robot, 1.01, 2.0, further, qd)
    model = DYNAMICS.efforts(further, qd, REST)
    assert found == pytest.approx(model + stiffness * (Q - further) - damping * qd)


@pytest.mark.parametrize('other', OTHERS)
def test_switching_modes_causes_no_step(other):
    robot = arm(SMOOTH)
    robot.at(0.0)
    efforts = [repeat(robot, 0.01, 1.001, PUSHED)]
    for k, mode in enumerate((other, Mode.JOINT_IMPEDANCE, other, Mode.JOINT_IMPEDANCE)):
        robot.change(mode=mode)
        efforts += [robot.at(1.01 + 0.3 * k + 0.01 * j, PUSHED) for j in range(30)]
    assert np.abs(np.diff(efforts, axis=0)).max() < 0.025 * np.abs(K * (Q - PUSHED)).max()


def test_settings_that_change_after_a_switch_in_the_same_moment():
    robot = arm(mode=Mode.INVERSE_DYNAMICS)
    robot.at(0.0)
    robot.change(mode=Mode.JOINT_IMPEDANCE)
    robot.change(stiffness=99.0)
    assert robot.at(0.01) == pytest.approx(DYNAMICS.gravity_efforts(Q))
    pull = 99.0 * (Q - PUSHED)
    assert robot.at(0.02, PUSHED) == pytest.approx(DYNAMICS.gravity_efforts(PUSHED) + pull)


@pytest.mark.filterwarnings('error')
def test_an_absurd_reference_is_forgotten():
    robot = arm(max_tracking_error=0.0)
    robot.at(0.0)
    robot.at(0.01, Q, REST, reference(0.01, np.array([-1.7e308, 0.0])))
    assert robot.phase is Phase.NO_SOLUTION
    found = repeat(robot, 0.02, 1.0)
    assert robot.phase is Phase.HOLDING
    assert found == pytest.approx(DYNAMICS.gravity_efforts(Q))


def test_joints_that_are_too_light_for_their_gains_are_described():
    loop = ControlLoop(PLANAR, settings=HELD)
    store_state(loop.collector, 0.0, NAMES, Q, REST)
    assert describe_unstable_gains(loop) == ''
    inertia = DYNAMICS.mass_matrix(Q)[1, 1]
    loop.apply(replace(HELD, impedance_damping=(0.0, 1.01 * inertia / 0.005)))
    text = describe_unstable_gains(loop)
    assert text == (
        f'{NAMES[1]} may oscillate: with its inertia ({inertia:.2g}) and a delay of 5 ms, '
        f'impedance_damping should be at most {inertia / 0.005:.2g} and stiffness at most '
        f'{inertia / 0.005**2:.2g}; lower these gains, or set armature to the reflected inertia '
        'of the rotor'
    )
    for share, is_light in ((0.99, False), (1.01, True)):
        stiffness = (0.0, share * inertia / 0.005**2)
        loop.apply(replace(HELD, impedance_damping=0.0, stiffness=stiffness))
        assert bool(describe_unstable_gains(loop)) is is_light
    loop.dynamics.set_armature(inertia)
    assert describe_unstable_gains(loop) == ''
    loop.apply(replace(HELD, stiffness=1e9, mode=Mode.COMPUTED_TORQUE))
    assert describe_unstable_gains(loop) == ''
    loop.apply(replace(HELD, kp=(1e6, 1.0), mode=Mode.COMPUTED_TORQUE))
    text = describe_unstable_gains(loop)
    assert f'{NAMES[0]} may oscillate: with a delay of 5 ms, kd should be at most 2e+02' in text
    assert NAMES[1] not in text


def test_a_leap_of_a_joint_that_is_not_commanded_does_not_move_the_equilibrium():
    settings = replace(HELD, stiffness=30.0, impedance_damping=2.0)
    for joint, moves in ((0, True), (1, False)):
        loop = ControlLoop(PLANAR, NAMES[:1], settings)
        store_state(loop.collector, 0.0, NAMES, Q, REST)
        loop.step(0.0)
        leapt = Q + np.array([0.01, 0.01])
        leapt[joint] += 2.0
        store_state(loop.collector, 0.005, NAMES, leapt, REST)
        loop.step(0.005)
        held = loop.law.equilibrium
        assert held == pytest.approx(leapt[:1] if moves else Q[:1])
