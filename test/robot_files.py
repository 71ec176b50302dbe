"""Where the robots of this package are."""

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
    """List the URDFs of real robots that the package example-robot-data carries, if it is here."""
    try:
        package = distribution('example-robot-data')
    except PackageNotFoundError:
        return []
    folder = Path(package.locate_file('cmeel.prefix/share/example-robot-data/robots'))
    return sorted(folder.glob('**/*.urdf'))
