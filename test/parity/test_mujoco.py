"""MuJoCo as a second opinion, on our own robots."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from lxml import etree
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import OUR_ROBOTS

mujoco = pytest.importorskip('mujoco')

RELATIVE = 1e-10  # to the largest effort: both round, in another order
GRAVITY = (0.4, -1.2, -9.5)


def mujoco_model(path):
    """Compile a URDF as it stands: bodies kept apart, no mass made up from geometry."""
    root = etree.fromstring(path.read_bytes())
    for tag in ('visual', 'collision'):
        for element in root.findall(f'.//{tag}'):
            element.getparent().remove(element)
    settings = etree.SubElement(etree.SubElement(root, 'mujoco'), 'compiler')
    settings.set('fusestatic', 'false')
    settings.set('balanceinertia', 'false')
    try:
        model = mujoco.MjModel.from_xml_string(etree.tostring(root, encoding='unicode'))
    except ValueError as error:
        pytest.skip(f'MuJoCo does not take it: {error}')
    model.opt.gravity = GRAVITY
    return model


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_efforts_and_mass_matrix(path, rng):
    robot = load_urdf(path)
    model = mujoco_model(path)
    data = mujoco.MjData(model)
    names = [model.joint(k).name for k in range(model.njnt)]
    bodies = [robot.body_names.index(name) for name in names]
    fold = np.zeros((len(names), len(robot.joint_names)))
    fold[np.arange(len(names)), robot.joint_index[bodies]] = robot.multiplier[bodies]
    dynamics = InverseDynamics(robot, GRAVITY)
    for _ in range(5):
        q, qd, qdd = rng.uniform(-2.0, 2.0, (3, len(robot.joint_names)))
        data.qpos[:] = fold @ q + robot.offset[bodies]
        data.qvel[:], data.qacc[:] = fold @ qd, fold @ qdd
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        efforts = np.empty(model.nv)
        mujoco.mj_rne(model, data, 1, efforts)
        # mj_fwdVelocity leaves bias forces in data; mj_rne with flag 1 takes qacc as given.
        expected = fold.T @ efforts
        tolerance = RELATIVE * np.abs(expected).max()
        assert tolerance > 0.0
        assert_allclose(dynamics.efforts(q, qd, qdd), expected, rtol=0, atol=tolerance)
        matrix = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        expected = fold.T @ matrix @ fold
        tolerance = RELATIVE * np.abs(expected).max()
        assert_allclose(dynamics.mass_matrix(q), expected, rtol=0, atol=tolerance)
