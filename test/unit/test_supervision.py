"""Commands end without a step when a dry run begins, and wait for zero before they begin again."""

from inverse_dynamics_node.control.supervision import DryRun
import numpy as np
import pytest

EFFORTS = np.array([4.0, -2.0])
DT = 0.1


def open_gate():
    gate = DryRun()
    gate.reset(is_dry_run=False)
    return gate


def test_an_open_gate_sends_the_computed_efforts():
    gate = open_gate()
    assert not gate.has_sent
    assert gate.select(EFFORTS, DT) is EFFORTS
    assert gate.has_sent
    assert gate.has_effort


def test_a_dry_run_from_the_start_sends_nothing():
    gate = DryRun()
    gate.reset(is_dry_run=True)
    assert gate.select(EFFORTS, DT) is None
    assert not gate.has_sent
    assert gate.may_open


def test_commands_fall_to_zero_and_end_while_the_computed_efforts_grow():
    gate = open_gate()
    gate.select(EFFORTS, DT)
    gate.close(time_to_fall=0.4)
    growing = (EFFORTS * (2.0 + k) for k in range(100))
    for factor in (0.75, 0.5, 0.25, 0.0):
        assert not gate.may_open
        assert gate.select(next(growing), DT) == pytest.approx(factor * EFFORTS, abs=1e-12)
    zeros = 0
    while (sent := gate.select(next(growing), DT)) is not None:
        assert not sent.any()
        zeros += 1
    assert zeros in (4, 5)
    assert not gate.has_sent
    assert not gate.is_open


def test_the_fall_begins_at_the_last_command_although_its_array_is_reused():
    gate, efforts = open_gate(), EFFORTS.copy()
    gate.select(efforts, DT)
    gate.close(time_to_fall=0.4)
    efforts[:] = 100.0
    assert gate.select(efforts, DT) == pytest.approx(0.75 * EFFORTS)


def test_zeros_are_sent_even_if_the_next_step_is_very_late():
    gate = open_gate()
    gate.select(EFFORTS, DT)
    gate.close(time_to_fall=0.4)
    assert gate.select(EFFORTS, 60.0).tolist() == [0.0, 0.0]
    assert gate.select(EFFORTS, DT) is None


def test_without_a_ramp_the_next_command_is_zero():
    gate = open_gate()
    gate.select(EFFORTS, DT)
    gate.close(time_to_fall=0.0)
    assert gate.select(EFFORTS, DT).tolist() == [0.0, 0.0]


def test_a_second_close_does_not_restart_the_ramp():
    gate = open_gate()
    gate.select(EFFORTS, DT)
    gate.close(time_to_fall=0.4)
    gate.select(EFFORTS, DT)
    gate.close(time_to_fall=10.0)
    assert gate.select(EFFORTS, DT) == pytest.approx(0.5 * EFFORTS)


def test_the_gate_may_open_as_soon_as_the_commands_are_zero():
    gate = open_gate()
    gate.select(EFFORTS, DT)
    assert not gate.may_open  # it is open
    gate.close(time_to_fall=0.2)
    gate.select(EFFORTS, DT)
    assert not gate.may_open
    gate.select(EFFORTS, DT)
    assert gate.may_open
    gate.open()
    assert gate.select(EFFORTS, DT) is EFFORTS


def test_a_gate_that_has_sent_nothing_closes_at_once():
    gate = open_gate()
    gate.close(time_to_fall=1.0)
    assert gate.select(EFFORTS, DT) is None
