"""Formats tables of an excitation motion and of the errors to expect in an identification."""

from __future__ import annotations

import math

import numpy as np

from ..analysis.excitation.clearance import Extent, Nearest
from ..analysis.excitation.information import expected_errors, ExpectedErrors
from ..analysis.excitation.search import CANDIDATES, Excitation, SAMPLES_PER_SECOND
from ..dynamics.trajectory import Trajectory
from ..errors import listed
from ..robot.model import Floats, RobotModel
from .tables import effort_unit, fraction, number, or_dash, table


def excitation_tables(
    robot: RobotModel,
    excitation: Excitation,
    trajectory: Trajectory,
    efforts: Floats,
    box: Extent,
) -> list[str]:
    """
    Return tables of an excitation motion and of the errors to expect in an identification.

    `trajectory` is the motion in the output file, which may be slower than `excitation`.
    `efforts` contains the modelled efforts, shape (points, joints) [N m or N]. `box` encloses the
    moving links during the whole motion.
    """
    errors = expected_errors(excitation.unknowns, excitation.information)
    return [
        _motion(robot, excitation, trajectory, efforts, box),
        _joints(robot, excitation, errors),
        _bodies(errors),
    ]


def _motion(
    robot: RobotModel,
    excitation: Excitation,
    trajectory: Trajectory,
    efforts: Floats,
    box: Extent,
) -> str:
    index = robot.joint_indices(trajectory.joint_names)
    assert trajectory.velocities is not None
    speeds = np.max(np.abs(trajectory.velocities), axis=0)
    rows = []
    for k, i in enumerate(index):
        unit = 'm  ' if robot.is_prismatic_joint[i] else 'rad'
        q = trajectory.positions[:, k]
        peak = float(np.max(np.abs(efforts[:, k])))
        rows.append(
            (
                trajectory.joint_names[k],
                f'{q[0]:.3f} {unit}',
                f'{np.min(q):.2f} to {np.max(q):.2f}',
                f'{number(robot.lower[i])} to {number(robot.upper[i])}',
                f'{speeds[k]:.3g} {unit.strip()}/s',
                number(robot.velocity_limits[i]),
                f'{peak:.3g} {effort_unit(robot, i)}',
                fraction(peak, robot.effort_limits[i]),
            )
        )
    sides = ', '.join(
        f'{axis} {low:.2f} to {high:.2f}' for axis, low, high in zip('xyz', *box, strict=True)
    )
    notes = [
        f'{excitation.series.harmonics} harmonics of {1.0 / trajectory.times[-1]:.3g} Hz; the '
        'motion starts and ends at rest, in the pose of the column "start"',
        f'space that the links need: {sides} m in the frame of the base; a payload is not '
        'included',
        *_distances(excitation),
        *excitation.limits.notes,
    ]
    title = f'Excitation motion of {robot.name}: {trajectory.times[-1]:g} s'
    columns = ('joint', 'start', 'moves', 'limits', 'speed', 'limit', 'effort', 'of limit')
    return table(title, columns, rows, notes)


def _distances(excitation: Excitation) -> list[str]:
    """Describe the smallest distances from links to each other, to the floor and to boxes."""
    kinds: dict[str, list[Nearest]] = {'floor': [], 'box': [], 'links': []}
    for each in excitation.nearest:
        kinds[each.names[1] if each.names[1] in kinds else 'links'].append(each)
    clearance = excitation.limits.clearance
    said = [
        f'{found[0].distance:.3f} m ({found[0].names[0]} and {found[0].names[1]})'
        for found in kinds.values()
        if found
    ]
    if clearance is None:
        return ['collisions are not checked']
    notes = [
        'smallest distances, including the motion to the start pose: '
        + (', '.join(said) or 'more than 0.3 m')
    ]
    if clearance.unchecked:
        pairs = listed(clearance.unchecked)
        notes.append(f'not checked, because these links are close in many poses: {pairs}')
    return notes


def _joints(robot: RobotModel, excitation: Excitation, errors: ExpectedErrors) -> str:
    rows = []
    for k, name in enumerate(errors.joint_names):
        armature, damping, coulomb, offset = (or_dash(x, '.2g') for x in errors.of_joints[k])
        unit = effort_unit(robot, robot.joint_names.index(name))
        rows.append(
            (
                name,
                f'{errors.noise[k]:.3g} {unit}',
                or_dash(errors.efforts[k], '.2g'),
                damping,
                coulomb,
                offset,
                armature,
            )
        )
    duration = excitation.series.duration
    count = SAMPLES_PER_SECOND * duration
    gain = math.exp((excitation.log_det - excitation.random_log_det) / (2.0 * errors.count))
    return table(
        'Expected standard errors of one run, by joint',
        ('joint', 'noise', 'efforts', 'damping', 'Coulomb', 'offset', 'armature'),
        rows,
        (
            f'assumes {count:g} independent samples in {duration:g} s, and no errors except the '
            'noise in the column "noise"; four runs halve all errors',
            'efforts: errors of the efforts that the identified model predicts in random states '
            'within the limits',
            f'{errors.count} unknowns; log det of their information matrix: '
            f'{excitation.log_det + errors.count * math.log(count):.4g}',
            f'with the best of {CANDIDATES} random motions within the same limits, errors are '
            f'{gain:.2f} times as large (geometric mean)',
        ),
    )


def _bodies(errors: ExpectedErrors) -> str:
    rows = [
        (name, *(or_dash(x, '.2g') for x in values))
        for name, values in zip(errors.body_names, errors.of_bodies, strict=True)
        if not np.isnan(values).all()
    ]
    return table(
        'Expected standard errors of one run, for the body that each joint moves',
        ('joint', 'mass [kg]', 'mass x distance [kg m]', 'inertia [kg m^2]'),
        rows,
        (
            'For vectors and tensors, the table shows the largest error among the components. If '
            'only a combination of parameters can be identified, its error is listed at one joint '
            'of the combination. The other joints show "-" or are left out.',
        ),
    )
