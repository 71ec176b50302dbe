"""Steps the control loop on time, even during a stop or a flood of messages."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any

from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode
from rclpy.task import Future
from rclpy.timer import Timer

from ..control.loop import Command, ControlLoop
from ..control.stop_damping import AT_REST
from ..control.supervisor import COMPUTING_PHASES
from ..errors import listed, shortened_lines
from ..ros.controllers import Controllers
from ..ros.graph import Graph
from .configure import apply_configuration
from .log import NodeLog
from .monitor import Monitor
from .outputs import Outputs
from .parameters import Configuration
from .status_text import describe_controllers

_WATCH_PERIOD = 0.01  # [s]; between steps or checks while no joint states arrive
_MAX_WATCH_PERIOD = 0.1  # [s]; between checks while joint states arrive
_ZEROS_TIME = 1.0  # [s]; zeros are repeated for this long before the process ends
_POLL_PERIOD = 0.0005  # [s]; between checks for a joint state during stop damping
_TIMEOUT = 0.1  # [s]; time-out of a spin that is not interrupted
_PATIENCE = 0.03  # [s]; a spin that is this late is interrupted
_CHECK_PERIOD = 0.05  # [s]; between checks for a late spin
_SHORT_TIMEOUT = 0.01  # [s]; the three short times apply during a flood of messages
_SHORT_PATIENCE = 0.005
_SHORT_CHECK_PERIOD = 0.01


class LoopRunner:
    """
    Steps the control loop and publishes its commands.

    `clock` drives the timers, and `now` returns the time of `clock` [s]. `signals` returns how
    many signals to end have arrived; the second ends the stop ramp.
    """

    def __init__(
        self,
        node: LifecycleNode,
        outputs: Outputs,
        graph: Graph,
        log: NodeLog,
        clock: Clock,
        now: Callable[[], float],
        signals: Callable[[], int],
        configuration: Configuration,
    ) -> None:
        self._node, self.outputs, self.graph, self.log = node, outputs, graph, log
        self._clock, self._signals = clock, signals
        self.now = now
        self.controllers = Controllers(node, outputs.commands)
        self.configuration = configuration
        self.loop: ControlLoop | None = None
        """The loop for the current robot description; None while the node is unconfigured."""
        self.is_active = False
        self.monitor = Monitor()
        self._last_step = 0.0
        self._timers: list[Timer] = []

    def configure(self, loop: ControlLoop) -> None:
        """Prepare a control loop for `start`."""
        self.forget_robot()
        self.loop, configuration = loop, self.configuration
        self.monitor = Monitor(configuration.period)
        # This timer detects lost joint states at any update rate.
        self._watch_period = min(_WATCH_PERIOD, 0.5 * configuration.state_timeout)
        self._watch = self._create_timer(self._watch_period, self._on_watch)
        if configuration.period:
            self._create_timer(configuration.period, self._on_timer)
        self.log.report_robot(loop)
        self.outputs.publish_description(loop)

    def _create_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        self._timers.append(self._node.create_timer(period, callback, clock=self._clock))
        return self._timers[-1]

    def apply(self, configuration: Configuration) -> None:
        """Apply changed parameters that `check_configuration` has accepted."""
        before, self.configuration = self.configuration, configuration
        if self.loop is not None:
            apply_configuration(self.loop, configuration, before)
            self._watch_after(self._watch_period)

    def forget_robot(self) -> None:
        """Drop the loop and its timers."""
        self.loop = None
        self.is_active = False
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._timers = []

    def start(self) -> None:
        """Start to send commands; the efforts rise from zero."""
        assert self.loop is not None
        self.loop.start(is_dry_run=self.configuration.dry_run)
        self.monitor.pause()
        self.outputs.find_subscribers()
        self.log.begin()
        self.is_active = True

    @property
    def objection(self) -> str:
        """Why no commands may begin: a controller expects other commands; '' if none does."""
        if self.loop is None or self.configuration.ignore_controller_joints:
            return ''
        problem = describe_controllers(self.loop, self.controllers.known)
        return f'{problem} (ignore_controller_joints overrides this)' if problem else ''

    def find_controllers(self) -> None:
        """
        Ask new subscribers of the commands for their joints; stop if their joints are wrong.

        The arm is not stopped because of a late answer, or while another controller agrees.
        """
        new = self.controllers.poll()
        if not self.is_active or self.configuration.ignore_controller_joints:
            return
        assert self.loop is not None
        loop, known = self.loop, self.controllers.known
        has_friend = any(not describe_controllers(loop, [each]) for each in known)
        problem = describe_controllers(loop, [each for each in new if not each.is_late])
        if problem and not has_friend and not loop.dry_run.is_active:
            loop.limit_stop(problem)

    def reject(self, topic: str, reason: object, what: str = 'message') -> None:
        """Log and count a message that cannot be used; `what` names the unusable part."""
        self.monitor.reject(topic, shortened_lines(str(reason)))
        self.log.report_message(topic, f'{what} dropped: {reason}')

    def enable(self, *, is_enabled: bool) -> None:
        """Ramp the efforts up, or ramp the efforts down and drop the reference."""
        assert self.loop is not None
        if is_enabled:
            self.loop.resume()
        else:
            self.loop.stop()
            self._watch_after(self._watch_period)

    def step(self, now: float) -> None:
        """Compute and publish one command for the time `now` [s]."""
        assert self.loop is not None
        began = time.perf_counter()
        if self.loop.dry_run.is_active is not self.configuration.dry_run:
            self._switch_dry_run(self.loop)
        command = self.loop.step(now)
        if command is None:
            return
        self._publish(now, command)
        took = time.perf_counter() - began
        self.monitor.step(now, took, command, self.loop.joints)
        self._report_damping(command.end_of_damping)
        self.log.report_activity(now, self.loop)
        if command.lost_velocities:
            joints = ', '.join(command.lost_velocities)
            publishers = listed(self.graph.publishers('joint_states'))
            text = f'the velocities of {joints} are missing in new messages from {publishers}; '
            self.log.report_message('joint_states', f'{text}zero is used')
        if self.loop.phase in COMPUTING_PHASES:
            self.outputs.publish_external_efforts(self.loop)

    def _publish(self, now: float, command: Command) -> None:
        assert self.loop is not None
        self._last_step = now
        self.outputs.publish_command(self.loop, command.efforts, command.sent)

    def _switch_dry_run(self, loop: ControlLoop) -> None:
        """Start or end a dry run as configured; it can only end while the commands are zero."""
        is_wanted, has_sent = self.configuration.dry_run, loop.dry_run.has_sent
        time_to_fall = loop.shaper.time_to_fall
        if not loop.switch_dry_run(is_wanted=is_wanted):
            return
        if is_wanted and has_sent:
            text = f'dry run: the commands end after the stop ramp ({time_to_fall:.3g} s)'
        elif is_wanted:
            text = 'dry run: no commands are sent'
        else:
            to = self.graph.with_subscribers()
            text = f'end of the dry run: efforts rise from zero and are sent to {to}'
        self._node.get_logger().info(text)
        self.log.begin()

    def catch_up(self) -> None:
        """Do the overdue work of the timers; that of the loop is late after half a period."""
        now, period = self.now(), self.configuration.period
        if self.is_active and period and now > self._last_step + 1.5 * period:
            self.step(now)
        self._on_watch()

    def _on_timer(self) -> None:
        if self.is_active:
            self.step(self.now())

    def _on_watch(self) -> None:
        """Step if joint states are lost, or if the commands must ramp down without them."""
        if self.loop is None:  # the event was queued before its timer was destroyed
            return
        wait = self._watch_period
        if self.is_active:
            assert self.loop is not None
            now = self.now()
            state = self.loop.collector.state()
            timeout = self.configuration.state_timeout
            if state is None or not 0.0 <= now - state.time <= timeout:
                self.step(now)
            elif self._must_fall:
                # Joint states may be lost during the ramp, for example at an emergency stop.
                if not 0.0 <= now - self._last_step < self._watch_period:
                    self.step(now)
            else:
                # An earlier check cannot find a loss, and takes as long as a short step.
                wait = max(wait, min(state.time + timeout - now, _MAX_WATCH_PERIOD))
        self._watch_after(wait)

    @property
    def _must_fall(self) -> bool:
        """Whether the commands must fall to zero even if no joint states arrive."""
        assert self.loop is not None
        if self.loop.dry_run.is_active or self.configuration.dry_run:
            return self.loop.dry_run.has_sent
        is_computing = self.loop.phase in COMPUTING_PHASES and not self.loop.supervisor.is_stopping
        return not is_computing and self.loop.has_effort

    def _watch_after(self, wait: float) -> None:
        """Set the period of the watch timer to `wait` [s]."""
        period = round(wait * 1e9)
        if period != self._watch.timer_period_ns:
            self._watch.timer_period_ns = period
            self._watch.reset()

    def ramp_down(
        self, reason: str, serve: Callable[[], None], is_last: Callable[[], bool]
    ) -> None:
        """
        Ramp the efforts down to zero, and publish zeros.

        `reason` is for the log. `serve` handles the latest joint state and waiting requests. If
        `is_last` returns True at the end of the ramp, the process ends soon. If a receiver is best
        effort, the zeros are then repeated for a second: it may stand still, and gets nothing from
        a process that has ended.
        """
        assert self.loop is not None
        self.is_active = False
        if not self.loop.dry_run.has_sent:  # the robot does not depend on this node
            if self.loop.dry_run.is_active:
                self._node.get_logger().info(f'stopped: {reason} (dry run: nothing to ramp down)')
            return
        self._node.get_logger().info(f'ramping efforts down: {reason}')
        start, steady_start, now = self.now(), time.monotonic(), self.now
        # Simulated time does not advance during a callback.
        self.now = lambda: start + time.monotonic() - steady_start
        try:
            self._follow_stop_ramp(self.loop, serve)
        finally:
            self.now = now
            self.outputs.publish_zeros(self.loop)
        for_a_while = ''
        if is_last() and self.outputs.has_best_effort_receivers:
            for_a_while = f' for {_ZEROS_TIME:g} s'
            end = time.monotonic() + _ZEROS_TIME
            while time.monotonic() < end and self._signals() < 2:
                time.sleep(_WATCH_PERIOD)
                self.outputs.publish_zeros(self.loop)
        self._node.get_logger().info(f'stopped, zeros sent{for_a_while}: {reason}')

    def _follow_stop_ramp(self, loop: ControlLoop, serve: Callable[[], None]) -> None:
        loop.stop()
        damping, period = loop.stop_damping, self.configuration.period
        while loop.has_to_stop and self._signals() < 2:
            poll = period or _POLL_PERIOD if damping.is_active else self._watch_period
            time.sleep(min(poll, self._watch_period))
            last_state = loop.collector.time
            try:
                serve()
            except Exception as error:  # perhaps the error that caused the stop
                serve = lambda: None  # noqa: E731 -- it would fail again
                if damping.is_active:
                    damping.end()
                    self._report_damping(f'an error in the program ({error!r})')
            is_due = period or loop.collector.time != last_state or not damping.is_active
            if not is_due and self.now() < self._last_step + self._watch_period:
                continue
            now = self.now()
            command = loop.step(now)
            assert command is not None
            self._publish(now, command)
            self._report_damping(command.end_of_damping)

    def _report_damping(self, report: str) -> None:
        """Log why the stop damping has ended, if it has."""
        if not report:
            return
        assert self.loop is not None
        text = f'stop damping ended{" (dry run)" * self.loop.dry_run.is_active}: {report}'
        if report == AT_REST:
            self._node.get_logger().info(text)
        else:
            self._node.get_logger().warning(text)


class Watchdog:
    """
    Spins an executor, and ends each spin in time even if the event queue is never empty.

    The EventsExecutor of rclpy queues an event for each message, and timers wait behind the
    messages. A spin checks its time-out only if the queue is empty. Therefore a thread ends the
    spin between two events, and the caller does all overdue work. The events stay in the queue.
    Creating a new executor instead would drop the events, but in rclpy 7.1, services would then
    stop answering.
    """

    def __init__(self) -> None:
        self.is_congested = False
        """Whether the last spin had to be interrupted."""
        self._future = Future()
        self._deadline = float('inf')
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name='watchdog', daemon=True)
        self._thread.start()

    def spin(self, executor: Any) -> None:
        """Let an executor handle events for less than 0.2 s."""
        timeout, patience = (
            (_SHORT_TIMEOUT, _SHORT_PATIENCE) if self.is_congested else (_TIMEOUT, _PATIENCE)
        )
        future = self._future = Future()
        self._deadline = time.monotonic() + timeout + patience
        # spin() never returns in builds against an old C library, and spin_once() would return
        # after every message.
        executor.spin_until_future_complete(future, timeout_sec=timeout)
        self._deadline = float('inf')
        self.is_congested = future.done()

    @property
    def native_id(self) -> int:
        """Kernel id of the watchdog thread."""
        assert self._thread.native_id is not None
        return self._thread.native_id

    def close(self) -> None:
        """End the watchdog thread."""
        self._is_closed.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._is_closed.wait(
            _SHORT_CHECK_PERIOD if self.is_congested else _CHECK_PERIOD
        ):
            future = self._future
            if time.monotonic() > self._deadline and not future.done():
                future.set_result(None)
