"""
Draw the robot of the README: `make pictures` writes doc/images/payload.png.

The Stanford arm is held by springs and picks up a load, before and after the node knows of it.
MuJoCo simulates and renders the arm; the efforts are those of the Python library.
"""

import os
from pathlib import Path

os.environ.setdefault('MUJOCO_GL', 'egl')  # renders without a screen

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.cli.pictures import style
from matplotlib.figure import Figure
import mujoco
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
URDF = ROOT / 'config' / 'stanford.urdf'
POSE = np.array([0.0, 0.9, 0.75, 0.0, 0.67, 0.0])  # [rad], joint 3 slides [m]
STIFFNESS = np.array([60.0, 60.0, 600.0, 20.0, 20.0, 20.0])  # [N m/rad], joint 3 [N/m]
DAMPING = np.sqrt(STIFFNESS)
LOAD, ABOVE, HALF = 2.0, 0.06, 0.06  # [kg]; centre and half width of the cube [m]
SETTLED = 12.0  # [s]
VISIBLE = 0.01  # [rad, m]
WIDTH, HEIGHT = 600, 500
SCENES = (
    ('the node compensates gravity', 0.0, 0.0),
    ('2 kg that the node does not know', LOAD, 0.0),
    ('the load is published on ~/payload', LOAD, LOAD),
)


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


def main():
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
    figure.savefig(ROOT / 'doc' / 'images' / 'payload.png')


if __name__ == '__main__':
    main()
