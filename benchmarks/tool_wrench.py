"""
Push simulated arms at their tools, then print and write doc/evidence/tool_wrench.md.

`make bench-tool-wrench`. The arms in MuJoCo are held by the control loop of the node. The efforts
that it commands are the measured efforts.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.contact import COMPONENTS, ExternalEffortEstimator, tool_wrench
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
from inverse_dynamics_node.robot.kinematics import last_link
from inverse_dynamics_node.robot.model import Floats
import numpy as np
from robot_files import ROOT, STANFORD
from simulated_arm import SimulatedArm

ARMS = {'stanford': STANFORD, 'seven_dof': ROOT / 'test/robots/seven_dof.urdf'}
POSES = 10
PERIOD = 0.0005  # [s]; short enough for springs on light wrists
SETTLED = 1.5  # [s]


def measure(path: Path, q: Floats, wrench: Floats) -> tuple[Floats, list[str]]:
    """Return the estimated wrench, and the components that are not shown."""
    robot = load_urdf(path)
    stiffness = np.where(robot.is_prismatic_joint, 2000.0, 100.0)
    damping = 1.4 * np.sqrt(stiffness * InverseDynamics(robot).mass_matrix(q).diagonal())
    settings = Settings(
        mode=Mode.JOINT_IMPEDANCE,
        start_ramp=0.0,
        stiffness=tuple(stiffness),
        impedance_damping=tuple(damping),
    )
    arm = SimulatedArm(path, q, settings, friction=False, period=PERIOD)
    link, estimator = last_link(robot), ExternalEffortEstimator(arm.dynamics)
    arm.step()
    arm.hardware.set_external_wrench(link, wrench[:3], wrench[3:])
    for _ in range(round(SETTLED / arm.period)):
        command = arm.step()
        efforts = estimator.update(arm.time, arm.q, arm.qd, command.efforts)
    assert arm.loop.phase is Phase.HOLDING, arm.loop.supervisor.limit_stop
    found, is_shown = tool_wrench(arm.dynamics, arm.q, link, efforts)
    return found, [name for name, shown in zip(COMPONENTS, is_shown, strict=True) if not shown]


def row(pose: str, wrench: Floats, found: Floats, hidden: list[str]) -> str:
    """Return a row of the table."""
    of_force, of_moment = (
        np.linalg.norm((found - wrench)[part]) for part in (slice(3), slice(3, 6))
    )
    return f'| {pose} | {of_force:.3f} | {of_moment:.4f} | {", ".join(hidden)} |'


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(prog='make bench-tool-wrench', description=__doc__)
    parser.add_argument('--doc', type=Path, help='folder of the page; by default, only print')
    options = parser.parse_args()
    page = [HEAD]
    for name, path in ARMS.items():
        robot, random = load_urdf(path), np.random.default_rng(4)
        page += [f'\n## {name}\n', TITLE]
        lower, upper = np.maximum(robot.lower, -2.0), np.minimum(robot.upper, 2.0)
        middle, reach, shown = 0.5 * (lower + upper), 0.4 * (upper - lower), 0
        while shown < POSES:
            q = middle + reach * random.uniform(-1.0, 1.0, len(lower))
            wrench = random.uniform(-1.0, 1.0, 6) * [20.0, 20.0, 20.0, 2.0, 2.0, 2.0]
            found, hidden = measure(path, q, wrench)
            shown += not hidden
            page.append(row('random', wrench, found, hidden))
            print(page[-1], flush=True)
        stretched = np.where(robot.is_prismatic_joint, upper, 0.0)
        wrench = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])
        page.append(row('stretched', wrench, *measure(path, stretched, wrench)))
        print(page[-1], flush=True)
    if options.doc:
        (options.doc / 'tool_wrench.md').write_text('\n'.join(page) + '\n')


HEAD = """# Wrench on the tool

`make bench-tool-wrench` writes this page. Arms in MuJoCo are held by `joint_impedance`, and a
random force of up to 20 N and moment of up to 2 N m along each axis acts on their tool link. The
table compares `~/tool_wrench`, from the efforts of the commands, with them, in random poses until
ten show all components, and with all joints at zero (or extended). Where the diagnostics name
components that are not shown, the wrench is finite, but not right."""
TITLE = (
    '| pose | error of the force [N] | error of the moment [N m] | not shown |\n|---|---|---|---|'
)

if __name__ == '__main__':
    main()
