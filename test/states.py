"""Joint states and single steps of a controller, for tests without a node."""

import math
from unittest.mock import patch

from inverse_dynamics_node.control import loop
from inverse_dynamics_node.control.joint_states import State
import numpy as np


def joint_state(q, qd, time, times=None):
    """Return a state of which all joints were reported at one time, unless times are given."""
    return State(q, qd, time, np.full(len(q), time) if times is None else times)


def store_state(collector, now, names, *values):
    """Store positions, velocities and perhaps efforts of joints, as one message brings them."""
    return collector.store(now, collector.layout(tuple(names)), *values)


class Controller(loop.ControlLoop):
    """A loop with given dynamics, whose joint states and references are arguments of a step."""

    end_of_damping = ''

    def __init__(self, dynamics, joints=(), settings=None, period=0.0):
        with patch.object(loop, 'InverseDynamics', lambda robot: dynamics):
            super().__init__(dynamics.robot, joints, settings, period, dynamics.gravity)

    def step(self, now, state, reference):
        collector, self.reference = self.collector, reference
        collector.time = -math.inf
        if state is not None:
            collector.q[:], collector.qd[:], collector.times[:] = state.q, state.qd, state.times
            collector._has_velocity[:] = True if state.has_velocity is None else state.has_velocity
            collector._find_oldest()
        command = super().step(now)
        if command is not None:
            self.end_of_damping = command.end_of_damping or self.end_of_damping
        return command


class UnobservedController(Controller):
    """A controller whose motion limits find nothing, for states that are no motion."""

    def _observe(self, now, state, is_live):
        self.motion_limits.reset()
        super()._observe(now, state, is_live)


def unobserved(loop):
    """Let the motion limits of a control loop find nothing, for states that are no motion."""
    observe = loop._observe

    def observe_anew(*arguments):
        loop.motion_limits.reset()
        observe(*arguments)

    loop._observe = observe_anew
    return loop
