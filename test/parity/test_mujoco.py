"""Agreement with MuJoCo on our own robots."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import assert_close
from loads import box_inertia, random_box
from lxml import etree
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import OUR_ROBOTS

mujoco = pytest.importorskip('mujoco')

RELATIVE = 1e-10  # to the largest effort; the order of summation differs
GRAVITY = (0.4, -1.2, -9.5)


def mujoco_model(path, payloads=()):
    """Compile a URDF with separate bodies and without masses from geometry."""
    root = etree.fromstring(path.read_bytes())
    for tag in ('visual', 'collision'):
        for element in root.findall(f'.//{tag}'):
            element.getparent().remove(element)
    settings = etree.SubElement(etree.SubElement(root, 'mujoco'), 'compiler')
    settings.set('fusestatic', 'false')
    settings.set('balanceinertia', 'false')
    try:
        spec = mujoco.MjSpec.from_string(etree.tostring(root, encoding='unicode'))
        for link, mass, com, inertia in payloads:
            load = spec.body(link).add_body(mass=mass, ipos=com, explicitinertial=True)
            load.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        model = spec.compile()
    except ValueError as error:
        pytest.skip(f'MuJoCo does not take it: {error}')
    model.opt.gravity = GRAVITY
    return model


class Fold:
    """Conversion of joint vectors: mimic joints are independent joints in MuJoCo."""

    def __init__(self, robot, model):
        names = [model.joint(k).name for k in range(model.njnt)]
        self.bodies = [robot.body_names.index(name) for name in names]
        self.robot = robot
        self.matrix = np.zeros((len(names), len(robot.joint_names)))
        joints = robot.joint_index[self.bodies]
        self.matrix[np.arange(len(names)), joints] = robot.multiplier[self.bodies]
        self.masters = [names.index(name) for name in robot.joint_names]

    def write(self, data, q, qd, qdd):
        data.qpos[:] = self.matrix @ q + self.robot.offset[self.bodies]
        data.qvel[:], data.qacc[:] = self.matrix @ qd, self.matrix @ qdd


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_efforts_and_mass_matrix(path, rng):
    robot = load_urdf(path)
    model = mujoco_model(path)
    data = mujoco.MjData(model)
    fold = Fold(robot, model)
    dynamics = InverseDynamics(robot, GRAVITY)
    for _ in range(5):
        q, qd, qdd = rng.uniform(-2.0, 2.0, (3, len(robot.joint_names)))
        fold.write(data, q, qd, qdd)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        efforts = np.empty(model.nv)
        mujoco.mj_rne(model, data, 1, efforts)
        # mj_fwdVelocity leaves bias forces in data; mj_rne with flag 1 takes qacc as given.
        expected = fold.matrix.T @ efforts
        tolerance = RELATIVE * np.abs(expected).max()
        assert tolerance > 0.0
        assert_allclose(dynamics.efforts(q, qd, qdd), expected, rtol=0, atol=tolerance)
        matrix = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        expected = fold.matrix.T @ matrix @ fold.matrix
        tolerance = RELATIVE * np.abs(expected).max()
        assert_allclose(dynamics.mass_matrix(q), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_payload_push_viscous_friction_and_armature(path, rng):
    robot = load_urdf(path)
    n = len(robot.joint_names)
    dynamics = InverseDynamics(robot, GRAVITY)
    # MuJoCo has merged the base into the world, so its links are not bodies.
    moved = [str(link) for link in np.array(robot.link_names)[robot.link_body > 0]]
    payloads, wrenches = [], {}
    for link in dict.fromkeys([moved[0], moved[-1]]):
        mass, com, box, rpy = random_box(rng)
        payloads.append((link, mass, com, box_inertia(mass, box, rpy)))
        dynamics.set_payload(*payloads[-1])
        wrenches[link] = rng.uniform(-9.0, 9.0, (2, 3))
        dynamics.set_external_wrench(link, *wrenches[link])
    damping, armature = rng.uniform(0.1, 2.0, (2, n))
    dynamics.set_friction(damping, coulomb=0.0)
    dynamics.set_armature(armature)

    model = mujoco_model(path, payloads)
    # Limits, mimicking and dry friction are constraints in MuJoCo.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    fold = Fold(robot, model)
    model.dof_damping[:], model.dof_armature[:] = 0.0, 0.0
    model.dof_damping[fold.masters], model.dof_armature[fold.masters] = damping, armature
    data = mujoco.MjData(model)
    for _ in range(5):
        q, qd, qdd = rng.uniform(-2.0, 2.0, (3, n))
        fold.write(data, q, qd, qdd)
        mujoco.mj_inverse(model, data)
        pushed = np.zeros(model.nv)
        for link, wrench in wrenches.items():
            body = data.body(link)
            force, moment = wrench @ body.xmat.reshape(3, 3).T
            mujoco.mj_applyFT(model, data, force, moment, body.xpos, body.id, pushed)
            arm = body.xpos - body.xipos  # MuJoCo applies forces at the centre of mass
            data.xfrc_applied[body.id] = np.r_[force, moment + np.cross(arm, force)]
        assert pushed.any()
        # Efforts and push cause the accelerations.
        expected = fold.matrix.T @ (data.qfrc_inverse - pushed)
        assert_close(dynamics.efforts(q, qd, qdd), expected, RELATIVE)

        if len(fold.masters) == model.nv:  # without mimics: forward dynamics of the result
            data.qfrc_applied[fold.masters] = dynamics.efforts(q, qd, qdd)
            mujoco.mj_forward(model, data)
            assert_close(data.qacc[fold.masters], qdd, 1e-8)
