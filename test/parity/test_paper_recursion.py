"""
The recursion of Luh, Walker and Paul (1979) as printed, compared with the core.

The core works in URDF frames, each on the axis of its own joint. This test shares nothing with it:
Denavit-Hartenberg frames, where the axis of joint i+1 is z of link i, and a table of the arm typed
from the literature (config/stanford.urdf names the sources), not read from the URDF. Agreement
verifies the core's departures from the paper, and config/stanford.urdf: a wrong number changes the
efforts or, if no effort depends on it, the comparison of masses.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest

# Relative to the largest effort of the joint over the states. Both sides add hundreds of products,
# which leaves 1e-14; a relative error of 1e-4 in a number of the URDF causes 5e-8 or more.
TOLERANCE = 1e-10

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
# Tilts the column to its side, so that gravity loads joint 1, too.
TILTED_GRAVITY = (3.0, -4.0, -8.0)

Z0 = np.array([0.0, 0.0, 1.0])
QUARTER = np.pi / 2


class Link(NamedTuple):
    """Link i in the literature's terms; the joint variable is theta, or d of a prismatic joint."""

    theta: float  # [rad], constant for a prismatic joint
    d: float  # m
    alpha: float  # rad; the arm has a = 0 everywhere
    slides: bool
    mass: float  # kg
    com_cm: tuple[float, float, float]  # in frame i, in centimetres as first published
    inertia_about_origin: tuple[float, float, float]  # diagonal, axes of frame i, kg m^2


STANFORD = (
    Link(0, 0.412, -QUARTER, False, 9.29, (0, 1.75, -11.05), (0.276, 0.255, 0.071)),
    Link(0, 0.154, QUARTER, False, 5.01, (0, -10.54, 0), (0.108, 0.018, 0.100)),
    Link(-QUARTER, 0, 0, True, 4.25, (0, 0, -64.47), (2.51, 2.51, 0.006)),
    Link(0, 0, -QUARTER, False, 1.08, (0, 0.92, -0.54), (0.002, 0.001, 0.001)),
    Link(0, 0, QUARTER, False, 0.63, (0, 0, 5.66), (0.003, 0.003, 0.0004)),
    Link(0, 0, 0, False, 0.51, (0, 0, 15.54), (0.013, 0.013, 0.0003)),
)


def centre_of_mass(link):
    return np.array(link.com_cm) / 100


def inertia_about_com(link):
    s = centre_of_mass(link)
    return np.diag(link.inertia_about_origin) - link.mass * (s @ s * np.eye(3) - np.outer(s, s))


def joint_transform(link, q):
    """Return A, coordinates i to i-1, and p*, from origin i-1 to origin i in frame i."""
    theta, d = (link.theta, q) if link.slides else (link.theta + q, link.d)
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(link.alpha), np.sin(link.alpha)
    rotation = np.array([[ct, -st * ca, st * sa], [st, ct * ca, -ct * sa], [0, sa, ca]])
    return rotation, np.array([0, d * sa, d * ca])


def paper_efforts(q, qd, qdd, gravity):
    """Run (36)-(47); every vector of link i is in frame i."""
    count = len(STANFORD)
    transforms = [joint_transform(link, q[i]) for i, link in enumerate(STANFORD)]
    omega, omega_dot = np.zeros(3), np.zeros(3)  # LWP (31)
    accel = -np.asarray(gravity)  # LWP (31)
    net_force, net_moment = [], []
    for i, link in enumerate(STANFORD):
        A, p = transforms[i]
        up = A.T  # coordinates i-1 to i
        s, J = centre_of_mass(link), inertia_about_com(link)
        turned = up @ omega
        if link.slides:
            omega = turned  # LWP (36)
            omega_dot = up @ omega_dot  # LWP (37)
            accel = (  # LWP (40)
                up @ (Z0 * qdd[i] + accel)
                + np.cross(omega_dot, p)
                + 2 * np.cross(omega, up @ Z0 * qd[i])
                + np.cross(omega, np.cross(omega, p))
            )
        else:
            omega_dot = up @ (omega_dot + Z0 * qdd[i] + np.cross(omega, Z0 * qd[i]))  # LWP (37)
            omega = up @ (omega + Z0 * qd[i])  # LWP (36)
            accel = (  # LWP (40)
                np.cross(omega_dot, p) + np.cross(omega, np.cross(omega, p)) + up @ accel
            )
        accel_com = np.cross(omega_dot, s) + np.cross(omega, np.cross(omega, s)) + accel  # (44)
        net_force.append(link.mass * accel_com)  # LWP (41)
        net_moment.append(J @ omega_dot + np.cross(omega, J @ omega))  # LWP (42)

    tau = np.zeros(count)
    force, moment = np.zeros(3), np.zeros(3)  # a free hand
    down = np.eye(3)  # coordinates i+1 to i
    for i in reversed(range(count)):
        A, p = transforms[i]
        s = centre_of_mass(STANFORD[i])
        moment = (  # LWP (46); the force in it is still that of link i+1
            down @ (moment + np.cross(down.T @ p, force))
            + np.cross(p + s, net_force[i])
            + net_moment[i]
        )
        force = down @ force + net_force[i]  # LWP (45)
        tau[i] = (force if STANFORD[i].slides else moment) @ (A.T @ Z0)  # LWP (47)
        down = A
    return tau


@pytest.fixture(scope='module')
def robot():
    return load_urdf(Path(__file__).resolve().parents[2] / 'config' / 'stanford.urdf')


def random_states(robot, count=200):
    rng = np.random.default_rng(1979)
    q = rng.uniform(robot.lower, robot.upper, (count, 6))
    qd = rng.uniform(-robot.velocity_limits, robot.velocity_limits, (count, 6))
    qdd = rng.uniform(-10, 10, (count, 6))
    return q, qd, qdd


@pytest.mark.parametrize('gravity', [STANDARD_GRAVITY, TILTED_GRAVITY])
def test_the_core_agrees_with_the_paper_at_random_states(robot, gravity):
    q, qd, qdd = random_states(robot)
    expected = np.array([paper_efforts(*state, gravity) for state in zip(q, qd, qdd, strict=True)])
    largest = np.abs(expected).max(axis=0)
    # Joint 6 turns only the 3e-4 kg m^2 of the hand about its own axis.
    assert (largest > 3e-3).all(), f'a joint without effort compares nothing: {largest}'

    efforts = InverseDynamics(robot, gravity=gravity).efforts(q, qd, qdd)
    np.testing.assert_allclose(efforts / largest, expected / largest, rtol=0, atol=TOLERANCE)


def test_every_mass_is_where_the_table_puts_it(robot):
    # Zero posture, in the base frame: L is the URDF's body, A the paper's frame of the same link.
    R_BL, p_BL, R_BA, p_BA = np.eye(3), np.zeros(3), np.eye(3), np.zeros(3)
    for body, link in enumerate(STANFORD, start=1):
        p_BL = p_BL + R_BL @ robot.p_PL[body]
        R_BL = R_BL @ robot.R_PL[body]
        A, p = joint_transform(link, 0.0)
        R_BA = R_BA @ A
        p_BA = p_BA + R_BA @ p
        for found, expected in (
            (robot.mass[body], link.mass),
            (p_BL + R_BL @ robot.com[body], p_BA + R_BA @ centre_of_mass(link)),
            (R_BL @ robot.inertia[body] @ R_BL.T, R_BA @ inertia_about_com(link) @ R_BA.T),
        ):
            np.testing.assert_allclose(
                found, expected, rtol=0, atol=TOLERANCE, err_msg=f'link {body}'
            )
