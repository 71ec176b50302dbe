"""Conversion of joint positions to pinocchio's order and form."""

import numpy as np


def write_positions(positions, robot, joints, bodies, q):
    """Convert joint positions q of a robot to pinocchio's, including those of mimic joints."""
    for joint, body in zip(joints, bodies, strict=True):
        x = robot.multiplier[body] * q[robot.joint_index[body]] + robot.offset[body]
        # Pinocchio stores the cosine and sine of a continuous joint.
        positions[joint.idx_q : joint.idx_q + joint.nq] = (
            (np.cos(x), np.sin(x)) if joint.nq == 2 else x
        )
    return positions
