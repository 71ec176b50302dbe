"""
Compiles the functions that most tests call, and keeps the machine code for the next processes.

`make test` runs it beside the linters; otherwise each process of the tests would compile them.

"""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
import numpy as np
from robot_files import STANFORD


def main():
    robot = load_urdf(STANFORD)
    ControlLoop(robot)
    dynamics = InverseDynamics(robot)
    for shape in (6,), (64, 6):
        states = np.zeros((3, *shape))
        for function in (dynamics.efforts, dynamics.joint_wrenches, dynamics.regressor):
            function(*states)


if __name__ == '__main__':
    main()
