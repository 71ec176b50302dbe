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

    end_of_damping = ''

    def step(self, now, state, reference):
        self.pass_time(now)
        command = self.command(now, state, reference)
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
    observe = loop.controller._observe

    def observe_anew(*arguments):
        loop.controller.motion_limits.reset()
        observe(*arguments)

    loop.controller._observe = observe_anew
    return loop
