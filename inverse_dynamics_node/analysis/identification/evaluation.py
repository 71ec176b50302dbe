"""
Evaluates the fits on unseen data, and collects the results.

Unseen data are data that were not used for the fit. A fold is a fit that leaves out one block of
the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import significant
from ...robot.model import Floats
from ...robot.rigid_body import PARAMETERS
from ..columns import base_parameters
from ..recordings.signals import rms
from .corrections import common_factor, link_factors
from .fit import mass_information, RobotFit
from .preparation import PreparedRecording, TrainingData
from .regression import (
    ARMATURE,
    COULOMB,
    DAMPING,
    IdentificationProblem,
    LOAD,
    Model,
    OFFSET,
    Regression,
    SPRING,
    TERMS,
)
from .result import BodyResult, DriveTerms, IdentificationResult, JointResult, Residuals, Unseen

_NAMES = {
    'armature': ARMATURE,
    'damping': DAMPING,
    'coulomb': COULOMB,
    'load_friction': LOAD,
    'stiffness': SPRING,
    'offset': OFFSET,
}
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
    validation: Sequence[PreparedRecording],
) -> IdentificationResult:
    """
    Return the result of an identification, evaluated on the recordings in `validation`.

    Without validation recordings, each block of the fitted recordings is predicted from the other
    blocks. `delay` contains the delay of the efforts and its standard error [s].

    """
    problem, identified = data.problem, data.problem.identified
    m = len(problem.joints)
    urdf = Model(identified.before, np.zeros((m, TERMS)), np.ones(m), np.zeros(m))
    least = data.least_widths
    models = urdf, friction.model.exported(least), fit.model.exported(least)
    training = _efforts(data, data.runs, models, (), 'the training data')
    if validation:
        text = 'recordings that were not used for the fit'
        unseen = _efforts(data, validation, models, (), text)
    else:
        folds = [
            [each.without(block).exported(least) for each in (friction, fit)]
            for block in range(data.regression.block_count)
        ]
        text = f'{len(folds)} blocks of the recordings, each predicted from the other blocks'
        unseen = _efforts(data, data.runs, models, folds, text)
    accepted = _explains(unseen) and _is_better(unseen)
    chosen = fit if accepted else friction
    named = [
        {name: float(own[k]) for name, k in _NAMES.items() if is_used[k]}
        for own, is_used in zip(chosen.joint_errors(), chosen.used, strict=True)
    ]
    runs, model = validation or data.runs, models[2 if accepted else 1]
    joints = tuple(_joint(data, j, model, named[j], training, unseen, runs) for j in range(m))
    covariance: Floats = np.asarray(np.linalg.inv(fit.hessian))
    scale = None if problem.currents else _scale(data, friction)
    return IdentificationResult(
        robot=identified.robot,
        calibrated=identified.robot_with(fit.model.bodies) if accepted else identified.robot,
        accepted=accepted,
        verdict=_verdict(accepted, unseen),
        are_currents=problem.currents,
        joints=joints,
        bodies=_bodies(problem, fit, covariance),
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
        signals=tuple(run.derived for run in [*data.runs, *validation]),
        base_parameters=_base_parameters(problem, fit, covariance),
        warnings=_warnings(data, joints, accepted, scale),
    )


def _efforts(
    data: TrainingData,
    runs: Sequence[PreparedRecording],
    models: Sequence[Model],
    folds: Sequence[Sequence[Model]],
    description: str,
) -> Unseen:
    """
    Return measured and predicted efforts.

    In the block that a fold left out, the models of the fold replace the last two of `models`.

    """
    regression = Regression(data.problem, [run.motion for run in runs], 0.0, max(1, len(folds)))
    # The delay of the efforts is kept, because the models do not contain a delay.
    gains = data.correction.gains
    measured = regression.with_efforts([run.motion.efforts * gains for run in runs]).efforts
    raw = regression.with_efforts([run.motion.raw_efforts * gains for run in runs]).efforts
    urdf, friction, identified = (regression.predict(model) for model in models)
    for block, fold in enumerate(folds):
        rows = regression.block == block
        for values, model in zip((friction, identified), fold, strict=True):
            values[rows] = regression.predict(model)[rows]
    return Unseen(
        _times(regression),
        measured,
        urdf,
        friction,
        identified,
        description,
        smoothing=max(run.derived.window * run.derived.period for run in runs),
        unsmoothed=rms(raw - identified),
    )


def _times(regression: Regression) -> Floats:
    """Return the times of the rows; successive recordings are placed one second apart."""
    parts, start = [], 0.0
    for smooth in regression.resamplers:
        times = smooth.times - smooth.times[0] + start
        parts.append(times)
        start = float(times[-1]) + 1.0
    return np.concatenate(parts)


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
        unsmoothed = significant(float(np.linalg.norm(unseen.unsmoothed)))
        return (
            f'On unseen data, the identified model leaves {identified} N m of the efforts '
            f'unexplained. The robot description leaves {urdf} N m, or {friction} N m with fitted '
            'friction. Each value combines all joints (root of the sum of squares), after '
            f'smoothing over {1e3 * unseen.smoothing:.0f} ms. Without smoothing, the identified '
            f'model leaves {unsmoothed} N m'
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
    errors: dict[str, float],
    training: Unseen,
    unseen: Unseen,
    runs: Sequence[PreparedRecording],
) -> JointResult:
    robot, joint = data.problem.identified.robot, data.problem.joints[j]
    gain = float(data.correction.gains[j])

    def residuals(data: Unseen) -> Residuals:
        return Residuals(
            *(
                float(rms(data.measured[:, j] - efforts[:, j]))
                for efforts in (data.urdf, data.friction, data.identified)
            )
        )

    values = {name: float(model.joints[j, k]) for name, k in _NAMES.items()}
    rest = 0.0
    if values['stiffness'] != 0.0:  # the spring contains the offset
        rest, values['offset'] = -values['offset'] / values['stiffness'], 0.0
        errors = {name: error for name, error in errors.items() if name != 'offset'}
    return JointResult(
        name=robot.joint_names[joint],
        is_prismatic=bool(robot.is_prismatic_joint[joint]),
        measured=float(rms(unseen.measured[:, j])),
        unseen=residuals(unseen),
        training=residuals(training),
        noise=float(abs(gain) * np.sqrt(np.mean([run.noise[j] ** 2 for run in runs]))),
        unsmoothed=float(unseen.unsmoothed[j]),
        terms=DriveTerms(
            width=float(model.widths[j]),
            rest=rest,
            coupling=float(model.couplings[j]),
            errors=errors,
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


def _bodies(
    problem: IdentificationProblem, fit: RobotFit, covariance: Floats
) -> tuple[BodyResult, ...]:
    identified, data_fractions = problem.identified, mass_information(fit)
    results = []
    for k, parameters in enumerate(fit.model.bodies):
        rows = slice(PARAMETERS * k, PARAMETERS * k + 4)
        own = covariance[rows, rows]
        mass, com = float(parameters[0]), parameters[1:4] / parameters[0]
        # The centre of mass is the first moment divided by the mass.
        jacobian = np.column_stack([-com, np.eye(3)]) / mass
        before = identified.before[k]
        results.append(
            BodyResult(
                link=identified.names[k],
                links=tuple(identified.robot.link_names[link] for link in identified.links[k]),
                mass_before=float(before[0]),
                mass=mass,
                mass_error=float(np.sqrt(own[0, 0])),
                com_before=before[1:4] / before[0],
                com=com,
                com_error=np.sqrt(np.diagonal(jacobian @ own @ jacobian.T)),
                data_fraction=float(data_fractions[k]),
            )
        )
    return tuple(results)


def _base_parameters(
    problem: IdentificationProblem, fit: RobotFit, covariance: Floats
) -> tuple[tuple[str, float, float], ...]:
    """Return names, values and standard errors of the base parameters."""
    base = base_parameters(problem.at_random_states())
    first = fit.model.bodies.size
    values = base.combinations @ fit.model.bodies.ravel()
    own = covariance[:first, :first]
    variances = np.einsum('ri,ij,rj->r', base.combinations, own, base.combinations)
    names = base.names(problem.identified.names)
    errors = np.sqrt(np.maximum(variances, 0.0))
    return tuple(zip(names, values.tolist(), errors.tolist(), strict=True))


def _warnings(
    data: TrainingData,
    joints: Sequence[JointResult],
    accepted: bool,
    scale: tuple[float, float] | None,
) -> tuple[tuple[str, str], ...]:
    problem = data.problem
    names = problem.identified.robot.joint_names
    warnings = []
    if problem.currents and not problem.has_known_mass:
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
    warnings += [
        (
            f'the drive of {joint.name} also turns with {joint.coupled_with[0]}, by '
            f'{joint.terms.coupling:.3g} rad per rad',
            'many wrists have such a coupling. A URDF cannot express it, but the node parameter '
            'drive_coupling can',
        )
        for joint in joints
        if joint.terms.coupling != 0.0
    ]
    warnings += [
        (
            f'{group} always moved in a fixed ratio',
            'record a motion in which these joints move independently. Otherwise, the fit cannot '
            'distinguish a coupling of the drives from inertia and friction',
        )
        for group in _moved_together(data)
    ]
    warnings += _unexplained(joints, accepted)
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


def _moved_together(data: TrainingData) -> list[str]:
    """Return the names of each group of joints that moved in a fixed ratio."""
    names = data.problem.identified.robot.joint_names
    groups = [[names[data.problem.joints[j]] for j in group] for group in data.regression.together]
    return [f'{", ".join(group[:-1])} and {group[-1]}' for group in groups]


def _unexplained(joints: Sequence[JointResult], accepted: bool) -> list[tuple[str, str]]:
    """Warn about joints whose residual is larger than the measured effort."""
    warnings = []
    for joint in joints:
        left = joint.unseen.identified if accepted else joint.unseen.friction
        if left > joint.measured:
            warnings.append(
                (
                    f'on unseen data, joint {joint.name} has a residual of {significant(left)} '
                    f'{joint.unit}, which exceeds the measured effort of '
                    f'{significant(joint.measured)} {joint.unit}',
                    'do not use the result for this joint. Check the sign and the unit of the '
                    'effort. The recordings for the fit and for the evaluation must contain '
                    'similar motions of the joint',
                )
            )
    return warnings
