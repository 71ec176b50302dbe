"""Faults of simulated robots with wrong descriptions: named, and nothing false is said."""

from benchmarks import confusion
from inverse_dynamics_node.analysis.diagnosis import FaultKind
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
import numpy as np
import pytest
from robot_files import real_robots

# Without compiled functions these tests take minutes.
pytestmark = pytest.mark.skipif(not IS_COMPILED, reason='numba is not here, or off')

SEED = 1979
BESIDE_WRONG_LINKS = (
    'none',
    'payload of 2 kg',
    'missing gravity',
    pytest.param('base tilted by 10 degrees', marks=pytest.mark.long),
    pytest.param('absent payload', marks=pytest.mark.long),
    pytest.param('external force', marks=pytest.mark.long),
)


@pytest.mark.parametrize('fault', BESIDE_WRONG_LINKS)
def test_a_fault_is_named_beside_wrong_links(fault):
    result = confusion.run(fault, 'seven_dof', SEED)
    assert result.is_named
    assert [text for text, is_true in result.statements if not is_true] == []


def kinds(case):
    return {fault.kind for fault in case.run().faults}


def test_the_delay_is_estimated_within_2_ms():
    case = confusion.Case('seven_dof', np.random.default_rng(SEED))
    confusion.delay(case)
    (late,) = [fault for fault in case.run().faults if fault.kind is FaultKind.DELAY]
    assert late.values == pytest.approx((0.02,), abs=0.002)


def test_a_delay_of_5_ms_is_not_reported():
    case = confusion.Case('seven_dof', np.random.default_rng(SEED))
    case.delay = 0.005
    assert FaultKind.DELAY not in kinds(case)


def test_weaker_gravity_is_not_a_tilt():
    case = confusion.Case('seven_dof', np.random.default_rng(SEED))
    angle = np.radians(10.0)
    case.real.set_gravity(8.86 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    for fault in case.run().faults:
        if fault.kind is FaultKind.MOUNTING:
            assert np.linalg.norm(fault.values) == pytest.approx(confusion.STANDARD, rel=0.02)


def test_a_counterweight_is_not_an_external_force():
    case = confusion.Case('seven_dof', np.random.default_rng(SEED))
    shoulder = case.names.index('shoulder_lift')

    def counterweight(times, q):
        efforts = np.zeros_like(q)
        efforts[:, shoulder] = -20.0 * np.sin(q[:, shoulder])
        return efforts

    case.added = counterweight
    assert FaultKind.EXTERNAL_FORCE not in kinds(case)


@pytest.mark.long
@pytest.mark.skipif(not real_robots(), reason='example-robot-data is not installed')
def test_the_table_names_nine_of_ten_faults_and_says_little_that_is_false():
    results = [confusion.run(fault, name, SEED) for fault in confusion.FAULTS
               for name in confusion.ROBOTS]  # fmt: skip
    faulty = [each.is_named for each in results if each.fault != 'none']
    said = [is_true for each in results for _, is_true in each.statements]
    assert np.mean(faulty) >= 0.9
    assert np.mean(said) >= 0.97
