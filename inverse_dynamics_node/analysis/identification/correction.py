"""Efforts of the model that are corrected as an explanation says."""

from __future__ import annotations

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats
from .compared_efforts import ComparedEfforts
from .explanation import Explanation
from .loads import payload_regressors, point_mass_parameters
from .part import Cause, Part
from .tilt import changing_gravity_efforts


def corrected_efforts(
    compared: ComparedEfforts, explanation: Explanation, part: Part | None = None
) -> tuple[Floats, Floats]:
    """Return measured efforts without distortions, and modelled ones with the hypothesis."""
    measured = compared.measured / explanation.unit
    correction = added_efforts(compared, explanation)
    if part is not None and part.cause is Cause.LOAD:
        correction = correction * compared.inside(part)[:, None]
    if part is not None and part.cause is Cause.TILT:
        correction = changing_gravity_efforts(
            part, compared.robot, compared.states[0], compared.motion.times
        )[:, compared.index]
        correction = correction - compared.gravity
    efforts = compared.rigid + correction
    for j, (c, fit) in enumerate(zip(compared.varying, explanation.fits, strict=True)):
        source = compared.measured[:, compared.varying[explanation.source[j]]]
        measured[:, c] = fit.distortion.sign * source / explanation.factor(j)
        efforts[:, c] += fit.rotor * compared.qdd[:, c]
    return measured, efforts


def added_efforts(compared: ComparedEfforts, explanation: Explanation) -> Floats:
    """Return the efforts that the hypothesis adds to the model."""
    hypothesis = explanation.hypothesis
    if hypothesis.kind == 'mounting':
        turned = InverseDynamics(compared.robot, hypothesis.solution)
        return turned.gravity_efforts(compared.states[0])[:, compared.index] - compared.gravity
    correction: Floats = np.zeros_like(compared.rigid)
    if hypothesis.is_weightless:
        correction -= compared.gravity
    if hypothesis.kind == 'payload':
        mass, *com = hypothesis.solution
        regressors = payload_regressors(
            compared.robot, compared.dynamics.gravity, hypothesis.link, compared.states
        )
        efforts = regressors @ point_mass_parameters(mass, np.array(com))
        correction += efforts[:, compared.index]
    return correction


def as_recorded(compared: ComparedEfforts, efforts: Floats, explanation: Explanation) -> Floats:
    """Distort efforts in the way in which the driver distorts them."""
    recorded: Floats = explanation.unit * efforts
    for j, (c, fit) in enumerate(zip(compared.varying, explanation.fits, strict=True)):
        source = compared.varying[explanation.source[j]]
        recorded[:, source] = fit.distortion.sign * explanation.factor(j) * efforts[:, c]
    return recorded
