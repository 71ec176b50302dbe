"""Paths of the test robots."""

from importlib.metadata import distribution, PackageNotFoundError
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STANFORD = ROOT / 'config' / 'stanford.urdf'
OUR_ROBOTS = [*sorted((ROOT / 'test' / 'robots').glob('*.urdf')), STANFORD]

NOTHING_MOVES = """
<robot name="rock"><link name="rock"/><link name="moss"/>
<joint name="glue" type="fixed"><parent link="rock"/><child link="moss"/></joint></robot>
"""


def real_robots():
    """Return the URDFs of real robots in example-robot-data, if it is installed."""
    try:
        package = distribution('example-robot-data')
    except PackageNotFoundError:
        return []
    folder = Path(package.locate_file('cmeel.prefix/share/example-robot-data/robots'))
    return sorted(folder.glob('**/*.urdf'))
