"""
Runs the node and its driver on two machines that are connected by a faulty network.

The machines are network namespaces of this machine. An arm swings while packets are lost, late,
duplicated or reordered, and while the network is down. The program checks every command that the
node sends:

- A step between two commands must be explained by the motion of the arm and by ramps.
- The efforts must be zero in time after joint states are lost.
- The efforts must return without a restart.

The program prints a table for doc/evidence/reliability.md, and fails if a check fails.

"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import contextlib
import math
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any, NamedTuple

from faulty_network import enter, MACHINES, Network, run_first
from fork_server import MAIN
from inverse_dynamics_node import InverseDynamics, load_urdf
from node_process import heed_signals, NodeProcess, RUNNING
import numpy as np
from rclpy.context import Context
from robot_side import RATE, RobotSide
from sensor_msgs.msg import JointState
from stalls import StallMeter, TOLERATED

SETTINGS = {
    # The two namespaces are connected only to each other: no packet leaves this machine.
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4',  # the namespaces share memory
    'ROS_DOMAIN_ID': '1',
}
ROBOT = Path(__file__).parent.parent / 'test/robots/seven_dof.urdf'
MODEL = load_urdf(ROBOT)
STATE_TIMEOUT, RAMP = 0.1, 0.5  # [s]; defaults of the node
RETURN = 2.0 * STATE_TIMEOUT  # [s]; time of joint states without a gap until efforts rise again
SLACK = 0.4  # [s]; tolerance for the end of a ramp on a busy machine
LATENESS = 0.03  # [s]; delay of a joint state without faults: its period, and a busy machine
NOMINAL = 2.0 / RATE  # [s]; largest time by which a ramp advances with one command
DISCOVERY = 10.0  # [s]; time in which the middleware finds the other machine again
SETTLED = 0.05  # largest difference of command and model, relative to the effort limits
WATCHED = 2.5  # [s]; time of checks after an outage
FAULTS = {
    'none': {},
    '1 % lost': {'loss': 0.01},
    '10 % lost': {'loss': 0.1},
    '20 ms of jitter': {'jitter': 0.02},
    '10 % duplicated': {'duplicates': 0.1},
    '10 % lost, 50 ms late, 20 ms of jitter, 10 % duplicated': {
        'loss': 0.1,
        'delay': 0.05,
        'jitter': 0.02,
        'duplicates': 0.1,
    },
}
OUTAGES = 0.05, 0.1, 0.2, 0.5, 1.0, 2.0  # [s]
LONG_OUTAGE = 30.0  # [s]; the middleware forgets the other machine after 20 s


class BrokenPromiseError(Exception):
    """A command violates one of the checks."""


class Swing:
    """The motion of the arm: the second joint, which carries the arm, swings at up to 1 rad/s."""

    def __init__(self) -> None:
        self._dynamics = InverseDynamics(MODEL)
        self._began = time.monotonic()
        self.message = JointState(name=MODEL.joint_names)
        times = self._began + np.linspace(0.0, math.pi, 500)  # one period
        efforts = np.array([self.efforts(at) for at in times])
        self.peak = np.abs(efforts).max(axis=0)
        """Largest efforts during the motion, shape (7,) [N m]."""
        self.rate = np.abs(np.diff(efforts, axis=0)).max(axis=0) / (times[1] - times[0])
        """Largest rate of change of the efforts, shape (7,) [N m/s]."""

    def state(self, at: float) -> tuple[Any, Any]:
        """Return positions and velocities at a time of the steady clock [s]."""
        q, qd = np.zeros((2, 7))
        q[1], qd[1] = 1.0 + 0.5 * math.sin(2.0 * (at - self._began)), 0.0
        qd[1], q[3] = math.cos(2.0 * (at - self._began)), 0.5
        return q, qd

    def efforts(self, at: float) -> Any:
        """Return the efforts of the motion without accelerations, shape (7,) [N m]."""
        return self._dynamics.efforts(*self.state(at), np.zeros(7))

    def next_message(self) -> JointState:
        """Return the joint state for the current time."""
        q, qd = self.state(time.monotonic())
        self.message.position, self.message.velocity = q.tolist(), qd.tolist()
        return self.message


class Monitor:
    """
    Receives the commands in a process on the machine of the node, where the network has no faults.

    A separate process is needed, because Fast DDS looks up network interfaces only once.
    """

    def __init__(self, network: Network) -> None:
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'benchmarks.command_monitor'],
            stdout=subprocess.PIPE,
            preexec_fn=lambda: enter(network.machines['node']),
        )
        assert self._process.stdout
        self._records = self._process.stdout.fileno()
        os.set_blocking(self._records, False)
        self._rest = b''
        self.times: list[float] = []
        """Times of the steady clock at which the commands arrived [s]."""
        self.efforts: list[Any] = []

    def poll(self) -> None:
        """Store the commands that have arrived."""
        size = 8 * (1 + len(MODEL.joint_names))
        try:
            data = self._rest + os.read(self._records, 1 << 20)
        except BlockingIOError:
            return
        whole = len(data) // size * size
        self._rest = data[whole:]
        for record in np.frombuffer(data[:whole]).reshape(-1, size // 8):
            self.times.append(record[0])
            self.efforts.append(record[1:])

    def close(self) -> None:
        """End the monitor process."""
        self._process.terminate()
        self._process.communicate()


class Row(NamedTuple):
    """The measurements with one fault."""

    fault: str
    rate: float
    """Commands per second that the node sent."""
    gap: float
    """Longest time between two commands [s]."""
    step: float
    """Largest step between two commands [N m]."""
    beyond: float
    """Excess of a step over the sum of motion and ramps [N m]."""
    lowest: float
    """Smallest command before the efforts had returned, as a fraction of the model's efforts."""
    back: float
    """Time from the end of the fault until the efforts had returned [s]."""
    step_at_driver: float
    """Largest step between two commands that arrived at the driver [N m]."""

    def __str__(self) -> str:
        back = f'{self.back:.2f}' if self.back else ''
        cells = (
            self.fault,
            f'{self.rate:.0f}',
            f'{1000.0 * self.gap:.0f}',
            f'{self.step:.1f}',
            f'{self.beyond:.1f}',
            f'{100.0 * self.lowest:.0f} %',
            back,
            f'{self.step_at_driver:.1f}',
        )
        return f'| {" | ".join(cells)} |'.replace('|  |', '| |')


HEAD = """\
| fault | commands per second | longest gap [ms] | largest step [N m] | of it beyond motion and \
ramps [N m] | lowest effort | back after [s] | largest step at the driver [N m] |
|---|---|---|---|---|---|---|---|"""


class Rig:
    """
    A driver with a swinging arm, the node, and a monitor on the machine of the node.

    The thread that creates the rig must be on the machine of the driver.
    """

    def __init__(self, network: Network, node: Any) -> None:
        self.network, self.node = network, node
        self.swing = Swing()
        self._log = 0  # number of characters in the log before the fault
        self.monitor = Monitor(network)
        context = Context()
        context.init(args=[])
        self.robot = RobotSide(context)
        self.robot._always.append((self.robot._states, self.swing.next_message))

    def close(self) -> None:
        """Close the driver's ROS interfaces, and end the monitor."""
        self.robot.close()
        self.monitor.close()

    def wait(self, is_true: Callable[[], bool], what: str) -> None:
        """Run the driver until a condition is true."""

        def check() -> bool:
            self.monitor.poll()
            return is_true()

        self.robot.wait_until(check, what)

    def pause(self, duration: float) -> float:
        """Run the driver for a duration [s]; return the time of the steady clock at the end."""
        end = time.monotonic() + duration
        self.wait(lambda: time.monotonic() >= end, f'{duration} s')
        return time.monotonic()

    def is_settled(self) -> bool:
        """Return whether the latest command matches the motion, and reaches the driver."""
        monitor, recent = self.monitor, time.monotonic() - STATE_TIMEOUT
        if any(
            not times or times[-1] < recent for times in (monitor.times, self.robot.command_times)
        ):
            return False
        off = np.abs(np.array(monitor.efforts[-1]) - self.swing.efforts(monitor.times[-1]))
        return bool((off < SETTLED * MODEL.effort_limits).all())

    def suffer(self, name: str, duration: float, faults: dict[str, Any]) -> Row:
        """
        Disturb the network for a duration [s], and return the effect on the commands.

        Raise a BrokenPromiseError if a step is too large, or efforts fall or return too late.
        """
        self.wait(self.is_settled, 'efforts of the motion')
        self.pause(0.3)
        first, first_arrived = len(self.monitor.times) - 1, len(self.robot.commands) - 1
        self._log = len(self.node.output)
        self.network.set(**faults)
        began = time.monotonic()
        end = self.pause(duration)
        self.network.set()
        is_outage = 'cut' in faults
        if is_outage:
            self.wait(self.is_settled, 'efforts after the outage')
        back = time.monotonic() - end
        self.pause(WATCHED - min(back, WATCHED) if is_outage else 0.3)
        times = np.array(self.monitor.times[first:])
        efforts = np.array(self.monitor.efforts[first:])
        gaps, steps = np.diff(times), np.abs(np.diff(efforts, axis=0))
        late = LATENESS + faults.get('delay', 0.0) + faults.get('jitter', 0.0)
        moved = np.minimum(gaps, STATE_TIMEOUT)[:, None] + late
        explained = moved * self.swing.rate + NOMINAL / RAMP * self.swing.peak
        during = (times > began) & (times < end)
        at_driver = np.abs(np.diff(self.robot.commands[first_arrived:], axis=0))
        row = Row(
            name,
            float(during.sum() / (end - began)),
            float(gaps.max()),
            float(steps.max()),
            float(max(0.0, (steps - explained).max())),
            float(self._shares(times, efforts, late).min()),
            back if is_outage else 0.0,
            float(at_driver.max()),
        )
        self._check(row, duration, is_outage)
        if 'driver' in faults.get('cut', ()):
            self._check_fall(times - began, efforts, duration)
        return row

    def _shares(self, times: Any, efforts: Any, late: float) -> Any:
        """Return commands as fractions of the model's efforts for joint states that are late."""
        found = []
        for delay in np.linspace(0.0, late + STATE_TIMEOUT, 6):
            modelled = np.array([self.swing.efforts(at - delay) for at in times])
            found.append((efforts * modelled).sum(axis=1) / (modelled**2).sum(axis=1))
        return np.max(found, axis=0)

    def _check(self, row: Row, duration: float, is_outage: bool) -> None:
        if row.beyond:
            raise BrokenPromiseError(f'{row.fault}: {row.beyond:.2f} N m beyond motion and ramps')
        if not is_outage and 'ramping efforts down' in self.node.output[self._log :]:
            raise BrokenPromiseError(f'{row.fault}: the efforts fell')
        longest = RETURN + RAMP + SLACK + (DISCOVERY if duration >= LONG_OUTAGE else 0.0)
        if row.back > longest:
            raise BrokenPromiseError(f'{row.fault}: back after {row.back:.2f} s')

    def _check_fall(self, times: Any, efforts: Any, duration: float) -> None:
        """Check that efforts fall in time after the loss of joint states at the time 0."""
        fall = (times > STATE_TIMEOUT + LATENESS) & (times < duration)
        grown = np.diff(np.abs(efforts[fall]), axis=0)
        if (grown > 1e-9).any():
            raise BrokenPromiseError(f'an effort grew by {grown.max():.3f} N m in a fall')
        late = (times > STATE_TIMEOUT + RAMP + SLACK) & (times < duration)
        if efforts[late].any():
            raise BrokenPromiseError(f'no zeros {STATE_TIMEOUT + RAMP + SLACK} s after the loss')


def suffer_without_stalls(rig: Rig, *case: Any) -> Row:
    """Measure; repeat the measurement if it failed because the machine stood still."""
    for attempts_left in (2, 1, 0):
        with StallMeter() as stalls:
            try:
                return rig.suffer(*case)
            except BrokenPromiseError:
                if not attempts_left or stalls.longest <= TOLERATED:
                    raise
    raise AssertionError


def measure(rig: Rig, seconds: float, repetitions: int, only: str) -> None:
    """Measure with each fault, and print the rows of the table."""
    cases = [(name, seconds, faults, 1) for name, faults in FAULTS.items()]
    cut = {'cut': MACHINES}
    cases += [(f'down for {each:g} s', each, cut, repetitions) for each in OUTAGES]
    one_way = 'commands lost for 1 s, joint states not'
    cases += [(one_way, 1.0, {'cut': ['node']}, repetitions)]
    cases += [(f'down for {LONG_OUTAGE:g} s', LONG_OUTAGE, cut, 1)]
    print(HEAD)
    for name, duration, faults, count in cases:
        if not name.startswith(only):
            continue
        each = [suffer_without_stalls(rig, name, duration, faults) for _ in range(count)]
        worst = [max(row[k] for row in each) for k in range(1, len(each[0]))]
        lowest, rate = min(row.lowest for row in each), min(row.rate for row in each)
        print(Row(name, *worst)._replace(lowest=lowest, rate=rate), flush=True)


def main() -> int:
    """Start the program in a user namespace, and run all faults; return the exit code."""
    parser = argparse.ArgumentParser(prog='make network-faults', description=__doc__)
    parser.add_argument('--seconds', type=float, default=5.0, help='time with each fault')
    parser.add_argument('--repetitions', type=int, default=3, help='of each outage')
    parser.add_argument('--only', default='', help='only faults that begin with this')
    options = parser.parse_args()
    if os.geteuid():  # start again as root of a user namespace
        arguments = [sys.executable, '-m', 'benchmarks.network_faults', *sys.argv[1:]]
        os.environ['PYTHONPATH'] = str(ROBOT.parents[1])
        os.execvp('unshare', ['unshare', '-rn', *arguments])
    heed_signals()
    os.environ.update(SETTINGS)
    try:
        network = Network()
    except OSError as error:
        print(f'{error}: network namespaces and /dev/net/tun are needed', file=sys.stderr)
        return 2
    with contextlib.closing(network), network.on('driver'):
        return run(network, options)


def run(network: Network, options: argparse.Namespace) -> int:
    """Run all faults and print the table; return the exit code."""
    # The motion may be as fast as it likes: faults of the network must not look like an arm that
    # is pushed, whose efforts fade.
    parameters = {'robot_description_file': ROBOT, 'velocity_limits': 0.0}
    machine = network.machines['node']
    domain_id = os.environ['ROS_DOMAIN_ID']
    node = NodeProcess(domain_id, (), parameters, ('-m', MAIN), lambda: enter(machine), False)
    RUNNING.append(node)
    run_first()
    rig = Rig(network, node)
    try:
        measure(rig, options.seconds, options.repetitions, options.only)
        node.interrupt()
        code = rig.robot.wait_for_end(node)
    except (BrokenPromiseError, AssertionError) as failure:
        print(f'FAILED: {failure}\n{node.output[-3000:]}', file=sys.stderr)
        return 1
    finally:
        node.kill()
        rig.close()
    print(f'All promises were kept; the node ended with code {code}.')
    return int(code)


if __name__ == '__main__':
    sys.exit(main())
