"""
Draw the pictures of the README and of the pages in doc/images: `make pictures`.

watch_*.svg are screens of `inverse_dynamics watch` beside a node and a simulated robot. The other
pictures are those of the commands; their reports, which the pages show too, are printed.
"""

import argparse
from contextlib import contextmanager
import io
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.cli.live_view import screen
from inverse_dynamics_node.cli.main import main as main_of_commands
from inverse_dynamics_node.cli.watch import _Watch
from inverse_dynamics_node.ros.observer import find_nodes, Observer, observing_node
import numpy as np
from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console
from simulated_runs import simulate_with_a_gripper, write_bag, write_csv

ROOT = Path(__file__).resolve().parent.parent
URDF, IMAGES = ROOT / 'config' / 'stanford.urdf', ROOT / 'doc' / 'images'
NODE, COLUMNS, WATCHED = '/inverse_dynamics', 104, 15.0  # [s]
PICTURES = {
    'effort': 'effort config/stanford.urdf doc/stanford_pick.yaml --payload 2 --link tool0',
    'compare': 'compare config/stanford.urdf run',
    'identify': 'identify my_arm.urdf run_1.csv --validate run_2.csv --output calibrated.urdf'
    ' --parameters node.yaml',
    'closed_loop': 'demo config/stanford.urdf --picture closed_loop.png',
}


@contextmanager
def running(*command):
    """Run a module of the package until the end of the context."""
    process = subprocess.Popen([sys.executable, '-m', *command], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def draw_watch(name, scale, load):
    """Draw the screen of `watch` in a dry run."""
    node = ['inverse_dynamics_node.node.main', '--ros-args', '-p', 'dry_run:=true']
    node += ['-p', f'robot_description_file:={URDF}', '-p', f'measured_effort_scale:={scale}']
    node += ['-p', 'state_timeout:=0.5', '-r', '~/commands:=/forward_effort_controller/commands']
    robot = ['inverse_dynamics_node.cli.main', 'simulate', str(URDF), '--sway']
    with observing_node() as ros, running(*robot):
        while not ros.count_publishers('/joint_states'):
            time.sleep(0.1)
        if load:
            publish_load(ros, load)
        with running(*node):
            draw_screen(ros, name)


def draw_screen(ros, name):
    """Watch the node for a while, and write the last screen."""
    options = argparse.Namespace(node=NODE, duration=WATCHED, rate=None, json=False, unchecked=[])
    watch = _Watch(Observer(ros, NODE), lambda: find_nodes(ros), options)
    while watch.observer.status is None or not watch.observer.status.is_computing:
        watch._poll()
        time.sleep(0.01)
    watch._began = time.monotonic()
    watch._loop(lambda: None, 1.0)
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    console.print(screen(watch.observer, watch.sample, watch.agreement))
    page = re.sub(r'@font-face \{\{.*?\}\}', '', CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    page = page.replace('Fira Code', 'DejaVu Sans Mono')
    text = console.export_svg(title='inverse_dynamics watch', code_format=page, unique_id=name)
    (IMAGES / f'{name}.svg').write_text('\n'.join(map(str.rstrip, text.splitlines())) + '\n')


def publish_load(ros, mass):
    """Attach a load to the simulated robot, of which the node does not know."""
    from geometry_msgs.msg import InertiaStamped

    message = InertiaStamped()
    message.header.frame_id, message.inertia.m, message.inertia.com.z = 'tool0', mass, 0.05
    publisher = ros.create_publisher(InertiaStamped, '/simulated_robot/payload', 1)
    while not publisher.get_subscription_count():
        time.sleep(0.1)
    publisher.publish(message)
    publisher.wait_for_all_acked()


def draw_commands():
    """Draw the pictures of the commands, in a folder with the files of doc/command_line.md."""
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        for name in ('config', 'doc', 'test/robots'):
            shutil.copytree(ROOT / name, name)
        shutil.copy(URDF, 'my_arm.urdf')
        write_bag(Path('run'), simulate_with_a_gripper())
        robot, rng = load_urdf(URDF), np.random.default_rng(0)
        real = real_robot(robot, rng, load_friction=0.04)
        for name in ('run_1.csv', 'run_2.csv'):
            write_csv(Path(name), record(real, exciting_motion(robot, rng, 40.0, 100.0), rng))
        for name, command in PICTURES.items():
            print(f'$ inverse_dynamics {command}', flush=True)
            before = {*Path().glob('*.png')}
            if main_of_commands(shlex.split(command)):
                sys.exit(f'{name} was not drawn')
            (drawn,) = {*Path().glob('*.png')} - before
            shutil.copy(drawn, IMAGES / f'{name}.png')
        os.chdir(ROOT)


def main():
    """Draw all pictures."""
    draw_commands()
    draw_watch('watch_agree', '1.0', 0.0)
    draw_watch('watch_sign', '[1.0, -1.0, 1.0, 1.0, 1.0, 1.0]', 0.0)
    draw_watch('watch_payload', '1.0', 2.0)


if __name__ == '__main__':
    main()
