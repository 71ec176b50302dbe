"""A control loop, and the joint states that it receives, without a node."""

from dataclasses import replace

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.joint_states import State
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
import numpy as np
from robot_files import ROOT

PLANAR = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
PERIOD = 0.005  # [s]
Q, REST = np.array([0.4, -0.7]), np.zeros(2)  # of a planar arm


def joint_state(q, qd, time, times=None):
    """Return a state of which all joints were reported at one time, unless times are given."""
    times = np.full(len(q), time) if times is None else times
    return State(q, qd, time, times, np.ones(len(q), dtype=bool))


def store_state(collector, now, names, *values):
    """Store positions, velocities and perhaps efforts of joints, as one message brings them."""
    return collector.store(now, collector.layout(tuple(names)), *values)


def unobserved(loop):
    """Let the motion limits of a control loop find nothing, for states that are no motion."""
    observe = loop._observe

    def observe_anew(*arguments):
        loop.motion_limits.reset()
        observe(*arguments)

    loop._observe = observe_anew
    return loop


def reference(time, positions=None, velocities=None, accelerations=REST, efforts=REST):
    """Return a reference; all values but the time are per joint, or None."""
    rows = (
        None if row is None else np.array(row, dtype=np.float64)
        for row in (accelerations, efforts, positions, velocities)
    )
    accelerations, efforts, positions, velocities = rows
    return Reference(accelerations, efforts, time, positions, velocities)


class Arm:
    """
    A control loop that is stepped with joint states at given times, or of joints at given speeds.

    Unless it is observed, its motion limits find nothing, for joint states that are no motion.
    """

    def __init__(self, robot=PLANAR, joints=(), *, is_observed=True, settings=None, **changes):
        options = {name: changes.pop(name) for name in ('period', 'gravity') if name in changes}
        settings = replace(settings or Settings(start_ramp=0.0, stop_ramp=0.0), **changes)
        self.loop = ControlLoop(robot, joints, settings, **options)
        if not is_observed:
            unobserved(self.loop)
        self.names, n = robot.joint_names, len(robot.joint_names)
        self.now, self.q = 1.0, Q.copy() if n == 2 else np.zeros(n)
        self.command = None

    @property
    def phase(self):
        return self.loop.phase

    @property
    def limit_stop(self):
        return self.loop.supervisor.limit_stop

    def change(self, **settings):
        """Change some of the settings."""
        self.loop.apply(replace(self.loop.settings, **settings))

    def at(self, now, q=None, qd=None, reference=None, received=None):
        """
        Step at a time; return the efforts, or None without a command.

        The joint state arrives then, or has arrived when ``received`` says; never if it is NaN.
        """
        self.now, q = now, self.q if q is None else q
        received = now if received is None else received
        if not np.isnan(received):
            qd = np.zeros(len(q)) if qd is None else qd
            store_state(self.loop.collector, received, self.names, q, qd)
        self.loop.reference = reference
        return self._step()

    def _step(self):
        self.command = self.loop.step(self.now)
        return None if self.command is None else self.command.efforts.copy()

    def move(
        self,
        qd=REST,
        duration=PERIOD,
        period=PERIOD,
        reported=1.0,
        has_states=True,
        behind=None,
    ):
        """
        Move at constant speed; return the commands.

        ``reported`` is a factor of the reported velocities. ``behind`` is the distance of the
        reference from the arm, if there is one.
        """
        commands, qd = [], np.asarray(qd)
        for _ in range(max(1, round(duration / period))):
            self.now += period
            self.q = self.q + period * qd
            if has_states:
                store_state(self.loop.collector, self.now, self.names, self.q, reported * qd)
            if behind is not None:
                self.loop.reference = reference(self.now, self.q + behind, qd)
            commands.append(self._step())
        return np.array(commands)
