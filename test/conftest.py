"""Fixtures of all tests: the robots of this package, and a seeded random generator."""

import gc

from hypothesis import HealthCheck, settings
import numpy as np
import pytest
from robot_files import OUR_ROBOTS

KINDS = ('passed', 'skipped', 'failed', 'error')  # of results

# No deadline, because the machine may be busy; the same examples everywhere, to repeat failures.
settings.register_profile(
    'here',
    deadline=None,
    derandomize=True,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    'long', settings.get_profile('here'), derandomize=False, max_examples=2000
)
settings.load_profile('here')


def pytest_addoption(parser):
    parser.addoption('--stage', default='', help='name of these tests in the summary')
    parser.addoption('--summary', help='file to which the result of these tests is appended')


def pytest_collection_finish():
    # A tenth of the time of the unit tests: the collector would visit all modules again and again.
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def pytest_terminal_summary(terminalreporter, config):
    if config.option.summary and not hasattr(config, 'workerinput'):
        found = {kind: len(terminalreporter.getreports(kind)) for kind in KINDS}
        counts = ', '.join(f'{number} {kind}' for kind, number in found.items() if number)
        with open(config.option.summary, 'a') as file:
            file.write(f'{config.option.stage}: {counts}\n')


@pytest.fixture
def rng():
    return np.random.default_rng(1979)


@pytest.fixture
def brief(monkeypatch):
    """Search for excitation motions for a short time; the promises do not depend on it."""
    from inverse_dynamics_node.analysis.excitation import search

    monkeypatch.setattr(search, '_MOST_TRIALS', 60)
    monkeypatch.setattr(search, 'CANDIDATES', 4)
    monkeypatch.setattr(search, 'HARMONICS', 3)


@pytest.fixture(params=OUR_ROBOTS, ids=lambda path: path.stem)
def urdf_path(request):
    """Return the path of each of our robots in turn."""
    return request.param
