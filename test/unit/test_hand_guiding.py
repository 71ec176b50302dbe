"""Gravity compensation that compensates a share of the friction, from the measured velocity."""

from dataclasses import replace

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop, Phase
from inverse_dynamics_node.control.settings import Mode, Settings
import numpy as np
import pytest
from robot_files import ROOT
from states import joint_state, store_state, unobserved, UnobservedController

ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
NAMES = ROBOT.joint_names
Q, QD = np.array([0.4, -0.7]), np.array([0.3, -0.2])
DAMPING, COULOMB = np.array([2.0, 1.0]), np.array([0.6, 0.4])
FRICTION = DAMPING * QD + COULOMB * np.tanh(QD / 0.01)
HOLD = InverseDynamics(ROBOT).gravity_efforts(Q)
GUIDED = Settings(
    mode=Mode.GRAVITY_COMPENSATION,
    friction_scale=0.8,
    start_ramp=0.0,
    use_urdf_effort_limits=False,
)


def guided(**settings):
    dynamics = InverseDynamics(ROBOT)
    dynamics.set_friction(DAMPING, COULOMB)
    return UnobservedController(dynamics, (), replace(GUIDED, **settings))


def moving(time, qd=QD):
    return joint_state(Q, np.array(qd), time, np.full(2, time))


def test_a_share_of_the_friction_is_compensated_for_each_joint():
    arm = guided(friction_scale=(0.5, 0.9))
    efforts = arm.step(0.0, moving(0.0), None).efforts
    assert efforts == pytest.approx(HOLD + [0.5, 0.9] * FRICTION)


def test_the_default_is_80_percent():
    assert guided().step(0.0, moving(0.0), None).efforts == pytest.approx(HOLD + 0.8 * FRICTION)


def test_the_share_includes_the_friction_that_grows_with_the_load():
    arm = guided(friction_scale=0.5)
    arm.dynamics.set_friction(0.0, 0.0, load_friction=0.1)
    friction = arm.dynamics.effort_terms(Q, QD, np.zeros(2)).friction
    assert np.abs(friction).min() > 0.1
    assert arm.step(0.0, moving(0.0), None).efforts == pytest.approx(HOLD + 0.5 * friction)


def test_guiding_damping_acts_against_the_motion():
    arm = guided(friction_scale=0.0, guiding_damping=(3.0, 4.0))
    efforts = arm.step(0.0, moving(0.0), None).efforts
    assert efforts == pytest.approx(HOLD - [3.0, 4.0] * QD)


def test_guiding_damping_needs_no_friction():
    arm = UnobservedController(InverseDynamics(ROBOT), (), replace(GUIDED, guiding_damping=3.0))
    assert arm.step(0.0, moving(0.0), None).efforts == pytest.approx(HOLD - 3.0 * QD)


def test_an_arm_at_rest_and_its_reference_add_nothing():
    arm = guided(guiding_damping=3.0)
    reference = Reference(np.ones(2), np.ones(2), 0.0, Q + 0.1, QD)
    assert arm.step(0.0, moving(0.0, np.zeros(2)), reference).efforts == pytest.approx(HOLD)
    assert arm.phase is Phase.FLOATING


def test_joints_in_another_order_and_others_than_the_commanded_ones():
    dynamics = InverseDynamics(ROBOT)
    dynamics.set_friction(DAMPING, COULOMB)
    turned = UnobservedController(
        dynamics, NAMES[::-1], replace(GUIDED, friction_scale=(0.9, 0.5))
    )
    expected = (HOLD + [0.5, 0.9] * FRICTION)[::-1]
    assert turned.step(0.0, moving(0.0), None).efforts == pytest.approx(expected)
    one = UnobservedController(dynamics, NAMES[1:], replace(GUIDED, guiding_damping=1.0))
    expected = (HOLD + 0.8 * FRICTION - QD)[1:]
    assert one.step(0.0, moving(0.0), None).efforts == pytest.approx(expected)


@pytest.mark.parametrize('mode', [mode for mode in Mode if mode is not Mode.GRAVITY_COMPENSATION])
def test_other_modes_compensate_all_of_the_friction(mode):
    arm = guided(mode=mode, friction_scale=0.3, guiding_damping=9.0, impedance_damping=0.0)
    full = arm.dynamics.efforts(Q, QD, np.zeros(2))
    assert arm.step(0.0, moving(0.0), None).efforts == pytest.approx(full)


def test_friction_follows_the_filtered_velocity():
    arm = guided(velocity_filter_cutoff=1.0, friction_scale=1.0)
    arm.step(0.0, moving(0.0, np.zeros(2)), None)
    efforts = arm.step(0.01, moving(0.01), None).efforts
    qd = QD * -np.expm1(-0.02 * np.pi)
    assert efforts == pytest.approx(HOLD + DAMPING * qd + COULOMB * np.tanh(qd / 0.01))


@pytest.mark.parametrize('cutoff', [0.0, 20.0])
def test_velocities_that_are_no_longer_reported_end_the_compensation(cutoff):
    loop = unobserved(ControlLoop(ROBOT, settings=replace(GUIDED, velocity_filter_cutoff=cutoff)))
    loop.dynamics.set_friction(DAMPING, COULOMB)
    for k in range(300):
        now = 0.01 * k
        with_velocities = k < 100
        velocities = QD if with_velocities else np.full(2, np.nan)
        if with_velocities or k > 110:  # the first ones without are rejected
            store_state(loop.collector, now, NAMES, Q, velocities)
        efforts = loop.step(now).efforts.copy()
        if k == 99:
            assert efforts == pytest.approx(HOLD + 0.8 * FRICTION)
    assert loop.phase is Phase.FLOATING
    assert efforts == pytest.approx(HOLD)


def test_a_late_joint_that_is_not_commanded_no_longer_counts():
    loop = unobserved(ControlLoop(ROBOT, NAMES[1:], GUIDED))
    loop.dynamics.set_friction(0.0, 0.0, load_friction=1.0)

    def efforts(first, now):
        store_state(loop.collector, now, NAMES[first:], Q[first:], [5.0, -0.2][first:])
        return loop.step(now).efforts.copy()

    def expected(qd):
        return (HOLD + 0.8 * loop.dynamics.effort_terms(Q, qd, np.zeros(2)).friction)[1:]

    assert efforts(0, 0.0) == pytest.approx(expected(np.array([5.0, -0.2])))
    for k in range(1, 150):
        last = efforts(1, 0.01 * k)
    assert last == pytest.approx(expected(np.array([0.0, -0.2])))


@pytest.mark.parametrize('change', [{'friction_scale': 0.2}, {'guiding_damping': 5.0}])
def test_a_live_change_is_blended_while_motion_acts_at_once(change):
    arm = guided(start_ramp=0.5)
    for now in np.arange(0.0, 1.0, 0.01):
        last = arm.step(now, moving(now), None).efforts.copy()
    arm.apply(replace(GUIDED, start_ramp=0.5, **change))
    slower = 0.9 * QD
    first = arm.step(1.0, moving(1.0, slower), None).efforts.copy()
    share, damping = change.get('friction_scale', 0.8), change.get('guiding_damping', 0.0)
    assert first - last == pytest.approx((damping - share * DAMPING) * (QD - slower), abs=1e-4)
    for now in np.arange(1.01, 1.6, 0.01):
        last = arm.step(now, moving(now, slower), None).efforts.copy()
    friction = DAMPING * slower + COULOMB * np.tanh(slower / 0.01)
    assert last == pytest.approx(HOLD + share * friction - damping * slower)


def test_without_friction_its_term_is_not_computed():
    arm = UnobservedController(InverseDynamics(ROBOT), (), GUIDED)
    arm.dynamics.effort_terms = None
    assert arm.step(0.0, moving(0.0), None).efforts == pytest.approx(HOLD)


@pytest.mark.filterwarnings('error')
def test_absurd_velocities_are_no_solution_and_print_no_warnings():
    arm = guided(guiding_damping=1e9)
    arm.step(0.0, moving(0.0), None)
    arm.step(0.01, moving(0.01, [1.7e308, 0.0]), None)
    assert arm.phase is Phase.NO_SOLUTION
