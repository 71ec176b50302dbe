"""The passes compute what `equations.recursion`, the statement of the paper, computes."""

from types import FunctionType

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.dynamics import equations, newton_euler, robot_table
from inverse_dynamics_node.dynamics.equations import Link
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import random_chain, urdf_of
from robot_files import OUR_ROBOTS

GRAVITY = (0.4, -1.2, -9.5)
CHAINS = [urdf_of(random_chain(np.random.default_rng(seed), 3 + 3 * seed)) for seed in range(5)]


def plain_python(*modules):
    """Return the functions of the modules as plain Python; they call each other."""
    names = {}
    for module in modules:
        names |= vars(module)
    for name, found in list(names.items()):
        function = getattr(found, 'py_func', found)
        if isinstance(function, FunctionType):
            names[name] = FunctionType(function.__code__, names)
    return names


PLAIN = plain_python(robot_table, equations, newton_euler)


def link_of(row):
    (parent, _, _, slides), (R, p) = PLAIN['joint_of'](row), PLAIN['frame_of'](row)
    mass, com, J = PLAIN['body_of'](row)
    return Link(R, p, com, mass, J, parent - 1, bool(slides))


def statement(rows, q, qd, qdd):
    """Return the efforts of the recursion, with those of mimic joints added to their masters'."""
    rows = rows[1:]
    joints = [(int(row[robot_table.JOINT]), row[robot_table.MULTIPLIER]) for row in rows]
    offsets = [row[robot_table.POSITION_OFFSET] for row in rows]
    positions = [m * q[j] + offset for (j, m), offset in zip(joints, offsets, strict=True)]
    rates, rates_dot = ([m * values[j] for j, m in joints] for values in (qd, qdd))
    links = [link_of(row) for row in rows]
    efforts = PLAIN['recursion'](links, positions, rates, rates_dot, GRAVITY)
    tau = [0.0] * len(q)
    for (j, m), effort in zip(reversed(joints), reversed(efforts), strict=True):
        tau[j] += m * effort
    return tau


@pytest.mark.parametrize('urdf', [*OUR_ROBOTS, *CHAINS])
def test_the_passes_agree_with_the_recursion(urdf, rng):
    dynamics = InverseDynamics(load_urdf(urdf), GRAVITY)
    n = len(dynamics.robot.joint_names)
    states = rng.uniform(-2.0, 2.0, (20, 3, n))
    rows, expected = dynamics.table.tolist(), []
    for q, qd, qdd in states.tolist():
        expected.append(statement(rows, q, qd, qdd))
        tau = [0.0] * n
        assert PLAIN['inverse_dynamics'](q, qd, qdd, tau, rows) == newton_euler.OK
        assert tau == expected[-1]  # to the last bit
    largest = np.abs(expected).max()
    assert largest > 0.0
    # Compiled code fuses a product and a sum into one operation, which rounds once.
    efforts = [dynamics.efforts(*state) for state in states]
    assert_allclose(efforts, expected, rtol=0, atol=4e-15 * largest)
