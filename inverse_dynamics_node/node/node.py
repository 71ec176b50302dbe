"""The managed node: messages in, `Controller.step`, messages out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import math
from pathlib import Path
import time
import traceback
from typing import Any

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from ..controller import Command, Controller, of_joints, PerJoint, Phase, Reference
from ..dynamics import InverseDynamics
from ..errors import ConfigurationError, InverseDynamicsError, JointStateError
from ..model import Floats, RobotModel
from ..state import JointStateCollector
from ..urdf import load_urdf
from . import messages
from .parameters import (
    checked_configuration,
    Configuration,
    declare_parameters,
    PARAMETERS,
    read_configuration,
    unknown_parameters,
)

_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_EVERY_ONE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
_LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
_WATCH_PERIOD = 0.01  # [s]; without an update rate, how often to look whether states still come
_LOG_PERIOD = 2.0  # [s]; how often the log repeats what lasts

_SUCCESS = TransitionCallbackReturn.SUCCESS
_FAILURE = TransitionCallbackReturn.FAILURE


class InverseDynamicsNode(LifecycleNode):
    """
    Publishes the joint efforts that produce the accelerations asked for.

    Publishers and subscriptions live as long as the node; what configuring makes (robot,
    controller, timer) goes with cleaning up.

    """

    def __init__(self, is_in_a_hurry: Callable[[], bool] = lambda: False, **kwargs: Any) -> None:
        super().__init__('inverse_dynamics', **kwargs)
        self._is_in_a_hurry = is_in_a_hurry
        declare_parameters(self)
        self._configuration = read_configuration(self)
        for name in unknown_parameters(self._parameter_overrides):
            self.get_logger().warning(f"parameter '{name}' was set, but this node has none such")
        self.is_finalized = False
        self._controller: Controller | None = None
        self._is_active = False
        self._has_commanded = False
        self._may_autostart = self._configuration.autostart
        self._description = ''  # the latest from the topic
        self._reference: Reference | None = None
        self._last_phase = Phase.WAITING
        self._log_times: dict[str, float] = {}
        self._pace: list[Timer] = []
        self._uses_sim_time = self.get_parameter('use_sim_time').value
        if self._uses_sim_time:
            self._timer_clock = self.get_clock()
            self._now: Callable[[], float] = lambda: self.get_clock().now().nanoseconds * 1e-9
        else:
            self._timer_clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._now = time.monotonic  # the same clock, twenty times faster to read
        self._create_entities()
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)

    def _create_entities(self) -> None:
        qos = {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}
        self._command_message = Float64MultiArray()
        self._efforts_message = JointState()
        self._commands = self.create_lifecycle_publisher(
            Float64MultiArray, '~/commands', _EVERY_ONE, **qos
        )
        self._joint_efforts = self.create_lifecycle_publisher(
            JointState, '~/joint_efforts', _EVERY_ONE, **qos
        )
        for message, topic, callback, profile in (
            (JointState, 'joint_states', self._on_joint_state, _LATEST),
            (String, 'robot_description', self._on_robot_description, _LATCHED),
            (Float64MultiArray, '~/desired_accelerations', self._on_accelerations, _EVERY_ONE),
            (JointTrajectory, '~/reference', self._on_reference, _EVERY_ONE),
        ):
            self.create_subscription(message, topic, callback, profile, **qos)

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
            self.trigger_deactivate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the robot description, compile, and get ready."""
        try:
            self._configure()
        except InverseDynamicsError as error:
            self.get_logger().error(str(error))
            return _FAILURE
        except Exception:  # rclpy would drop it without a word
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to command, from zero."""
        assert self._controller is not None
        result = super().on_activate(state)
        self._controller.start()
        self._reference = None
        self._last_phase = self._controller.phase
        self._is_active = result == _SUCCESS
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
        robot = self._load_robot(configuration)
        rate = configuration.update_rate
        controller = Controller(
            InverseDynamics(robot),
            configuration.joints,
            configuration.settings,
            period=1.0 / rate if rate else 0.0,
        )
        self._set_up_dynamics(controller, configuration)
        controller.dynamics.gravity_efforts([0.0] * len(robot.joint_names))  # a first call is slow
        self._collector = JointStateCollector(robot.joint_names)
        self._efforts_message.name = list(controller.joints)
        self._forget_robot()
        # Lost states are noticed by a timer of their own, whatever the rate.
        self._watch_period = min(_WATCH_PERIOD, 0.5 * configuration.settings.state_timeout)
        clock = self._timer_clock
        self._pace = [self.create_timer(self._watch_period, self._on_watch, clock=clock)]
        if rate:
            self._pace.append(self.create_timer(1.0 / rate, self._on_timer, clock=clock))
        self._controller = controller
        self._introduce(robot, controller.joints)

    def _forget_robot(self) -> None:
        self._controller = None
        self._is_active = False
        for timer in self._pace:
            self.destroy_timer(timer)
        self._pace = []

    def _set_up_dynamics(self, controller: Controller, configuration: Configuration) -> None:
        """Tell the dynamics what parameters say of gravity, friction and rotors."""
        dynamics = controller.dynamics
        robot = dynamics.robot
        index = [robot.joint_names.index(name) for name in controller.joints]

        def of_robot(name: str, values: PerJoint, others: Floats) -> Floats:
            given = of_joints(name, values, len(index))
            if ((given < 0.0) & (given != -1.0)).any():
                raise ConfigurationError(f"parameter '{name}' is {values}, expected -1, or from 0")
            chosen: Floats = others.copy()
            chosen[index] = np.where(given < 0.0, others[index], given)
            return chosen

        damping = of_robot('damping', configuration.damping, robot.damping)
        coulomb = of_robot('coulomb', configuration.coulomb, robot.friction)
        armature = of_robot('armature', configuration.armature, np.zeros_like(damping))
        share = 1.0 if configuration.include_friction else 0.0
        dynamics.set_gravity(
            configuration.gravity if configuration.include_gravity else (0.0, 0.0, 0.0)
        )
        dynamics.set_friction(share * damping, share * coulomb, configuration.coulomb_width)
        dynamics.set_armature(armature)

    def _load_robot(self, configuration: Configuration) -> RobotModel:
        if configuration.robot_description_file:
            # A shell leaves a ~ after := as it is.
            return load_urdf(Path(configuration.robot_description_file).expanduser())
        text = configuration.robot_description or self._description
        if not text:
            raise ConfigurationError(
                'no robot description: none on the topic, and neither parameter is set'
            )
        return load_urdf(_as_xml(text))

    def _introduce(self, robot: RobotModel, joints: Sequence[str]) -> None:
        for warning in robot.warnings:
            self.get_logger().warning(warning)
        others = [name for name in robot.joint_names if name not in joints]
        self.get_logger().info(
            f"robot '{robot.name}', {robot.mass.sum():.3g} kg; commands {', '.join(joints)}"
            + (f'; takes into account {", ".join(others)}' if others else '')
        )

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept new values only if all of them together can be used."""
        values = {name: self.get_parameter(name).value for name in PARAMETERS}
        changed = {p.name: p.value for p in parameters if p.name in PARAMETERS}
        try:
            for parameter in parameters:
                if parameter.name == 'use_sim_time' and parameter.value != self._uses_sim_time:
                    raise ConfigurationError("parameter 'use_sim_time' is read at the start only")
                if parameter.name in changed and parameter.type_ is Parameter.Type.NOT_SET:
                    raise ConfigurationError(f"parameter '{parameter.name}' cannot be taken away")
            configuration = checked_configuration({**values, **changed})
            if self._controller is not None:
                self._check_live(configuration, changed)
        except InverseDynamicsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_live(self, configuration: Configuration, names: Iterable[str]) -> None:
        """Refuse what cannot change while configured, and what does not fit the joints."""
        assert self._controller is not None
        for name in names:
            if not PARAMETERS[name].is_live and _differ(configuration, self._configuration, name):
                raise ConfigurationError(
                    f"parameter '{name}' is read when the node is configured; deactivate and "
                    'clean up first'
                )
        robot, joints = self._controller.dynamics.robot, self._controller.joints
        trial = Controller(InverseDynamics(robot), joints, configuration.settings)
        self._set_up_dynamics(trial, configuration)

    def _apply_parameters(self, parameters: list[Parameter]) -> None:
        if not any(parameter.name in PARAMETERS for parameter in parameters):
            return
        self._configuration = read_configuration(self)
        if self._controller is not None:
            self._controller.apply(self._configuration.settings)
            self._set_up_dynamics(self._controller, self._configuration)
        else:
            self.autostart()

    # In the loop

    def _on_joint_state(self, message: JointState) -> None:
        if self._controller is None:
            return
        now = self._now()
        try:
            is_ours = self._collector.update(now, message.name, message.position, message.velocity)
        except JointStateError as error:
            self._log(now, 'joint_states', f'joint state dropped: {error}')
            return
        if is_ours and self._is_active and self._configuration.update_rate == 0.0:
            self._step(now)

    def _on_accelerations(self, message: Float64MultiArray) -> None:
        self._take_reference(messages.reference_from_accelerations, message)

    def _on_reference(self, message: JointTrajectory) -> None:
        self._take_reference(messages.reference_from_trajectory, message)

    def _take_reference(self, read: Callable[..., Reference], message: Any) -> None:
        if self._controller is None or not self._is_active:
            return
        now = self._now()
        try:
            self._reference = read(message, self._controller.joints, now)
        except JointStateError as error:
            self._log(now, read.__name__, f'reference dropped: {error}')

    def _on_robot_description(self, message: String) -> None:
        configuration = self._configuration
        if configuration.robot_description or configuration.robot_description_file:
            return
        if self._controller is None:
            self._description = message.data
            self.autostart()
        elif message.data != self._description:
            self.get_logger().warning(
                'a new robot description came; it counts when the node is configured again'
            )
            self._description = message.data

    def _on_timer(self) -> None:
        if self._is_active:
            self._step(self._now())

    def _on_watch(self) -> None:
        """Step where no joint state will: none has come yet, or none comes any more."""
        if not self._is_active:
            return
        now = self._now()
        state = self._collector.state()
        timeout = self._configuration.settings.state_timeout
        if state is None or not 0.0 <= now - state.time <= timeout:
            self._step(now)

    def _step(self, now: float) -> None:
        assert self._controller is not None
        command = self._controller.step(now, self._collector.state(), self._reference)
        if command is None:
            self._log(now, 'waiting', self._what_is_missing)
            return
        self._publish(command.efforts)
        self._report(now, command)

    def _publish(self, efforts: Floats) -> None:
        self._has_commanded = True
        messages.write_commands(self._command_message, efforts)
        self._commands.publish(self._command_message)
        if self._joint_efforts.get_subscription_count():
            messages.write_joint_efforts(self._efforts_message, efforts)
            self._efforts_message.header.stamp = self.get_clock().now().to_msg()
            self._joint_efforts.publish(self._efforts_message)

    def _ramp_down(self) -> None:
        """Publish falling efforts, then zeros, from within one callback: nothing else runs."""
        assert self._controller is not None
        self._is_active = False
        self._controller.stop()
        state = self._collector.state()
        start, steady_start = self._now(), time.monotonic()
        while state is not None and self._controller.gain and not self._is_in_a_hurry():
            time.sleep(self._watch_period)
            # A simulated clock stands still meanwhile.
            now = start + time.monotonic() - steady_start
            command = self._controller.step(now, state, None)
            assert command is not None
            self._publish(command.efforts)
        if not self._has_commanded:
            return  # who holds the robot now, it is not this node
        for _ in range(3):  # once is enough where messages are acknowledged
            self._publish(np.zeros(len(self._controller.joints)))
        self._commands.wait_for_all_acked(Duration(seconds=1))

    # Words

    def _report(self, now: float, command: Command) -> None:
        """Tell what has changed, and now and then what has not and should."""
        assert self._controller is not None
        phase = self._controller.phase
        if phase is not self._last_phase:
            self._tell_phase(now, phase)
            self._last_phase = phase
        if phase is Phase.STATE_LOST:
            self._log(now, 'state lost', lambda: self._what_is_stale(now))
        if command.is_saturated.any():
            joints = command.is_saturated.tobytes().hex()  # others are news
            self._log(now, f'saturated {joints}', lambda: self._what_is_saturated(command))

    def _tell_phase(self, now: float, phase: Phase) -> None:
        if self._last_phase is Phase.WAITING:
            for name in self._collector.without_velocity():
                self.get_logger().warning(f"joint_states: no velocity of '{name}', taken as zero")
        if not self._is_due(now, phase.name):
            return
        if phase in (Phase.RUNNING, Phase.HOLDING):
            self.get_logger().info(phase.value)
        else:
            self.get_logger().error(phase.value)

    def _log(self, now: float, key: str, text: str | Callable[[], str]) -> None:
        """Warn, but not of the same thing all the time; a logger's own throttle costs 0.2 ms."""
        if self._is_due(now, key):
            self.get_logger().warning(text if isinstance(text, str) else text())

    def _is_due(self, now: float, key: str) -> bool:
        if abs(now - self._log_times.get(key, -math.inf)) < _LOG_PERIOD:
            return False
        self._log_times[key] = now
        return True

    def _what_is_missing(self) -> str:
        topic = self.resolve_topic_name('joint_states')
        return (
            f'no command yet: {topic} ({self.count_publishers(topic)} publishers) has not told '
            f'the position of {", ".join(self._collector.missing())}'
        )

    def _what_is_stale(self, now: float) -> str:
        timeout = self._configuration.settings.state_timeout
        joints = self._collector.stale(now, timeout)
        return f'no joint state for more than {timeout:g} s of {", ".join(joints)}'

    def _what_is_saturated(self, command: Command) -> str:
        assert self._controller is not None
        joints = self._controller.joints
        cut = [name for name, cut in zip(joints, command.is_saturated, strict=True) if cut]
        return f'effort cut to its limit: {", ".join(cut)}'


def _differ(one: Configuration, other: Configuration, name: str) -> bool:
    return bool(getattr(one, name) != getattr(other, name))


def _as_xml(text: str) -> str:
    """Keep a robot description that is no XML from being taken for the name of a file."""
    return text if text.lstrip('\ufeff \t\r\n').startswith('<') else f'<!-- -->{text}'
