"""
Draw the pictures of the README and of the pages in doc/images: `make pictures`.

payload.png shows the Stanford arm, held by springs, which picks up a load, before and after the
node knows of it. MuJoCo simulates and renders the arm; the efforts are those of the library.

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

os.environ.setdefault('MUJOCO_GL', 'egl')  # renders without a screen

from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.cli.live_view import screen
from inverse_dynamics_node.cli.main import main as main_of_commands
from inverse_dynamics_node.cli.pictures import style
from inverse_dynamics_node.cli.watch import _Watch
from inverse_dynamics_node.ros.observer import find_nodes, Observer, observing_node
from matplotlib.figure import Figure
import mujoco
import numpy as np
from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console
from simulated_runs import simulate_with_a_gripper, write_bag, write_csv

ROOT = Path(__file__).resolve().parent.parent
URDF, IMAGES = ROOT / 'config' / 'stanford.urdf', ROOT / 'doc' / 'images'
POSE = np.array([0.0, 0.9, 0.75, 0.0, 0.67, 0.0])  # [rad], joint 3 slides [m]
STIFFNESS = np.array([60.0, 60.0, 600.0, 20.0, 20.0, 20.0])  # [N m/rad], joint 3 [N/m]
DAMPING = np.sqrt(STIFFNESS)
LOAD, ABOVE, HALF = 2.0, 0.06, 0.06  # [kg]; centre and half width of the cube [m]
SETTLED = 12.0  # [s]
VISIBLE = 0.01  # [rad, m]
WIDTH, HEIGHT = 600, 500
NODE, COLUMNS, WATCHED = '/inverse_dynamics', 104, 15.0  # [s]
SCENES = (
    ('the node compensates gravity', 0.0, 0.0),
    ('2 kg that the node does not know', LOAD, 0.0),
    ('the load is published on ~/payload', LOAD, LOAD),
)
PICTURES = {
    'check': 'check config/stanford.urdf --picture check.png',
    'effort': 'effort config/stanford.urdf doc/stanford_pick.yaml --payload 2 --link tool0',
    'compare': 'compare config/stanford.urdf run',
    'identify': 'identify my_arm.urdf run_1.csv --validate run_2.csv --output calibrated.urdf'
    ' --parameters node.yaml --json report.json',
    'closed_loop': 'demo config/stanford.urdf --picture closed_loop.png',
}


def world(load):
    """Return the MuJoCo model of the arm with its shapes, on a floor."""
    text = URDF.read_text()
    settings = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco></robot>'
    spec = mujoco.MjSpec.from_string(text.replace('</robot>', settings))
    spec.option.timestep = 0.001
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.add_texture(
        name='sky', type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=32, height=192,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=[1, 1, 1], rgb2=[1, 1, 1],
    )  # fmt: skip
    spec.visual.headlight.ambient[:] = 0.45
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.worldbody.add_light(pos=[1, -2, 3], dir=[-0.3, 0.6, -1], castshadow=False)
    if load:
        spec.body('tool0').add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[HALF] * 3, pos=[0, 0, ABOVE], mass=load,
            rgba=[0.9, 0.62, 0, 1],
        )  # fmt: skip
    return spec.compile()


def settle(model, known):
    """Return the state of the arm after its springs have come to rest."""
    dynamics = InverseDynamics(load_urdf(URDF))
    if known:
        inertia = known * (2 * HALF) ** 2 / 6 * np.eye(3)
        dynamics.set_payload('tool0', known, com=(0.0, 0.0, ABOVE), inertia=inertia)
    model.dof_damping[:] = DAMPING
    data = mujoco.MjData(model)
    data.qpos[:] = POSE
    for _ in range(int(SETTLED / model.opt.timestep)):
        springs = STIFFNESS * (POSE - data.qpos)  # MuJoCo adds the dampers
        data.qfrc_applied[:] = dynamics.gravity_efforts(data.qpos) + springs
        mujoco.mj_step(model, data)
    return data


def render(model, data):
    """Return an image of the arm, and the pose that it should have, in blue, if that differs."""
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = [0.36, 0.0, 0.5], 1.75
    camera.azimuth, camera.elevation = 100, -8
    wanted = mujoco.MjData(model)
    wanted.qpos[:] = POSE
    mujoco.mj_forward(model, wanted)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera)
        first = renderer.scene.ngeom
        if np.abs(data.qpos - POSE).max() > VISIBLE:
            mujoco.mjv_addGeoms(
                model, wanted, mujoco.MjvOption(), mujoco.MjvPerturb(),
                mujoco.mjtCatBit.mjCAT_DYNAMIC, renderer.scene,
            )  # fmt: skip
        for geom in renderer.scene.geoms[first : renderer.scene.ngeom]:
            geom.rgba = [0.0, 0.45, 0.7, 0.25]
        return renderer.render()


def draw_arm():
    """Draw the scenes side by side."""
    figure = Figure(figsize=(9.0, 2.8), dpi=150, layout='constrained')
    for axes, (title, load, known) in zip(figure.subplots(1, len(SCENES)), SCENES, strict=True):
        model = world(load)
        data = settle(model, known)
        distance = np.abs(data.qpos - POSE)[1]
        axes.imshow(render(model, data))
        axes.set_axis_off()
        axes.set_title(title, fontsize=10, color=style.DARK)
        print(f'{title}: joint_2 is {1e3 * distance:.2f} mrad off')
    figure.savefig(IMAGES / 'payload.png')


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
    options = argparse.Namespace(node=NODE, duration=WATCHED, rate=None, json=False)
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
    draw_arm()
    draw_commands()
    draw_watch('watch_agree', '1.0', 0.0)
    draw_watch('watch_sign', '[1.0, -1.0, 1.0, 1.0, 1.0, 1.0]', 0.0)
    draw_watch('watch_payload', '1.0', 2.0)


if __name__ == '__main__':
    main()
