"""
Evaluates the fits on unseen data, and collects the results.

Unseen data are data that were not used for the fit. A fold is a fit that leaves out one block of
the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import significant
from ...robot.model import Booleans, Floats
from ...robot.rigid_body import PARAMETERS
from ..recordings.signals import Motion, rms
from .corrections import common_factor, link_factors
from .fit import body_covariance, RobotFit
from .preparation import BLOCKS, TrainingData
from .regression import (
    ARMATURE,
    IdentificationProblem,
    Model,
    NAMES,
    regression_of,
    TERMS,
)
from .result import BodyResult, DriveTerms, IdentificationResult, JointResult, Residuals, Unseen

_NOT_MOVED = 'this joint did not move far enough in both directions'
LEAST_GAIN = 0.01
"""The model must reduce the residuals of a friction-only fit by at least this fraction."""
LEAST_EXPLAINED = 0.1
"""Fraction of the effort variation that the identified model must explain."""


def evaluate(
    data: TrainingData,
    fit: RobotFit,
    friction: RobotFit,
    delay: tuple[float, float],
    validation: Sequence[Motion],
) -> IdentificationResult:
    """
    Return the result of an identification, evaluated on the motions in `validation`.

    Without validation, each block of the fitted recordings is predicted from the other blocks.
    `delay` contains the delay of the efforts and its standard error [s].

    """
    problem, identified = data.problem, data.problem.identified
    motions = validation or data.motions
    unseen = _unseen(data, fit, friction, validation)
    accepted = _explains(unseen) and _is_better(unseen)
    chosen = fit if accepted else friction
    model = chosen.model.exported(data.least_widths)
    joints = tuple(
        _joint(data, j, model, errors[used], used, unseen, motions)
        for j, (errors, used) in enumerate(zip(chosen.joint_errors(), chosen.used, strict=True))
    )
    scale = None if problem.currents else _scale(data, friction)
    return IdentificationResult(
        robot=identified.robot,
        calibrated=identified.robot_with(fit.model.bodies) if accepted else identified.robot,
        accepted=accepted,
        verdict=_verdict(accepted, unseen),
        are_currents=problem.currents,
        joints=joints,
        bodies=_bodies(problem, fit),
        inertials=identified.link_inertials(fit.model.bodies) if accepted else {},
        unseen=unseen,
        urdf_weight=fit.urdf_weight,
        scale=scale,
        delay=delay[0],
        delay_error=delay[1],
        delay_removed=data.correction.delay,
        smoothing=data.regression.resamplers[0].seconds,
        sample_count=sum(len(motion.times) for motion in data.motions),
        duration=data.duration,
        signals=(*data.motions, *validation),
        warnings=_warnings(data, scale),
    )


def _unseen(
    data: TrainingData, fit: RobotFit, friction: RobotFit, validation: Sequence[Motion]
) -> Unseen:
    """Return measured and predicted efforts of unseen data."""
    problem, least, gains = data.problem, data.least_widths, data.correction.gains
    m = len(problem.joints)
    motions = validation or data.motions
    regression = regression_of(problem, motions, 0.0, BLOCKS)
    # The delay of the efforts is kept, because the models do not contain a delay.
    measured = regression.with_efforts([motion.efforts * gains for motion in motions]).efforts
    urdf = Model(problem.identified.before, np.zeros((m, TERMS)), np.ones(m), np.zeros(m))
    blocks = range(regression.block_count)
    parts = [] if validation else [regression.only(block) for block in blocks]

    def predict(fit: RobotFit) -> Floats:
        if validation:
            return regression.predict(fit.model.exported(least))
        models = [fit.without(block).exported(least) for block in blocks]
        pairs = zip(parts, models, strict=True)
        return np.concatenate([part.predict(model) for part, model in pairs])

    return Unseen(
        times=regression.times,
        measured=measured,
        urdf=regression.predict(urdf),
        friction=predict(friction),
        identified=predict(fit),
        description='recordings that were not used for the fit'
        if validation
        else f'{len(blocks)} blocks of the recordings, each predicted from the other blocks',
        smoothing=max(motion.window * motion.period for motion in motions),
    )


def _explains(unseen: Unseen) -> bool:
    """Return whether the identified model explains enough of the effort variation."""
    left = np.linalg.norm(rms(unseen.measured - unseen.identified))
    return bool(left < (1.0 - LEAST_EXPLAINED) * _variation(unseen))


def _variation(unseen: Unseen) -> float:
    """Return the norm of the standard deviations of the joint efforts."""
    return float(np.linalg.norm(np.std(unseen.measured, axis=0)))


def _is_better(unseen: Unseen) -> bool:
    """
    Return whether the identified model is clearly better than a fit of friction alone.

    The model must reduce the total residual by the fraction `LEAST_GAIN`. The residuals of the
    joints may increase on average, but by less than this fraction.

    """
    friction = rms(unseen.measured - unseen.friction)
    identified = rms(unseen.measured - unseen.identified)
    total = float(np.linalg.norm(identified) / max(float(np.linalg.norm(friction)), 1e-12))
    ratio = identified / np.maximum(friction, 1e-3 * rms(unseen.measured) + 1e-12)
    relative = float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-3)))))
    return total < 1.0 - LEAST_GAIN and relative < 1.0 + LEAST_GAIN


def _verdict(accepted: bool, unseen: Unseen) -> str:
    totals = [
        float(np.linalg.norm(rms(unseen.measured - efforts)))
        for efforts in (unseen.urdf, unseen.friction, unseen.identified)
    ]
    urdf, friction, identified = map(significant, totals)
    if accepted:
        return (
            f'On unseen data, the identified model leaves {identified} N m of the efforts '
            f'unexplained. The robot description leaves {urdf} N m, or {friction} N m with fitted '
            'friction. Each value combines all joints (root of the sum of squares), after '
            f'smoothing over {1e3 * unseen.smoothing:.0f} ms'
        )
    if not _explains(unseen):
        explained = max(0.0, 1.0 - (totals[2] / _variation(unseen)) ** 2)
        return (
            f'On unseen data, the identified model explains {explained:.0%} of the variation of '
            f'the efforts, which is {significant(_variation(unseen))} N m. The masses of the '
            'robot description are kept'
        )
    return (
        'The identified model is not clearly better on unseen data: it leaves '
        f'{identified} N m unexplained, and the robot description with fitted friction leaves '
        f'{friction} N m. Therefore, the masses of the robot description are kept, and only '
        'friction is written'
    )


def _joint(
    data: TrainingData,
    j: int,
    model: Model,
    errors: Floats,
    used: Booleans,
    unseen: Unseen,
    motions: Sequence[Motion],
) -> JointResult:
    """Return the result of a joint; `errors` are those of the terms in the mask `used`."""
    robot, joint = data.problem.identified.robot, data.problem.joints[j]
    gain = float(data.correction.gains[j])
    values = dict(zip(NAMES, model.joints[j].tolist(), strict=True))
    named = dict(zip(np.array(NAMES)[used].tolist(), errors.tolist(), strict=True))
    rest = 0.0
    if values['stiffness'] != 0.0:  # the spring contains the offset
        rest, values['offset'] = -values['offset'] / values['stiffness'], 0.0
        named.pop('offset', None)
    predicted = unseen.urdf, unseen.friction, unseen.identified
    return JointResult(
        name=robot.joint_names[joint],
        is_prismatic=bool(robot.is_prismatic_joint[joint]),
        measured=float(rms(unseen.measured[:, j])),
        unseen=Residuals(*(float(rms(unseen.measured[:, j] - each[:, j])) for each in predicted)),
        noise=abs(gain) * float(rms(np.array([each.effort_noise[j] for each in motions]))),
        terms=DriveTerms(
            width=float(model.widths[j]),
            rest=rest,
            coupling=float(model.couplings[j]),
            errors=named,
            **values,
        ),
        unknown_because='' if data.moving[j] else _NOT_MOVED,
        coupled_with=_coupled_with(data.problem, model, j),
        gain=gain if data.problem.currents else None,
    )


def _coupled_with(problem: IdentificationProblem, model: Model, j: int) -> tuple[str, ...]:
    """Return the joints that share a drive with joint j, in order from the base."""
    names, before = problem.identified.robot.joint_names, problem.before
    others = [int(before[j])] if model.couplings[j] else []
    others += [k for k in np.flatnonzero(model.couplings).tolist() if before[k] == j]
    return tuple(names[problem.joints[k]] for k in others)


def _scale(data: TrainingData, friction: RobotFit) -> tuple[float, float] | None:
    """Return how many times as large as modelled all efforts are, with its error, or None."""
    used = friction.used.copy()
    used[:, ARMATURE] = data.moving
    return common_factor(*link_factors(data.regression, friction.model, used))


def _bodies(problem: IdentificationProblem, fit: RobotFit) -> tuple[BodyResult, ...]:
    identified, covariance = problem.identified, body_covariance(fit)
    results = []
    for k, parameters in enumerate(fit.model.bodies):
        rows = slice(PARAMETERS * k, PARAMETERS * k + 4)
        own = covariance[rows, rows]
        links = tuple(identified.robot.link_names[link] for link in identified.links[k])
        mass, com = float(parameters[0]), parameters[1:4] / parameters[0]
        # The centre of mass is the first moment divided by the mass.
        jacobian = np.column_stack([-com, np.eye(3)]) / mass
        before = identified.before[k]
        results.append(
            BodyResult(
                link=links[0],
                links=links,
                mass_before=float(before[0]),
                mass=mass,
                mass_error=float(np.sqrt(own[0, 0])),
                com_before=before[1:4] / before[0],
                com=com,
                com_error=np.sqrt(np.diagonal(jacobian @ own @ jacobian.T)),
            )
        )
    return tuple(results)


def _warnings(
    data: TrainingData, scale: tuple[float, float] | None
) -> tuple[tuple[str, str], ...]:
    problem = data.problem
    names = problem.identified.robot.joint_names
    warnings = []
    if problem.currents and problem.payload is None:
        warnings.append(
            (
                'gains, masses and friction are known only up to one common factor',
                'the masses of the URDF determine this factor. If these masses may be wrong, '
                'record a run with a known payload, and use --payload MASS,X,Y,Z --link LINK',
            )
        )
    if problem.currents:
        warnings += [
            (
                f'the gain of {names[joint]} cannot be determined, because the current hardly '
                'depends on the modelled effort',
                'move this joint in poses where gravity loads it, or with high accelerations. Its '
                'gain was set to the median magnitude of the other gains, so its friction and '
                'armature are in an unknown unit',
            )
            for joint, known in zip(problem.joints, data.correction.is_gain_known, strict=True)
            if not known
        ]
    if scale is not None:
        factor, error = scale
        size = 'small' if factor < 1.0 else 'large'
        warnings.append(
            (
                f'all efforts are {factor:.2f} ± {error:.2f} of the model',
                f'if the robot description is right, the gain of the efforts is '
                f'{abs(1.0 / factor - 1.0):.0%} too {size}. To find out, weigh a link, or record '
                'a run with a known payload',
            )
        )
    return tuple(warnings)
