"""Advice on what to record next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .estimator import Estimator
from .result import BodyResult

SHORT = 20.0
"""Duration below which a longer recording is worth most [s]."""
SLOW = 0.2
"""Fraction of the speed limit below which a joint is slow."""
FAST_ENOUGH = 0.5
"""Speed [rad/s, m/s] above which a joint need not be faster."""
LITTLE = 0.5
"""Fraction of the information about a mass below which more should be recorded."""
MOST = 4
"""Number of suggestions."""


def what_to_record(found: Estimator, bodies: Sequence[BodyResult]) -> tuple[str, ...]:
    """Return suggestions for the next recording, most useful first."""
    problem = found.problem
    robot = problem.identified.robot
    advice = []
    speeds = np.max([np.quantile(np.abs(m.qd), 0.95, axis=0) for m in found.motions], axis=0)
    for j, joint in enumerate(problem.joints):
        name = robot.joint_names[joint]
        unit = 'm/s' if robot.is_prismatic_joint[joint] else 'rad/s'
        limit = float(robot.velocity_limits[joint])
        if not found.moving[j]:
            advice.append(
                f'move {name} to and fro for 30 s: its friction is unknown, and that of the '
                'robot description is kept'
            )
        elif speeds[joint] < min(SLOW * limit, FAST_ENOUGH):
            goal = min(FAST_ENOUGH, 0.5 * limit)
            advice.append(
                f'record 30 s more of {name} at up to {goal:.2g} {unit}: it was faster than '
                f'{speeds[joint]:.2g} {unit} for a twentieth of the time only'
            )
    duration = sum(float(np.ptp(motion.times)) for motion in found.motions)
    if duration < SHORT:
        advice.append(f'record at least 30 s: these recordings last {duration:.3g} s')
    unknown = [
        body for body in bodies if body.data_fraction < LITTLE and not _is_first(found, body)
    ]
    if unknown:
        names = ', '.join(body.link for body in unknown[:3])
        advice.append(
            f'move all joints at the same time, in varied poses and with quick reversals: the '
            f'masses of {names} come mostly from the robot description; `inverse_dynamics excite` '
            'plans such a motion'
        )
    return tuple(advice[:MOST])


def _is_first(found: Estimator, body: BodyResult) -> bool:
    """Return whether a joint of the base moves a body, so that its mass may have no effect."""
    robot = found.problem.identified.robot
    number = int(robot.link_body[robot.link_index(body.link)])
    return int(robot.parent[number]) == 0
