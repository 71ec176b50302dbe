"""Laws of the damping during a stop: it takes energy out of the arm, and respects the limits."""

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.settings import Settings
import numpy as np
from robot_files import ROOT
from states import Arm

ROBOT = load_urdf(ROOT / 'test/robots/gripper_arm.urdf')
N = len(ROBOT.joint_names)
DYNAMICS = InverseDynamics(ROBOT)
STEP = 0.01  # [s]; no ramp advances faster

some = {
    'stop_damping': st.sampled_from([1.0, 50.0, 200.0]),
    'stop_ramp': st.sampled_from([0.0, 0.1, 0.5]),
    'effort_limits': st.sampled_from([np.inf, 20.0, 0.5]),
}
scales = st.lists(st.sampled_from([1.0, 1.0, -1.0, 0.02, -3.0, 0.0]), min_size=N, max_size=N)
subsets = st.sets(st.integers(0, N - 1), min_size=1).map(sorted)


class Stop:
    """A control loop of some joints, and the joint states of an arm that moves at random."""

    def __init__(self, index, scale, seed, noise, **some_settings):
        self.index, self.scale = index, np.array(scale)[index]
        self.settings = Settings(
            start_ramp=0.0, effort_scale=tuple(self.scale.tolist()), **some_settings
        )
        names = [ROBOT.joint_names[i] for i in index]
        self.arm = Arm(ROBOT, names, is_observed=False, settings=self.settings)
        self.random, self.noise = np.random.default_rng(seed), noise
        self.q = self.random.uniform(np.maximum(ROBOT.lower, -3), np.minimum(ROBOT.upper, 3))
        self.qd = self.random.uniform(-1.0, 1.0, N)
        self.time = self.measured_at = 0.0
        self.top = self.command(0.0)

    def command(self, period, *, has_state=True):
        self.time += period
        if has_state:
            self.qd = self.qd + 0.1 * self.random.standard_normal(N)
            self.q = self.q + (self.time - self.measured_at) * self.qd
            self.measured = self.qd + self.noise * self.random.standard_normal(N)
            self.measured_at = self.time
        return self.arm.at(self.time, self.q, self.measured, None, self.measured_at)

    def check(self, periods):
        """Check the commands of a stop; return how many of them damp the motion."""
        self.arm.loop.stop()
        passed, damped, ramp = None, 0, self.settings.stop_ramp
        for period, has_state in periods:
            command = self.command(period, has_state=has_state)
            passed = 0.0 if passed is None else passed + period
            left = max(0.0, 1.0 - passed / ramp) if ramp else 0.0
            added = command - left * self.top
            self.check_limits(command, left)
            self.check_power(added)
            damped += bool(np.abs(added).max() > 1e-9)
            assert self.arm.loop.stop_damping.is_active or np.abs(added).max() < 1e-9
        return damped

    def check_limits(self, command, left):
        assert (np.abs(command) <= self.arm.loop.limits + 1e-9).all()
        assert (np.abs(left * self.top) <= self.arm.loop.limits + 1e-9).all()

    def check_power(self, added):
        """Scale turns the effort of a joint into the command; without it there is no effort."""
        efforts = np.divide(added, self.scale, out=np.zeros(len(added)), where=self.scale != 0.0)
        power = float(self.measured[self.index] @ efforts)
        full = np.zeros(N)
        full[self.index] = self.measured[self.index] * (self.scale != 0.0)
        largest = self.settings.stop_damping * full @ DYNAMICS.mass_matrix(self.q) @ full
        assert -1.01 * largest - 1e-9 <= power <= 1e-9 * (1.0 + largest)
        assert not added[self.scale == 0.0].any()


periods = st.lists(
    st.tuples(st.sampled_from([0.001, 0.005, STEP]), st.sampled_from([True, True, True, False])),
    min_size=1,
    max_size=60,
)


@settings(max_examples=200)
@given(
    subsets,
    scales,
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.01, 0.3]),
    st.fixed_dictionaries(some),
    periods,
)
def test_its_power_is_never_positive_and_commands_stay_within_the_limits(
    index, scale, seed, noise, values, steps
):
    Stop(index, scale, seed, noise, **values).check(steps)


@given(subsets, st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.01]))
def test_it_damps_whichever_joints_are_commanded(index, seed, noise):
    stop = Stop(index, [1.0] * N, seed, noise, stop_damping=50.0, stop_ramp=0.1)
    assert stop.check([(0.005, True)] * 60) > 50
