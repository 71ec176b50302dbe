"""Laws of the modes, for random trees, commanded joints, gains and references."""

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node.control.motion_limits import MotionLimits
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
from kinematics import assert_close
import numpy as np
from random_trees import robots_with_states as cases
from states import Arm, reference

FREE = Settings(start_ramp=0.0, use_urdf_effort_limits=False, max_tracking_error=0.0)
FRICTION = 0.5, 0.2, 0.01, 0.1
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
has = st.tuples(*4 * [st.booleans()])


class Case:
    """A robot of which some joints are commanded in any order, in a state, with a reference."""

    def __init__(self, case, rng, has_rows, mode, friction=FRICTION, **gains):
        _, self.robot, vectors = case
        self.q, self.qd, self.before, *rows = vectors
        names, n = self.robot.joint_names, len(self.robot.joint_names)
        self.index = rng.permutation(n)[: rng.integers(1, n + 1)]
        m = len(self.index)
        self.gains = {name: rng.choice(values, m) for name, values in gains.items()}
        given_gains = {name: tuple(values.tolist()) for name, values in self.gains.items()}
        joints = [names[k] for k in self.index]
        self.arm = Arm(
            self.robot, joints, is_observed=False, settings=FREE, mode=mode, **given_gains
        )
        self.arm.loop.dynamics.set_friction(*friction)
        has_reference, has_positions, has_velocities, _ = has_rows
        kept = (has_positions, has_velocities, True, True)
        rows = [row[self.index] if has else None for row, has in zip(rows, kept, strict=True)]
        self.positions, self.velocities, self.accelerations, self.added = rows
        self.reference = reference(0.01, *rows) if has_reference else None
        if not has_reference:
            self.positions = self.velocities = None
            self.accelerations, self.added = np.zeros((2, m))
        self.arm.at(0.0, self.before)
        limits = MotionLimits(self.arm.loop.dynamics, self.index.tolist())
        self.arm.loop.motion_limits = limits  # the joints do not jump to `q`
        self.arm.change()
        self.efforts = self.arm.at(0.01, self.q, self.qd, self.reference)
        assert self.arm.phase is not Phase.NO_SOLUTION

    def model(self, qd, accelerations):
        """Return the efforts of the commanded joints at accelerations of theirs."""
        qdd = np.zeros(len(self.q))
        qdd[self.index] = accelerations
        return self.arm.loop.dynamics.efforts(self.q, qd, qdd)[self.index]

    def way(self, target):
        """Return the way to positions; continuous joints take the shorter one."""
        way = target - self.q[self.index]
        turns = np.round(way / (2.0 * np.pi)) * self.robot.is_continuous[self.index]
        return way - 2.0 * np.pi * turns

    def speed_error(self):
        wanted = 0.0 if self.velocities is None else self.velocities
        return wanted - self.qd[self.index]


GAINS = [0.0, 0.3, 1.0, 20.0]
robots = cases(vectors=7)


@given(robots, seeds, has)
def test_inverse_dynamics_produces_the_accelerations_of_the_reference(case, rng, rows):
    each = Case(case, rng, rows, Mode.INVERSE_DYNAMICS)
    assert_close(each.efforts, each.model(each.qd, each.accelerations) + each.added, 1e-9)


@given(robots, seeds, has)
def test_computed_torque_adds_accelerations_towards_the_reference(case, rng, rows):
    each = Case(case, rng, rows, Mode.COMPUTED_TORQUE, kp=GAINS, kd=GAINS)
    qdd = each.accelerations
    if each.positions is not None:
        qdd = qdd + each.gains['kp'] * each.way(each.positions)
    if each.positions is not None or each.velocities is not None:
        qdd = qdd + each.gains['kd'] * each.speed_error()
    assert_close(each.efforts, each.model(each.qd, qdd) + each.added, 1e-9)


@given(robots, seeds, has)
def test_joint_impedance_adds_springs_and_dampers(case, rng, rows):
    """Without positions of the reference, the arm is held where it was first."""
    gains = {'stiffness': GAINS, 'impedance_damping': GAINS}
    each = Case(case, rng, rows, Mode.JOINT_IMPEDANCE, **gains)
    held = each.before[each.index] if each.positions is None else each.positions
    spring = each.gains['stiffness'] * each.way(held)
    damper = each.gains['impedance_damping'] * each.speed_error()
    model = each.model(each.qd, each.accelerations) + each.added
    assert_close(each.efforts, model + spring + damper, 1e-9)


@given(robots, seeds, has, st.tuples(*3 * [st.sampled_from([0.0, 0.1, 5.0])]))
def test_hand_guiding_adds_a_share_of_the_friction_and_damping(case, rng, rows, friction):
    damping, coulomb, load = friction
    gains = {'friction_scale': [0.0, 0.5, 1.0], 'guiding_damping': GAINS}
    mode, friction = Mode.GRAVITY_COMPENSATION, (damping, coulomb, 0.01, load)
    each = Case(case, rng, rows, mode, friction, **gains)
    dynamics, qd = each.arm.loop.dynamics, each.qd[each.index]
    whole = dynamics.effort_terms(each.q, each.qd, 0.0 * each.q).friction[each.index]
    added = each.gains['friction_scale'] * whole - each.gains['guiding_damping'] * qd
    held = dynamics.gravity_efforts(each.q)[each.index]
    scale = max(np.abs(held).max(), np.abs(whole).max(), np.abs(added).max())
    np.testing.assert_allclose(each.efforts, held + added, rtol=0, atol=1e-9 * scale)
    # What is left of the friction never drives the arm.
    assert ((added - whole) * qd <= 1e-9 * scale * np.abs(qd)).all()
