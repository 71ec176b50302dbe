"""Random robots for property tests: trees with every kind of joint, as URDF text."""

from dataclasses import dataclass, replace

from hypothesis import strategies as st
from inverse_dynamics_node import load_urdf
import numpy as np

KINDS = ('revolute', 'continuous', 'prismatic', 'fixed')


@dataclass(frozen=True)
class Link:
    """A link and its parent joint; the joint of the first link is ignored."""

    parent: int
    kind: str
    mimics: int  # link whose joint this one mimics; -1 for none
    xyz: tuple
    rpy: tuple
    axis: tuple
    mass: float
    com: tuple
    com_rpy: tuple
    box: tuple  # sides of a solid box, whose inertia is always physical
    multiplier: float = 1.0
    offset: float = 0.0

    def urdf(self, i):
        a, b, c = (side * side for side in self.box)
        ixx, iyy, izz = (self.mass / 12.0 * s for s in (b + c, c + a, a + b))
        return (
            f'<link name="link{i}"><inertial><origin xyz="{_text(self.com)}" '
            f'rpy="{_text(self.com_rpy)}"/><mass value="{self.mass!r}"/>'
            f'<inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/>'
            '</inertial></link>'
        ) + (self._joint_urdf(i) if i else '')

    def _joint_urdf(self, i):
        mimic = (
            f'<mimic joint="joint{self.mimics}" multiplier="{self.multiplier!r}" '
            f'offset="{self.offset!r}"/>'
            if self.mimics >= 0
            else ''
        )
        return (
            f'<joint name="joint{i}" type="{self.kind}"><parent link="link{self.parent}"/>'
            f'<child link="link{i}"/><origin xyz="{_text(self.xyz)}" rpy="{_text(self.rpy)}"/>'
            f'<axis xyz="{_text(self.axis)}"/>{mimic}'
            '<limit lower="-9" upper="9" effort="1000" velocity="10"/></joint>'
        )

    def moved(self, **changes):
        return replace(self, **changes)


def urdf_of(links):
    """Write a tree of links as URDF."""
    return f'<robot name="tree">{"".join(link.urdf(i) for i, link in enumerate(links))}</robot>'


@st.composite
def trees(draw, max_links=8, kinds=KINDS, mimics=True):
    """Draw a tree with at least one movable joint; hypothesis shrinks its shape only."""
    count = draw(st.sampled_from(range(2, max_links + 1)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    links = [random_link(rng, parent=-1, kind='fixed', mimics=-1)]
    movers = []
    for i in range(1, count):
        kind = draw(st.sampled_from(kinds))
        if i == count - 1 and not movers and kind == 'fixed':
            kind = 'revolute'
        master = -1
        if mimics and kind != 'fixed' and movers and draw(st.integers(0, 3)) == 0:
            master = draw(st.sampled_from(movers))
        links.append(random_link(rng, draw(st.integers(0, i - 1)), kind, master))
        if kind != 'fixed' and master < 0:
            movers.append(i)
    return links


@st.composite
def states(draw, n, vectors=3):
    """Draw vectors of n typical joint positions, velocities or accelerations."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return rng.uniform(-3.0, 3.0, size=(vectors, n))


@st.composite
def robots_with_states(draw, vectors=3, **kwargs):
    """Draw a tree: its links, the loaded robot, and joint vectors."""
    links = draw(trees(**kwargs))
    robot = load_urdf(urdf_of(links))
    return links, robot, draw(states(len(robot.joint_names), vectors))


def random_link(rng, parent, kind, mimics):
    return Link(
        parent=parent,
        kind=kind,
        mimics=mimics,
        xyz=tuple(rng.uniform(-0.5, 0.5, 3)),
        rpy=tuple(rng.uniform(-3.0, 3.0, 3)),
        axis=tuple(rng.uniform(-1.0, 1.0, 3)),
        mass=float(rng.uniform(0.1, 5.0)),
        com=tuple(rng.uniform(-0.3, 0.3, 3)),
        com_rpy=tuple(rng.uniform(-3.0, 3.0, 3)),
        box=tuple(rng.uniform(0.05, 0.6, 3).tolist()),
        multiplier=float(rng.choice([-1.5, -1.0, 0.5, 2.0])),
        offset=float(rng.uniform(-0.5, 0.5)),
    )


def _text(numbers):
    return ' '.join(repr(float(x)) for x in numbers)


def random_chain(rng, count):
    """Make a chain of joints, every third of them prismatic."""
    kinds = ['prismatic' if i % 3 == 2 else 'revolute' for i in range(count)]
    links = [random_link(rng, -1, 'fixed', -1)]
    return links + [random_link(rng, i, kind, -1) for i, kind in enumerate(kinds)]
