"""Robots and joint states for the benchmarks."""

from __future__ import annotations

from pathlib import Path

from inverse_dynamics_node import load_urdf, RobotModel
from inverse_dynamics_node.robot.model import Floats
from lxml import etree
import numpy as np
from random_trees import random_chain, urdf_of
from robot_files import real_robots, STANFORD

SEED = 1979
STATES = 16  # too many for a branch predictor to learn, few enough to stay in the cache
_NOT_DYNAMICS = ('visual', 'collision', 'transmission', 'gazebo', 'dynamics', 'safety_controller')


class Robot:
    """A robot as URDF text that every library can read, and as a `RobotModel`."""

    def __init__(self, name: str, urdf: str) -> None:
        self.name = name
        self.urdf = urdf
        self.model: RobotModel = load_urdf(urdf)
        self.n = len(self.model.joint_names)


def robots() -> list[Robot]:
    """Return the robots of the tables; real ones only if example-robot-data is installed."""
    real = {path.stem: path for path in real_robots()}
    found = []
    if 'panda' in real:
        found.append(Robot('Panda', bare(real['panda'], locked=('panda_finger_joint',))))
    if 'ur5_robot' in real:
        found.append(Robot('UR5', bare(real['ur5_robot'])))
    found.append(stanford())
    if 'talos_reduced' in real:
        found.append(Robot('Talos', bare(real['talos_reduced'])))
    return [*found, chain(30), chain(100)]


def stanford() -> Robot:
    """Return the arm of the paper."""
    return Robot('Stanford', bare(STANFORD))


def chain(count: int) -> Robot:
    """Create a chain in general position; every third joint is prismatic."""
    return Robot(f'chain {count}', urdf_of(random_chain(np.random.default_rng(count), count)))


def random_states(n: int, count: int = STATES) -> Floats:
    """Draw positions, velocities and accelerations, shape (3, count, n)."""
    return np.random.default_rng(SEED).uniform(-2.0, 2.0, (3, count, n))


def bare(path: Path, locked: tuple[str, ...] = ()) -> str:
    """
    Remove everything except kinematics and inertia from a URDF; lock joints by name prefix.

    Without meshes, every library can read the URDF. Without damping, all libraries compute the
    same efforts.
    """
    root = etree.fromstring(path.read_bytes(), etree.XMLParser(remove_comments=True))
    for tag in _NOT_DYNAMICS:
        for element in root.findall(f'.//{tag}'):
            element.getparent().remove(element)
    for joint in root.findall('joint'):
        if joint.get('name', '').startswith(locked):
            joint.set('type', 'fixed')
        if joint.get('type') == 'fixed':  # here, not all libraries accept a mimic element
            for mimic in joint.findall('mimic'):
                joint.remove(mimic)
    return str(etree.tostring(root, encoding='unicode'))
