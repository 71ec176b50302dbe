"""Laws of the regressor on random trees."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.robot.rigid_body import RigidBody
from kinematics import assert_close
from loads import apply, random_loads
import numpy as np
from random_trees import robots_with_states as cases


@given(cases(), st.integers(0, 2**32 - 1))
def test_regressor_times_parameters_gives_the_efforts(case, seed):
    _, robot, (q, qd, qdd) = case
    dynamics = InverseDynamics(robot)
    apply(dynamics, random_loads(robot, np.random.default_rng(seed)))
    dynamics.set_armature(0.0)
    terms = dynamics.effort_terms(q, qd, qdd)
    efforts = dynamics.regressor(q, qd, qdd) @ dynamics.inertial_parameters()
    assert_close(efforts, terms.inertial + terms.coriolis + terms.gravity)
    assert_close(efforts + terms.friction + terms.external, dynamics.efforts(q, qd, qdd))


@given(cases(), st.integers(0, 2**32 - 1))
def test_efforts_are_linear_in_the_parameters(case, seed):
    _, robot, (q, qd, qdd) = case
    rng = np.random.default_rng(seed)
    b = len(robot.mass)
    shapes = rng.uniform(-1.0, 1.0, (b, 3, 3))
    other = replace(
        robot,
        mass=rng.uniform(0.1, 5.0, b),
        com=rng.uniform(-0.3, 0.3, (b, 3)),
        inertia=shapes @ shapes.transpose(0, 2, 1),
    )
    before, after = InverseDynamics(robot), InverseDynamics(other)
    change = after.inertial_parameters() - before.inertial_parameters()
    expected = after.efforts(q, qd, qdd) - before.efforts(q, qd, qdd)
    assert_close(before.regressor(q, qd, qdd) @ change, expected)
    # It depends on the motion only.
    assert (before.regressor(q, qd, qdd) == after.regressor(q, qd, qdd)).all()


@given(cases())
def test_a_joint_has_no_effort_for_bodies_that_it_does_not_move(case):
    _, robot, (q, qd, qdd) = case
    blocks = InverseDynamics(robot).regressor(q, qd, qdd).reshape(len(q), -1, 10)
    for body in range(1, len(robot.parent)):
        movers = set()
        k = body
        while k > 0:
            movers.add(int(robot.joint_index[k]))
            k = int(robot.parent[k])
        for joint, block in enumerate(blocks[:, body - 1]):
            assert block.any() == (joint in movers)


@given(st.integers(0, 2**32 - 1))
def test_parameters_of_a_body_are_about_the_origin(seed):
    rng = np.random.default_rng(seed)
    points, masses = rng.uniform(-1.0, 1.0, (5, 3)), rng.uniform(0.1, 2.0, 5)
    com = masses @ points / masses.sum()

    def inertia(about):
        arms = points - about
        return sum(
            m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True)
        )

    found = RigidBody(masses.sum(), com, inertia(com)).parameters()
    I = inertia(np.zeros(3))  # noqa: E741
    assert_close(found[:4], [masses.sum(), *(masses @ points)])
    assert_close(found[4:], [I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])
