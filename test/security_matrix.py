"""
Runs the node and the programs around it with SROS 2 under Enforce.

Usage: python test/security_matrix.py LIBRARY...

The wheels of PyPI contain Fast DDS without security. LIBRARY... replace their libraries:
libfastrtps.so of Fast DDS 2.14.5, and librmw_fastrtps_shared_cpp.so, both compiled with security.
The Python packages sros2 0.13.0 and cryptography 41.0.7 create the keystores. The program takes a
few minutes, because it waits for connections that must not come about.

"""

import contextlib
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from domain_coordinator import domain_id
from node_process import MAIN
from robot_files import ROOT, STANFORD

POLICY = ROOT / 'config/sros2/policy.xml'
COMMAND = '-m', 'inverse_dynamics_node.cli.main'
ROS2 = (str(ROOT / 'test/ros2.py'),)
NODE = '-m', MAIN, '--ros-args', '-p', f'robot_description_file:={STANFORD}'
ROBOT = *COMMAND, 'simulate', str(STANFORD), '--rate', '100', '--commands'
PAYLOAD = '{"header": {"frame_id": "link_6"}, "inertia": {"m": 0.1}}'
NEEDS = 'expected Fast DDS and rmw_fastrtps_shared_cpp compiled with -DSECURITY=ON'
PATIENCE = 120.0  # [s]; ten times as long as a loaded machine needs


class Programs:
    """Starts programs in enclaves, and ends them."""

    def __init__(self, folder, settings):
        self._folder = folder
        self._settings = settings
        self._running = []
        self._started = 0

    def start(self, enclave, *arguments, **settings):
        """Start Python in an enclave, or without security if the enclave is None."""
        own = {'ROS_SECURITY_ENCLAVE_OVERRIDE': enclave or ''}
        own['ROS_SECURITY_ENABLE'] = 'true' if enclave else 'false'
        self._started += 1
        log = self._folder / f'{self._started}.log'
        with log.open('w') as file:
            process = subprocess.Popen(
                [sys.executable, *arguments],
                env={**os.environ, **self._settings, **own, **settings},
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        self._running.append(process)
        return process, log

    def result(self, *arguments, **settings):
        """Return the exit code and the output of a program."""
        process, log = self.start(*arguments, **settings)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
        return process.poll(), log.read_text()

    def end(self):
        """End all programs; SIGTERM first, so that the node can stop the arm."""
        for process in self._running:
            process.terminate()
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20.0)
            process.kill()
            process.wait()
        self._running.clear()


def set_payload(parent=''):
    topic = f'{parent}/inverse_dynamics/payload'
    return *ROS2, 'topic', 'pub', '--once', topic, 'geometry_msgs/msg/InertiaStamped', PAYLOAD


def check_model(parent=''):
    name = f'{parent}/inverse_dynamics/check_model'
    return *ROS2, 'service', 'call', name, 'std_srvs/srv/Trigger', '{}'


def keystore(path, policy, enclaves):
    """Create a keystore for the domain in the environment."""
    from sros2.keystore import create_enclave, create_keystore, create_permission

    create_keystore(path)
    for enclave in enclaves:
        create_enclave(path, enclave)
        create_permission(path, enclave, policy)
    return str(path)


def wait_for_text(log, text):
    """Wait for a text in a log; return whether it came."""
    end = time.monotonic() + PATIENCE
    while text not in log.read_text() and time.monotonic() < end:
        time.sleep(0.1)
    return text in log.read_text()


def running(programs, parent, node):
    """Start node and robot, and yield what works."""
    topic = f'{parent}/inverse_dynamics'.lstrip('/')
    _, log = programs.start(f'{parent}/inverse_dynamics', *node)
    ros = ['--ros-args', '-r', f'__ns:={parent}'] if parent else []
    programs.start(f'{parent}/driver', *ROBOT, f'/{topic}/commands', *ros)
    where = f'with namespace {parent}: ' if parent else ''
    yield f'{where}node and robot', wait_for_text(log, 'efforts for'), log.read_text()
    code, text = programs.result(f'{parent}/watch', *COMMAND, 'watch', f'/{topic}', '--for', '3')
    yield f'{where}watch', code == 0 and 'model and robot agree' in text, text
    dry_run = *ROS2, 'param', 'set', f'/{topic}', 'dry_run', 'false'
    for what, arguments, expected in (
        ('parameter', dry_run, 'Set parameter successful'),
        ('payload', set_payload(parent), ''),
        ('service', check_model(parent), 'success=True'),
    ):
        code, text = programs.result(f'{parent}/operator', *arguments)
        yield f'{where}operator: {what}', code == 0 and expected in text, text


def refused(programs, stores):
    """Yield what must not work, while the node runs."""
    ways = set_payload(), check_model()
    outside = [programs.start(None, *way) for way in ways]
    for (process, log), what in zip(outside, ('payload', 'service'), strict=True):
        code = process.wait(PATIENCE)
        yield (
            f'no certificate: {what} refused',
            code and 'not within' in log.read_text(),
            log.read_text(),
        )
    for what, way in zip(('payload', 'service'), ways, strict=True):
        code, text = programs.result('/watch', *way)
        yield f'/watch: {what} refused', code and 'not found in allow rule' in text, text
    for what, words in (
        ('topic missing in the policy', 'Failed to create subscription'),
        ('keystore of another domain', 'ros_discovery_info'),
    ):
        code, text = programs.result(
            '/inverse_dynamics', *NODE, ROS_SECURITY_KEYSTORE=stores[what]
        )
        yield f'{what}: node refused', code == 1 and words in text, text


def main(libraries):
    os.environ['AMENT_PREFIX_PATH'] = sys.prefix  # where sros2 looks for its files
    try:
        import sros2  # noqa: F401
    except ImportError as error:
        print(f'{error}: expected the Python packages sros2 0.13.0 and cryptography 41.0.7')
        return 1
    wrong = [each for each in libraries if not Path(each).is_file()]
    if wrong or not libraries:
        print(f'{" ".join(wrong) or "no library was given"}: {NEEDS}')
        return 1
    with domain_id() as domain, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settings = {
            'LD_PRELOAD': ' '.join(libraries),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_DOMAIN_ID': str(domain),
            'ROS_SECURITY_KEYSTORE': str(folder / 'keystore'),
            'ROS_SECURITY_STRATEGY': 'Enforce',
        }
        left = folder / 'left.xml'
        remaps = '--ros-args', '-r', '__ns:=/left', '-r', 'joint_states:=/left/joint_states'
        arguments = [sys.executable, '-m', MAIN, '--policy', *remaps]
        left.write_text(
            subprocess.run(arguments, check=True, stdout=subprocess.PIPE, text=True).stdout
        )
        kinds = '/inverse_dynamics', '/driver', '/watch', '/operator'
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        keystore(folder / 'keystore', POLICY, kinds)
        keystore(folder / 'left', left, [f'/left{kind}' for kind in kinds])
        lacking = folder / 'lacking.xml'
        text = POLICY.read_text()
        lacking.write_text(text.replace('<topic>/inverse_dynamics/gravity</topic>', '', 1))
        stores = {'topic missing in the policy': keystore(folder / 'lacking', lacking, kinds[:1])}
        os.environ['ROS_DOMAIN_ID'] = str(domain + 1)
        stores['keystore of another domain'] = keystore(folder / 'other', POLICY, kinds[:1])
        programs = Programs(folder, settings)
        lines = []
        try:
            _, text = programs.result('/watch', *COMMAND, 'watch', '--for', '1')
            if "doesn't have the security libraries" in text:
                print(f'{" ".join(libraries)}: no security, {NEEDS}')
                return 1
            lines += report(running(programs, '', NODE))
            lines += report(refused(programs, stores))
            programs.end()
            settings['ROS_SECURITY_KEYSTORE'] = str(folder / 'left')
            lines += report(running(programs, '/left', (*NODE, *remaps[1:])))
        finally:
            programs.end()
    print(f'{sum(lines)} of {len(lines)} as expected')
    return int(not all(lines))


def report(checks):
    """Print checks; return whether each is as expected."""
    found = []
    for name, is_well, output in checks:
        print(f'{name}: {"as expected" if is_well else f"failed{chr(10)}{output}"}', flush=True)
        found.append(bool(is_well))
    return found


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
