"""Loads on robots: fixed ones, and random ones as calls in any order."""

from functools import cache

from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import rotation_of_rpy
import numpy as np
from random_trees import random_chain, urdf_of


def loaded_dynamics(robot, angular_velocity=(0.0, 0.0, 0.0), angular_acceleration=(0.0, 0.0, 0.0)):
    """Return dynamics of a robot with every kind of load."""
    dynamics = InverseDynamics(robot, (0.4, -1.2, -9.5))
    link = robot.link_names[-1]
    dynamics.set_payload(link, 0.7, (0.01, -0.02, 0.1), np.diag((0.02, 0.03, 0.04)))
    dynamics.set_external_wrench(link, (3.0, -2.0, 1.0), (0.3, 0.2, -0.1))
    dynamics.set_base_motion(angular_velocity, angular_acceleration, (0.3, 0.1, -0.2))
    dynamics.set_friction(0.3, 0.8, 0.05, 0.2)
    dynamics.set_armature(0.05)
    return dynamics


@cache
def loaded_chain(*base_rotation):
    """Return shared dynamics of a chain of five joints with every kind of load."""
    robot = load_urdf(urdf_of(random_chain(np.random.default_rng(5), 5)))
    return loaded_dynamics(robot, *base_rotation)


def random_loads(robot, rng):
    """
    Draw calls that set every kind of load, payloads and wrenches on two links each.

    Returns
    -------
    calls : list of (str, tuple)
        Name and arguments of methods of `InverseDynamics`; no call undoes another.

    """
    n = len(robot.joint_names)
    calls = [
        ('set_gravity', (rng.uniform(-9.0, 9.0, 3),)),
        ('set_base_motion', tuple(rng.uniform(-2.0, 2.0, (3, 3)))),
        ('set_friction', (*rng.uniform(0.2, 2.0, (3, n)), rng.uniform(0.1, 0.5, n))),
        ('set_armature', (rng.uniform(0.1, 1.0, n),)),
    ]
    for link in some_links(robot, rng):
        mass, com, box, rpy = random_box(rng)
        calls.append(('set_payload', (link, mass, com, box_inertia(mass, box, rpy))))
    for link in some_links(robot, rng):
        calls.append(('set_external_wrench', (link, *rng.uniform(-9.0, 9.0, (2, 3)))))
    return calls


def without_any(calls):
    """Return the calls that undo others; gravity returns to its default."""
    for name, arguments in calls:
        if name == 'set_payload':
            yield name, (arguments[0], 0.0)
        elif name == 'set_external_wrench':
            yield name, arguments[:1]
        elif name == 'set_friction':
            yield name, (0.0, 0.0)
        elif name == 'set_armature':
            yield name, (0.0,)
        elif name == 'set_base_motion':
            yield name, ()
        else:
            yield name, ((0.0, 0.0, -9.80665),)


def apply(dynamics, calls):
    for name, arguments in calls:
        getattr(dynamics, name)(*arguments)
    return dynamics


def some_links(robot, rng):
    count = min(2, len(robot.link_names))
    return [str(link) for link in rng.choice(robot.link_names, count, replace=False)]


def random_box(rng):
    return (
        float(rng.uniform(0.5, 5.0)),
        rng.uniform(-0.3, 0.3, 3),
        rng.uniform(0.05, 0.6, 3),
        rng.uniform(-3.0, 3.0, 3),
    )


def box_inertia(mass, box, rpy):
    """Return the inertia of a rotated solid box."""
    a, b, c = np.square(box)
    R = rotation_of_rpy(rpy)
    return mass / 12.0 * R @ np.diag([b + c, c + a, a + b]) @ R.T


def everything(dynamics, q, qd, qdd):
    """Compute every quantity, by name; all are nonzero for a moving robot."""
    wrenches = dynamics.joint_wrenches(q, qd, qdd)
    return {
        'efforts': dynamics.efforts(q, qd, qdd),
        'terms': np.stack(dynamics.effort_terms(q, qd, qdd)),
        'mass matrix': dynamics.mass_matrix(q),
        'forces': wrenches.force,
        'moments': wrenches.moment,
    }


def samples():
    """Return every quantity of random chains with random loads, by name, as lists."""
    found = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        robot = load_urdf(urdf_of(random_chain(rng, 1 + seed)))
        dynamics = apply(InverseDynamics(robot), random_loads(robot, rng))
        for shape in (1 + seed,), (3, 1 + seed):
            values = everything(dynamics, *rng.uniform(-3.0, 3.0, (3, *shape)))
            found.append({name: array.ravel().tolist() for name, array in values.items()})
    return found
