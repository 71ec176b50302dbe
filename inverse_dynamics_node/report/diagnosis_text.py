"""Says in words which faults were found, and whether model and robot agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any, NamedTuple

from ..analysis.diagnosis import Fault, FaultKind, is_usual
from ..analysis.diagnosis.live import Agreement, Check, DURATION, Obstacle, Size
from ..robot.model import ModelWarning


class _Words(NamedTuple):
    """Templates that describe a fault; `_fields` returns their fields."""

    headline: str
    advice: str
    evidence: str = ''
    options: str = ''
    """Options of `compare` that correct the fault."""


_UNIT = (
    'The same factor for all joints means a different unit, such as N mm for a factor of 1000. '
    'Convert the efforts to N m (prismatic joints: N).'
)
_SCALE = 'measured effort divided by modelled effort is {values}{unknown}'
_POINT_MASS = (
    'a point mass of {mass:.3f} kg (standard error {error:.2g} kg, which covers random errors '
    'only) at {com} m in the frame of the link'
)
_FAULTS: Mapping[str, _Words] = {
    'positions': _Words(
        'the positions of {joints} are {far}, so nothing else can be diagnosed',
        'Convert the positions to rad. Check the zero positions, and whether the limits belong to '
        'this robot.',
    ),
    'velocity': _Words(
        '{velocities}',
        'Correct the velocities in the driver; a factor of 57.3 means degrees per second. Do not '
        'go live: with wrong velocities, damping and computed torque drive the joints.',
    ),
    'velocity_lag': _Words(
        'the velocity of {joints} lags behind the position by {lags}',
        'Shorten the filter of the velocities in the driver. Late velocities make damping and '
        'computed torque unstable.',
    ),
    'reversed_axis': _Words(
        '{joints} {has_axes} position, velocity and effort have the wrong sign',
        'Change the sign of the <axis> in the URDF, or change the signs of positions, velocities '
        'and efforts in the driver. Until then, do not send efforts of the node to this joint.',
    ),
    'delay': _Words(
        'the efforts are {delay}',
        'The driver may filter the efforts, or publish them later than the positions. '
        'inverse_dynamics identify takes the delay into account.',
    ),
    'order': _Words(
        'the efforts of {joints} are in the wrong order',
        'Check that names and efforts have the same order in the driver, and that all files of '
        'the driver list the joints in the same order.',
        '{pairs}',
    ),
    'sign': _Words(
        '{joints} {reports} efforts with the wrong sign',
        'Change the sign in the driver. If positions have the wrong sign too, change the sign of '
        'the <axis> in the URDF instead. Until then, do not send efforts of the node to this '
        'joint: they would drive the joint in the wrong direction.',
    ),
    'sign of all': _Words(
        'all joints report efforts with the wrong sign',
        'The driver reports the effort of the joint on the drive, not the effort of the drive on '
        'the joint: change the sign of all efforts.',
    ),
    'unit': _Words('the efforts are in the wrong unit, all {times}', _UNIT),
    'unit of the model': _Words(
        'all efforts are {factor:.2f} times those of the model',
        'The torque constants of the driver, or all masses of the URDF, may be wrong by this '
        'factor. To find out which, measure a payload of known mass with inverse_dynamics '
        'payload.',
    ),
    'scale': _Words(
        'the effort of {joints} is in the wrong unit',
        'Compare the torque constant, gear ratio and unit with those of the other joints.',
        _SCALE,
    ),
    'scale of all': _Words(
        'the efforts are not torques or forces, but proportional to them',
        'The values may be motor currents, or torques before the gears. For each joint, divide '
        'them by the ratio of measured to modelled effort, which is 1 / (torque constant * gear '
        'ratio).',
        _SCALE,
    ),
    'gravity_compensated': _Words(
        'the measured efforts lack gravity',
        'If no brakes hold the arm, the driver already compensates gravity: set include_gravity '
        'to false in the node. If gravity were compensated twice, the arm would move upwards. If '
        'only the measured efforts lack gravity, set measured_gravity to excluded instead.',
        options='--gravity 0 0 0',
    ),
    'gravity_compensated, not commanded': _Words(
        'the measured efforts lack gravity, although measured_gravity is set to included',
        'If no brakes hold the arm, the driver reports efforts without gravity: set '
        'measured_gravity to excluded in the node.',
        options='--gravity 0 0 0',
    ),
    'gravity_measured': _Words(
        'the measured efforts contain gravity, although measured_gravity is set to excluded',
        'Set measured_gravity to as_commanded in the node. If the driver adds gravity to the '
        'commands, set include_gravity to false and measured_gravity to included instead.',
    ),
    'gravity_measured, not commanded': _Words(
        'the measured efforts contain gravity, but the commands do not',
        'Is this intended? If the driver adds gravity to the commands, set measured_gravity to '
        'included in the node. Otherwise set include_gravity to true, or the arm will sink.',
    ),
    'mounting': _Words(
        'the base is tilted by {angle:.0f} degrees compared with the model',
        'Set gravity to [{gravity}] in the node. If the base moves, mount an IMU on it, or '
        'publish gravity on ~/gravity.',
        'gravity is ({gravity}) m/s^2 in the frame of the base link',
        '--gravity {given}',
    ),
    'payload': _Words(
        "link '{link}' carries {size:.2f} kg that the model does not have",
        'Add this payload to the URDF, or publish it on ~/payload of the node while the robot '
        'holds it. If nothing is attached to the link, the masses or centres of mass of the last '
        'links are wrong.',
        _POINT_MASS,
        '--link {link} --payload {given_load}',
    ),
    'no payload': _Words(
        "link '{link}' lacks {size:.2f} kg that the model has",
        'Remove parts that the robot does not have, such as a tool or a hand, from the URDF or '
        'from the payload of the node.',
        _POINT_MASS,
    ),
    'bodies': _Words(
        'the masses or centres of mass of several links are wrong',
        'Fit all links to the recording: '
        'inverse_dynamics identify URDF RUN --output calibrated.urdf',
    ),
    'external_force': _Words(
        'an external force acts on {joints}',
        'Somebody or something may have pushed the robot, or the robot may have touched its '
        'surroundings. The friction was fitted without this interval.',
    ),
    'rotor_inertia': _Words(
        '{joints} {moves} more inertia than the model has, probably because of rotors and gears',
        "Set the parameter 'armature' of the node to these values.",
        'efforts proportional to the acceleration show an additional inertia of {values} kg m^2 '
        '(prismatic joints: kg)',
    ),
    'offset': _Words(
        'the effort of {joints} has a constant offset',
        'Zero the torque sensors in a pose in which the modelled effort is zero. If the efforts '
        'are derived from motor currents, look for an offset of the current, or for friction that '
        'depends on the direction of motion. A spring or a counterweight, which a URDF cannot '
        'describe, is another possible cause.',
        '{values} N m (prismatic joints: N)',
    ),
    'not_measured': _Words(
        'the measured effort of {joints} never changes',
        'The driver does not measure or does not report this effort. Look for a setting that '
        'enables the measurement, or leave these joints out of the comparison.',
        'the modelled effort varies, but the measured effort is constant ({values})',
    ),
    'unexplained': _Words(
        'the effort of {joints} differs from the model, and no known cause explains it',
        'To see when the efforts differ, look at the picture that inverse_dynamics compare '
        'writes. Possible causes are contact, a wrong link inertia, a drive at its limit, and an '
        'effort that is filtered or delayed.',
    ),
}


def _words(fault: Fault) -> _Words:
    """Return the templates for a fault."""
    kind, value = fault.kind.value, fault.values[0] if fault.values else 0.0
    is_one_factor = fault.kind is FaultKind.UNIT or (
        fault.kind is FaultKind.SCALE and fault.is_every_joint and fault.is_same_factor
    )
    if is_one_factor:
        return _FAULTS['unit of the model' if is_usual(_factor(fault)) else 'unit']
    special = {
        f'{kind} of all': fault.is_every_joint,
        f'{kind}, not commanded': not fault.is_commanded,
        'no payload': fault.kind is FaultKind.PAYLOAD and value < 0.0,
    }
    found = (key for key, applies in special.items() if applies and key in _FAULTS)
    return _FAULTS[next(found, kind)]


# ---- Faults --------------------------------------------------------------------------------


def headline(fault: Fault) -> str:
    """Summarize a fault in one clause, without an initial capital letter or a full stop."""
    text = _words(fault).headline.format_map(_Fields(fault))
    if fault.interval is None:
        return text
    begin, end = fault.interval
    return f'from {begin:.1f} s to {end:.1f} s, {text}'


def sentence(fault: Fault) -> str:
    """Capitalize the first letter of the headline, unless it starts with the name of a joint."""
    text = headline(fault)
    if fault.interval is None and _words(fault).headline.startswith('{joints}'):
        return text
    return text[0].upper() + text[1:]


def advice(fault: Fault) -> str:
    """Return advice on a fault."""
    return _words(fault).advice.format_map(_Fields(fault))


def diagnosis_warning(fault: Fault) -> ModelWarning:
    """Return a fault as a warning with evidence and advice."""
    words, hint = _words(fault), advice(fault)
    if words.options and fault.interval is None:
        again = words.options.format_map(_Fields(fault))
        hint += f' To continue the diagnosis, use {again}'
    texts = [headline(fault), words.evidence.format_map(_Fields(fault))]
    return ModelWarning(': '.join(filter(None, texts)), hint)


class _Fields:
    """The fields of the templates, computed when they are needed."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault

    def __getitem__(self, name: str) -> Any:
        return _FIELDS[name](self.fault)


def _factor(fault: Fault) -> float:
    return sum(fault.values) / len(fault.values)


def _times(fault: Fault) -> str:
    factor = _factor(fault)
    size, word = (1.0 / factor, 'small') if factor < 1.0 else (factor, 'large')
    return f'{float(f"{size:.3g}"):g} times too {word}'


def _verb(one: str, many: str) -> Callable[[Fault], str]:
    return lambda fault: one if len(fault.joints) == 1 else many


def _velocities(fault: Fault) -> str:
    parts = []
    for joint, factor in zip(fault.joints, fault.values, strict=True):
        fact = f'is {factor:.3g} times that of its position'
        if math.isnan(factor):
            fact = 'contradicts its position'
        elif factor == 0.0:
            fact = 'is zero while the joint moves'
        elif factor < 0.0:
            fact = 'has the wrong sign'
        parts.append(f'the velocity of {joint} {fact}')
    return '; '.join(parts)


def _values(fault: Fault) -> str:
    pairs = zip(fault.joints, fault.values, strict=True)
    return ', '.join(f'{joint} {value:.3g}' for joint, value in pairs)


def _unknown(fault: Fault) -> str:
    if not fault.unknown:
        return ''
    joints = joined(fault.unknown)
    return f'; the effort unit of {joints} is unknown, because friction dominates'


def _numbers(values: Sequence[float], separator: str) -> str:
    """Write numbers as options of a command, with 0 for unknown ones."""
    return separator.join(f'{0.0 if math.isnan(x) else round(x, 3) + 0.0:.3f}' for x in values)


def centre_of_mass(fault: Fault) -> str:
    """Write the centre of mass of a payload in the frame of its link [m]."""
    known = ('unknown' if math.isnan(x) else f'{round(x, 3) + 0.0:.3f}' for x in fault.values[1:])
    return f'({", ".join(known)})'


_FIELDS: Mapping[str, Callable[[Fault], Any]] = {
    'angle': lambda fault: math.degrees(fault.angle),
    'com': centre_of_mass,
    'delay': lambda fault: (
        f'{1e3 * abs(fault.values[0]):.0f} ms {"late" if fault.values[0] > 0.0 else "early"}'
    ),
    'error': lambda fault: fault.error,
    'factor': _factor,
    'far': lambda fault: 'in degrees' if fault.values else 'far outside their limits',
    'given': lambda fault: _numbers(fault.values, ' '),
    'given_load': lambda fault: _numbers(fault.values, ','),
    'gravity': lambda fault: ', '.join(f'{x:.2f}' for x in fault.values),
    'has_axes': _verb('has a reversed axis, so its', 'have reversed axes, so their'),
    'joints': lambda fault: joined(fault.joints),
    'lags': lambda fault: ', '.join(f'{1e3 * seconds:.0f} ms' for seconds in fault.values),
    'link': lambda fault: fault.link,
    'mass': lambda fault: fault.values[0],
    'moves': _verb('moves', 'move'),
    'pairs': lambda fault: ', '.join(
        f'{source} reports the effort of {joint}'
        for joint, source in zip(fault.joints, fault.sources, strict=True)
    ),
    'reports': _verb('reports', 'report'),
    'size': lambda fault: abs(fault.values[0]),
    'times': _times,
    'unknown': _unknown,
    'values': _values,
    'velocities': _velocities,
}


# ---- The verdict of `watch` ----------------------------------------------------------------

_OBSTACLES = {
    Obstacle.SLOW_STATES: (
        'joint states arrive at {rate:.0f} Hz, expected at least {least:.0f} Hz; the efforts lag '
        'behind the motion'
    ),
    Obstacle.SATURATED: (
        '{saturated}: the effort is cut to its limit, so the arm cannot hold itself or follow a '
        'motion; raise effort_limits, or move to another pose; do not go live'
    ),
    Obstacle.NOT_CHECKED: 'not checked: {unchecked}. Otherwise model and robot agree: {sizes}',
    Obstacle.AT_REST: (
        '{joints}: measured and modelled effort differ at rest ({residual}); the cause is dry '
        'friction or a wrong model; move the arm to find out which'
    ),
    Obstacle.NO_DIAGNOSTICS: '{reason}',
    Obstacle.NODE_STATE: 'not compared: {reason}',
    Obstacle.NO_EFFORTS: 'not compared: joint_states has no efforts; enable them in the driver',
    Obstacle.ZERO_EFFORTS: (
        'not compared: all measured efforts are 0; either brakes hold the arm, or the driver does '
        'not report efforts, or the driver reports efforts without gravity (then set '
        'measured_gravity to excluded)'
    ),
    Obstacle.TOO_FEW_SAMPLES: f'not compared yet: collecting samples for up to {DURATION:g} s',
    Obstacle.SMALL_EFFORTS: (
        'not compared: modelled and measured efforts are too small in this pose; move the arm'
    ),
}
_CHECKS = {
    Check.NO_WEIGHT: 'move {}: without weight, the sign of an effort shows only in motion',
    Check.NOT_MOVED: 'move {}: velocities are compared with positions only in motion',
    Check.FAINT: (
        'move {} faster, or accept with --unchecked: weight, friction and inertia are too small '
        'to show the sign of the effort'
    ),
    Check.NOT_MEASURED: 'accept {} with --unchecked: no effort is measured',
}


def agreement_sentence(agreement: Agreement) -> str:
    """Say whether and why model and robot differ, without the final full stop."""
    if agreement.obstacle is None and agreement.faults:
        return _differ(agreement)
    residual = f'RMS residual {" and ".join(map(_size, agreement.sizes))}'
    sizes = residual if agreement.is_moving else f'{residual}, at rest'
    if agreement.obstacle is None:
        return f'model and robot agree: {sizes}'
    rate, least = agreement.numbers or (math.nan, math.nan)
    return _OBSTACLES[agreement.obstacle].format(
        joints=joined(agreement.faults[0].joints if agreement.faults else ()),
        least=least,
        rate=rate,
        reason=agreement.reason,
        residual=residual,
        saturated=joined(agreement.saturated),
        sizes=sizes,
        unchecked=_unchecked(agreement),
    )


def _differ(agreement: Agreement) -> str:
    """Describe all faults, and give advice on the first fault."""
    parts = []
    for fault in agreement.faults:
        place = ''
        if fault.kind is FaultKind.PAYLOAD and not all(map(math.isnan, fault.values[1:])):
            place = f', at {centre_of_mass(fault)} m in the frame of the link'
        parts.append(headline(fault) + place)
    parts.append(f'RMS residual {" and ".join(map(_size, agreement.sizes))}')
    if agreement.is_past:
        parts.append('found earlier in this run')
    if any(fault.kind is FaultKind.SIGN for fault in agreement.faults):
        parts.append('do not go live')
    if agreement.saturated:
        parts.append(f'the effort of {joined(agreement.saturated)} is cut to its limit')
    return f'{"; ".join(parts)}. {advice(agreement.faults[0]).removesuffix(".")}'


def _unchecked(agreement: Agreement) -> str:
    """Say what would check each joint that was not checked."""
    checks = agreement.checks
    by_check = {check: [name for name in checks if checks[name] is check] for check in _CHECKS}
    return '; '.join(
        _CHECKS[check].format(joined(names)) for check, names in by_check.items() if names
    )


# ---- Words and numbers ---------------------------------------------------------------------


def amount(effort: float, is_prismatic: bool) -> str:
    """Write an effort with three digits and its unit."""
    return f'{effort:.3g} {"N" if is_prismatic else "N m"}'


def joined(names: Sequence[str]) -> str:
    """Join names with commas, and the last name with 'and'."""
    return ' and '.join(filter(None, (', '.join(names[:-1]), *names[-1:])))


def _size(size: Size) -> str:
    unit = 'N' if size.is_prismatic else 'N m'
    return f'{_two_digits(size.residual)} of {_two_digits(size.measured)} {unit}'


def _two_digits(value: float) -> str:
    """Write a number with two significant digits, but at most three decimals."""
    if not math.isfinite(value) or value == 0.0:
        return '0' if value == 0.0 else '-'
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{min(digits, 3)}f}'
