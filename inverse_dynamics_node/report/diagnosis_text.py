"""Describes faults, and whether model and robot agree: headline, evidence and advice."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math

from ..analysis.diagnosis import Fault, FaultKind, is_usual
from ..analysis.diagnosis.live import Agreement, Check, DURATION, Obstacle, Size
from ..robot.model import ModelWarning
from .tables import counted

MOST_CHANGES = 3  # largest number of joints whose residuals are listed
_MOST_NAMES = 4


def headline(fault: Fault) -> str:
    """Summarize a fault in one clause, without an initial capital letter or a full stop."""
    text = _HEADLINES[fault.kind](fault)
    if fault.interval is None:
        return text
    begin, end = fault.interval
    return f'from {begin:.1f} s to {end:.1f} s, {text}'


def sentence(fault: Fault) -> str:
    """Capitalize the first letter of the headline, unless it starts with the name of a joint."""
    text = headline(fault)
    return text if fault.kind in _STARTS_WITH_JOINT and fault.interval is None and not (
        fault.kind is FaultKind.SIGN and fault.is_every_joint
    ) else text[0].upper() + text[1:]  # fmt: skip


def diagnosis_warning(fault: Fault) -> ModelWarning:
    """Return a fault as a warning with evidence and advice."""
    again = _options(fault)
    hint = advice(fault)
    if again:
        hint += f' To continue the diagnosis, use {again}'
    parts = [_EVIDENCE.get(fault.kind, _fixed(''))(fault), _changes(fault)]
    return ModelWarning(f'{headline(fault)}: {"; ".join(filter(None, parts))}', hint)


def advice(fault: Fault) -> str:
    """Return advice on a fault."""
    return _ADVICE[fault.kind](fault)


def _options(fault: Fault) -> str:
    """Return `compare` options that correct the fault; '' if none exist."""
    if fault.interval is not None:
        return ''
    numbers = [0.0 if abs(value) < 5e-4 or math.isnan(value) else value for value in fault.values]
    if fault.kind is FaultKind.GRAVITY_COMPENSATED:
        return '--gravity 0 0 0'
    if fault.kind is FaultKind.MOUNTING:
        return f'--gravity {" ".join(f"{x:.3f}" for x in numbers)}'
    if fault.kind is FaultKind.PAYLOAD and numbers[0] > 0.0:
        return f'--link {fault.link} --payload {",".join(f"{x:.3f}" for x in numbers)}'
    return ''


# ---- Headlines -----------------------------------------------------------------------------


def _positions(fault: Fault) -> str:
    positions = f'the positions of {joined(fault.joints)}'
    if fault.values:
        return f'{positions} are in degrees, so nothing else can be diagnosed'
    return f'{positions} are far outside their limits, so nothing else can be diagnosed'


def _velocity(fault: Fault) -> str:
    parts = []
    for joint, factor in zip(fault.joints, fault.values, strict=True):
        if math.isnan(factor):
            parts.append(f'the velocity of {joint} contradicts its position')
        elif factor == 0.0:
            parts.append(f'the velocity of {joint} is zero while the joint moves')
        elif factor < 0.0:
            parts.append(f'the velocity of {joint} has the wrong sign')
        else:
            parts.append(f'the velocity of {joint} is {factor:.3g} times that of its position')
    return '; '.join(parts)


def _velocity_lag(fault: Fault) -> str:
    lags = ', '.join(f'{1e3 * seconds:.0f} ms' for seconds in fault.values)
    return f'the velocity of {joined(fault.joints)} lags behind the position by {lags}'


def _reversed_axis(fault: Fault) -> str:
    is_one = len(fault.joints) == 1
    axes = 'has a reversed axis, so its' if is_one else 'have reversed axes, so their'
    return f'{joined(fault.joints)} {axes} position, velocity and effort have the wrong sign'


def _delay(fault: Fault) -> str:
    seconds = fault.values[0]
    return f'the efforts are {1e3 * abs(seconds):.0f} ms {"late" if seconds > 0.0 else "early"}'


def _sign(fault: Fault) -> str:
    if fault.is_every_joint:
        return 'all joints report efforts with the wrong sign'
    report = 'reports' if len(fault.joints) == 1 else 'report'
    return f'{joined(fault.joints)} {report} efforts with the wrong sign'


def _unit(fault: Fault) -> str:
    factor = sum(fault.values) / len(fault.values)
    if is_usual(factor):
        return f'all efforts are {factor:.2f} times those of the model'
    size = f'{float(f"{factor:.3g}"):g} times too large'
    if factor < 1.0:
        size = f'{float(f"{1.0 / factor:.3g}"):g} times too small'
    return f'the efforts are in the wrong unit, all {size}'


def _scale(fault: Fault) -> str:
    if not fault.is_every_joint:
        return f'the effort of {joined(fault.joints)} is in the wrong unit'
    if fault.is_same_factor:
        return _unit(fault)
    return 'the efforts are not torques or forces, but proportional to them'


def _gravity_compensated(fault: Fault) -> str:
    text = 'the measured efforts lack gravity'
    return text if fault.is_commanded else f'{text}, although measured_gravity is set to included'


def _gravity_measured(fault: Fault) -> str:
    text = 'the measured efforts contain gravity'
    if fault.is_commanded:
        return f'{text}, although measured_gravity is set to excluded'
    return f'{text}, but the commands do not'


def _mounting(fault: Fault) -> str:
    angle = math.degrees(fault.angle)
    return f'the base is tilted by {angle:.0f} degrees compared with the model'


def _payload(fault: Fault) -> str:
    mass = fault.values[0]
    carries = 'carries' if mass > 0.0 else 'lacks'
    model = 'does not have' if mass > 0.0 else 'has'
    return f"link '{fault.link}' {carries} {abs(mass):.2f} kg that the model {model}"


def _rotor(fault: Fault) -> str:
    move = 'moves' if len(fault.joints) == 1 else 'move'
    return (
        f'{joined(fault.joints)} {move} more inertia than the model has, probably because of '
        'rotors and gears'
    )


def _joints(text: str) -> Callable[[Fault], str]:
    return lambda fault: text.format(joined(fault.joints))


def _fixed(text: str) -> Callable[[Fault], str]:
    return lambda fault: text


_HEADLINES: Mapping[FaultKind, Callable[[Fault], str]] = {
    FaultKind.POSITIONS: _positions,
    FaultKind.VELOCITY: _velocity,
    FaultKind.VELOCITY_LAG: _velocity_lag,
    FaultKind.REVERSED_AXIS: _reversed_axis,
    FaultKind.DELAY: _delay,
    FaultKind.ORDER: _joints('the efforts of {} are in the wrong order'),
    FaultKind.GRAVITY_COMPENSATED: _gravity_compensated,
    FaultKind.GRAVITY_MEASURED: _gravity_measured,
    FaultKind.MOUNTING: _mounting,
    FaultKind.UNIT: _unit,
    FaultKind.SIGN: _sign,
    FaultKind.SCALE: _scale,
    FaultKind.PAYLOAD: _payload,
    FaultKind.BODIES: _fixed('the masses or centres of mass of several links are wrong'),
    FaultKind.EXTERNAL_FORCE: _joints('an external force acts on {}'),
    FaultKind.ROTOR_INERTIA: _rotor,
    FaultKind.OFFSET: _joints('the effort of {} has a constant offset'),
    FaultKind.NOT_MEASURED: _joints('the measured effort of {} never changes'),
    FaultKind.UNEXPLAINED: _joints(
        'the effort of {} differs from the model, and no known cause explains it'
    ),
}
_STARTS_WITH_JOINT = (FaultKind.SIGN, FaultKind.REVERSED_AXIS, FaultKind.ROTOR_INERTIA)


# ---- Evidence ------------------------------------------------------------------------------


def _changes(fault: Fault) -> str:
    """Describe the residuals, and how much a correction of the fault reduces them."""
    changes = fault.changes[:MOST_CHANGES]
    if not changes:
        return ''
    if fault.kind in (FaultKind.UNEXPLAINED, FaultKind.EXTERNAL_FORCE):
        left = ', '.join(
            f'{amount(each.after, each.is_prismatic)} at {each.joint} '
            f'({amount(each.measured, each.is_prismatic)} measured)'
            for each in changes
        )
        return f'the RMS residual is {left}'
    left = ', '.join(
        f'at {each.joint} from {amount(each.before, each.is_prismatic)} to '
        f'{amount(each.after, each.is_prismatic)}'
        for each in changes
    )
    cause = 'fitting all links' if fault.kind is FaultKind.BODIES else 'correcting this alone'
    how = 'friction and small errors of the links fitted in both cases'
    if fault.kind is FaultKind.BODIES:
        how += ', fitted links tested by two-fold cross-validation'
    more = len(fault.changes) - len(changes)
    others = f', and at {counted(more, "more joint")}' if more else ''
    return f'{cause} reduces the RMS residual {left}{others} ({how})'


def _values(fault: Fault, unit: str = '', unit_prismatic: str = '') -> str:
    prismatic = {each.joint for each in fault.changes if each.is_prismatic}
    return ', '.join(
        f'{name} {value:.3g} {unit_prismatic if name in prismatic else unit}'.rstrip()
        for name, value in zip(fault.joints, fault.values, strict=True)
    )


def _scale_evidence(fault: Fault) -> str:
    text = f'measured effort divided by modelled effort is {_values(fault)}'
    if fault.unknown:
        unknown = joined(fault.unknown)
        text += f'; the effort unit of {unknown} is unknown, because friction dominates'
    return text


def _payload_evidence(fault: Fault) -> str:
    return (
        f'a point mass of {fault.values[0]:.3f} kg (standard error {fault.error:.2g} kg, '
        f'which covers random errors only) at {centre_of_mass(fault)} m in the frame of the link'
    )


def centre_of_mass(fault: Fault) -> str:
    """Write the centre of mass of a payload in the frame of its link [m]."""
    known = ('unknown' if math.isnan(x) else f'{round(x, 3) + 0.0:.3f}' for x in fault.values[1:])
    return f'({", ".join(known)})'


def _order_evidence(fault: Fault) -> str:
    pairs = zip(fault.joints, fault.sources, strict=True)
    return ', '.join(f'{source} reports the effort of {joint}' for joint, source in pairs)


def _gravity(fault: Fault) -> str:
    return ', '.join(f'{x:.2f}' for x in fault.values)


_EVIDENCE: Mapping[FaultKind, Callable[[Fault], str]] = {
    FaultKind.ORDER: _order_evidence,
    FaultKind.MOUNTING: lambda each: (
        f'gravity is ({_gravity(each)}) m/s^2 in the frame of the base link'
    ),
    FaultKind.SCALE: _scale_evidence,
    FaultKind.PAYLOAD: _payload_evidence,
    FaultKind.ROTOR_INERTIA: lambda each: (
        'efforts proportional to the acceleration show an additional inertia of '
        f'{_values(each, "kg m^2", "kg")}'
    ),
    FaultKind.OFFSET: lambda each: _values(each, 'N m', 'N'),
    FaultKind.NOT_MEASURED: lambda each: (
        f'the modelled effort varies, but the measured effort is constant ({_values(each)})'
    ),
}


# ---- Advice --------------------------------------------------------------------------------


def _sign_advice(fault: Fault) -> str:
    if fault.is_every_joint:
        return (
            'The driver reports the effort of the joint on the drive, not the effort of the drive '
            'on the joint: change the sign of all efforts.'
        )
    return (
        'Change the sign in the driver. If positions have the wrong sign too, change the sign of '
        'the <axis> in the URDF instead. Until then, do not send efforts of the node to this '
        'joint: they would drive the joint in the wrong direction.'
    )


def _scale_advice(fault: Fault) -> str:
    if not fault.is_every_joint:
        return 'Compare the torque constant, gear ratio and unit with those of the other joints.'
    if fault.is_same_factor:
        return _UNIT_ADVICE
    return (
        'The values may be motor currents, or torques before the gears. For each joint, divide '
        'them by the ratio of measured to modelled effort, which is 1 / (torque constant * gear '
        'ratio).'
    )


def _payload_advice(fault: Fault) -> str:
    if fault.interval is not None:
        return (
            'If the robot picked up a load, publish the load on ~/payload of the node while the '
            'robot holds it.'
        )
    if fault.values[0] > 0.0:
        return (
            'Add this payload to the URDF, or publish it on ~/payload of the node. If nothing is '
            'attached to the link, the masses or centres of mass of the last links are wrong.'
        )
    return (
        'Remove parts that the robot does not have, such as a tool or a hand, from the URDF or '
        'from the payload of the node.'
    )


def _mounting_advice(fault: Fault) -> str:
    if fault.interval is not None:
        return 'If the base moves, mount an IMU on it, or publish gravity on ~/gravity.'
    return f'Set gravity to [{_gravity(fault)}] in the node.'


def _gravity_compensated_advice(fault: Fault) -> str:
    if not fault.is_commanded:
        return (
            'If no brakes hold the arm, the driver reports efforts without gravity: set '
            'measured_gravity to excluded in the node.'
        )
    return (
        'If no brakes hold the arm, the driver already compensates gravity: set '
        'include_gravity to false in the node. If gravity were compensated twice, the arm would '
        'move upwards. If only the measured efforts lack gravity, set measured_gravity to '
        'excluded instead.'
    )


def _gravity_measured_advice(fault: Fault) -> str:
    if fault.is_commanded:
        return (
            'Set measured_gravity to as_commanded in the node. If the driver adds gravity to the '
            'commands, set include_gravity to false and measured_gravity to included instead.'
        )
    return (
        'Is this intended? If the driver adds gravity to the commands, set measured_gravity to '
        'included in the node. Otherwise set include_gravity to true, or the arm will sink.'
    )


def _offset_advice(fault: Fault) -> str:
    cause = 'A spring or a counterweight, which a URDF cannot describe, is another possible cause.'
    if fault.is_motor_side:
        return (
            'The efforts contain the friction of the gears, so they are probably derived from '
            'motor currents. Look for an offset of the current, or for friction that depends '
            f'on the direction of motion. {cause}'
        )
    return f'Zero the torque sensors in a pose in which the modelled effort is zero. {cause}'


_UNIT_ADVICE = (
    'The same factor for all joints means a different unit, such as N mm for a factor of 1000. '
    'Convert the efforts to N m (prismatic joints: N).'
)
_FACTOR_ADVICE = (
    'The torque constants of the driver, or all masses of the URDF, may be wrong by this factor. '
    'To find out which, measure a payload of known mass with inverse_dynamics payload.'
)
_ADVICE: Mapping[FaultKind, Callable[[Fault], str]] = {
    FaultKind.POSITIONS: _fixed(
        'Convert the positions to rad. Check the zero positions, and whether the limits '
        'belong to this robot.'
    ),
    FaultKind.VELOCITY: _fixed(
        'Correct the velocities in the driver; a factor of 57.3 means degrees per second. Do not '
        'go live: with wrong velocities, damping and computed torque drive the joints.'
    ),
    FaultKind.VELOCITY_LAG: _fixed(
        'Shorten the filter of the velocities in the driver. Late velocities make damping and '
        'computed torque unstable.'
    ),
    FaultKind.REVERSED_AXIS: _fixed(
        'Change the sign of the <axis> in the URDF, or change the signs of positions, '
        'velocities and efforts in the driver. Until then, do not send efforts of the node to '
        'this joint.'
    ),
    FaultKind.DELAY: _fixed(
        'The driver may filter the efforts, or publish them later than the positions. '
        'inverse_dynamics identify takes the delay into account.'
    ),
    FaultKind.ORDER: _fixed(
        'Check that names and efforts have the same order in the driver, and that all files '
        'of the driver list the joints in the same order.'
    ),
    FaultKind.GRAVITY_COMPENSATED: _gravity_compensated_advice,
    FaultKind.GRAVITY_MEASURED: _gravity_measured_advice,
    FaultKind.MOUNTING: _mounting_advice,
    FaultKind.UNIT: lambda fault: _FACTOR_ADVICE if is_usual(fault.values[0]) else _UNIT_ADVICE,
    FaultKind.SIGN: _sign_advice,
    FaultKind.SCALE: _scale_advice,
    FaultKind.PAYLOAD: _payload_advice,
    FaultKind.BODIES: _fixed(
        'Fit all links to the recording: '
        'inverse_dynamics identify URDF RUN --output calibrated.urdf'
    ),
    FaultKind.EXTERNAL_FORCE: _fixed(
        'Somebody or something may have pushed the robot, or the robot may have touched its '
        'surroundings. The friction was fitted without this interval.'
    ),
    FaultKind.ROTOR_INERTIA: _fixed("Set the parameter 'armature' of the node to these values."),
    FaultKind.OFFSET: _offset_advice,
    FaultKind.NOT_MEASURED: _fixed(
        'The driver does not measure or does not report this effort. Look for a setting that '
        'enables the measurement, or leave these joints out of the comparison.'
    ),
    FaultKind.UNEXPLAINED: _fixed(
        'To see when the efforts differ, look at the picture that inverse_dynamics compare '
        'writes. Possible causes are contact, a wrong link inertia, a drive at its limit, and an '
        'effort that is filtered or delayed.'
    ),
}


# ---- Words and numbers ---------------------------------------------------------------------


def amount(effort: float, is_prismatic: bool) -> str:
    """Write an effort with three digits and its unit."""
    return f'{effort:.3g} {"N" if is_prismatic else "N m"}'


def joined(names: Sequence[str]) -> str:
    """Join names with commas, and the last name with 'and'."""
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'


def agreement_sentence(agreement: Agreement) -> str:
    """Say whether and why model and robot differ, without the final full stop."""
    if agreement.obstacle is not None:
        return _OBSTACLES[agreement.obstacle](agreement)
    if agreement.faults:
        return _differ(agreement)
    return f'model and robot agree: {_compared(agreement)}'


def _differ(agreement: Agreement) -> str:
    """Describe all faults, and give advice on the first fault."""
    parts = [*map(_headline, agreement.faults), _sizes(agreement)]
    if agreement.is_past:
        parts.append('found earlier in this run')
    if any(fault.kind is FaultKind.SIGN for fault in agreement.faults):
        parts.append('do not go live')
    if agreement.saturated:
        parts.append(f'the effort of {_listed(agreement.saturated)} is cut to its limit')
    return f'{"; ".join(parts)}. {advice(agreement.faults[0]).removesuffix(".")}'


def _headline(fault: Fault) -> str:
    """Return the headline of a fault, with the centre of mass of a payload if it is known."""
    text = headline(fault)
    if fault.kind is not FaultKind.PAYLOAD or all(map(math.isnan, fault.values[1:])):
        return text
    return f'{text}, at {centre_of_mass(fault)} m in the frame of the link'


def _not_checked(agreement: Agreement) -> str:
    """Say which joints were not checked, and what would check each of them."""
    by_check: dict[Check, list[str]] = {}
    for name, check in agreement.checks.items():
        by_check.setdefault(check, []).append(name)
    parts = [
        text.format(joined(by_check[check]))
        for check, text in _CHECKS.items()
        if check in by_check
    ]
    return f'not checked: {"; ".join(parts)}. Otherwise model and robot agree: ' + _compared(
        agreement
    )


_CHECKS = {
    Check.NO_WEIGHT: 'move {}: without weight, the sign of an effort shows only in motion',
    Check.NOT_MOVED: 'move {}: velocities are compared with positions only in motion',
    Check.FAINT: (
        'move {} faster, or accept with --unchecked: weight, friction and inertia are too small '
        'to show the sign of the effort'
    ),
    Check.NOT_MEASURED: 'accept {} with --unchecked: no effort is measured',
}


def _saturated(agreement: Agreement) -> str:
    return (
        f'{joined(agreement.saturated)}: the effort is cut to its limit, so the arm cannot hold '
        'itself or follow a motion; raise effort_limits, or move to another pose; do not go live'
    )


def _compared(agreement: Agreement) -> str:
    text = _sizes(agreement)
    if not agreement.is_moving:
        text += ', at rest'
    return text


def _slow_states(agreement: Agreement) -> str:
    measured, least = agreement.numbers
    return (
        f'joint states arrive at {measured:.0f} Hz, expected at least {least:.0f} Hz; the efforts '
        'lag behind the motion'
    )


def _at_rest(agreement: Agreement) -> str:
    return (
        f'{joined(agreement.faults[0].joints)}: measured and modelled effort differ at rest '
        f'({_sizes(agreement)}); the cause is dry friction or a wrong model; move the arm to find '
        'out which'
    )


def _small_efforts(agreement: Agreement) -> str:
    if agreement.has_gravity:
        return (
            'not compared: the modelled efforts are too small in this pose; move the arm to '
            'another pose'
        )
    return (
        'not compared: without gravity, modelled and measured efforts are too small; move the arm'
    )


def _listed(names: tuple[str, ...]) -> str:
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')


def _sizes(agreement: Agreement) -> str:
    return f'RMS residual {" and ".join(map(_size, agreement.sizes))}'


def _size(size: Size) -> str:
    unit = 'N' if size.is_prismatic else 'N m'
    residual, measured = _two_digits(size.residual), _two_digits(size.measured)
    return f'{residual} of {measured} {unit}'


def _two_digits(value: float) -> str:
    """Write a number with two significant digits, but at most three decimals."""
    if not math.isfinite(value) or value == 0.0:
        return '0' if value == 0.0 else '-'
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{min(digits, 3)}f}'


_OBSTACLES: dict[Obstacle, Callable[[Agreement], str]] = {
    Obstacle.SLOW_STATES: _slow_states,
    Obstacle.SATURATED: _saturated,
    Obstacle.NOT_CHECKED: _not_checked,
    Obstacle.AT_REST: _at_rest,
    Obstacle.NO_DIAGNOSTICS: lambda agreement: agreement.reason,
    Obstacle.NODE_STATE: lambda agreement: f'not compared: {agreement.reason}',
    Obstacle.NO_EFFORTS: lambda agreement: (
        'not compared: joint_states has no efforts; enable them in the driver'
    ),
    Obstacle.ZERO_EFFORTS: lambda agreement: (
        'not compared: all measured efforts are 0; either brakes hold the arm, or the driver does '
        'not report efforts, or the driver reports efforts without gravity (then set '
        'measured_gravity to excluded)'
    ),
    Obstacle.TOO_FEW_SAMPLES: lambda agreement: (
        f'not compared yet: collecting samples for up to {DURATION:g} s'
    ),
    Obstacle.SMALL_EFFORTS: _small_efforts,
}
