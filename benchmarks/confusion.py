"""
Tests the statements of `compare` about simulated recordings with one known fault each.

The program writes `doc/evidence/confusion.md`. Masses and inertias of the simulated robots differ
from the robot description by about 10 %. The joints have friction and rotors, and the signals have
noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
import math
from pathlib import Path

from identification_runs import exciting_motion, other_bodies
from inverse_dynamics_node import InverseDynamics, load_urdf, RobotModel
from inverse_dynamics_node.analysis.diagnosis import (
    ComparisonResult,
    diagnose_recording,
    Fault,
    FaultKind,
)
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.report.diagnosis_text import headline
from inverse_dynamics_node.robot.model import Floats
import numpy as np
from robot_files import real_robots, ROOT, STANFORD
from scipy.signal import butter, sosfiltfilt

from .robots import bare

WRONG = 0.1  # relative standard deviation of the errors of masses and inertias
DURATION, RATE = 30.0, 125.0  # [s], [Hz]
EFFORT_NOISE = 0.02  # relative to the RMS effort of each joint
POSITION_NOISE, VELOCITY_NOISE = 2e-5, 2e-3  # [rad or m], [rad/s or m/s]
STANDARD = 9.80665

LOCKED = {
    'panda': ('panda_finger',),
    'kinova': ('j2s6s200_joint_finger',),
    'z1': ('jointGripper',),
}
TIPS = {
    'Stanford': 'tool0', 'seven_dof': 'tool0', 'branched': 'right_forearm', 'panda': 'panda_hand',
    'ur5_robot': 'tool0', 'ur10_robot': 'tool0', 'ur3_robot': 'tool0', 'xarm7': 'link_eef',
    'z1': 'gripperStator', 'kinova': 'j2s6s200_end_effector',
}  # fmt: skip
ROBOTS = ('Stanford', 'seven_dof', 'panda', 'ur5_robot', 'ur10_robot', 'xarm7')
"""The robots of the table; some of them need example-robot-data."""


def robot(name: str) -> RobotModel:
    """Load one of the robots by name."""
    own = {'Stanford': STANFORD} | {path.stem: path for path in (ROOT / 'test/robots').glob('*')}
    paths = own | {path.stem: path for path in real_robots()}
    return load_urdf(bare(paths[name], locked=LOCKED.get(name, ())))


# ---- One recording with a fault ------------------------------------------------------------


@dataclass
class Case:
    """A moving simulated robot, its robot description, and one fault."""

    name: str
    rng: np.random.Generator
    model: InverseDynamics = field(init=False)
    """Dynamics of the robot description."""
    real: InverseDynamics = field(init=False)
    """Dynamics of the simulated robot, with different bodies, rotors and friction."""
    armature: Floats = field(init=False)
    expected: Fault | None = None
    """The fault that `compare` should name, with tolerances for known values."""
    change: Callable[[Recording], Recording] = lambda recording: recording
    """Distorts the recorded signals like a faulty driver."""
    delay: float = 0.0
    """Delay of the efforts [s]."""
    added: Callable[[Floats, Floats], Floats] | None = None
    """Returns external efforts for times and positions."""
    also: tuple[FaultKind, ...] = ()
    """Kinds of other statements that are true."""

    def __post_init__(self) -> None:
        described = robot(self.name)
        self.model = InverseDynamics(described)
        self.build(WRONG)

    def build(self, wrong: float) -> None:
        """Draw a real robot whose bodies differ by the relative error `wrong`, and a motion."""
        described, rng, n = self.model.robot, self.rng, len(self.names)
        self.real = InverseDynamics(other_bodies(described, rng, wrong))
        self.motion = exciting_motion(described, rng, DURATION, RATE)
        bodies = np.sqrt(np.mean(self.model.efforts(*self.motion[1:]) ** 2, axis=0))
        size = bodies + 0.02 * bodies.max()
        self.armature = 0.05 * size * rng.uniform(0.5, 1.5, n)
        self.real.set_armature(self.armature)
        damping, coulomb = (x * size * rng.uniform(0.5, 1.5, n) for x in (0.1, 0.15))
        self.real.set_friction(damping, coulomb, rng.uniform(0.02, 0.1, n), 0.02)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.model.robot.joint_names

    def joint(self) -> int:
        """Draw the index of a joint that is neither the first nor the last."""
        return int(self.rng.integers(1, len(self.names) - 1))

    def recording(self) -> Recording:
        """Simulate the motion, and return the recording with the fault."""
        rng, (times, q, qd, qdd) = self.rng, self.motion
        efforts = self.real.efforts(q, qd, qdd)
        if self.added is not None:
            efforts = efforts + self.added(times, q)
        if self.delay:
            efforts = np.stack([np.interp(times - self.delay, times, x) for x in efforts.T], 1)
        efforts += EFFORT_NOISE * np.sqrt(np.mean(efforts**2, 0)) * rng.normal(size=q.shape)
        q = q + POSITION_NOISE * rng.normal(size=q.shape)
        qd = qd + VELOCITY_NOISE * rng.normal(size=q.shape)
        return self.change(Recording(self.names, times, q, qd, efforts))

    def run(self) -> ComparisonResult:
        """Compare the recording with the robot description."""
        return diagnose_recording(self.model, self.recording())

    def common_factor(self) -> float:
        """Return the factor of the modelled weights that is closest to the real ones."""
        real, model = (each.gravity_efforts(self.motion[1]) for each in (self.real, self.model))
        return float(np.sum(real * model) / np.sum(model**2))

    # ---- Judging statements --------------------------------------------------------------

    def is_named(self, fault: Fault) -> bool:
        """Return whether a statement names the expected fault."""
        expected = self.expected
        if expected is None or fault.kind is not expected.kind:
            return False
        if expected.joints and set(fault.joints) != set(expected.joints):
            return False
        if expected.kind is FaultKind.MOUNTING:
            return abs(fault.angle - expected.angle) < math.radians(3.0) and not fault.interval
        if expected.interval is not None:
            ends = zip(fault.interval or (math.inf, math.inf), expected.interval, strict=True)
            return all(abs(found - real) < 1.5 for found, real in ends)
        return not expected.values or bool(
            np.allclose(fault.values[: len(expected.values)], expected.values, rtol=0.3)
        )

    def is_true(self, fault: Fault) -> bool:
        """Return whether a statement describes the robot, its description or the fault."""
        if self.is_named(fault):
            return True
        if self.expected is not None and self.expected.kind is FaultKind.POSITIONS:
            return False  # all other statements are computed with wrong positions
        if fault.kind is FaultKind.ROTOR_INERTIA:
            real = np.array([self.armature[self.names.index(joint)] for joint in fault.joints])
            return bool((np.abs(np.log(np.array(fault.values) / real)) < math.log(2.0)).all())
        if fault.kind is FaultKind.UNIT:
            return abs(fault.values[0] / self.common_factor() - 1.0) < 0.05
        return fault.kind is FaultKind.BODIES or fault.kind in self.also


# ---- Faults --------------------------------------------------------------------------------


def nothing(case: Case) -> None:
    """Add no fault."""


def _efforts(case: Case, change: Callable[[Floats], Floats]) -> None:
    case.change = lambda recording: recording._replace(efforts=change(recording.efforts))


def swapped_joints(case: Case) -> None:
    """Record the efforts of two joints under each other's names."""
    j = int(case.rng.integers(1, len(case.names) - 1))
    order = np.arange(len(case.names))
    order[[j - 1, j]] = j, j - 1
    case.expected = Fault(FaultKind.ORDER, (case.names[j - 1], case.names[j]))
    _efforts(case, lambda efforts: efforts[:, order])


def sign(case: Case) -> None:
    """Reverse the effort of a joint."""
    j = case.joint()
    signs = np.where(np.arange(len(case.names)) == j, -1.0, 1.0)
    case.expected = Fault(FaultKind.SIGN, (case.names[j],))
    _efforts(case, lambda efforts: signs * efforts)


def unit(case: Case) -> None:
    """Record efforts in mN m."""
    case.expected = Fault(FaultKind.UNIT, values=(1000.0,))
    _efforts(case, lambda efforts: 1000.0 * efforts)


def currents(case: Case) -> None:
    """Record the current of one motor in place of the effort."""
    j = case.joint()
    factor = np.where(np.arange(len(case.names)) == j, 0.1, 1.0)
    case.expected = Fault(FaultKind.SCALE, (case.names[j],), (0.1,))
    _efforts(case, lambda efforts: factor * efforts)


def reversed_axis(case: Case) -> None:
    """Reverse position, velocity and effort of a joint."""
    j = case.joint()
    signs = np.where(np.arange(len(case.names)) == j, -1.0, 1.0)
    case.expected = Fault(FaultKind.REVERSED_AXIS, (case.names[j],))
    case.change = lambda recording: recording._replace(
        positions=signs * recording.positions,
        velocities=signs * recording.velocities,
        efforts=signs * recording.efforts,
    )


def delay(case: Case) -> None:
    """Record efforts 20 ms late."""
    case.delay = 0.02
    case.expected = Fault(FaultKind.DELAY, values=(0.02,))


def payload(case: Case) -> None:
    """Carry a payload of 2 kg that is not in the description."""
    case.real.set_payload(TIPS[case.name], 2.0, (0.02, 0.0, 0.06))
    case.expected = Fault(FaultKind.PAYLOAD, values=(2.0,))


def missing_gravity(case: Case) -> None:
    """Record efforts without gravity."""
    case.added = lambda times, q: -case.real.gravity_efforts(q)
    case.expected = Fault(FaultKind.GRAVITY_COMPENSATED)


def degrees(case: Case) -> None:
    """Record positions and velocities in degrees."""
    case.expected = Fault(FaultKind.POSITIONS)
    case.change = lambda recording: recording._replace(
        positions=np.degrees(recording.positions), velocities=np.degrees(recording.velocities)
    )


def tilt(case: Case) -> None:
    """Tilt the base by 10 degrees."""
    angle, direction = math.radians(10.0), case.rng.uniform(0.0, 2.0 * math.pi)
    side = math.sin(angle) * np.array([math.cos(direction), math.sin(direction)])
    case.real.set_gravity(STANDARD * np.append(side, -math.cos(angle)))
    case.expected = Fault(FaultKind.MOUNTING, angle=angle)


def absent_payload(case: Case) -> None:
    """Declare a payload of 2 kg that the robot does not carry."""
    case.model.set_payload(TIPS[case.name], 2.0, (0.0, 0.0, 0.05))
    case.expected = Fault(FaultKind.PAYLOAD, values=(-2.0,))


def external_force(case: Case) -> None:
    """Push the tip with 40 N for 5 s."""
    begin = float(case.rng.uniform(6.0, 18.0))
    force = case.rng.normal(size=3)
    force *= 40.0 / np.linalg.norm(force)

    def added(times: Floats, q: Floats) -> Floats:
        course = np.sin(math.pi * np.clip((times - begin) / 5.0, 0.0, 1.0)) ** 0.5
        jacobians = case.model.jacobian(q, TIPS[case.name])[:, :3]
        return np.asarray(-course[:, None] * (force @ jacobians))

    case.added = added
    case.expected = Fault(FaultKind.EXTERNAL_FORCE, interval=(begin, begin + 5.0))


def gravity_and_offsets(case: Case) -> None:
    """Record efforts without gravity, with offsets."""
    missing_gravity(case)
    size = np.sqrt(np.mean(case.model.efforts(*case.motion[1:]) ** 2, axis=0))
    offsets = 0.1 * size * case.rng.choice([-1.0, 1.0], len(size))
    case.also = (FaultKind.OFFSET,)
    _efforts(case, lambda efforts: efforts + offsets)


def payload_on_wrong_links(case: Case) -> None:
    """Carry a payload of 2 kg on links whose masses are wrong by 20 %."""
    case.build(2.0 * WRONG)
    payload(case)


def push_at_rest(case: Case) -> None:
    """Push the tip of a resting robot with 40 N for 5 s."""
    times, q, *_ = case.motion
    still = np.tile(q[0], (len(times), 1))
    case.motion = times, still, np.zeros_like(still), np.zeros_like(still)
    external_force(case)


def low_pass(case: Case) -> None:
    """Filter the efforts at 3 Hz before they are recorded."""
    filter_ = butter(4, 3.0, fs=RATE, output='sos')
    _efforts(case, lambda efforts: sosfiltfilt(filter_, efforts, axis=0))


def common_factor(case: Case) -> None:
    """Record efforts that are all 1.3 times too large."""
    case.expected = Fault(FaultKind.UNIT, values=(1.3,))
    _efforts(case, lambda efforts: 1.3 * efforts)


FAULTS: dict[str, Callable[[Case], None]] = {
    'none': nothing,
    'swapped joints': swapped_joints,
    'sign': sign,
    'unit of all joints': unit,
    'unit of one joint': currents,
    'reversed axis': reversed_axis,
    'delay of 20 ms': delay,
    'payload of 2 kg': payload,
    'missing gravity': missing_gravity,
    'degrees': degrees,
    'base tilted by 10 degrees': tilt,
    'absent payload': absent_payload,
    'external force': external_force,
    'missing gravity, offsets': gravity_and_offsets,
    'payload on wrong links': payload_on_wrong_links,
    'push at rest': push_at_rest,
    'efforts filtered at 3 Hz': low_pass,
    'all efforts 1.3 times': common_factor,
}
HEALTHY = 'none', 'efforts filtered at 3 Hz'
"""Recordings without a fault."""


# ---- The table -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Result:
    """The statements of `compare` about one recording."""

    fault: str
    robot: str
    is_named: bool
    statements: tuple[tuple[str, bool], ...]
    """Statements, each with a flag: whether the statement is true."""


def run(fault: str, name: str, seed: int) -> Result:
    """Simulate a recording with a fault, and judge the statements of `compare` about it."""
    stream = [seed, list(FAULTS).index(fault), *name.encode()]
    case = Case(name, np.random.default_rng(stream))
    FAULTS[fault](case)
    found = case.run().faults
    is_named = any(map(case.is_named, found)) or (case.expected is None and not found)
    said = tuple((headline(each), case.is_true(each)) for each in found)
    return Result(fault, name, is_named or (fault in HEALTHY and all(x for _, x in said)), said)


def summary(results: list[Result]) -> str:
    """Summarize how many faults are named, and how many statements are false."""
    faulty = [each for each in results if each.fault not in HEALTHY]
    named = sum(each.is_named for each in faulty)
    said = [is_true for each in results for _, is_true in each.statements]
    return (
        f'{named} of {len(faulty)} faults are named ({named / max(len(faulty), 1):.0%}); '
        f'{said.count(False)} of {len(said)} statements are false '
        f'({said.count(False) / max(len(said), 1):.1%}).'
    )


def page(results: list[Result]) -> str:
    """Return the Markdown page with the table."""
    robots = list(dict.fromkeys(each.robot for each in results))
    cells = {(each.fault, each.robot): each for each in results}
    lines = [
        '# What `compare` says about known faults',
        '',
        'Generated by',
        '',
        '```sh',
        'PYTHONPATH=test python -m benchmarks.confusion',
        '```',
        '',
        'which simulates each robot with each fault, and runs the diagnosis of `compare` on',
        f'{DURATION:g} s of joint states at {RATE:g} Hz. The masses, centres of mass and inertias',
        f'of the robots differ from their descriptions by {WRONG:.0%} (standard deviation). Their',
        'joints have rotors, viscous friction, and Coulomb friction that grows with the load. The',
        f'noise of the efforts is {EFFORT_NOISE:.0%} of their RMS.',
        '',
        f'**{summary(results)}**',
        '',
        '*yes*: the fault is named, with its joints, and with its value within 30 %, its angle',
        'within 3 degrees, or its times within 1.5 s. Without a fault: nothing false is said. The',
        'number of false statements follows if there are any. It is true in all rows that several',
        'links are wrong, that joints have rotors, if these are right within a factor of two, and',
        'that all efforts are a multiple of those of the model, if this is within 5 % of the',
        'factor of the modelled weights that is closest to the real ones.',
        '',
        f'| fault | {" | ".join(robots)} |',
        f'|---{"|---" * len(robots)}|',
    ]
    for fault in dict.fromkeys(each.fault for each in results):
        row = [cells[fault, name] for name in robots]
        lines.append(f'| {fault} | {" | ".join(map(_cell, row))} |')
    false = [
        f'| {each.fault} | {each.robot} | {text} |'
        for each in results
        for text, is_true in each.statements
        if not is_true
    ]
    if false:
        lines += ['', '| fault | robot | false statement |', '|---|---|---|', *false]
    return '\n'.join([*lines, ''])


def _cell(result: Result) -> str:
    false = sum(not is_true for _, is_true in result.statements)
    return ('yes' if result.is_named else 'no') + (f', {false} false' if false else '')


def main() -> None:
    """Simulate all recordings, then print and write the page."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.confusion', description=__doc__)
    parser.add_argument('--faults', nargs='*', default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument('--robots', nargs='*', default=list(ROBOTS), choices=sorted(TIPS))
    parser.add_argument('--seeds', nargs='*', type=int, default=[1979], help='writes no page')
    parser.add_argument('--doc', type=Path, default=ROOT / 'doc', help='folder of the page')
    options = parser.parse_args()
    results = []
    for seed in options.seeds:
        for fault in options.faults:
            for name in options.robots:
                results.append(run(fault, name, seed))
                said = '; '.join(
                    text if is_true else f'FALSE: {text}'
                    for text, is_true in results[-1].statements
                )
                named = 'named' if results[-1].is_named else 'NOT  '
                print(f'{seed} {fault:26} {name:12} {named} {said}', flush=True)
    print(summary(results))
    if [options.faults, options.robots, options.seeds] == [list(FAULTS), list(ROBOTS), [1979]]:
        (options.doc / 'evidence').mkdir(exist_ok=True)
        (options.doc / 'evidence' / 'confusion.md').write_text(page(results))


if __name__ == '__main__':
    main()
