"""
Follow trajectories with simulated arms, then print and write doc/evidence/following.md.

`make bench-following`. The control loop of the node moves arms in MuJoCo with friction, faster
than real time. The arms have the friction of their descriptions, and the loop knows it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from inverse_dynamics_node import InverseDynamics, load_urdf, TrajectoryError
from inverse_dynamics_node.control.following import plan
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
from inverse_dynamics_node.dynamics.trajectory import Trajectory
from inverse_dynamics_node.robot.model import Floats
from inverse_dynamics_node.simulation.trajectory import plan as plan_motion
from inverse_dynamics_node.simulation.trajectory import start_pose
import numpy as np
from robot_files import real_robots, ROOT, STANFORD
from simulated_arm import SimulatedArm

PERIOD = 0.002  # [s]
MOVING = 8.0  # [s]; duration of the motion
HELD = 60.0  # [s]
# Gains [1/s^2], [1/s], and the inertia of rotors [kg m^2] that the URDF lacks beside its friction.
ARMS = {
    'stanford': (100.0, 20.0, 0.0),
    'seven_dof': (2500.0, 100.0, 0.05),
    'ur10_robot': (100.0, 20.0, 0.0),
}
LIMIT = 0.9  # fraction of the speed limits
PATHS = {
    path.stem: path for path in [*real_robots(), *(ROOT / 'test/robots').glob('*.urdf'), STANFORD]
}


class Result(NamedTuple):
    """What one run showed."""

    error: float
    """Largest tracking error [rad or m]."""
    step: float
    """Largest change of an effort from one command to the next, per effort limit."""
    own_step: float
    """The same of the model along the references alone, without friction and feedback."""
    drift: float
    """Growth of the distance from the reference while the arm is held at the end [rad or m]."""
    end: str
    """Why the trajectory has ended, the limit stop, or ''."""


class Run:
    """One arm that follows trajectories from rest."""

    def __init__(self, name: str) -> None:
        # The arm is held from the first command on; later, changes are blended in as by default.
        kp, kd, armature = ARMS[name]
        settings = Settings(mode=Mode.COMPUTED_TORQUE, start_ramp=0.0, kp=kp, kd=kd)
        robot = load_urdf(PATHS[name])
        self.start = start_pose(robot, InverseDynamics(robot))
        self.arm = SimulatedArm(PATHS[name], self.start, settings, period=PERIOD)
        self.loop, self.following = self.arm.loop, self.arm.loop.following
        self.arm.dynamics.set_friction()
        self.arm.dynamics.set_armature(armature)
        self.arm.hardware._model.dof_armature[:] = armature
        self.motion = plan_motion(robot, self.arm.dynamics, self.start, MOVING)
        self._efforts: list[Floats] = []
        self._own: list[Floats] = []
        self._errors = [0.0]
        self.advance(0.1)
        self.loop.apply(replace(settings, start_ramp=Settings().start_ramp))
        self.advance(1.0)
        self._efforts.clear()

    def trajectory(
        self, points: int, fields: int = 1, stretch: float = 1.0, part: slice = slice(None)
    ) -> Trajectory:
        """Return the motion with some points; ``fields`` 2 adds velocities, 3 accelerations."""
        times = np.linspace(0.0, MOVING, points)
        rows = list(self.motion.sample(times))
        rows = [each[:, part] / stretch**order for order, each in enumerate(rows)]
        return Trajectory(self.loop.joints[part], stretch * times, *rows[:fields])

    def follow(self, trajectory: Trajectory, time: float = 0.0) -> None:
        """Follow a trajectory that started ``time`` seconds ago."""
        limits, present = self.following.limits, self.loop.present_motion()
        self.loop.follow_trajectory(plan(trajectory, limits, present, max(time, 0.0)), time)

    def advance(self, duration: float) -> None:
        """Let time pass."""
        for _ in range(round(duration / PERIOD)):
            self._efforts.append(self.arm.step().efforts.copy())
            if self.following.is_active:
                state = self.following.state
                self._own.append(InverseDynamics.efforts(self.arm.dynamics, *state))
                self._errors.append(float(self.following.largest_error.max()))

    def suspend(self, duration: float) -> None:
        """Let the arm move on under the last command, as if the node had been stopped."""
        self.arm.hardware.advance(duration)
        self.arm.time += duration

    def lose(self, duration: float) -> None:
        """Let time pass without joint states."""
        measure, self.arm.measure = self.arm.measure, lambda qd: None
        self.advance(duration)
        self.arm.measure = measure

    def finish(self, duration: float) -> Result:
        """Follow until the end, and hold; return what was seen."""
        for _ in range(100):
            if not self.following.time_left:
                break
            self.advance(0.2)
        self.advance(1.0)
        before, grown = self.following.error, 0.0
        for _ in range(round(duration)):
            self.advance(1.0)
            grown = max(grown, float((self.following.error - before).max()))
        limits = self.loop.robot.effort_limits
        step, own = (
            float((np.abs(np.diff(each, axis=0)) / limits).max(initial=0.0))
            for each in (self._efforts, self._own)
        )
        end = self.loop.supervisor.limit_stop or self.following.reason
        return Result(max(self._errors), step, own, grown, end)


def _replace(run: Run) -> None:
    run.follow(run.trajectory(50, 2))
    run.advance(3.1)
    run.follow(run.trajectory(9)._replace(times=np.linspace(1.0, 9.0, 9)))


def _empty(run: Run) -> None:
    run.follow(run.trajectory(50, 3))
    run.advance(3.1)
    run.following.hold(run.following.state, 'an empty trajectory has arrived')


def _late(run: Run) -> None:
    run.follow(run.trajectory(50, 3), 0.05)


def _future(run: Run) -> None:
    run.follow(run.trajectory(50, 3), -1.0)


def _partial(run: Run) -> None:
    run.follow(run.trajectory(50, 2, part=slice(1, 3)))


def _fast(run: Run) -> None:
    speeds = np.abs(run.motion.sample(np.linspace(0.0, MOVING, 4000))[1]).max(axis=0)
    ratio = float((speeds / run.loop.robot.velocity_limits).max())
    run.follow(run.trajectory(400, 3, stretch=ratio / LIMIT))


def _held(run: Run) -> None:
    run.arm.dynamics.set_friction(0.0, 0.0)
    run.follow(run.trajectory(30))


def _suspended(duration: float) -> Callable[[Run], None]:
    def scenario(run: Run) -> None:
        run.follow(run.trajectory(400, 3))
        run.advance(3.1)
        run.suspend(duration)

    return scenario


def _lost(duration: float, policy: StalePolicy = StalePolicy.ZERO) -> Callable[[Run], None]:
    def scenario(run: Run) -> None:
        run.loop.apply(replace(run.loop.settings, on_stale_state=policy))
        run.follow(run.trajectory(400, 3))
        run.advance(3.1)
        run.lose(duration)

    return scenario


def _simple(points: int, fields: int) -> Callable[[Run], None]:
    return lambda run: run.follow(run.trajectory(points, fields))


LONG = f'held for {HELD:g} s, friction not compensated'
SCENARIOS: dict[str, Callable[[Run], None]] = {
    '3 points, positions': _simple(3, 1),
    '30 points, positions': _simple(30, 1),
    '30 points, velocities': _simple(30, 2),
    '30 points, accelerations': _simple(30, 3),
    '10 000 points, positions': _simple(10_000, 1),
    '10 000 points, accelerations': _simple(10_000, 3),
    'replaced in motion': _replace,
    'emptied in motion': _empty,
    'joined 0.05 s after its start': _late,
    'starts in 1 s': _future,
    'two of the joints': _partial,
    f'at {LIMIT:.0%} of the speed limit': _fast,
    'node suspended for 0.1 s': _suspended(0.1),
    'node suspended for 0.3 s': _suspended(0.3),
    'joint states lost for 0.09 s': _lost(0.09),
    'joint states lost for 0.15 s': _lost(0.15),
    'joint states lost for 0.15 s, on_stale_state: hold': _lost(0.15, StalePolicy.HOLD),
    'joint states lost for 1 s': _lost(1.0),
    LONG: _held,
}


def main() -> None:
    """Run the scenarios, and write the page."""
    parser = argparse.ArgumentParser(prog='make bench-following', description=__doc__)
    parser.add_argument('--doc', type=Path, help='folder of the page; by default, only print')
    parser.add_argument('scenarios', nargs='*', metavar='SCENARIO', help='parts of names')
    options = parser.parse_args()
    chosen = {
        name: scenario
        for name, scenario in SCENARIOS.items()
        if not options.scenarios or any(part in name for part in options.scenarios)
    }
    page = [HEAD]
    for arm in ARMS:
        kp, kd, _ = ARMS[arm]
        page.append(f'\n## {arm}, with kp {kp:g} and kd {kd:g}\n\n{TITLE}')
        for name, scenario in chosen.items():
            run = Run(arm)
            try:
                scenario(run)
            except TrajectoryError as error:
                page.append(f'| {name} | refused: {error} | | | |')
            else:
                found = run.finish(HELD if name == LONG else 2.0)
                page.append(
                    f'| {name} | {1e3 * found.error:.2f} | {found.step:.2%} '
                    f'| {found.own_step:.2%} | {1e3 * found.drift:.4f} | {found.end} |'
                )
            print(arm, page[-1], flush=True)
    if options.doc:
        (options.doc / 'following.md').write_text('\n'.join(page) + '\n')


HEAD = f"""# Following trajectories

`make bench-following` writes this page. The control loop of the node moves arms in MuJoCo at
500 Hz in `computed_torque`. The friction of the arms is that of their descriptions, and the node
compensates it (`include_friction`). Each trajectory is that of `simulate`, {MOVING:g} s long, with
all joints in motion. seven_dof has rotors of 0.05 kg m² (`armature`), because a gear with its
friction has them. No run ended in a limit stop, unless the last column says so.

- **Error**: largest distance between the arm and its reference.
- **Step**: largest change of an effort from one command to the next, per effort limit of the
  joint. The next column has the same for the model along the references alone.
- **Drift**: by how much the distance grows from 1 s after the end on: in {HELD:g} s in the last
  row, in 2 s in the others. An arm with friction creeps towards its reference.
- **Pauses**: while no joint states arrive, and while the node is suspended, the efforts stay as
  they were; after `state_timeout` (0.1 s) they fall, and after a pause of more than 0.1 s they are
  blended in over `start_ramp`. stanford and ur10_robot have no friction at all: they fall like a
  pendulum, and a wrist that was in motion goes on."""
TITLE = (
    '| trajectory | error [mrad, mm] | step | step of the model | drift [mrad, mm] | ended |\n'
    '|---|---|---|---|---|---|'
)

if __name__ == '__main__':
    main()
