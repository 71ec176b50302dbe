"""Springs and dampers hold the joints at the reference, or where they were when it began."""

from dataclasses import replace
import math

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop, Phase
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
from inverse_dynamics_node.node.status_text import describe_unstable_gains
import numpy as np
import pytest
from robot_files import ROOT
from states import joint_state, store_state, unobserved, UnobservedController

TEXT = (ROOT / 'test/robots/planar_2r.urdf').read_text()
ROBOT = load_urdf(TEXT)
NAMES = ROBOT.joint_names
DYNAMICS = InverseDynamics(ROBOT)
Q, REST = np.array([0.4, -0.7]), np.zeros(2)
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


def arm(settings=HELD, **changes):
    return UnobservedController(InverseDynamics(ROBOT), (), replace(settings, **changes))


def step(arm, now, q=Q, qd=REST, reference=None, received=None):
    received = now if received is None else received
    state = joint_state(np.array(q), np.array(qd), received, np.full(2, received))
    return arm.step(now, state, reference).efforts.copy()


def repeat(arm, begin, end, *inputs):
    for now in np.arange(begin, end, 0.01):
        efforts = step(arm, now, *inputs)
    return efforts


def reference(time, positions=None, velocities=None, accelerations=REST, efforts=REST):
    return Reference(accelerations, np.array(efforts), time, positions, velocities)


def spring(q, equilibrium=Q):
    """Return the efforts that hold joints at rest."""
    return DYNAMICS.gravity_efforts(q) + K * (equilibrium - q)


def test_without_a_reference_the_first_measured_position_is_held():
    robot = arm()
    assert step(robot, 0.0) == pytest.approx(DYNAMICS.gravity_efforts(Q))
    assert robot.phase is Phase.HOLDING
    assert step(robot, 0.01, PUSHED) == pytest.approx(spring(PUSHED))
    qd = np.array([0.5, -0.4])
    model = DYNAMICS.efforts(PUSHED, qd, REST)
    assert step(robot, 0.02, PUSHED, qd) == pytest.approx(model + K * (Q - PUSHED) - D * qd)


def test_the_reference_is_followed_with_its_velocities_accelerations_and_efforts():
    robot = arm()
    q_ref, qd_ref, qdd = Q + 0.1, np.array([0.2, 0.3]), np.array([1.0, -2.0])
    qd, added = np.array([0.5, -0.4]), np.array([0.7, 0.9])
    found = step(robot, 0.0, Q, qd, reference(0.0, q_ref, qd_ref, qdd, added))
    model = DYNAMICS.efforts(Q, qd, qdd)
    assert found == pytest.approx(model + added + K * (q_ref - Q) + D * (qd_ref - qd))
    assert robot.phase is Phase.RUNNING


def test_springs_belong_to_the_commanded_joints():
    robot = UnobservedController(InverseDynamics(ROBOT), NAMES[::-1], HELD)
    step(robot, 0.0)
    found = step(robot, 0.01, PUSHED)
    pull = (Q - PUSHED)[::-1]
    assert found == pytest.approx(DYNAMICS.gravity_efforts(PUSHED)[::-1] + K * pull)


def test_a_reference_without_velocities_is_damped():
    qd = np.array([0.5, -0.4])
    found = step(arm(), 0.0, Q, qd, reference(0.0, Q))
    assert found == pytest.approx(DYNAMICS.efforts(Q, qd, REST) - D * qd)


def test_a_reference_without_positions_leaves_the_equilibrium_where_it_is():
    robot = arm()
    step(robot, 0.0)
    qdd, added = np.array([1.0, -2.0]), np.array([0.7, 0.9])
    found = step(robot, 0.01, PUSHED, REST, reference(0.01, None, None, qdd, added))
    model = DYNAMICS.efforts(PUSHED, REST, qdd)
    assert found == pytest.approx(model + added + K * (Q - PUSHED))
    assert robot.phase is Phase.RUNNING
    assert step(robot, 0.02, PUSHED) == pytest.approx(spring(PUSHED))


def test_the_end_of_a_reference_causes_no_step():
    robot = arm(reference_timeout=0.5)
    last = reference(0.0, Q + 0.1)
    followed = step(robot, 0.5, Q, REST, last)
    assert robot.phase is Phase.RUNNING
    assert step(robot, 0.51, Q, REST, last) == pytest.approx(followed)
    assert robot.phase is Phase.HOLDING
    assert step(robot, 9.0, PUSHED) == pytest.approx(spring(PUSHED, Q + 0.1))


def test_the_largest_step_is_that_of_the_equilibrium():
    robot = arm(max_tracking_error=0.1)
    pushed, beyond = (Q + way * np.eye(2)[0] for way in (0.09, 0.15))
    step(robot, 0.0)
    assert step(robot, 0.01, pushed, REST, reference(0.01, Q)) == pytest.approx(spring(pushed))
    assert robot.phase is Phase.RUNNING
    # Near the arm, but far from where it is held.
    assert step(robot, 0.02, pushed, REST, reference(0.02, beyond)) == pytest.approx(
        spring(pushed)
    )
    assert robot.phase is Phase.HOLDING_TOO_FAR
    assert step(robot, 0.03, pushed, REST, reference(0.03, pushed)) == pytest.approx(
        spring(pushed, pushed)
    )
    assert robot.phase is Phase.RUNNING


@pytest.mark.parametrize('mode', [mode for mode in Mode if mode is not Mode.JOINT_IMPEDANCE])
def test_a_reference_after_a_switch_is_compared_with_the_measured_position(mode):
    robot = arm(mode=mode, max_tracking_error=0.0)
    step(robot, 0.0, Q, REST, reference(0.0, Q + 0.4))
    robot.apply(replace(HELD, max_tracking_error=0.1))
    assert step(robot, 0.01, Q, REST, reference(0.01, Q + 0.4)) == pytest.approx(spring(Q))
    assert robot.phase is Phase.HOLDING_TOO_FAR
    robot.apply(replace(HELD, mode=Mode.COMPUTED_TORQUE, max_tracking_error=0.1))
    step(robot, 0.02, Q + 0.4, REST, reference(0.02, Q + 0.4))
    assert robot.phase is Phase.RUNNING


def test_continuous_joints_take_the_shorter_way():
    wheel = load_urdf(TEXT.replace('"revolute"', '"continuous"'))
    robot = UnobservedController(InverseDynamics(wheel, (0.0, 0.0, 0.0)), (), HELD)
    step(robot, 0.0, [3.1, 0.1])
    turned = 2.0 * math.pi - 6.2
    found = step(robot, 0.01, [-3.1, 0.1 - 4.0 * math.pi])
    assert found == pytest.approx([-K[0] * turned, 0.0], abs=1e-9)
    step(robot, 0.02, [-3.1, 0.1], REST, reference(0.02, np.array([3.0, 0.1])))
    assert robot.phase is Phase.RUNNING


def restarted(robot):
    robot.start()
    return 0.02, robot


def stopped(robot):
    robot.stop()
    for now in np.arange(0.02, 0.7, 0.01):
        step(robot, now, PUSHED)
    robot.resume()
    return now, robot


def lost(robot):
    for now in np.arange(0.02, 2.0, 0.01):
        step(robot, now, PUSHED, received=0.01 if now < 1.0 else now)
    return now, robot


def switched(robot):
    robot.apply(replace(robot.settings, mode=Mode.GRAVITY_COMPENSATION))
    step(robot, 0.02, PUSHED)
    robot.apply(replace(robot.settings, mode=Mode.JOINT_IMPEDANCE))
    return 0.02, robot


def set_back(robot):
    step(robot, -50.0, PUSHED, received=0.01)
    return -50.0, robot


@pytest.mark.parametrize('interrupt', [restarted, stopped, lost, switched, set_back])
@pytest.mark.parametrize('policy', StalePolicy)
def test_after_an_interruption_the_arm_is_held_where_it_is(interrupt, policy):
    robot = arm(SMOOTH, on_stale_state=policy)
    step(robot, 0.0)
    step(robot, 0.01, PUSHED)
    now, robot = interrupt(robot)
    for k in range(1, 120):
        found = step(robot, now + 0.01 * k, PUSHED)
    assert robot.phase is Phase.HOLDING
    assert found == pytest.approx(DYNAMICS.gravity_efforts(PUSHED))


@pytest.mark.parametrize('interrupt', [stopped, lost, switched, set_back])
def test_an_interruption_causes_no_step(interrupt):
    robot = arm(SMOOTH)
    step(robot, -1.0)
    for now in np.arange(-0.99, 0.0, 0.01):
        step(robot, now, PUSHED)
    before = step(robot, 0.0, PUSHED)
    now, robot = interrupt(robot)
    steps = [step(robot, now + 0.01 * k, PUSHED) for k in range(1, 120)]
    assert before - steps[-1] == pytest.approx(K * (Q - PUSHED))
    assert np.abs(np.diff(steps, axis=0)).max() < 0.04 * np.abs(before).max()


@pytest.mark.parametrize('policy', StalePolicy)
def test_a_brief_loss_changes_nothing(policy):
    robot = arm(SMOOTH, on_stale_state=policy, state_timeout=0.102)
    step(robot, 0.0)
    phases = set()
    for k in range(1, 700):  # every 5 ms, with a new state every 110 ms
        found = step(robot, 0.005 * k, PUSHED, received=0.11 * (k // 22))
        phases.add(robot.phase)
    assert phases == {Phase.HOLDING, Phase.STATE_LOST}
    assert found == pytest.approx(spring(PUSHED))


def test_payloads_gravity_and_friction_do_not_move_the_equilibrium():
    robot = arm()
    step(robot, 0.0)
    step(robot, 0.01, PUSHED)
    expected = InverseDynamics(ROBOT, (0.0, 2.0, -9.0))
    for dynamics in (robot.dynamics, expected):
        dynamics.set_gravity((0.0, 2.0, -9.0))
        dynamics.set_payload(ROBOT.link_names[-1], 0.5)
        dynamics.set_friction(1.0, 1.0)
    robot.blend()
    found = step(robot, 0.02, PUSHED)
    assert found == pytest.approx(expected.gravity_efforts(PUSHED) + K * (Q - PUSHED))


def test_a_suspension_does_not_move_the_equilibrium():
    robot = arm(SMOOTH)
    step(robot, 0.0)
    before = repeat(robot, 0.01, 1.0, PUSHED)
    assert step(robot, 9.0, PUSHED) == pytest.approx(before)
    assert repeat(robot, 9.01, 10.0, PUSHED) == pytest.approx(before)


def test_positions_that_jump_are_held_where_they_are_from_then_on():
    """After an encoder was reset, the old equilibrium is somewhere else."""
    loop = unobserved(ControlLoop(ROBOT, settings=SMOOTH))
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
    loop = ControlLoop(ROBOT, NAMES[:1], replace(HELD, stiffness=30.0, impedance_damping=0.0))
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
    step(robot, 0.0)
    before = repeat(robot, 0.01, 1.0, PUSHED, qd)
    robot.apply(replace(SMOOTH, **change))
    stiffness, damping = change.get('stiffness', K), change.get('impedance_damping', D)
    further = PUSHED + 0.01
    first = step(robot, 1.0, further, qd)
    model = DYNAMICS.efforts(further, qd, REST) - DYNAMICS.efforts(PUSHED, qd, REST)
    assert first - before == pytest.approx(model - 0.01 * stiffness)
    found = repeat(robot, 1.01, 2.0, further, qd)
    model = DYNAMICS.efforts(further, qd, REST)
    assert found == pytest.approx(model + stiffness * (Q - further) - damping * qd)


@pytest.mark.parametrize('other', [mode for mode in Mode if mode is not Mode.JOINT_IMPEDANCE])
def test_switching_modes_causes_no_step(other):
    robot = arm(SMOOTH)
    step(robot, 0.0)
    repeat(robot, 0.01, 1.0, PUSHED)
    efforts = [step(robot, 1.0, PUSHED)]
    for k, mode in enumerate((other, Mode.JOINT_IMPEDANCE, other, Mode.JOINT_IMPEDANCE)):
        robot.apply(replace(SMOOTH, mode=mode))
        begin = 1.01 + 0.3 * k
        efforts += [step(robot, begin + 0.01 * j, PUSHED) for j in range(30)]
    assert np.abs(np.diff(efforts, axis=0)).max() < 0.025 * np.abs(K * (Q - PUSHED)).max()


def test_settings_that_change_after_a_switch_in_the_same_moment():
    robot = arm(mode=Mode.INVERSE_DYNAMICS)
    step(robot, 0.0)
    robot.apply(HELD)
    robot.apply(replace(HELD, stiffness=99.0))
    assert step(robot, 0.01) == pytest.approx(DYNAMICS.gravity_efforts(Q))
    assert step(robot, 0.02, PUSHED) == pytest.approx(
        DYNAMICS.gravity_efforts(PUSHED) + 99.0 * (Q - PUSHED)
    )


@pytest.mark.filterwarnings('error')
def test_an_absurd_reference_is_forgotten():
    robot = arm(max_tracking_error=0.0)
    step(robot, 0.0)
    step(robot, 0.01, Q, REST, reference(0.01, np.array([-1.7e308, 0.0])))
    assert robot.phase is Phase.NO_SOLUTION
    for k in range(2, 100):
        found = step(robot, 0.01 * k)
    assert robot.phase is Phase.HOLDING
    assert found == pytest.approx(DYNAMICS.gravity_efforts(Q))


def test_the_arrays_of_the_next_joint_state_do_not_move_the_equilibrium():
    loop = ControlLoop(ROBOT, settings=HELD)
    for now, q in ((0.0, Q), (0.01, PUSHED)):
        store_state(loop.collector, now, NAMES, q, REST)
        efforts = loop.step(now).efforts
    assert efforts == pytest.approx(spring(PUSHED))


def test_joints_that_are_too_light_for_their_gains_are_described():
    loop = ControlLoop(ROBOT, settings=HELD)
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
        loop = ControlLoop(ROBOT, NAMES[:1], settings)
        store_state(loop.collector, 0.0, NAMES, Q, REST)
        loop.step(0.0)
        leapt = Q + np.array([0.01, 0.01])
        leapt[joint] += 2.0
        store_state(loop.collector, 0.005, NAMES, leapt, REST)
        loop.step(0.005)
        held = loop.law.equilibrium
        assert held == pytest.approx(leapt[:1] if moves else Q[:1])
