"""Gravity compensation that compensates a share of the friction, from the measured velocity."""

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
import numpy as np
import pytest
from states import Arm, PLANAR, Q, store_state

NAMES = PLANAR.joint_names
QD = np.array([0.3, -0.2])
DAMPING, COULOMB = np.array([2.0, 1.0]), np.array([0.6, 0.4])
HOLD = InverseDynamics(PLANAR).gravity_efforts(Q)
GUIDED = Settings(
    mode=Mode.GRAVITY_COMPENSATION,
    friction_scale=0.8,
    start_ramp=0.0,
    use_urdf_effort_limits=False,
)


def guided(joints=(), **settings):
    arm = Arm(joints=joints, is_observed=False, settings=GUIDED, **settings)
    arm.loop.dynamics.set_friction(DAMPING, COULOMB)
    return arm


def friction(qd):
    return DAMPING * qd + COULOMB * np.tanh(qd / 0.01)


@pytest.mark.parametrize('mode', [mode for mode in Mode if mode is not Mode.GRAVITY_COMPENSATION])
def test_other_modes_compensate_all_of_the_friction(mode):
    arm = guided(mode=mode, friction_scale=0.3, guiding_damping=9.0, impedance_damping=0.0)
    full = arm.loop.dynamics.efforts(Q, QD, np.zeros(2))
    assert arm.at(0.0, qd=QD) == pytest.approx(full)


def test_friction_follows_the_filtered_velocity():
    arm = guided(velocity_filter_cutoff=1.0, friction_scale=1.0)
    arm.at(0.0)
    qd = QD * -np.expm1(-0.02 * np.pi)
    assert arm.at(0.01, qd=QD) == pytest.approx(HOLD + friction(qd))


@pytest.mark.parametrize('cutoff', [0.0, 20.0])
def test_velocities_that_are_no_longer_reported_end_the_compensation(cutoff):
    arm = guided(velocity_filter_cutoff=cutoff)
    for now in 0.01 * np.arange(100):
        efforts = arm.at(now, qd=QD)
    assert efforts == pytest.approx(HOLD + 0.8 * friction(QD))
    for now in 0.01 * np.arange(100, 300):  # the first ones without velocities are ignored
        efforts = arm.at(now, qd=np.full(2, np.nan))
    assert arm.phase is Phase.FLOATING
    assert efforts == pytest.approx(HOLD)


def test_a_late_joint_that_is_not_commanded_no_longer_counts():
    arm = guided(NAMES[1:])
    arm.loop.dynamics.set_friction(0.0, 0.0, load_friction=1.0)

    def efforts(first, now):
        store_state(arm.loop.collector, now, NAMES[first:], Q[first:], [5.0, -0.2][first:])
        return arm.loop.step(now).efforts.copy()

    def expected(qd):
        return (HOLD + 0.8 * arm.loop.dynamics.effort_terms(Q, qd, np.zeros(2)).friction)[1:]

    assert efforts(0, 0.0) == pytest.approx(expected(np.array([5.0, -0.2])))
    for k in range(1, 150):
        last = efforts(1, 0.01 * k)
    assert last == pytest.approx(expected(np.array([0.0, -0.2])))


@pytest.mark.parametrize('change', [{'friction_scale': 0.2}, {'guiding_damping': 5.0}])
def test_a_live_change_is_blended_while_motion_acts_at_once(change):
    arm = guided(start_ramp=0.5)
    for now in np.arange(0.0, 1.0, 0.01):
        last = arm.at(now, qd=QD)
    arm.change(**change)
    slower = 0.9 * QD
    first = arm.at(1.0, qd=slower)
    share, damping = change.get('friction_scale', 0.8), change.get('guiding_damping', 0.0)
    assert first - last == pytest.approx((damping - share * DAMPING) * (QD - slower), abs=1e-4)
    for now in np.arange(1.01, 1.6, 0.01):
        last = arm.at(now, qd=slower)
    assert last == pytest.approx(HOLD + share * friction(slower) - damping * slower)


def test_without_friction_its_term_is_not_computed():
    arm = Arm(settings=GUIDED)
    arm.loop.dynamics.effort_terms = None
    assert arm.at(0.0) == pytest.approx(HOLD)
