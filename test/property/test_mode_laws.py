"""Laws of hand guiding and joint impedance, for random trees and gains."""

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import Phase
from inverse_dynamics_node.control.motion_limits import MotionLimits
from inverse_dynamics_node.control.settings import Mode, Settings
from kinematics import assert_close
import numpy as np
from random_trees import robots_with_states as cases
from states import joint_state, UnobservedController

NO_LIMITS = {'start_ramp': 0.0, 'use_urdf_effort_limits': False, 'max_tracking_error': 0.0}
gains = st.sampled_from([0.0, 0.3, 1.0, 20.0])


def efforts(dynamics, q, qd, reference=None, before=None, **settings):
    """Return the efforts in one state, after a state at rest if one is given."""
    controller = UnobservedController(dynamics, (), Settings(**NO_LIMITS, **settings))
    if before is not None:
        controller.step(0.0, joint_state(before, np.zeros(len(q)), 0.0), None)
        controller.motion_limits = MotionLimits(dynamics, controller.index)  # no jump to `q`
    found = controller.step(0.01, joint_state(q, qd, 0.01), reference).efforts.copy()
    assert controller.phase is not Phase.NO_SOLUTION
    return found


@given(cases(vectors=7), st.tuples(st.booleans(), st.booleans(), st.booleans()))
def test_without_gains_joint_impedance_is_inverse_dynamics(case, has):
    _, robot, (q, qd, qdd, added, q_ref, qd_ref, before) = case
    has_reference, has_positions, has_velocities = has
    positions, velocities = q_ref if has_positions else None, qd_ref if has_velocities else None
    reference = Reference(qdd, added, 0.01, positions, velocities) if has_reference else None
    dynamics = InverseDynamics(robot)
    dynamics.set_friction(0.5, 0.2, load_friction=0.1)
    expected = efforts(dynamics, q, qd, reference, before, mode=Mode.INVERSE_DYNAMICS)
    none = {'stiffness': 0.0, 'impedance_damping': 0.0}
    found = efforts(dynamics, q, qd, reference, before, mode=Mode.JOINT_IMPEDANCE, **none)
    assert found.tolist() == expected.tolist()


@given(cases(vectors=3), gains, gains)
def test_springs_pull_back_and_dampers_slow_down(case, stiffness, damping):
    _, robot, (q, qd, before) = case
    dynamics = InverseDynamics(robot)
    given_gains = {'stiffness': stiffness, 'impedance_damping': damping}
    found = efforts(dynamics, q, qd, None, before, mode=Mode.JOINT_IMPEDANCE, **given_gains)
    way = before - q
    turns = np.round(way / (2.0 * np.pi)) * robot.is_continuous
    spring = stiffness * (way - 2.0 * np.pi * turns)
    model = dynamics.efforts(q, qd, 0.0 * q)
    assert_close(found, model + spring - damping * qd, 1e-9)


@given(
    cases(vectors=2),
    st.floats(0.0, 1.0),
    gains,
    st.tuples(*3 * [st.sampled_from([0.0, 0.1, 5.0])]),
    st.sampled_from([1e-3, 0.01, 1.0]),
)
def test_compensated_friction_is_a_share_of_the_friction(case, scale, damping, friction, width):
    _, robot, (q, qd) = case
    dynamics = InverseDynamics(robot)
    viscous, coulomb, load = friction
    dynamics.set_friction(viscous, coulomb, width, load)
    modes = {'mode': Mode.GRAVITY_COMPENSATION, 'friction_scale': scale}
    held = efforts(dynamics, q, 0.0 * qd, **modes)
    found = efforts(dynamics, q, qd, **modes) - held
    whole = dynamics.effort_terms(q, qd, 0.0 * qd).friction
    room = 1e-9 * (1.0 + np.abs(held) + np.abs(whole))
    assert (np.abs(found) <= scale * np.abs(whole) + room).all()
    assert (found * whole >= -room * np.abs(whole)).all()
    # What is left of the friction never drives the arm, and the damping brakes it.
    damped = efforts(dynamics, q, qd, **modes, guiding_damping=damping) - held
    assert ((damped - whole) * qd <= room * np.abs(qd)).all()
    assert (np.abs(damped - found + damping * qd) <= room * (1.0 + np.abs(damping * qd))).all()
