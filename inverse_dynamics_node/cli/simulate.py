"""The command `simulate`: runs a simulated robot to try out the node."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..simulation.drivers import DRIVERS, IDEAL
from .arguments import new_parser

EPILOG = """\
The robot publishes joint_states with efforts. At first, a position controller holds the robot.
When commands have arrived for 1.5 s and their efforts are steady, the robot follows the commands,
like an arm with a forward_command_controller. When the commands stop, the position controller
takes over after 0.5 s.

Two topics change the robot without informing the node: ~/payload (geometry_msgs/InertiaStamped)
attaches a load to a link, and ~/push (geometry_msgs/WrenchStamped) pushes the robot. The prefix ~
stands for /simulated_robot. While the parameter dry_run of the node is true, no commands arrive,
and the position controller holds the robot.

The option --driver makes commands, efforts and topics follow the conventions of a driver. If the
real driver needs a program that forwards commands, the simulated robot takes the commands directly
from the node. doc/robots.md describes the drivers, and config/robots has a parameter file for each
driver.

The robot takes the arguments of ROS. With the parameter joints, the robot takes commands for some
joints only, in the given order; the others hold their positions.

examples:
  inverse_dynamics simulate my_arm.urdf
  inverse_dynamics simulate my_arm.urdf --driver franka_ros2
  inverse_dynamics simulate my_arm.urdf --sway
  inverse_dynamics simulate my_arm.urdf --ros-args -p joints:='[joint_1, joint_2]'
  inverse_dynamics simulate my_arm.urdf --ros-args -r __ns:=/left -r commands:=my_commands

The robot runs until Ctrl-C, in the ROS domain of ROS_DOMAIN_ID. Messages stay on this machine
unless ROS_AUTOMATIC_DISCOVERY_RANGE is set.

exit code: 0 stopped; 1 the robot could not run; 2 invalid arguments."""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = new_parser('simulate', 'Simulate a robot that has the topics of a real one.', EPILOG)
    parser.add_argument('urdf', type=Path, help='the robot description')
    parser.add_argument(
        '--driver',
        metavar='NAME',
        choices=DRIVERS,
        help=f'driver to imitate: {", ".join(DRIVERS)}',
    )
    parser.add_argument(
        '--sway',
        action='store_true',
        help='let the position controller move all joints back and forth until commands arrive',
    )
    parser.add_argument(
        '--rate',
        type=float,
        metavar='HZ',
        help='rate of joint states (default: the usual rate of --driver, otherwise '
        f'{IDEAL.rate:g})',
    )
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the robot until SIGINT or SIGTERM; return the exit code."""
    # Imported here, because few commands need ROS.
    from ..ros.middleware import stay_on_this_machine
    from ..simulation.robot import simulate

    stay_on_this_machine()
    driver = DRIVERS[options.driver] if options.driver else IDEAL
    # ROS applies the first remapping that fits, so those of the user come first.
    arguments = [*options.ros_arguments, '--ros-args', '-r', f'commands:={driver.commands}']
    arguments += ['-r', f'joint_states:={driver.joint_states}']
    rate = options.rate or driver.rate
    return simulate(options.urdf, driver, rate, arguments, sways=options.sway)
