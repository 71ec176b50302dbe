"""
Identify a robot, and check the printed residuals with Pinocchio and the written files.

    python -m benchmarks.identification URDF TRAIN --validate VALID
    python -m benchmarks.identification URDF RUN --split 0.6

Pinocchio reads the calibrated URDF and the parameters of the node from the written files. Its
input states come from polynomials of degree 5 fitted over 0.15 s.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.identification import identify_parameters
from inverse_dynamics_node.analysis.identification.result import (
    calibrated_urdf,
    identified_parameters,
)
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.robot.model import Floats
import numpy as np
import yaml

SMOOTHING = 0.15  # [s]
DEGREE = 5
TOLERANCE = 0.03  # largest relative difference between the printed residual and Pinocchio's


class Written(NamedTuple):
    """The written files as the node would read them."""

    urdf: str
    parameters: dict[str, Any]
    offsets: Floats
    """Constant efforts of the drives, from the result."""

    def per_joint(self, name: str) -> Floats:
        """Return the values of a parameter for all joints."""
        return np.array(self.parameters.get(name, np.zeros(len(self.parameters['joints']))))


def main() -> int:
    """Identify, evaluate and print; return 1 if the residuals of both programs differ."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('urdf', type=Path)
    parser.add_argument('recording', type=Path)
    unseen = parser.add_mutually_exclusive_group(required=True)
    unseen.add_argument('--validate', type=Path, help='recording that is not fitted')
    unseen.add_argument('--split', type=float, help='fraction of the recording that is fitted')
    options = parser.parse_args()
    robot = load_urdf(options.urdf)
    training = read_measured_states(options.recording, robot.joint_names)[0]
    if options.split is None:
        validation = read_measured_states(options.validate, robot.joint_names)[0]
    else:
        training, validation = split(training, options.split)
    result = identify_parameters(robot, [training], [validation])
    written = Written(
        calibrated_urdf(result, options.urdf).decode(),
        yaml.safe_load(identified_parameters(result))['/**']['ros__parameters'],
        np.array([joint.terms.offset for joint in result.joints]),
    )
    smoothed, raw = residuals(written, validation)
    print(f'{result.verdict}.\n')
    print(f'{"residual on unseen data":34}{"root of the sum":>20}{"root of the mean":>20}')
    print(f'{"":34}{"over joints":>20}{"over joints":>20}')
    printed = [joint.unseen.identified for joint in result.joints]
    for name, values in (
        ('printed', np.array(printed)),
        ('Pinocchio, smoothed over 0.15 s', smoothed),
        ('Pinocchio, not smoothed', raw),
    ):
        total = float(np.linalg.norm(values))
        print(f'{name:34}{total:20.3f}{total / np.sqrt(len(values)):20.3f}')
    difference = float(np.linalg.norm(printed) / np.linalg.norm(smoothed) - 1.0)
    print(f'\nprinted and Pinocchio: {difference:+.1%}')
    least = least_density(written.urdf)
    print(f'bodies: {"physical" if least > 0.0 else "NOT PHYSICAL"} (least {least:.1e})')
    return int(abs(difference) > TOLERANCE or least <= 0.0)


def split(recording: Recording, fraction: float) -> tuple[Recording, Recording]:
    """Return the first fraction of a recording, and the remaining recording."""
    times = recording.times
    is_first = times <= times[0] + fraction * (times[-1] - times[0])

    def part(chosen: Any) -> Recording:
        return Recording(
            recording.joint_names,
            times[chosen],
            recording.positions[chosen],
            None if recording.velocities is None else recording.velocities[chosen],
            recording.efforts[chosen],
        )

    return part(is_first), part(~is_first)


def residuals(written: Written, recording: Recording) -> tuple[Floats, Floats]:
    """Return the RMS of measured minus modelled efforts per joint, smoothed and unsmoothed."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import savgol_filter

    times, index = np.unique(recording.times, return_index=True)
    period = float(np.median(np.diff(times)))
    grid = np.arange(times[0], times[-1], period)
    names = [recording.joint_names.index(name) for name in written.parameters['joints']]
    q = CubicSpline(times, recording.positions[index][:, names])(grid)
    measured = CubicSpline(times, recording.efforts[index][:, names])(grid)
    half = round(0.5 * SMOOTHING / period)

    def smooth(values: Floats, order: int = 0) -> Floats:
        return np.asarray(savgol_filter(values, 2 * half + 1, DEGREE, order, period, axis=0))

    states = [smooth(q), smooth(q, 1), smooth(q, 2)]
    if recording.velocities is not None:
        qd = CubicSpline(times, recording.velocities[index][:, names])(grid)
        states[1:] = smooth(qd), smooth(qd, 1)
    left = measured - modelled(written, *states)
    # Leave out both ends, where the polynomials would extrapolate.
    parts = smooth(left)[half:-half], left[half:-half]
    smoothed, raw = (np.sqrt(np.mean(part**2, axis=0)) for part in parts)
    return smoothed, raw


def modelled(written: Written, q: Floats, qd: Floats, qdd: Floats) -> Floats:
    """Compute efforts with Pinocchio and the written files: one row per state."""
    import pinocchio

    model = pinocchio.buildModelFromXML(written.urdf)
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in written.parameters['joints']]
    velocities, positions = [j.idx_v for j in joints], [j.idx_q for j in joints]
    turns = np.array([joint.nq == 2 for joint in joints])
    state = pinocchio.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    rigid = np.zeros_like(q)
    for k in range(len(q)):
        for j, at in enumerate(positions):
            if turns[j]:
                state[0][at : at + 2] = np.cos(q[k, j]), np.sin(q[k, j])
            else:
                state[0][at] = q[k, j]
        state[1][velocities], state[2][velocities] = qd[k], qdd[k]
        rigid[k] = pinocchio.rnea(model, data, *state)[velocities]
    drives = np.eye(len(joints))  # drive turns per joint turn
    for j, ratio in enumerate(written.per_joint('drive_coupling')):
        if ratio:
            parent = model.names[model.parents[model.getJointId(written.parameters['joints'][j])]]
            drives[j, written.parameters['joints'].index(parent)] = ratio
    spring = written.per_joint('spring_stiffness') * (q - written.per_joint('spring_rest'))
    held, rate = rigid + spring, qd @ drives.T
    dry = written.per_joint('coulomb') + written.per_joint('load_friction') * np.abs(held)
    drive = (
        written.per_joint('armature') * (qdd @ drives.T)
        + written.per_joint('damping') * rate
        + dry * np.tanh(rate / written.per_joint('coulomb_width'))
    )
    return np.asarray(held + drive @ drives + written.offsets)


def least_density(urdf: str) -> float:
    """Return the smallest eigenvalue of all pseudo-inertias, each relative to its largest one."""
    least = np.inf
    for element in ElementTree.fromstring(urdf).iter('inertial'):
        mass = float(element.find('mass').attrib['value'])  # type: ignore[union-attr]
        if mass == 0.0:
            continue
        inertia = element.find('inertia').attrib  # type: ignore[union-attr]
        ixx, iyy, izz, ixy, ixz, iyz = (
            float(inertia[name]) for name in ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
        )
        about_com = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        density = 0.5 * np.trace(about_com) * np.eye(3) - about_com
        eigenvalues = np.append(np.linalg.eigvalsh(density), mass)
        least = min(least, float(eigenvalues[0] / eigenvalues[-2]), mass)
    return least


if __name__ == '__main__':
    raise SystemExit(main())
