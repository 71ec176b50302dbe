"""The managed node: its life cycle, parameters and robot description."""

from __future__ import annotations

from collections.abc import Callable
import gc
import math
import time
import traceback
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import String

from ..errors import ConfigurationError, InverseDynamicsError, shortened_lines
from ..ros.graph import Graph
from ..ros.middleware import LATCHED, overridable
from ..ros.private import leave_graph
from .configure import check_configuration, launch_warning, make_loop
from .description_file import load_robot
from .follow_action import serve_action
from .following import TrajectoryFollower
from .inputs import Inputs
from .log import BoundedLogger, NodeLog
from .outputs import Outputs
from .parameters import Configuration, PARAMETERS
from .ros_parameters import (
    changed_configuration,
    declare_parameters,
    is_own_parameter,
    unknown_overrides,
)
from .runner import LoopRunner
from .scheduling import Scheduling
from .services import answer_requests, contain_errors, Services
from .status import OUTDATED
from .status_publisher import StatusPublisher
from .trajectory_filler import TrajectoryFiller
from .worker import Worker, WorkQueue

_SUBSCRIBERS_PERIOD = 0.2  # [s]; between checks for subscribers
# On a busy machine, an answer is lost if the node leaves the graph before the client has read it.
_ANSWER_TIME = 1.0  # [s]; between a shutdown transition and the end of the node

_SUCCESS = TransitionCallbackReturn.SUCCESS
_FAILURE = TransitionCallbackReturn.FAILURE


class InverseDynamicsNode(LifecycleNode):
    """
    Publishes the joint efforts that produce the requested joint accelerations.

    Publishers, subscriptions and services exist as long as the node exists. The control loop and
    its timers exist only while the node is configured.

    `signals` returns how many signals to end have arrived; the second ends the stop ramp. `worker`
    fills trajectories. Create `scheduling` before `worker`, as `Worker` explains. Other arguments
    are for `LifecycleNode`.
    """

    def __init__(
        self,
        signals: Callable[[], int],
        scheduling: Scheduling,
        worker: Worker,
        **kwargs: Any,
    ) -> None:
        self._worker, self._scheduling = worker, scheduling
        super().__init__('inverse_dynamics', **kwargs)
        contain_errors(self, self.catch_up)
        configuration = declare_parameters(self)
        for problem in unknown_overrides(self):
            self.get_logger().warning(f'ignored {problem}')
        self._leaves_at = math.inf  # [s]
        self._may_autostart = configuration.autostart
        self._description = ''  # the latest text from the topic
        self._reason_to_stop, self._is_ending = 'deactivated', False
        self._uses_sim_time = self.get_parameter('use_sim_time').value
        self._signals = signals
        self._create_parts(configuration)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)

    def _create_parts(self, configuration: Configuration) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        now = time.monotonic  # twenty times as fast as reading `steady`
        if self._uses_sim_time:
            now = lambda: self.get_clock().now().nanoseconds * 1e-9  # noqa: E731
        clock = self.get_clock() if self._uses_sim_time else steady
        log = NodeLog(self.get_logger())
        self._outputs = Outputs(self)
        self._graph = Graph(self, *self._outputs.forms)
        self._runner = LoopRunner(
            self,
            self._outputs,
            self._graph,
            log,
            clock,
            now,
            self._signals,
            configuration,
        )
        self._queue = WorkQueue(self, self._worker)
        filler = TrajectoryFiller(self, self._runner, self._queue)
        serve_action(self, self._runner, TrajectoryFollower(self, self._runner, self._queue))
        self.create_subscription(
            String,
            'robot_description',
            self._on_robot_description,
            LATCHED,
            **overridable(),
        )
        self._inputs = Inputs(self, self._runner, filler)
        Services(self, self._runner)
        self._diagnostics = StatusPublisher(
            self, self._runner, self._inputs, steady, self._scheduling
        )
        self.create_timer(_SUBSCRIBERS_PERIOD, self._find_subscribers, clock=steady)

    def get_logger(self) -> Any:
        """Return a logger that shortens long lines."""
        return BoundedLogger(super().get_logger())

    @property
    def configuration(self) -> Configuration:
        """The current values of all parameters."""
        return self._runner.configuration

    # Life cycle

    def autostart(self) -> bool:
        """
        Configure and activate the node if there is a robot description.

        Do nothing if the parameter `autostart` is false. Do nothing after the first activation,
        because a user may have deactivated the node. Return False if the robot description or the
        parameters cannot be used.
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
        """Ramp the efforts down to zero if the node is active."""
        if self._runner.is_active:
            self._reason_to_stop, self._is_ending = 'the process is ending', True
            self.trigger_deactivate()

    def catch_up(self) -> None:
        """Handle the latest joint state, and do the overdue work of the timers."""
        if self._runner.loop is None:
            return
        self._inputs.read_latest_joint_state()
        self._queue.poll()
        self._runner.catch_up()
        self._diagnostics.publish_if_late()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the robot description and compile the control loop."""
        try:
            self._configure()
        except InverseDynamicsError as error:
            self.get_logger().error(str(error))
            return _FAILURE
        except Exception:  # rclpy would not log the error
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to send commands; the efforts rise from zero."""
        assert self._runner.loop is not None
        if self._runner.objection and not self.configuration.dry_run:
            self.get_logger().error(self._runner.objection)
            return _FAILURE
        result = super().on_activate(state)
        if result == _SUCCESS:
            self._runner.start()
        joints = ', '.join(self._runner.loop.joints)
        to = f'to {self._graph.with_subscribers()}'
        where = f'are sent {to}'
        if self.configuration.dry_run:
            where = self._outputs.describe_dry_run(to)
        self.get_logger().info(f'efforts for {joints} {where}')
        self._may_autostart = False
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramp the efforts down to zero, and then stop publishing."""
        self._ramp_down()
        return super().on_deactivate(state)

    def _ramp_down(self) -> None:
        self._runner.ramp_down(self._reason_to_stop, self._serve, lambda: self._is_ending)

    def _serve(self) -> None:
        """Do what cannot wait for the end of a stop, which may take 20 s."""
        self._inputs.read_latest_joint_state()
        answer_requests(self)
        if self._signals() and not self._is_ending:
            self._is_ending = True
            self.get_logger().info(
                'signal received: the process ends after the stop; another signal ends the stop'
            )

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Discard the robot model, the payloads and the external wrenches."""
        self._runner.forget_robot()
        return super().on_cleanup(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Discard the robot model; the node can be configured again."""
        self._runner.forget_robot()
        return _SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramp the efforts down to zero, and let `main` end the process a second later."""
        self._may_autostart = False  # a description may arrive in this second
        if self._runner.is_active:
            self._is_ending = True
            self._ramp_down()
        self._leaves_at = time.monotonic() + _ANSWER_TIME
        return super().on_shutdown(state)

    @property
    def may_leave(self) -> bool:
        """Whether a shutdown transition has ended, and its answer has had time to arrive."""
        return time.monotonic() >= self._leaves_at

    def destroy_node(self) -> None:
        """Destroy the node, so that it leaves the ROS graph at once."""
        super().destroy_node()
        leave_graph(self)

    def _configure(self) -> None:
        configuration = self.configuration
        with self._scheduling.normal_priority():
            loop = make_loop(configuration, *load_robot(configuration, self._description))
        self._graph.expect_discovery()
        warning = launch_warning(configuration)
        if warning:
            self.get_logger().warning(warning)
        self._runner.configure(loop)
        # Garbage collection would otherwise search all libraries for tens of milliseconds.
        gc.freeze()

    def _find_subscribers(self) -> None:
        self._outputs.find_subscribers()
        self._runner.find_controllers()

    # Parameters

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept new values only if the node can use them together with its other parameters."""
        try:
            self._check_change(parameters)
        except InverseDynamicsError as error:
            return SetParametersResult(successful=False, reason=shortened_lines(str(error)))
        return SetParametersResult(successful=True)

    def _check_change(self, parameters: list[Parameter]) -> None:
        """Check new values, and store them for `_apply_parameters`, which rclpy calls next."""
        before, changed = self.configuration, {}
        self._next = before
        for parameter in parameters:
            if parameter.name == 'use_sim_time' and parameter.value != self._uses_sim_time:
                raise ConfigurationError(
                    "parameter 'use_sim_time' is only read when the process starts"
                )
            if is_own_parameter(parameter.name):
                if parameter.type_ is Parameter.Type.NOT_SET:
                    raise ConfigurationError(f"parameter '{parameter.name}' cannot be unset")
                changed[parameter.name] = parameter.value
        if not changed:
            return
        after = changed_configuration(before, changed)
        if self._runner.loop is not None:
            for name in changed:
                field = name.partition('.')[0]
                is_live = field in PARAMETERS and PARAMETERS[field].is_live
                if not is_live and getattr(before, field) != getattr(after, field):
                    raise ConfigurationError(
                        f"parameter '{name}' is only read when the node is configured; deactivate "
                        'and clean up the node first'
                    )
            check_configuration(self._runner.loop, after)
        is_beginning = before.dry_run and not after.dry_run
        if is_beginning and not after.ignore_controller_joints and self._runner.objection:
            raise ConfigurationError(f'the dry run goes on: {self._runner.objection}')
        self._next = after

    def _apply_parameters(self, parameters: list[Parameter]) -> None:
        if self._next is self.configuration:
            return
        self._runner.apply(self._next)
        if self._runner.loop is None:
            self.autostart()

    # Robot description

    def _has_description(self) -> bool:
        configuration = self.configuration
        return bool(
            configuration.robot_description
            or configuration.robot_description_file
            or self._description
        )

    def _on_robot_description(self, message: String) -> None:
        configuration = self.configuration
        if configuration.robot_description or configuration.robot_description_file:
            return
        if message.data == self._description:
            return
        self._description = message.data
        loop = self._runner.loop
        if loop is None:
            self.autostart()
            return
        is_outdated = message.data != loop.description
        if is_outdated and not loop.is_outdated:
            name = self.get_fully_qualified_name()
            self.get_logger().warning(
                f'{OUTDATED}: for x in deactivate cleanup configure activate; do ros2 lifecycle '
                f'set {name} $x; done'
            )
        loop.is_outdated = is_outdated
