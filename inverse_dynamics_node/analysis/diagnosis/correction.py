"""Efforts of the model that are corrected as an explanation says."""

from __future__ import annotations

import numpy as np

from ...robot.model import Floats
from ..columns import gravity_columns, payload_columns
from .compared_efforts import ComparedEfforts
from .fault import FaultKind
from .intervals import changing_gravity_efforts, FaultInterval
from .loads import point_mass_parameters
from .regression_data import RobotFit


def corrected_efforts(
    compared: ComparedEfforts, robot_fit: RobotFit, fault: FaultInterval | None = None
) -> tuple[Floats, Floats]:
    """Return measured efforts without sensor faults, and modelled ones of the candidate."""
    measured = compared.measured / robot_fit.unit
    correction = added_efforts(compared, robot_fit)
    if fault is not None and fault.kind is FaultKind.PAYLOAD:
        correction = correction * compared.inside(fault)[:, None]
    if fault is not None and fault.kind is FaultKind.MOUNTING:
        correction = changing_gravity_efforts(
            fault, compared.robot, compared.states[0], compared.motion.times
        )[:, compared.index]
        correction = correction - compared.gravity
    efforts = compared.rigid + correction
    for j, (c, fit) in enumerate(zip(compared.varying, robot_fit.fits, strict=True)):
        source = compared.measured[:, compared.varying[robot_fit.source[j]]]
        measured[:, c] = fit.sensor_fault.sign * source / robot_fit.factor(j)
        efforts[:, c] += fit.rotor * compared.qdd[:, c]
    return measured, efforts


def added_efforts(compared: ComparedEfforts, robot_fit: RobotFit) -> Floats:
    """Return the efforts that the candidate model adds to the model."""
    candidate = robot_fit.candidate
    if candidate.kind is FaultKind.MOUNTING:
        turned = gravity_columns(compared.robot, compared.states[0]) @ np.array(candidate.solution)
        return np.asarray(turned[:, compared.index] - compared.gravity)
    correction: Floats = np.zeros_like(compared.rigid)
    if candidate.is_gravity_compensated:
        correction -= compared.gravity
    if candidate.kind is FaultKind.PAYLOAD:
        mass, *com = candidate.solution
        columns = payload_columns(
            compared.robot, compared.dynamics.gravity, candidate.link, compared.states
        )
        efforts = columns @ point_mass_parameters(mass, np.array(com))
        correction += efforts[:, compared.index]
    return correction


def as_recorded(compared: ComparedEfforts, efforts: Floats, robot_fit: RobotFit) -> Floats:
    """Distort efforts in the way in which the driver distorts them."""
    recorded: Floats = robot_fit.unit * efforts
    for j, (c, fit) in enumerate(zip(compared.varying, robot_fit.fits, strict=True)):
        source = compared.varying[robot_fit.source[j]]
        recorded[:, source] = fit.sensor_fault.sign * robot_fit.factor(j) * efforts[:, c]
    return recorded
