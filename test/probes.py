"""
Runs a probe of the commands on the control loop and an arm in MuJoCo, with faults and friction.

Usage: python test/probes.py [ROBOT ...] prints a table.
"""

from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise, product
import sys

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.probe import (
    FAULTS,
    largest_pushes,
    node_parameters,
    Probe,
    Verdict,
)
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.simulation.mujoco import MujocoRobot, SimulationError
from inverse_dynamics_node.simulation.trajectory import start_pose
import numpy as np
from robot_files import OUR_ROBOTS
from states import store_state

PERIOD = 0.002  # [s]; of joint states and commands
DELAY = 3  # joint states until a push that the probe requests reaches the node
PARAMETER_DELAY = 15  # the same for parameters
LONGEST = 180.0  # [s]
FRICTION = 0.0, 0.02, 0.2  # [effort limits]
OUTCOMES = 'stopped', 'undecided', 'passes'


@dataclass
class ProbedArm:
    """An arm that floats, with a fault between the node and its motors."""

    path: object
    friction: float = 0.0  # [effort limits]
    gain_error: float = 0.0
    noise: float = 1e-5  # [rad or m]; of positions; 200 times as much of velocities per second
    fault: str = ''
    seed: int = 0
    period: float = PERIOD
    start: object = None
    settings: dict = field(default_factory=dict)
    judges_scale: bool = True

    def __post_init__(self):
        self.robot = robot = load_urdf(self.path)
        dynamics = InverseDynamics(robot)
        start = start_pose(robot, dynamics) if self.start is None else np.array(self.start)
        self.hardware = MujocoRobot(robot, start, friction=False)
        self.joints = list(robot.joint_names)
        self.random = np.random.default_rng(self.seed)
        limits = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
        self.hardware._model.dof_frictionloss[self.hardware._order] = self.friction * limits
        m = len(self.joints)
        self.gains = 1.0 + self.gain_error * self.random.choice([-1.0, 1.0], m)
        self.factor, self.order = np.ones(m), np.arange(m)
        kind, _, which = self.fault.partition(' ')
        if kind == 'sign':
            self.factor[self.joints.index(which)] = -1.0
        elif kind == 'scale':
            joint, _, factor = which.partition(' ')
            self.factor[slice(None) if joint == 'all' else self.joints.index(joint)] = float(
                factor
            )
        elif kind == 'swap':
            one, other = map(self.joints.index, which.split())
            self.order[[one, other]] = other, one
        else:
            assert not kind, self.fault
        self.loop = ControlLoop(robot, settings=Settings(start_ramp=0.0, **self.settings))
        self.loop.start()
        most = largest_pushes(robot, self.joints, self.loop.limits, dynamics, start)
        options = {'judges_scale': self.judges_scale}
        self.probe = Probe(self.loop.dynamics, self.joints, most, self.period, **options)
        self.start_q = start
        self.travel = 0.0  # largest way of a joint until the motors have no effort [rad or m]

    def run(self):
        """Play the probe; return this object."""
        loop, hardware, robot = self.loop, self.hardware, self.robot
        limits = robot.effort_limits
        requests, is_held = [], None
        commands = np.zeros(len(self.joints))
        for k in range(round(LONGEST / self.period)):
            now = k * self.period
            q = hardware.positions() + self.noise * self.random.standard_normal(len(self.joints))
            qd = hardware.velocities() + 200.0 * self.noise * self.random.standard_normal(len(q))
            store_state(loop.collector, now, robot.joint_names, q, qd)
            commands = loop.step(now).efforts.copy()
            if not (loop.supervisor.limit_stop and not commands.any()):
                self.travel = max(self.travel, np.abs(hardware.positions() - self.start_q).max())
            requests.append(self.probe.step(now, q, commands, loop.supervisor.limit_stop))
            if self.probe.is_over:
                self.time = now
                break
            late = requests[max(0, len(requests) - PARAMETER_DELAY)]
            if is_held is None or (late.is_held != is_held).any():
                is_held = late.is_held
                values = node_parameters(robot, self.joints, is_held, self.period)
                values |= {'mode': Mode(values['mode'])}
                values.pop('include_friction')
                lists = {n: tuple(v) for n, v in values.items() if isinstance(v, list)}
                loop.apply(Settings(**{**values, **lists}))
            request = requests[max(0, len(requests) - DELAY)]
            zeros = np.zeros(len(self.joints))
            loop.follow(Reference(zeros, request.efforts, now, request.positions, zeros))
            applied = np.clip((self.factor * self.gains * commands)[self.order], -limits, limits)
            hardware.command(applied)
            try:
                hardware.advance(self.period)
            except SimulationError:
                self.travel = np.inf
                break
        self.found = {name: result.verdict for name, result in self.probe.results.items()}
        self.ended_at = np.abs(hardware.positions() - self.start_q).max()
        self.outcome = 'undecided'
        if self.probe.reason or any(verdict in FAULTS for verdict in self.found.values()):
            self.outcome = 'stopped'
        elif set(self.found.values()) <= {Verdict.RIGHT} and len(self.found) == len(self.joints):
            self.outcome = 'passes'
        return self


def faults(joints):
    """Return the faults of the commands of these joints, by kind."""
    return {
        'none': [''],
        'sign': [f'sign {joint}' for joint in joints],
        'order': [f'swap {one} {other}' for one, other in pairwise(joints)],
        'scale 2': [f'scale {joint} 2' for joint in joints],
        'scale 0.5': [f'scale {joint} 0.5' for joint in joints],
    }


def main(names):
    count, travel, times = Counter(), {}, {}
    for path in OUR_ROBOTS:
        if names and path.stem not in names:
            continue
        for kind, each in faults(load_urdf(path).joint_names).items():
            for friction, fault in product(FRICTION, each):
                arm = ProbedArm(path, friction, 0.03, fault=fault).run()
                key = kind, friction
                count[(*key, arm.outcome)] += 1
                travel[key] = max(travel.get(key, 0.0), arm.travel)
                times[key] = max(times.get(key, 0.0), arm.time)
                if (arm.outcome == 'passes') is bool(fault) or arm.travel > 0.05:
                    shown = {name: v.value for name, v in arm.found.items()}
                    print(
                        f'{path.stem}, friction {friction:g}, {fault or "none"}: {arm.outcome}, '
                        f'travel {arm.travel:.3f}: {shown} {arm.probe.reason}',
                        flush=True,
                    )
    print('| fault | friction | stopped | undecided | passes | travel | time [s] |')
    for kind, friction in travel:
        row = [str(count[kind, friction, outcome]) for outcome in OUTCOMES]
        key = kind, friction
        print(
            f'| {kind} | {friction:g} | {" | ".join(row)} | {travel[key]:.3f} | {times[key]:.0f} |'
        )


if __name__ == '__main__':
    main(sys.argv[1:])
