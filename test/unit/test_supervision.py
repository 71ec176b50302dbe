"""Dry runs end commands without a step; efforts rise again when lost joint states are back."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.laws import Law
from inverse_dynamics_node.control.loop import Phase, Supervisor
from inverse_dynamics_node.control.settings import Settings
from inverse_dynamics_node.control.shaping import DryRun
import numpy as np
import pytest
from robot_files import ROOT
from states import joint_state

EFFORTS = np.array([4.0, -2.0])
DT = 0.1


def test_without_a_dry_run_the_computed_efforts_are_sent():
    dry_run = DryRun()
    assert not dry_run.has_sent
    assert dry_run.select(EFFORTS, DT) is EFFORTS
    assert dry_run.has_sent
    assert dry_run.has_effort


def test_a_dry_run_from_the_start_sends_nothing():
    dry_run = DryRun(is_active=True)
    assert dry_run.select(EFFORTS, DT) is None
    assert not dry_run.has_sent
    assert not dry_run.has_effort


def test_commands_fall_to_zero_and_end_while_the_computed_efforts_grow():
    dry_run = DryRun()
    dry_run.select(EFFORTS, DT)
    dry_run.begin(time_to_fall=0.4)
    growing = (EFFORTS * (2.0 + k) for k in range(100))
    for factor in (0.75, 0.5, 0.25, 0.0):
        assert dry_run.has_effort
        assert dry_run.select(next(growing), DT) == pytest.approx(factor * EFFORTS, abs=1e-12)
    zeros = 0
    while (sent := dry_run.select(next(growing), DT)) is not None:
        assert not sent.any()
        zeros += 1
    assert zeros in (4, 5)
    assert not dry_run.has_sent
    assert dry_run.is_active


def test_the_fall_begins_at_the_last_command_although_its_array_is_reused():
    dry_run, efforts = DryRun(), EFFORTS.copy()
    dry_run.select(efforts, DT)
    dry_run.begin(time_to_fall=0.4)
    efforts[:] = 100.0
    assert dry_run.select(efforts, DT) == pytest.approx(0.75 * EFFORTS)


def test_zeros_are_sent_even_if_the_next_step_is_very_late():
    dry_run = DryRun()
    dry_run.select(EFFORTS, DT)
    dry_run.begin(time_to_fall=0.4)
    assert dry_run.select(EFFORTS, 60.0).tolist() == [0.0, 0.0]
    assert dry_run.select(EFFORTS, DT) is None


def test_without_a_ramp_the_next_command_is_zero():
    dry_run = DryRun()
    dry_run.select(EFFORTS, DT)
    dry_run.begin(time_to_fall=0.0)
    assert dry_run.select(EFFORTS, DT).tolist() == [0.0, 0.0]


def test_a_second_begin_does_not_restart_the_ramp():
    dry_run = DryRun()
    dry_run.select(EFFORTS, DT)
    dry_run.begin(time_to_fall=0.4)
    dry_run.select(EFFORTS, DT)
    dry_run.begin(time_to_fall=10.0)
    assert dry_run.select(EFFORTS, DT) == pytest.approx(0.5 * EFFORTS)


def test_a_dry_run_has_no_effort_as_soon_as_the_commands_are_zero():
    dry_run = DryRun()
    dry_run.select(EFFORTS, DT)
    assert not dry_run.is_active
    dry_run.begin(time_to_fall=0.2)
    dry_run.select(EFFORTS, DT)
    assert dry_run.has_effort
    dry_run.select(EFFORTS, DT)
    assert not dry_run.has_effort
    dry_run.end()
    assert dry_run.select(EFFORTS, DT) is EFFORTS


def test_a_dry_run_begins_at_once_if_nothing_has_been_sent():
    dry_run = DryRun()
    dry_run.begin(time_to_fall=1.0)
    assert dry_run.select(EFFORTS, DT) is None


class Supervised:
    """A supervisor of a controller that has computed efforts for a while."""

    def __init__(self):
        self.supervisor = Supervisor(['joint'], ['rad'])
        law = Law(InverseDynamics(load_urdf(ROOT / 'test/robots/planar_2r.urdf')), [0])
        self.supervisor.apply(Settings(state_timeout=0.1), law)
        self.at(100.0)
        self.at(109.9)

    def at(self, time, gain=1.0, age=0.0):
        """Return whether the states are lost."""
        state = joint_state(np.zeros(2), np.zeros(2), time - age)
        return self.supervisor.decide(time, state, None, gain) is Phase.STATE_LOST


def test_losses_in_quick_succession_add_up_and_are_forgotten_after_a_while():
    states = Supervised()
    assert states.at(110.0, age=0.2)
    assert not states.at(110.0, gain=0.99)
    assert states.at(110.1, age=0.2)
    assert not states.at(110.1, gain=0.97)
    assert states.at(110.2, age=0.2)
    assert states.at(110.2, gain=0.98)  # 0.06 in all, of 0.05
    assert states.at(110.3, gain=0.9)
    assert not states.at(110.41, gain=0.9)
    assert not states.at(111.0)
    assert states.at(111.1, age=0.2)
    assert not states.at(111.1, gain=0.96)
