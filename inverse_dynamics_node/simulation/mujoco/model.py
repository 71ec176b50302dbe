"""
Compiles a URDF to a MuJoCo model with exactly the same dynamics.

MuJoCo parses the URDF itself, so that an error in our own loader appears as a tracking error. The
URDF needs four changes:

- Shapes are removed, because shapes need mesh files and would have a mass in MuJoCo.
- Quaternions become roll, pitch and yaw, because MuJoCo ignores ``quat_xyzw``.
- An option keeps links on fixed joints as separate bodies, because merging would drop the inertia
  of a link whose mass is 0.
- During compilation, placeholders replace masses and inertias that MuJoCo rejects.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from lxml import etree
import mujoco
import numpy as np

from ...dynamics.inverse_dynamics import STANDARD_GRAVITY
from ...errors import InverseDynamicsError
from ...robot.kinematics import rpy_of_quaternion
from ...robot.model import Floats
from ...robot.urdf.schema import inertia_tensor, MOMENTS
from ...robot.urdf.xml import Element, parse, read_source, tag

OLDEST_MUJOCO = (3, 17)  # 3.13 rotates inertias the wrong way, and older versions ignore <mimic>
LARGEST_STEP = 0.00025  # [s]: integration errors are far below the effect of one late sample
STIFFEST = 0.9999  # MuJoCo's upper bound on the stiffness of a constraint
LEAST_PLAUSIBLE = 1e-12  # [kg or kg m^2]: MuJoCo rejects values below 1e-15

logger = logging.getLogger(__name__)


class SimulationError(InverseDynamicsError):
    """A robot cannot be simulated, or a simulation failed."""


def compile_model(urdf: str | Path, friction: bool = True) -> Any:
    """
    Compile a URDF, given as a path or as text, to a MuJoCo model.

    If ``friction`` is False, the joints have neither the damping nor the Coulomb friction that
    the URDF specifies. The model has one body per link except the root, and one degree of freedom
    per movable joint. Equality constraints couple mimic joints. Raise a `SimulationError` if
    MuJoCo is too old or rejects the robot.
    """
    if tuple(map(int, mujoco.__version__.split('.')[:2])) < OLDEST_MUJOCO:
        raise SimulationError(f'MuJoCo has version {mujoco.__version__}, expected 3.17 or newer')
    # By default, MuJoCo would append its warnings to a file in the working directory.
    mujoco.set_mju_user_warning(logger.info)
    root, _ = parse(read_source(urdf))
    _strip_shapes(root)
    _write_quaternions_as_rpy(root)
    set_aside = _set_implausible_inertias_aside(root)
    settings = etree.SubElement(root, 'mujoco')
    etree.SubElement(settings, 'compiler', fusestatic='false')
    try:
        model = mujoco.MjModel.from_xml_string(etree.tostring(root, encoding='unicode'))
    except ValueError as error:
        raise SimulationError(f'MuJoCo rejects this robot: {error}') from error
    _restore_inertias(model, set_aside)
    _set_options(model)
    if not friction:
        model.dof_damping[:] = 0.0
        model.dof_frictionloss[:] = 0.0
    return model


def _strip_shapes(root: Element) -> None:
    for element in root.iter():
        if element.prefix is None:
            element.tag = tag(element)  # without the default namespace, which MuJoCo ignores
    for element in list(root):
        if tag(element) not in ('link', 'joint'):
            root.remove(element)
    for link in root.iter('link'):
        for element in list(link):
            if tag(element) != 'inertial':
                link.remove(element)


def _write_quaternions_as_rpy(root: Element) -> None:
    for origin in root.iter('origin'):
        if 'quat_xyzw' in origin.attrib:
            origin.set('rpy', rpy_of_quaternion(origin.attrib.pop('quat_xyzw')))


def _set_implausible_inertias_aside(root: Element) -> dict[str, tuple[float, Floats]]:
    """Write placeholders where MuJoCo rejects a mass or an inertia; return the originals."""
    set_aside = {}
    for link in root.iter('link'):
        mass, inertia = _mass_and_inertia(link)
        moments = np.linalg.eigvalsh(inertia)
        if min(mass, moments[0]) < LEAST_PLAUSIBLE or moments.sum() <= 2.0 * moments[2]:
            set_aside[link.get('name')] = mass, inertia
            _write_placeholder(link)
    return set_aside


def _mass_and_inertia(link: Element) -> tuple[float, Floats]:
    element = link.find('inertial/inertia')
    if element is None:
        return 0.0, np.zeros((3, 3))
    inertia = inertia_tensor([float(element.get(name, 0.0)) for name in MOMENTS])
    return float(link.find('inertial/mass').get('value')), inertia


def _write_placeholder(link: Element) -> None:
    """Write a mass and an inertia that MuJoCo accepts; keep the origin."""
    inertial = link.find('inertial')
    if inertial is None:
        inertial = etree.SubElement(link, 'inertial')
    for name in ('mass', 'inertia'):
        for element in inertial.findall(name):
            inertial.remove(element)
    etree.SubElement(inertial, 'mass', value='1')
    # If the moments are distinct and descending, body_iquat is the rotation of the origin.
    moments = {'ixx': '1.3', 'iyy': '1.2', 'izz': '1.1', 'ixy': '0', 'ixz': '0', 'iyz': '0'}
    etree.SubElement(inertial, 'inertia', **moments)


def _restore_inertias(model: Any, set_aside: dict[str, tuple[float, Floats]]) -> None:
    for link, (mass, inertia) in set_aside.items():
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link)
        if body <= 0:
            continue  # the mass of the root link has no effect
        turned = np.zeros(4)
        model.body_mass[body] = mass
        model.body_inertia[body], principal = principal_axes(inertia)
        mujoco.mju_mulQuat(turned, model.body_iquat[body], principal)
        model.body_iquat[body] = turned
    mujoco.mj_setConst(model, mujoco.MjData(model))


def principal_axes(inertia: Floats) -> tuple[Floats, Floats]:
    """Return the principal moments of an inertia, shape (3,), and the axes as a quaternion."""
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.linalg.det(axes)  # turns a reflection into a rotation
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    return moments, quaternion


def _set_options(model: Any) -> None:
    model.opt.gravity[:] = STANDARD_GRAVITY
    model.opt.timestep = LARGEST_STEP
    # Integrate damping implicitly, because a joint with a small inertia may have large damping.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A diverging state must be an error, not a jump back to the start.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # A mimic joint stops with its master, and the limits of a mimic joint are often wrong.
    model.jnt_limited[model.eq_obj1id] = False
    model.eq_solimp[:, :2] = STIFFEST
    model.eq_solref[:, 0] = 2.0 * LARGEST_STEP  # the smallest value that MuJoCo considers stable
    model.dof_solimp[:, :2] = STIFFEST  # otherwise joints creep under Coulomb friction
