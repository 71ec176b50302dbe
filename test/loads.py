"""Everything that can act on a robot, drawn at random, as calls to make in any order."""

from kinematics import rotation_of_rpy
import numpy as np


def random_loads(robot, rng):
    """
    Draw calls that between them set everything, on two links each.

    Returns
    -------
    calls : list of (str, tuple)
        Name and arguments of methods of `InverseDynamics`; no call undoes another.

    """
    n = len(robot.joint_names)
    calls = [
        ('set_gravity', (rng.uniform(-9.0, 9.0, 3),)),
        ('set_base_motion', tuple(rng.uniform(-2.0, 2.0, (3, 3)))),
        ('set_friction', tuple(rng.uniform(0.2, 2.0, (3, n)))),
        ('set_armature', (rng.uniform(0.1, 1.0, n),)),
    ]
    for link in some_links(robot, rng):
        mass, com, box, rpy = random_box(rng)
        calls.append(('set_payload', (link, mass, com, box_inertia(mass, box, rpy))))
    for link in some_links(robot, rng):
        calls.append(('set_external_wrench', (link, *rng.uniform(-9.0, 9.0, (2, 3)))))
    return calls


def without_any(calls):
    """Undo calls, each by its own kind; gravity becomes what it is by default."""
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
    """Find the inertia of a solid box, turned."""
    a, b, c = np.square(box)
    R = rotation_of_rpy(rpy)
    return mass / 12.0 * R @ np.diag([b + c, c + a, a + b]) @ R.T


def everything(dynamics, q, qd, qdd):
    """Compute all there is, by name; every one of them differs from zero on a robot that moves."""
    wrenches = dynamics.joint_wrenches(q, qd, qdd)
    return {
        'efforts': dynamics.efforts(q, qd, qdd),
        'terms': np.stack(dynamics.effort_terms(q, qd, qdd)),
        'mass matrix': dynamics.mass_matrix(q),
        'forces': wrenches.force,
        'moments': wrenches.moment,
    }
