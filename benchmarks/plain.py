"""A worker (see `workers`) that runs this package without numba."""

from __future__ import annotations

import json
import sys

from . import peers
from .robots import random_states, Robot


def main() -> None:
    """Answer the requests on standard input."""
    task = json.loads(sys.stdin.readline())
    robot = Robot('', task['urdf'])
    timed = peers.ours(robot, random_states(robot.n))
    print(json.dumps(timed.results().tolist()), flush=True)
    for line in sys.stdin:
        print(timed.seconds(json.loads(line)), flush=True)


if __name__ == '__main__':
    main()
