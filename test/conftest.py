"""Fixtures of all tests: the robots of this package, and a seeded random generator."""

from hypothesis import HealthCheck, settings
import numpy as np
import pytest
from robot_files import OUR_ROBOTS

# No deadline, because the machine may be busy; the same examples everywhere, to repeat failures.
settings.register_profile(
    'here',
    deadline=None,
    derandomize=True,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile('here')


@pytest.fixture
def rng():
    return np.random.default_rng(1979)


@pytest.fixture(params=OUR_ROBOTS, ids=lambda path: path.stem)
def urdf_path(request):
    """Return the path of each of our robots in turn."""
    return request.param
