"""Diagnoses of a recording in words: a headline, the evidence, and advice."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from types import MappingProxyType

from ..analysis.diagnosis import Change, Diagnosis
from ..robot.model_warning import ModelWarning

MOST_CHANGES = 3  # joints whose residuals are listed as evidence


def headline(diagnosis: Diagnosis) -> str:
    """Summarize a diagnosis in one clause, starting with a small letter or a joint's name."""
    text = _HEADLINES[diagnosis.kind](diagnosis)
    if diagnosis.interval is None:
        return text
    begin, end = diagnosis.interval
    return f'from {begin:.1f} s to {end:.1f} s, {text}'


def sentence(diagnosis: Diagnosis) -> str:
    """Return the headline as the start of a sentence."""
    text = headline(diagnosis)
    # Names of joints keep their first letter.
    return text if diagnosis.kind in _STARTS_WITH_JOINT and diagnosis.interval is None and not (
        diagnosis.kind == 'sign' and diagnosis.is_every_joint
    ) else text[0].upper() + text[1:]  # fmt: skip


def diagnosis_warning(diagnosis: Diagnosis) -> ModelWarning:
    """Return a diagnosis as a warning, with a suggestion for the next run."""
    again = _options(diagnosis)
    hint = _ADVICE[diagnosis.kind](diagnosis)
    if again:
        hint += f' To see the remaining difference: {again}'
    parts = [_EVIDENCE.get(diagnosis.kind, _fixed(''))(diagnosis), _changes(diagnosis)]
    return ModelWarning(f'{headline(diagnosis)}: {"; ".join(filter(None, parts))}', hint)


def _options(diagnosis: Diagnosis) -> str:
    """Return the options of `compare` that include a diagnosis in the model."""
    if diagnosis.interval is not None:
        return f'--from {diagnosis.interval[0]:.1f} --to {diagnosis.interval[1]:.1f}'
    numbers = [
        0.0 if abs(value) < 5e-4 or math.isnan(value) else value for value in diagnosis.values
    ]
    if diagnosis.kind == 'gravity_compensated':
        return '--gravity 0 0 0'
    if diagnosis.kind == 'mounting':
        return f'--gravity {" ".join(f"{x:.3f}" for x in numbers)}'
    if diagnosis.kind == 'payload' and numbers[0] > 0.0:
        return f'--link {diagnosis.link} --payload {",".join(f"{x:.3f}" for x in numbers)}'
    return ''


# ---- Headlines -----------------------------------------------------------------------------


def _sign(diagnosis: Diagnosis) -> str:
    if diagnosis.is_every_joint:
        return 'every joint has its sign swapped'
    has = 'has its sign' if len(diagnosis.joints) == 1 else 'have their signs'
    return f'{listed(diagnosis.joints)} {has} swapped'


def _unit(diagnosis: Diagnosis) -> str:
    factor = sum(diagnosis.values) / len(diagnosis.values)
    size = f'{float(f"{factor:.3g}"):g} times too large'
    if factor < 1.0:
        size = f'{float(f"{1.0 / factor:.3g}"):g} times too small'
    return f'the efforts are in another unit: all are {size}'


def _scale(diagnosis: Diagnosis) -> str:
    if not diagnosis.is_every_joint:
        return f'the effort of {listed(diagnosis.joints)} is in another unit'
    if diagnosis.is_same_factor:
        return _unit(diagnosis)
    return 'the efforts are not torques or forces, but proportional to them'


def _mounting(diagnosis: Diagnosis) -> str:
    angle = math.degrees(diagnosis.angle)
    return f'the base is tilted by {angle:.0f} degrees from its mounting in the model'


def _payload(diagnosis: Diagnosis) -> str:
    mass = diagnosis.values[0]
    carries = 'carries' if mass > 0.0 else 'lacks'
    model = 'does not have' if mass > 0.0 else 'has'
    return f"link '{diagnosis.link}' {carries} {abs(mass):.2f} kg that the model {model}"


def _rotor(diagnosis: Diagnosis) -> str:
    move = 'moves' if len(diagnosis.joints) == 1 else 'move'
    return f'{listed(diagnosis.joints)} {move} more inertia than the model has: rotors and gears'


def _joints(text: str) -> Callable[[Diagnosis], str]:
    return lambda diagnosis: text.format(listed(diagnosis.joints))


def _fixed(text: str) -> Callable[[Diagnosis], str]:
    return lambda diagnosis: text


_HEADLINES: Mapping[str, Callable[[Diagnosis], str]] = MappingProxyType(
    {
        'order': _joints('the efforts of {} are in another order'),
        'gravity_compensated': _fixed(
            'the measured efforts lack gravity: the driver compensates it already'
        ),
        'mounting': _mounting,
        'unit': _unit,
        'sign': _sign,
        'scale': _scale,
        'payload': _payload,
        'bodies': _fixed('the masses or centres of mass of several links are wrong'),
        'external_force': _joints('an external force acts on {}'),
        'rotor_inertia': _rotor,
        'offset': _joints('the effort of {} has a constant offset'),
        'constant': _joints('the measured effort of {} never changes'),
        'unexplained': _joints(
            'the effort of {} differs from the model, and no known cause explains it'
        ),
    }
)
_STARTS_WITH_JOINT = ('sign', 'rotor_inertia')


# ---- Evidence ------------------------------------------------------------------------------


def _changes(diagnosis: Diagnosis) -> str:
    """Write the residuals that a diagnosis reduces, beside those with friction only."""
    changes = diagnosis.changes[:MOST_CHANGES]
    if not changes:
        return ''
    if diagnosis.kind in ('unexplained', 'external_force'):
        left = ', '.join(
            f'{each.joint} {amount(each.after, each.is_prismatic)} of '
            f'{amount(each.measured, each.is_prismatic)}'
            for each in changes
        )
        return f'the residual is {left} RMS'
    left = ', '.join(
        f'at {each.joint} from {amount(each.before, each.is_prismatic)} to '
        f'{amount(each.after, each.is_prismatic)}'
        for each in changes
    )
    cause = 'fitting all links' if diagnosis.kind == 'bodies' else 'this alone'
    how = 'friction fitted in both cases'
    if diagnosis.kind == 'bodies':
        how += ', links fitted to the other half of the recording'
    more = len(diagnosis.changes) - len(changes)
    others = f', and at {more} more {"joints" if more > 1 else "joint"}' if more else ''
    return f'{cause} reduces the RMS residual {left}{others} ({how})'


def _values(diagnosis: Diagnosis, unit: str = '', unit_prismatic: str = '') -> str:
    prismatic = {each.joint for each in diagnosis.changes if each.is_prismatic}
    return ', '.join(
        f'{name} {value:.3g} {unit_prismatic if name in prismatic else unit}'.rstrip()
        for name, value in zip(diagnosis.joints, diagnosis.values, strict=True)
    )


def _scale_evidence(diagnosis: Diagnosis) -> str:
    text = f'the measured effort is the modelled one times {_values(diagnosis)}'
    if diagnosis.unknown:
        unknown = listed(diagnosis.unknown)
        text += f'; the unit of {unknown} is unknown, because friction dominates'
    return text


def _payload_evidence(diagnosis: Diagnosis) -> str:
    mass, *com = diagnosis.values
    where = ', '.join('unknown' if math.isnan(x) else f'{round(x, 3) + 0.0:.3f}' for x in com)
    return (
        f'{mass:.3f} kg (standard error of random errors {diagnosis.error:.2g}) at ({where}) m in '
        'its frame, as a point mass'
    )


def _order_evidence(diagnosis: Diagnosis) -> str:
    pairs = zip(diagnosis.joints, diagnosis.sources, strict=True)
    return ', '.join(f'{source} has the effort of {joint}' for joint, source in pairs)


def _gravity(diagnosis: Diagnosis) -> str:
    return ', '.join(f'{x:.2f}' for x in diagnosis.values)


_EVIDENCE: Mapping[str, Callable[[Diagnosis], str]] = MappingProxyType(
    {
        'order': _order_evidence,
        'mounting': lambda each: (
            f'gravity is {_gravity(each)} m/s^2 in the frame of the base link'
        ),
        'scale': _scale_evidence,
        'payload': _payload_evidence,
        'rotor_inertia': lambda each: (
            f'an effort is proportional to the acceleration, {_values(each, "kg m^2", "kg")}'
        ),
        'offset': lambda each: _values(each, 'N m', 'N'),
        'constant': lambda each: (
            f'it is always the same value ({_values(each)}), while the modelled effort varies'
        ),
    }
)


# ---- Advice --------------------------------------------------------------------------------


def _sign_advice(diagnosis: Diagnosis) -> str:
    if diagnosis.is_every_joint:
        return (
            'The driver reports the reaction of the joint on the drive: change the sign of all '
            'efforts.'
        )
    return (
        'Change the sign in the driver, or of the <axis> in the URDF if positions have the wrong '
        'sign too. Do not send efforts of the node to this joint before that: they would drive it '
        'in the wrong direction.'
    )


def _scale_advice(diagnosis: Diagnosis) -> str:
    if not diagnosis.is_every_joint:
        return 'Compare torque constant, gear ratio and unit with those of the other joints.'
    if diagnosis.is_same_factor:
        return 'The same factor for all joints is a different unit (1000: N mm): convert it.'
    return (
        'They may be motor currents, or torques before the gears: divide by these factors (torque '
        'constant times gear ratio is their inverse).'
    )


def _payload_advice(diagnosis: Diagnosis) -> str:
    if diagnosis.interval is not None:
        return (
            'If the robot picked up a load, publish it on ~/payload of the node while it is held.'
        )
    if diagnosis.values[0] > 0.0:
        return (
            'Add it to the URDF. If nothing is attached there, the masses or centres of mass of '
            'the last links are wrong by about as much.'
        )
    return 'Remove from the URDF all parts that the robot does not have, such as a tool or a hand.'


def _mounting_advice(diagnosis: Diagnosis) -> str:
    if diagnosis.interval is not None:
        return 'If the base moves, use an IMU on it, or publish ~/gravity.'
    return f'Set gravity: [{_gravity(diagnosis)}] in the node.'


def _offset_advice(diagnosis: Diagnosis) -> str:
    cause = 'A spring or a counterweight, which a URDF cannot describe, is another possible cause.'
    if diagnosis.is_motor_side:
        return (
            'The efforts contain the friction of the gears, so that they seem to come from motor '
            f'currents: look for an offset of the current or for friction that differs between '
            f'the directions. {cause}'
        )
    return f'Zero the torque sensors in a pose in which the modelled effort is zero. {cause}'


_ADVICE: Mapping[str, Callable[[Diagnosis], str]] = MappingProxyType(
    {
        'order': _fixed(
            'Compare the order of names and efforts in the driver, and the lists of joints in all '
            'of its files.'
        ),
        'gravity_compensated': _fixed(
            'Set include_gravity: false in the node. If gravity were compensated twice, the arm '
            'would move upwards.'
        ),
        'mounting': _mounting_advice,
        'unit': _fixed(
            'The same factor for all joints is a different unit (1000: N mm): convert it.'
        ),
        'sign': _sign_advice,
        'scale': _scale_advice,
        'payload': _payload_advice,
        'bodies': _fixed(
            'No payload on one link explains this. Fit all links to the recording: '
            'inverse_dynamics identify URDF RUN --output calibrated.urdf'
        ),
        'external_force': _fixed(
            'Somebody or something may have pushed the robot, or it touched its surroundings. '
            'Leave this time out with --from and --to before you use the friction.'
        ),
        'rotor_inertia': _fixed("Set these values as the parameter 'armature' of the node."),
        'offset': _offset_advice,
        'constant': _fixed(
            'The driver does not measure or does not report it: look for a setting that enables '
            'it, or leave these joints out of the comparison.'
        ),
        'unexplained': _fixed(
            'Look at the picture. Possible causes are contact, a wrong link inertia, a drive at '
            'its limit, and an effort that is filtered or delayed.'
        ),
    }
)


# ---- Words and numbers ---------------------------------------------------------------------


def amount(effort: float, is_prismatic: bool) -> str:
    """Write an effort with three digits and its unit."""
    return f'{effort:.3g} {"N" if is_prismatic else "N m"}'


def listed(names: Sequence[str]) -> str:
    """Join names by commas, and the last one by 'and'."""
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'


__all__ = ['Change', 'amount', 'diagnosis_warning', 'headline', 'listed', 'sentence']
