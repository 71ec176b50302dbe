"""Simulate an arm on a tilting base whose controller assumes that the base is level."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats
from ..mujoco.hardware import MujocoRobot
from ..tilt import Tilt
from .demo_setup import DemoSetup, KD, KP

PERIOD = 0.002  # [s]


def held_without_imu(setup: DemoSetup, attitude: ArrayLike, began: float) -> tuple[Floats, Floats]:
    """
    Hold an arm by computed torque on a tilting base without an IMU.

    Parameters
    ----------
    setup : DemoSetup
        The robot, its pose and the duration.
    attitude : array_like, shape (3,)
        Final rotation vector of the base from level [rad].
    began : float
        Time at which the base begins to tilt [s].

    Returns
    -------
    times : ndarray, shape (k,)
        Times [s].
    errors : ndarray, shape (k, n)
        Position errors of the joints [rad or m].

    """
    simulated = MujocoRobot(setup.urdf, setup.robot, setup.start, friction=False)
    simulated.brakes_on = False
    dynamics = InverseDynamics(setup.robot)
    order = [simulated.state_names.index(name) for name in setup.robot.joint_names]
    tilt = Tilt()
    tilt.turn_to(attitude, began)
    times = np.arange(0.0, setup.duration, PERIOD)
    errors = np.zeros((len(times), len(setup.start)))
    for time, error in zip(times, errors, strict=True):
        q, qd = (values[order] for values in simulated.state()[:2])
        error[:] = setup.start - q
        simulated.command(dynamics.efforts(q, qd, KP * error - KD * qd))
        simulated.world.set_base_motion(*tilt.motion(float(time)))
        simulated.advance(PERIOD)
    return times, errors
