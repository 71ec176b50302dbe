"""Joint states and single steps of a controller, for tests without a node."""

from inverse_dynamics_node.control import loop
from inverse_dynamics_node.control.joint_states import State
import numpy as np


def joint_state(q, qd, time, times=None):
    """Return a state of which all joints were reported at one time, unless times are given."""
    return State(q, qd, time, np.full(len(q), time) if times is None else times)


def store_state(collector, now, names, *values):
    """Store positions, velocities and perhaps efforts of joints, as one message brings them."""
    return collector.store(now, collector.layout(tuple(names)), *values)


class Controller(loop.Controller):
    """A controller with the time and the command of a step in one call."""

    def step(self, now, state, reference):
        self.pass_time(now)
        return self.command(now, state, reference)


class UnobservedController(Controller):
    """A controller whose motion limits find nothing, for states that are no motion."""

    def _observe(self, now, state, is_live):
        pass


def unobserved(loop):
    """Let the motion limits of a control loop find nothing, for states that are no motion."""
    loop.controller._observe = lambda *arguments: None
    return loop
