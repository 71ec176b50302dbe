"""What every test may use: the robots of this package, and a seeded source of numbers."""

from hypothesis import HealthCheck, settings
import numpy as np
import pytest
from robot_files import OUR_ROBOTS

# A machine under load is no failure, and the same examples everywhere make a failure repeatable.
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
    """Every robot of ours, one after the other."""
    return request.param
