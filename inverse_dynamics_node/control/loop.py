"""The control loop of one robot, from joint states to commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics, STANDARD_GRAVITY
from ..errors import TrajectoryError
from ..robot.kinematics import last_link
from ..robot.model import Booleans, Floats, RobotModel
from .contact import COMPONENTS, ContactDetector, ExternalEffortEstimator, tool_wrench
from .external_loads import ExternalLoads
from .following import Following, JointLimits, LONGEST_GAP, Plan
from .joint_states import Events, JointStateCollector, State
from .laws import HandGuiding, joint_index, Law, LAWS, Reference
from .motion_limits import Finding, LIMIT_RAMP, MotionLimits
from .settings import ContactPolicy, MeasuredGravity, Settings, StalePolicy
from .shaping import CommandShaper, DriveReference, DryRun
from .stop_damping import StopDamping
from .supervisor import COMPUTING_PHASES, Phase, Supervisor

# Settings that decide which inputs are used, or how; other settings act on the result.
_OF_INPUTS = (
    'mode',
    'state_timeout',
    'reference_timeout',
    'max_tracking_error',
    'velocity_filter_cutoff',
    'velocity_limits',
    'guiding_speed',
    'limit_margin',
    'limit_stiffness',
)
_STATES_LOST = 'joint states were lost'
_USUAL_DELAY = 0.01  # [s]; of joint states; a shorter delay is not compared with the gains


class Command(NamedTuple):
    """The computed efforts of one step, and the efforts to send."""

    efforts: Floats
    """Computed efforts, always finite, shape (m,) [N m or N]; valid until the next step."""
    is_saturated: Booleans
    """Whether each effort was cut to its limit, shape (m,)."""
    is_slowed: Booleans
    """Whether a rate limit slowed the change of each effort, shape (m,)."""
    sent: Floats | None = None
    """Efforts to send to the robot [N m or N]; None while a dry run sends nothing."""
    end_of_damping: str = ''
    """Why the stop damping has ended in this step; '' if it has not."""
    lost_velocities: tuple[str, ...] = ()
    """Joints whose velocities are no longer reported since the last step."""


class ControlLoop:
    """
    Computes one command per step; equal sequences of inputs produce equal commands.

    The dynamics include all n joints of the robot. Uncommanded joints are assumed to have zero
    acceleration. ``joints`` lists the m joints to command, in the order of the commands. An empty
    list means all joints. ``period`` is the time between steps [s]; 0 if each joint state triggers
    a step. ``gravity`` is the free-fall acceleration in the frame of the base link [m/s^2]; see
    `ExternalLoads`. ``locked`` contains the positions of locked joints; see
    `JointStateCollector`. Locked joints cannot be commanded. If ``has_imu`` is true, there are no
    commands before the first message about the motion of the base. A ConfigurationError is raised
    if an argument does not fit the robot.

    """

    def __init__(
        self,
        robot: RobotModel,
        joints: Sequence[str] = (),
        settings: Settings | None = None,
        period: float = 0.0,
        gravity: ArrayLike = STANDARD_GRAVITY,
        base_link: str = '',
        locked: Mapping[str, float] | None = None,
        has_imu: bool = False,
    ) -> None:
        self.robot, self.dynamics = robot, InverseDynamics(robot)
        self.description = ''
        """The URDF as XML text, if known."""
        self.is_outdated = False
        """Whether another robot description has arrived that the loop does not use."""
        self.joints = tuple(joints) or robot.joint_names
        self.index = index = joint_index(self.joints, robot)
        # The inputs
        self.collector = JointStateCollector(robot.joint_names, locked, self.joints)
        self.base_link, self.has_imu = base_link or robot.body_names[0], has_imu
        self.loads = ExternalLoads(self.dynamics, settings, gravity, base_link)
        self.reference: Reference | None = None
        # The way from the inputs to the command
        units = ['m' if robot.is_prismatic_joint[i] else 'rad' for i in index]
        self.supervisor = Supervisor(self.joints, units)
        self.law = Law(self.dynamics, index)
        """The law of the present mode."""
        self.motion_limits = MotionLimits(self.dynamics, index)
        ranges = robot.lower[index], robot.upper[index], np.zeros(len(index))
        is_continuous = robot.is_continuous[index]
        self.following = Following(JointLimits(self.joints, tuple(units), is_continuous, *ranges))
        """Leads along trajectories; its references replace others."""
        self.endings = 0
        """How often something has ended a reference, or an arm has been stopped or enabled."""
        self._led_at = -math.inf  # time of the joint state of the last reference [s]
        # Efforts that the law added in the last command, without and with the motion limits.
        self._last_added: tuple[Floats | float, Floats | float] = 0.0, 0.0
        self.motion_problem = '', -math.inf
        """What the motion limits have found without stopping the arm, and when [s]."""
        self.stop_damping = StopDamping(self.dynamics, index)
        self.shaper = CommandShaper(index, period)
        self.dry_run = DryRun()
        """Selects the efforts to send, also while no dry run is active."""
        flags = self.shaper.is_saturated, self.shaper.is_slowed
        self._result = Command(self.shaper.command, *flags, sent=self.shaper.command)
        # Further outputs
        self.drive = DriveReference()
        self.external_effort_estimator = ExternalEffortEstimator(self.dynamics)
        self._contact = ContactDetector(len(index))
        self.measured_gravity = MeasuredGravity.AS_COMMANDED
        self.tool_link = last_link(robot)
        """Link whose wrench `tool_wrench` estimates."""
        self.hidden_components: list[str] = []
        """Components of the last tool wrench that the efforts do not show."""
        self.settings = settings or Settings()
        self.apply(self.settings)

    def apply(self, settings: Settings) -> None:
        """
        Change the settings; the next step continues from the last command.

        Also call this method after changes of the dynamics, for example of friction. All changes
        are blended in over the start ramp, so that the efforts do not jump. If a setting has the
        wrong number of values, a ConfigurationError is raised and nothing changes.

        """
        of_joint, robot = settings.expanded(len(self.joints)), self.robot
        has_same_inputs = all(
            getattr(settings, name) == getattr(self.settings, name) for name in _OF_INPUTS
        )
        limits = of_joint['effort_limits']
        if settings.use_urdf_effort_limits:
            limits = np.minimum(limits, robot.effort_limits[self.index])
        self.settings, self.of_joint, self.limits = settings, of_joint, limits
        self.loads.settings = settings
        # Less than the state timeout, so that messages without velocities do not stop the arm.
        self.collector.velocity_timeout = 0.5 * settings.state_timeout
        self.has_contact_limits = bool(np.isfinite(of_joint['contact_limits']).any())
        """Whether contacts are looked for, which needs measured efforts."""
        self._choose_law()
        self.motion_limits.apply(settings, of_joint)
        speeds = self.motion_limits.speeds
        self.following.limits = self.following.limits._replace(speeds=speeds)
        self.shaper.configure(
            of_joint['effort_scale'],
            limits,
            of_joint['effort_rate_limits'],
            settings.start_ramp,
            settings.stop_ramp,
        )
        if has_same_inputs:
            self.blend_model()
        else:
            self.blend()

    def _choose_law(self) -> None:
        """Use the law of the mode; after a contact, one that floats."""
        kind = HandGuiding if self.supervisor.contact else LAWS[self.settings.mode]
        if type(self.law) is not kind:
            self.law = kind(self.dynamics, self.index)
        self.law.apply(self.settings, self.of_joint)
        self.supervisor.apply(self.settings, self.law)

    def blend(self) -> None:
        """
        Fade from the last command to the computed efforts over the start ramp.

        Call this method when the computed efforts change without motion.

        """
        self.shaper.begin()

    def blend_model(self) -> None:
        """
        Fade out the effect of a change of the dynamics, such as a new payload.

        Unlike after `blend`, the next command already follows new joint states and references.

        """
        tau, (without, with_limits) = self.law.last_efforts(), self._last_added
        with np.errstate(all='ignore'):
            added = self.law.added + (with_limits - without)
        self.shaper.begin(tau, added)

    @property
    def phase(self) -> Phase:
        """Phase of the last command."""
        return self.supervisor.phase

    @property
    def has_effort(self) -> bool:
        """Whether the last command contains a nonzero effort, or stop damping is active."""
        return bool(self.shaper.command.any()) or self.stop_damping.is_active

    def stop(self) -> None:
        """Drop the reference, ramp the efforts to zero, and keep them at zero until `resume`."""
        self._drop_reference('the node was disabled')
        if not self.supervisor.is_stopping and self.phase in COMPUTING_PHASES:
            self.stop_damping.begin(self.settings, self.of_joint['effort_scale'], self.limits)
        self.supervisor.stop()

    def follow(self, reference: Reference) -> None:
        """Follow a reference from the next step on, and no trajectory."""
        self._drop_reference('another reference has arrived')
        self.reference = reference

    def follow_trajectory(self, plan: Plan, time: float) -> None:
        """
        Follow a trajectory, and then hold its last position.

        ``time`` is the time since the start of the trajectory [s]; see `Following.start`. A
        TrajectoryError is raised if no trajectory can begin.

        """
        if self.phase not in COMPUTING_PHASES or self.supervisor.contact:
            raise TrajectoryError(f'no trajectory can begin: {self.phase.value}')
        if not self.law.uses_reference:
            mode = self.settings.mode.value
            raise TrajectoryError(f'the mode is {mode}, in which no trajectory is followed')
        farthest = self.settings.max_tracking_error or math.inf
        self.following.start(plan, time, self.present_motion(), farthest)
        self._led_at = self.collector.time
        last = self.law.followed
        if last is not None and (last.efforts.any() or last.positions is None):
            self.blend()  # efforts and feedback of the last reference end

    def present_motion(self) -> Floats:
        """
        Return the motion from which a trajectory begins, shape (3, m).

        It is the present reference, or the motion of an arm that follows no positions. The rows
        contain positions [rad or m], velocities and accelerations.

        """
        reference, following, law = self.reference, self.following, self.law
        q, qd, qdd = self._measured_motion()
        leads = law.is_closed or self.drive.is_leading  # whether positions act on the arm
        is_running = self.phase is Phase.RUNNING and reference is not None
        if is_running and following.is_active and leads:
            return following.state
        if law.holds and law.equilibrium is not None:
            q, qd = law.equilibrium, 0.0 * q
        if is_running and reference is not None:
            qdd = reference.accelerations
            if leads and reference.positions is not None:
                q, qd = reference.positions, 0.0 * q
            if leads and reference.velocities is not None:
                qd = reference.velocities
        return np.array([q, qd, qdd])

    def _measured_motion(self) -> Floats:
        q, qd = self.collector.q[self.index], self.collector.qd[self.index]
        return np.array([q, qd, 0.0 * q])

    def _drop_reference(self, reason: str) -> None:
        self.following.end(reason)
        self.reference = None
        self.endings += 1

    def resume(self) -> None:
        """End a stop, or what follows a contact; the efforts continue from the last command."""
        self.endings += 1
        self._contact = ContactDetector(len(self.index))
        if self.supervisor.limit_stop:
            self.motion_limits.reset()
        if self.supervisor.resume():
            self._choose_law()
            self.blend()  # even after a brief stop, because the reference may have been dropped

    def start(self, *, is_dry_run: bool = False) -> None:
        """Start with zero efforts and without a reference; wait for a fresh joint state."""
        self.dry_run = DryRun(is_active=is_dry_run)
        self.supervisor.resume()
        self._choose_law()
        self._restart()

    def _restart(self) -> None:
        """Begin anew with zero efforts; a stop, and what follows a contact, go on."""
        self._drop_reference('the node was started anew')
        self._last_added = 0.0, 0.0
        self.motion_problem = '', -math.inf
        self.supervisor.phase = Phase.WAITING
        self.stop_damping.end()
        self.law.reset()
        self.shaper.reset()
        self.motion_limits.reset()
        self.drive.reset()

    def limit_stop(self, reason: str) -> None:
        """Let the efforts fall to zero at once, and keep them at zero until `resume`."""
        self.endings += 1
        self.stop_damping.end(reason if self.stop_damping.is_active else '')
        self.supervisor.stop_at_limit(reason)

    @property
    def has_to_stop(self) -> bool:
        """Whether the robot last received a nonzero effort, or stop damping is active."""
        is_damped = self.stop_damping.is_active and not self.dry_run.is_active
        return self.dry_run.has_effort or is_damped

    def switch_dry_run(self, *, is_wanted: bool) -> bool:
        """
        Start or end a dry run; return whether anything changed.

        A dry run does not end before the efforts sent to the robot have fallen to zero.

        """
        dry_run = self.dry_run
        if is_wanted is dry_run.is_active or (dry_run.has_effort and not is_wanted):
            return False
        if is_wanted:
            dry_run.begin(self.shaper.time_to_fall)
            return True
        self._restart()
        dry_run.end()
        return True

    def step(self, now: float) -> Command | None:
        """
        Compute the command at time ``now`` [s]; return None while inputs are missing.

        ``now`` is measured by the same clock as the times of joint states and references.

        """
        law, shaper, is_live = self.law, self.shaper, not self.dry_run.is_active
        self._pass_time(now)
        state, events = self._inputs(now, is_live)
        if self.following.is_active:
            self.reference = self._lead(now)
        phase = self.supervisor.decide(now, state, self.reference, shaper.gain, is_live=is_live)
        if phase is Phase.WAITING:
            shaper.clock.start()
            return None
        if self.following.is_active:
            self._watch_following(now, phase, state)
        report = ''
        if phase is not Phase.STOPPED:
            self.stop_damping.end()
        if self.supervisor.is_behind and not is_live:
            self.motion_problem = self.supervisor.is_behind, now
        if phase not in COMPUTING_PHASES:
            law.forget()
            report = self._fall(now, state)
        elif not self._follow(now, state, self.reference if phase is Phase.RUNNING else None):
            self.supervisor.phase = Phase.NO_SOLUTION
            report = self._fall(now, state)
        sent = self.dry_run.select(shaper.command, shaper.clock.step)
        if sent is self._result.sent and not report and not events.lost_velocities:
            return self._result
        return self._result._replace(
            sent=sent, end_of_damping=report, lost_velocities=events.lost_velocities
        )

    def _lead(self, now: float) -> Reference:
        """
        Return the next reference along the trajectory.

        The trajectory advances with the joint states, not with the commands. Otherwise, feedback
        would drive the arm while its states are late.

        """
        gap = max(0.0, self.collector.time - self._led_at)
        self._led_at = self.collector.time
        if gap > LONGEST_GAP:
            reason = f'there was no joint state for {gap:.2g} s'
            self.blend()
            self.following.hold(self._measured_motion(), reason)
            gap = 0.0
        return self.following.reference(now, gap)

    def _watch_following(self, now: float, phase: Phase, state: State | None) -> None:
        """Compare the arm with its trajectory, and end the trajectory if the arm is lost."""
        reference, law = self.reference, self.law
        if phase is Phase.RUNNING and state is not None and reference is not None:
            assert reference.positions is not None
            self.following.compare(law.distance(law.measured(state), reference.positions))
        elif phase is Phase.STATE_LOST:
            lost = now - self.collector.time
            is_new = self.following.reason != _STATES_LOST
            # It ends soon, or it has lasted so long that the trajectory cannot go on.
            if lost <= self.settings.state_timeout or (lost > LONGEST_GAP and is_new):
                self.following.hold(self._measured_motion(), _STATES_LOST)
        else:
            self._drop_reference(self.supervisor.limit_stop or phase.value)

    def _pass_time(self, now: float) -> None:
        """Advance the ramps; after an interruption, begin a blend."""
        if self.shaper.clock.advance(now):
            self.blend()
            # Old messages may arrive together, which show no motion.
            self.motion_limits.reset()
            self.stop_damping.fall()

    def _inputs(self, now: float, is_live: bool) -> tuple[State | None, Events]:
        """Return the joint state, and bridge all changes of the inputs that are no motion."""
        state, events = self.collector.at(now)
        if self.loads.needs_update and self.loads.update(now):
            self.blend_model()
        if events.has_changed:
            self.blend()
        if self.reference is not None and self.reference.time > now:
            # The clock was set back. Otherwise, the old reference would be followed again later.
            self.reference = None
        if self.lacks_imu:
            state = None
        if not self.shaper.continues:
            self.law.release()
        if state is not None and 0.0 <= now - state.time <= self.settings.state_timeout:
            self._observe(now, state, is_live)
            if self.has_contact_limits and is_live and self.phase in COMPUTING_PHASES:
                self._feel(state.time)
        return state, events

    def _feel(self, time: float) -> None:
        """End the motion of the arm after a contact."""
        if self.shaper.gain < 1.0 or self.supervisor.contact:
            return  # until the start ramp has ended, something else holds the arm
        efforts, limits = self.external_efforts()[self.index], self.of_joint['contact_limits']
        k = self._contact.find(time, efforts, limits)
        if k is None:
            return
        unit = 'N' if self.robot.is_prismatic_joint[self.index[k]] else 'N m'
        effort, limit = (f'{values[k]:.3g} {unit}' for values in (efforts, limits))
        contact = f'at {self.joints[k]}: {effort}, limit {limit}'
        self._drop_reference(f'a contact {contact}')
        if self.settings.on_contact is ContactPolicy.STOP:
            self.stop()
        self.supervisor.contact = contact
        self._choose_law()
        self.blend()

    def _follow(self, now: float, state: State | None, reference: Reference | None) -> bool:
        """Command the efforts of the law; return False if they are not finite."""
        assert state is not None
        tau = self.law.efforts(now, state, reference)
        if tau is None:
            return False
        is_following, step = reference is not None, self.shaper.clock.step
        added = self.motion_limits.restrain(
            state, tau, self.law.added, step, is_following=is_following
        )
        self._last_added = self.law.added, added
        return self.shaper.follow(tau, added)

    def _fall(self, now: float, state: State | None) -> str:
        """Let the efforts fall, or hold them; return why the stop damping has ended, if it has."""
        phase, shaper, damping = self.phase, self.shaper, self.stop_damping
        if phase is Phase.LIMIT_STOP:
            shaper.fall(within=LIMIT_RAMP)
        elif phase is Phase.STOPPED:
            clock = shaper.clock
            shaper.fall(damping.efforts(now, state, clock.step, clock.since), damping.limits)
        elif self.settings.on_stale_state is StalePolicy.ZERO:
            shaper.fall()
        else:
            shaper.hold()
        return damping.take_report()

    def _observe(self, now: float, state: State, is_live: bool) -> None:
        """
        Bridge a jump of the positions, and stop the arm if its motion is beyond the limits.

        In a dry run, only remember what is wrong.

        """
        phase = self.phase
        is_following = phase is Phase.RUNNING or phase not in COMPUTING_PHASES or not is_live
        seen = self.motion_limits.observe(state, is_following=is_following)
        if seen.has_jumped:
            self.blend()
        if seen.has_moved:
            self.law.release()
        is_closed, problem = phase is Phase.RUNNING and self.law.is_closed, seen.text
        if seen.finding is Finding.JUMP and not is_closed:
            problem = ''  # without feedback of the position, a jump is only bridged
        if is_closed and state.delay > _USUAL_DELAY and not problem:
            is_unstable, _ = self.law.unstable_gains(state.q, state.delay)
            if is_unstable.any():
                problem = (
                    f'{self.joints[int(np.argmax(is_unstable))]} may oscillate with these gains, '
                    f'because joint states are {1e3 * state.delay:.0f} ms old when they arrive'
                )
        if not problem:
            return
        if not is_live:
            self.motion_problem = problem, now
        elif phase in COMPUTING_PHASES or self.stop_damping.is_active:
            self.limit_stop(problem)

    def drive_reference(self) -> tuple[Floats, Floats]:
        """Return positions and velocities to send with the last command; see `DriveReference`."""
        settings, phase = self.settings, self.phase
        return self.drive.motion(
            self.law,
            self.collector.q[self.index],
            self.collector.qd[self.index],
            self.shaper.clock.step,
            settings.start_ramp,
            LIMIT_RAMP if phase is Phase.LIMIT_STOP else settings.stop_ramp,
            settings.max_tracking_error,
            is_computing=phase in COMPUTING_PHASES and not self.dry_run.is_active,
        )

    def external_efforts(self) -> Floats:
        """Estimate external efforts from the last state; see `ExternalEffortEstimator.update`."""
        collector = self.collector
        with self.loads.gravity_included(self.measures_gravity):
            return self.external_effort_estimator.update(
                collector.time, collector.q, collector.qd, collector.efforts
            )

    def tool_wrench(self, efforts: Floats) -> Floats:
        """Estimate the wrench on `tool_link` from external efforts; see `contact.tool_wrench`."""
        wrench, is_shown = tool_wrench(self.dynamics, self.collector.q, self.tool_link, efforts)
        self.hidden_components = list(compress(COMPONENTS, ~is_shown))
        return wrench

    @property
    def measures_gravity(self) -> bool:
        """Whether the efforts that the driver measures contain gravity."""
        return self.measured_gravity.is_included(self.loads.include_gravity)

    @property
    def lacks_imu(self) -> bool:
        """Whether the base has an IMU that has not sent any message yet."""
        return self.has_imu and self.loads.imu_time == -math.inf
