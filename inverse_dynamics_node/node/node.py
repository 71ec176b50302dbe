"""The managed node: messages in, `ControlLoop.step`, messages out."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import math
import time
import traceback
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.timer import Timer
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from ..control.activity import describe_silence
from ..control.control_loop import ControlLoop
from ..control.controller import COMPUTING_PHASES, Reference
from ..control.external_loads import rotation_of
from ..control.graph_info import GraphInfo
from ..control.monitor import Monitor
from ..dynamics.trajectory import complete, joint_index, trajectory_efforts
from ..errors import (
    ConfigurationError,
    InverseDynamicsError,
    JointStateError,
    shortened,
    shortened_lines,
    TrajectoryError,
)
from ..robot.model import Floats
from . import messages
from .cdr import JointStateReader
from .configure import apply_configuration, check_configuration, make_loop
from .containment import contain_errors
from .diagnostics import diagnostic_array
from .graph import Graph
from .log import BoundedLogger, NodeLog
from .model_report import describe_robot
from .outputs import Outputs
from .parameters import BaseMotion, Configuration, PARAMETERS
from .ros_parameters import (
    checked_configuration,
    declare_parameters,
    read_configuration,
    unknown_parameters,
    unused_qos_overrides,
    values_of,
)

_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_EVERY_ONE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
_SEVERAL = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
_LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
_WATCH_PERIOD = 0.01  # [s]; how often to step, or to look, where no joint states come
_LONGEST_WATCH = 0.1  # [s]; how long at most not to look where they do
_LISTENERS_PERIOD = 0.2  # [s]; how often to look who listens to more than the commands
_DIAGNOSTICS_PERIOD = 1.0  # [s]; REP-107
_LAUNCH_SIGTERM_TIMEOUT = 5.0  # [s]; default of ros2 launch

_SUCCESS = TransitionCallbackReturn.SUCCESS
_FAILURE = TransitionCallbackReturn.FAILURE


class InverseDynamicsNode(LifecycleNode):
    """
    Publishes the joint efforts that produce the accelerations asked for.

    Publishers, subscriptions and services live as long as the node; what configuring makes (loop,
    timers) goes with cleaning up.

    """

    def __init__(self, skip_ramp: Callable[[], bool] = lambda: False, **kwargs: Any) -> None:
        super().__init__('inverse_dynamics', **kwargs)
        contain_errors(self)
        self._is_in_a_hurry = skip_ramp
        declare_parameters(self)
        self._configuration = read_configuration(self)
        for problem in unknown_parameters(self):
            self.get_logger().warning(f'ignored {problem}')
        self.is_finalized = False
        self._loop: ControlLoop | None = None
        self._is_active = False
        self._has_commanded = False
        self._reason_to_stop = 'deactivated'
        self._may_autostart = self._configuration.autostart
        self._description = ''  # the latest from the topic
        self._loader = ThreadPoolExecutor(1, 'robot_description')
        self._loading: Future[ControlLoop] | None = None
        self._log = NodeLog(self.get_logger())
        self._monitor = Monitor()
        self._reader = JointStateReader()
        self._last_diagnostics = self._last_message = time.monotonic()
        self._pace: list[Timer] = []
        self._uses_sim_time = self.get_parameter('use_sim_time').value
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self._uses_sim_time:
            self._timer_clock = self.get_clock()
            self._now: Callable[[], float] = lambda: self.get_clock().now().nanoseconds * 1e-9
        else:
            self._timer_clock = steady
            self._now = time.monotonic  # the same clock, twenty times faster to read
        self._create_entities()
        for problem in unused_qos_overrides(self):
            self.get_logger().warning(problem)
        self.create_timer(_LISTENERS_PERIOD, self._look_for_listeners, clock=steady)
        self.create_timer(_DIAGNOSTICS_PERIOD, self._on_diagnostics, clock=steady)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)

    def get_logger(self) -> Any:
        """Return the logger of the node; it shortens long lines."""
        return BoundedLogger(super().get_logger())

    @property
    def configuration(self) -> Configuration:
        """All parameters, as they count now."""
        return self._configuration

    def _create_entities(self) -> None:
        qos = {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}
        self._outputs = Outputs(self, _EVERY_ONE, **qos)
        self._graph = Graph(self, self._outputs.commands)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', _SEVERAL)
        self._trajectories = self.create_publisher(
            JointTrajectory, '~/joint_trajectory_out', _EVERY_ONE, **qos
        )
        for message, topic, callback, profile in (
            (String, 'robot_description', self._on_robot_description, _LATCHED),
            (Float64MultiArray, '~/desired_accelerations', self._on_accelerations, _EVERY_ONE),
            (JointTrajectory, '~/reference', self._on_reference, _EVERY_ONE),
            (JointTrajectory, '~/joint_trajectory_in', self._on_trajectory, _EVERY_ONE),
            # Several links may each have one of their own.
            (InertiaStamped, '~/payload', self._on_payload, _SEVERAL),
            (WrenchStamped, '~/external_wrench', self._on_external_wrench, _SEVERAL),
            (Vector3Stamped, '~/gravity', self._on_gravity, _EVERY_ONE),
            (Imu, 'imu', self._on_imu, _LATEST),
        ):
            self.create_subscription(message, topic, callback, profile, **qos)
        self._states = self.create_subscription(
            JointState, 'joint_states', self._on_joint_state, _LATEST, raw=True, **qos
        )
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.create_service(Trigger, '~/check_model', self._on_check_model)

    # Lifecycle

    def autostart(self) -> bool:
        """
        Configure and activate, unless told not to or still without a robot description.

        It does so once: who takes the node down by hand will want to bring it up by hand.

        Returns
        -------
        is_well : bool
            False if the robot description or the parameters turned out to be of no use.

        """
        if not self._may_autostart:
            return True
        if not self._has_description():
            topic = self.resolve_topic_name('robot_description')
            self.get_logger().info(
                f'waiting for a robot description on {topic} '
                '(or set parameter robot_description_file)'
            )
            return True
        return bool(self.trigger_configure() == _SUCCESS and self.trigger_activate() == _SUCCESS)

    def shut_down(self) -> None:
        """Leave the robot with zeros."""
        if self._is_active:
            self._reason_to_stop = 'the process is ending'
            self.trigger_deactivate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the robot description, compile, and get ready."""
        try:
            self._configure()
        except InverseDynamicsError as error:
            self.get_logger().error(str(error))
            return _FAILURE
        except MemoryError as error:
            self.get_logger().error(f'not enough memory: {error!r}')
            return _FAILURE
        except Exception:  # rclpy would drop it without a word
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to command, from zero."""
        assert self._loop is not None
        result = super().on_activate(state)
        self._loop.start()
        self._monitor.pause()
        self._outputs.look_for_listeners()
        self._log.begin()
        self._is_active = result == _SUCCESS
        joints = ', '.join(self._loop.controller.joints)
        self.get_logger().info(f'efforts for {joints} to {self._graph.with_subscribers()}')
        self._may_autostart = False  # from now on, who takes it down brings it up
        self._has_commanded = False
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the efforts fall to zero, see that the zeros arrive, and be silent."""
        self._ramp_down()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the robot."""
        self._forget_robot()
        return super().on_cleanup(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the robot; the node can be configured again."""
        self._forget_robot()
        return _SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the robot with zeros, then end the process."""
        if self._is_active:
            self._ramp_down()
        self.is_finalized = True
        return super().on_shutdown(state)

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:  # noqa: N802
        """Refuse a transition that is not possible now; rclpy 7.1 would end the process."""
        from rclpy._rclpy_pybind11 import RCLError

        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except RCLError as error:
            self.get_logger().error(f'no such transition from here: {error}')
            response.success = False
            return response

    # Configuring

    def _has_description(self) -> bool:
        configuration = self._configuration
        return bool(
            configuration.robot_description
            or configuration.robot_description_file
            or self._description
        )

    def _configure(self) -> None:
        self._configuration = configuration = read_configuration(self)
        loop = make_loop(configuration, self._description)
        self._forget_robot()
        self._graph.expect_discovery()
        self._warn_of_long_stop(configuration.settings.stop_ramp)
        self._monitor = Monitor(configuration.period)
        # Lost states are noticed by a timer of their own, whatever the rate.
        self._watch_period = min(_WATCH_PERIOD, 0.5 * configuration.settings.state_timeout)
        clock = self._timer_clock
        self._watch = self.create_timer(self._watch_period, self._on_watch, clock=clock)
        self._pace = [self._watch]
        if configuration.period:
            self._pace.append(self.create_timer(configuration.period, self._on_timer, clock=clock))
        self._use(loop)

    def _warn_of_long_stop(self, stop_ramp: float) -> None:
        if stop_ramp >= _LAUNCH_SIGTERM_TIMEOUT:
            self.get_logger().warning(
                f'stop_ramp is {stop_ramp:g} s, but ros2 launch sends SIGTERM '
                f'{_LAUNCH_SIGTERM_TIMEOUT:g} s after SIGINT, which ends the ramp: increase '
                'sigterm_timeout of the launch action'
            )

    def _use(self, loop: ControlLoop) -> None:
        self._loop = loop
        self._R_BS = rotation_of(*self._configuration.imu_orientation)
        self._log.introduce(loop)

    def _forget_robot(self) -> None:
        self._loop = None
        self._is_active = False
        self._loading = None
        for timer in self._pace:
            self.destroy_timer(timer)
        self._pace = []

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept new values only if all of them together can be used."""
        ours = values_of(self)
        changed = {p.name: p.value for p in parameters if p.name in ours}
        try:
            for parameter in parameters:
                if parameter.name == 'use_sim_time' and parameter.value != self._uses_sim_time:
                    raise ConfigurationError("parameter 'use_sim_time' is read at the start only")
                if parameter.name in changed and parameter.type_ is Parameter.Type.NOT_SET:
                    raise ConfigurationError(f"parameter '{parameter.name}' cannot be unset")
            configuration = checked_configuration({**ours, **changed})
            if self._loop is not None:
                for name, value in changed.items():
                    is_live = name in PARAMETERS and PARAMETERS[name].is_live
                    if not is_live and value != ours[name]:
                        raise ConfigurationError(
                            f"parameter '{name}' is read when the node is configured; deactivate "
                            'and clean up first'
                        )
                check_configuration(self._loop, configuration)
        except InverseDynamicsError as error:
            return SetParametersResult(successful=False, reason=shortened_lines(str(error)))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, parameters: list[Parameter]) -> None:
        ours = values_of(self)
        if not any(parameter.name in ours for parameter in parameters):
            return
        before, self._configuration = self._configuration, read_configuration(self)
        if self._loop is None:
            self.autostart()
            return
        apply_configuration(self._loop, self._configuration, before)
        self._watch_after(self._watch_period)
        self._R_BS = rotation_of(*self._configuration.imu_orientation)

    # A new robot description

    def _on_robot_description(self, message: String) -> None:
        configuration = self._configuration
        if configuration.robot_description or configuration.robot_description_file:
            return
        if message.data == self._description:
            return
        self._description = message.data
        if self._loop is None:
            self.autostart()
            return
        self.get_logger().info('a new robot description came')
        if self._loading is not None:
            self._loading.cancel()  # of several in a row, the last will do
        # Loading takes tenths of a second, in which the robot must not go without commands.
        self._loading = self._loader.submit(make_loop, configuration, message.data)
        self._watch_after(self._watch_period)

    def _reload(self, loading: Future[ControlLoop]) -> None:
        """Go on with another description of the robot; or with the old one, if that is better."""
        assert self._loop is not None
        try:
            loop = loading.result()
            apply_configuration(loop, self._configuration)
            continue_from = loop.continue_from if self._is_active else loop.copy_inputs_from
            for link in continue_from(self._loop):
                self.get_logger().warning(f"link '{link}' is no more; its payload is dropped")
        except Exception as error:  # of a thread that nobody else asks
            self.get_logger().error(
                f'the new robot description is not used, the old one still is: {error}'
            )
            self._monitor.reject('robot_description', str(error).partition('\n')[0])
            return
        self._use(loop)

    # Messages in

    def _on_joint_state(self, data: bytes) -> None:
        self._last_message = time.monotonic()
        if self._loop is None:
            return
        now = self._now()
        try:
            names, positions, velocities, measured = self._reader.read(data)
            efforts = self._efforts(len(names), measured)
            is_ours = self._loop.collector.update(now, names, positions, velocities, efforts)
        except JointStateError as error:
            self._reject('joint_states', error)
            return
        if is_ours and self._is_active and self._configuration.update_rate == 0.0:
            self._step(now)

    def _efforts(self, count: int, measured: Floats) -> Floats | tuple[()]:
        """Return measured efforts, if they are wanted; NaN for those that are not there."""
        if not self._outputs.wants_measured_efforts:
            return ()
        if len(measured) == count:
            return measured
        if len(measured):  # no reason not to know where the arm is
            self._reject('joint_states', f'{count} names, but {len(measured)} efforts')
        return np.full(count, math.nan)

    def _on_accelerations(self, message: Float64MultiArray) -> None:
        self._take_reference('~/desired_accelerations', messages.read_accelerations, message)

    def _on_reference(self, message: JointTrajectory) -> None:
        self._take_reference('~/reference', messages.read_reference, message)

    def _take_reference(self, topic: str, read: Callable[..., Reference], message: Any) -> None:
        if self._loop is None or not self._is_active:
            return
        now = self._now()
        try:
            self._loop.reference = read(message, self._loop.controller.joints, now)
        except JointStateError as error:
            self._reject(topic, error)

    def _on_payload(self, message: InertiaStamped) -> None:
        def take(loop: ControlLoop, now: float) -> None:
            payload = messages.read_payload(message)
            if loop.loads.set_payload(now, *payload):
                self.get_logger().info(f"payload on link '{payload.link}': {payload.mass:g} kg")

        self._handle('~/payload', take)

    def _on_external_wrench(self, message: WrenchStamped) -> None:
        self._handle(
            '~/external_wrench',
            lambda loop, now: loop.loads.set_external_wrench(now, *messages.read_wrench(message)),
        )

    def _on_gravity(self, message: Vector3Stamped) -> None:
        def take(loop: ControlLoop, now: float) -> None:
            frame = message.header.frame_id
            if frame not in ('', loop.base_link):
                raise ConfigurationError(
                    f"frame_id is '{shortened(frame)}', expected that of the base, "
                    f"'{loop.base_link}'"
                )
            if loop.has_imu:
                raise ConfigurationError("gravity is measured: parameter 'base_motion' is imu")
            loop.loads.set_gravity(messages.vector(message.vector))

        self._handle('~/gravity', take)

    def _on_imu(self, message: Imu) -> None:
        if self._configuration.base_motion is not BaseMotion.IMU:
            return
        self._handle(
            'imu',
            lambda loop, now: loop.set_base_motion(now, *messages.read_imu(message, self._R_BS)),
        )

    def _handle(self, topic: str, take: Callable[[ControlLoop, float], None]) -> None:
        """Let the loop take in a message, or tell why not."""
        now = self._now()
        if self._loop is None:
            self._reject(topic, 'there is no robot yet')
            return
        try:
            take(self._loop, now)
        except InverseDynamicsError as error:
            self._reject(topic, error)

    def _reject(self, topic: str, reason: object) -> None:
        self._monitor.reject(topic, shortened_lines(str(reason)))
        self._log.warn(topic, f'{topic}: message dropped: {reason}')

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._handle('~/joint_trajectory_in', lambda loop, now: self._fill(loop, message))

    def _fill(self, loop: ControlLoop, message: JointTrajectory) -> None:
        """Publish a trajectory with the efforts that it takes, if somebody wants it."""
        if not self._trajectories.get_subscription_count():
            raise TrajectoryError('nobody listens to ~/joint_trajectory_out')
        trajectory, derived = complete(messages.read_trajectory(message))
        for words in derived:
            self._log.warn(words, f'~/joint_trajectory_in: {words}')
        efforts = trajectory_efforts(loop.dynamics, trajectory, loop.collector.q)
        index = joint_index(trajectory.joint_names, loop.robot.joint_names)
        efforts = loop.calibrated(index, efforts)
        for name in loop.beyond_limits(index, efforts):
            words = f"~/joint_trajectory_in: efforts of '{name}' go beyond its limit"
            self._log.warn(words, words)
        self._trajectories.publish(messages.write_trajectory(message, trajectory, efforts))

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        if self._loop is None or not self._is_active:
            response.message = 'the node is not active'
            return response
        if request.data:
            self._loop.controller.resume()
        else:
            self._loop.controller.stop()
            self._loop.reference = None
        response.success = True
        response.message = f'efforts {"rise" if request.data else "fall to zero"} along the ramp'
        self.get_logger().info(response.message)
        return response

    def _on_check_model(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        response.success = self._loop is not None
        response.message = describe_robot(self._loop) if self._loop else 'there is no robot yet'
        self.get_logger().info(response.message)  # a command line shows it on one long line
        return response

    # In the loop

    def catch_up(self) -> None:
        """Take the latest joint state and do what the timers would do, if they are late."""
        if self._loop is None:
            return
        with self._states.handle:
            message = self._states.handle.take_message(JointState, True)
        if message is not None:
            self._on_joint_state(message[0])
        if self._configuration.period:
            self._on_timer()
        self._on_watch()
        if time.monotonic() > self._last_diagnostics + 1.5 * _DIAGNOSTICS_PERIOD:
            self._on_diagnostics()

    def _on_timer(self) -> None:
        if self._is_active:
            self._step(self._now())

    def _on_watch(self) -> None:
        """Step where no joint state will: none has come yet, or none comes any more."""
        if self._loading is not None and self._loading.done():
            loading, self._loading = self._loading, None
            self._reload(loading)
        wait = self._watch_period
        if self._is_active:
            assert self._loop is not None
            now = self._now()
            state = self._loop.collector.state()
            timeout = self._configuration.settings.state_timeout
            if state is None or not 0.0 <= now - state.time <= timeout:
                self._step(now)
            elif self._loading is None:
                # Before, nothing can be lost; and a look costs as much as some of the steps.
                wait = max(wait, min(state.time + timeout - now, _LONGEST_WATCH))
        self._watch_after(wait)

    def _watch_after(self, wait: float) -> None:
        """Let the next look be in so many seconds, and all after it."""
        period = round(wait * 1e9)
        if period != self._watch.timer_period_ns:
            self._watch.timer_period_ns = period
            self._watch.reset()

    def _step(self, now: float) -> None:
        assert self._loop is not None
        began = time.perf_counter()
        command = self._loop.step(now)
        if command is None:
            self._log.tell_waiting(self._missing)
            return
        self._has_commanded = True
        self._outputs.publish_command(self._loop, command.efforts)
        took = time.perf_counter() - began
        self._monitor.step(now, took, command, self._loop.controller.joints)
        self._log.tell(now, self._loop, command)
        if self._loop.controller.phase in COMPUTING_PHASES:
            self._explain()

    def _missing(self) -> list[str]:
        assert self._loop is not None
        return self._loop.missing(
            self._graph.with_publishers('joint_states'), self._graph.with_publishers('imu')
        )

    def _explain(self) -> None:
        assert self._loop is not None
        try:
            self._outputs.publish_explanation(self._loop)
        except JointStateError as error:
            self._log.warn('explanation', str(error))

    def _ramp_down(self) -> None:
        """Publish falling efforts, then zeros, from within one callback: nothing else runs."""
        assert self._loop is not None
        self._is_active = False
        if not self._has_commanded:
            return  # who holds the robot now, it is not this node
        self.get_logger().info(f'ramping efforts down: {self._reason_to_stop}')
        try:
            self._follow_stop_ramp(self._loop)
        finally:
            self._outputs.publish_zeros(self._loop)
        self.get_logger().info(f'stopped, zeros sent: {self._reason_to_stop}')

    def _follow_stop_ramp(self, loop: ControlLoop) -> None:
        loop.controller.stop()
        start, steady_start = self._now(), time.monotonic()
        while loop.controller.has_effort and not self._is_in_a_hurry():
            time.sleep(self._watch_period)
            # A simulated clock stands still meanwhile.
            now = start + time.monotonic() - steady_start
            command = loop.step(now)
            assert command is not None
            self._outputs.publish_command(loop, command.efforts)

    # How it goes

    def _look_for_listeners(self) -> None:
        self._outputs.look_for_listeners()
        news = self._graph.lost_or_found_subscribers() if self._is_active else ''
        if news:
            self.get_logger().info(news)

    def _on_diagnostics(self) -> None:
        self._last_diagnostics = time.monotonic()
        publishers = []
        if self._loop is not None and self._loop.collector.has_alternating:
            publishers = self._graph.publishers('joint_states')
            self._log.tell_conflicts(self._loop, publishers)
        around = GraphInfo(
            receivers=self._outputs.receivers,
            publishers=self.count_publishers(self.resolve_topic_name('joint_states')),
            is_active=self._is_active,
            state=str(self._state_machine.current_state[1]),
            others=self._graph.others(),
            state_publishers=tuple(publishers),
            simulated=self._graph.simulated_time() if self._uses_sim_time else None,
            silence=time.monotonic() - self._last_message,
        )
        if self._is_active:
            self._log.tell_silence(describe_silence(around))
        if self._loop is not None:
            self._log.tell_implausible(self._loop)
        statuses = self._monitor.report(self._now(), self._loop, around)
        for status in statuses:
            if status.part in ('other nodes', 'clock'):
                self._log.tell_status(status)
        self._diagnostics.publish(
            diagnostic_array(
                self.get_clock().now().to_msg(),
                self.get_fully_qualified_name(),
                self._loop.robot.name if self._loop else '',
                statuses,
            )
        )
