"""
Samples of all joints, and the columns of everything that may explain the measured efforts.

A column contains the efforts for one unit of an unknown. The columns of a joint form one matrix.
Fits use only the products of these columns, so that the time of a fit does not depend on the
number of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats, Integers
from ..columns import body_columns, gravity_columns, payload_columns
from .fault import GravityConvention, WITH_GRAVITY

SPREAD = 0.12  # assumed relative standard deviation of masses
SIZE = 0.2  # [m], smallest assumed size of bodies
LIGHTEST = 0.1  # [kg]; lighter bodies are assumed to be as uncertain as bodies of this mass
NEGLIGIBLE = 1e-3  # combinations of bodies with smaller efforts, as a fraction of the RMS effort
SMALL = 0.01  # the efforts of bodies are compared with this fraction of the largest RMS effort
DAMPING, COULOMB, LOAD_FRICTION, ROTOR, OFFSET = range(5)
"""Columns of each drive."""
POINT_MASS = 4
OWN, OF_MODEL = 1, 2
"""Kinds of gravity that the measured efforts may lack: their own, or that of the model."""


class Signals(NamedTuple):
    """S samples of n joints of a robot, of which c joints are compared."""

    joints: tuple[int, ...]
    """Indices of the compared joints in ``robot.joint_names``."""
    times: Floats
    """Times of the samples, shape (S,) [s]."""
    q: Floats
    qd: Floats
    qdd: Floats
    """Positions, velocities and accelerations of all joints, shape (S, n)."""
    measured: Floats
    """Measured efforts of the compared joints, shape (S, c) [N m or N]."""
    added: Floats
    """Modelled efforts that the rigid bodies do not cause, shape (S, c) [N m or N]."""
    direction: Floats
    """Smoothed direction of motion of the compared joints, shape (S, c)."""
    rate: Floats
    """Time derivatives of the measured efforts, shape (S, c) [N m/s or N/s]."""
    used: Booleans
    """Whether a sample of a joint is compared, shape (S, c)."""
    moves: Booleans
    """Whether a joint moves, shape (c,)."""
    independent: float
    """Number of samples with independent noise."""
    noise: Floats
    """Smallest standard deviation of the residuals, shape (c,) [N m or N]."""
    dry: Floats
    """Standard deviation of unknown dry friction of joints at rest, shape (c,) [N m or N]."""

    def part(self, some: slice) -> Signals:
        """Return a part of the samples."""
        fields = self._asdict()
        per_sample = [
            name for name, values in fields.items() if name == 'times' or np.ndim(values) == 2
        ]
        return self._replace(**{name: fields[name][some] for name in per_sample})


class Window(NamedTuple):
    """A load, a tilt or an external force between two times [s]."""

    kind: str
    """'load', 'tilt' or 'push'."""
    begin: float
    end: float
    link: str = ''
    """Link that carries the load."""
    joints: tuple[int, ...] = ()
    """Joints that are pushed."""

    def inside(self, times: Floats) -> Booleans:
        """Return a mask of the times in the window."""
        return np.asarray((times >= self.begin) & (times <= self.end))


class Places(NamedTuple):
    """Places of the columns in the matrix of a joint."""

    model: int
    bodies: Integers
    tilt: Integers
    rate: Integers
    drive: Integers
    loads: dict[str, Integers]
    window: Integers


@dataclass
class Columns:
    """The columns of all compared joints, for given signs of the axes."""

    matrix: Floats
    """Shape (c, S, p)."""
    at: Places
    sizes: Floats
    """RMS of the drive columns, shape (c, 5); the columns have been divided by it."""
    products: dict[bytes, Floats] = field(default_factory=dict)

    def product(self, weights: Floats) -> Floats:
        """Return the weighted products of the columns of each joint, shape (c, p, p)."""
        key = weights.tobytes()
        if key not in self.products:
            scaled = self.matrix * weights.T[:, :, None]
            self.products.clear()
            self.products[key] = np.matmul(self.matrix.transpose(0, 2, 1), scaled)
        return self.products[key]


class Rows:
    """The samples of a robot, with their columns for any signs of the axes."""

    def __init__(
        self,
        dynamics: InverseDynamics,
        signals: Signals,
        links: Sequence[str],
        convention: GravityConvention = WITH_GRAVITY,
    ) -> None:
        self.dynamics, self.robot, self.signals = dynamics, dynamics.robot, signals
        self.convention = convention
        self.links = tuple(links)
        self.index = np.array(signals.joints)
        self.count = len(signals.joints)
        self.rms = np.sqrt(np.mean(signals.measured**2, axis=0)) + 1e-9
        kinds = self.robot.is_prismatic_joint[self.index]
        self.largest = np.array([self.rms[kinds == kind].max() for kind in kinds])
        """Largest RMS effort of the joints of the same type, shape (c,)."""
        self._cache: dict[tuple[bytes, int, Window | None], Columns] = {}

    def rigid(self, states: tuple[Floats, Floats, Floats], has_gravity: bool) -> Floats:
        """Return the efforts of the rigid bodies of the compared joints [N m or N]."""
        efforts = self.dynamics.efforts(*states) - self.dynamics.effort_terms(*states).friction
        if not has_gravity:
            efforts = efforts - self.dynamics.gravity_efforts(states[0])
        return np.asarray(efforts[:, self.index])

    def _load(self, link: str, states: tuple[Floats, Floats, Floats]) -> Floats:
        return payload_columns(self.robot, self.dynamics.gravity, link, states)

    def _moved(
        self,
        columns: Callable[[tuple[Floats, Floats, Floats]], Floats],
        states: tuple[Floats, Floats, Floats],
        has_gravity: bool,
    ) -> Floats:
        """Return columns of all states; without gravity, leave out the efforts at rest."""
        found = columns(states)
        if not has_gravity:
            still = np.zeros_like(states[0])
            found = found - columns((states[0], still, still))
        return np.asarray(found[:, self.index])

    @cached_property
    def basis(self) -> Floats:
        """
        Combinations of the parameters of all bodies that matter, shape (10 b, r).

        Each combination has a standard deviation of one, and is independent of the others.
        """
        s = self.signals
        columns = body_columns(self.dynamics, (s.q, s.qd, s.qdd), self.bodies)[:, self.index]
        robot, bodies = self.robot, self.bodies
        masses = np.maximum(robot.mass[bodies], LIGHTEST)
        gyration = np.trace(robot.inertia[bodies], axis1=1, axis2=2) / (2.0 * robot.mass[bodies])
        squares = np.maximum(gyration + np.sum(robot.com[bodies] ** 2, axis=1), SIZE**2)
        moments = np.column_stack([np.full((len(bodies), 3), SIZE), *6 * [squares]])
        prior = (SPREAD * masses[:, None] * np.insert(moments, 0, 1.0, axis=1)).ravel()
        efforts = self.rigid((s.q, s.qd, s.qdd), True)
        sizes = np.sqrt(np.mean(efforts**2, axis=0))
        columns = columns * prior / (sizes + SMALL * sizes.max() + 1e-300)[:, None]
        flat = columns.reshape(-1, len(prior))
        values, vectors = np.linalg.eigh(flat.T @ flat / len(s.q))
        kept = values > NEGLIGIBLE**2
        return np.asarray(prior[:, None] * vectors[:, kept])

    @property
    def bodies(self) -> list[int]:
        """Bodies with a mass."""
        return [b for b in range(1, len(self.robot.mass)) if self.robot.mass[b] > 0.0]

    def at(self, signals: Signals) -> Rows:
        """Return other samples of the same motion, with the same combinations of bodies."""
        other = Rows(self.dynamics, signals, self.links, self.convention)
        other.__dict__['basis'] = self.basis
        return other

    def columns(
        self, signs: Floats, other_gravity: int = 0, window: Window | None = None
    ) -> Columns:
        """Return the columns for given signs of the axes, shape (c,), and a window."""
        if window is not None and window.kind == 'push':
            window = None
        key = signs.tobytes(), other_gravity, window
        if key not in self._cache:
            if len(self._cache) > 3 * self.count:
                self._cache.clear()
            self._cache[key] = self._make(signs, other_gravity, window)
        return self._cache[key]

    def states(self, signs: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the states of all joints, with the signs of the axes corrected."""
        s, every = self.signals, np.ones(self.signals.q.shape[1])
        every[self.index] = signs
        return every * s.q, every * s.qd, every * s.qdd

    def _make(self, signs: Floats, other_gravity: int, window: Window | None) -> Columns:
        s, index = self.signals, self.index
        has_gravity = self.convention.in_measured != bool(other_gravity)
        loads_have_gravity = has_gravity or other_gravity == OF_MODEL
        states = self.states(signs)
        model = self.rigid(states, has_gravity) + signs * s.added
        bodies = self._moved(
            lambda x: body_columns(self.dynamics, x, self.bodies), states, loads_have_gravity
        )
        tilt = gravity_columns(self.robot, states[0])[:, index] * has_gravity
        loads = {
            link: self._moved(partial(self._load, link), states, loads_have_gravity)
            for link in self.links
        }
        direction = signs * s.direction
        # The gears carry the weight of the robot even if the measured efforts lack gravity.
        load = model if has_gravity else self.rigid(states, True) + signs * s.added
        drive = np.stack(
            [
                states[1][:, index],
                direction,
                direction * np.abs(load),
                states[2][:, index],
                np.ones_like(model),
            ],
            axis=-1,
        )
        sizes = np.sqrt(np.mean(drive**2, axis=0)) + 1e-9
        scale = 1.0 / sizes
        scale[~s.moves, :OFFSET] = 0.0
        parts = [
            np.broadcast_to(s.measured[:, None], (*model.shape, self.count)),
            model[..., None],
            bodies @ self.basis,
            tilt,
            s.rate[..., None],
            drive * scale,
            *loads.values(),
        ]
        if window is not None:
            added = tilt if window.kind == 'tilt' else loads[window.link][..., :POINT_MASS]
            parts.append(added * window.inside(s.times)[:, None, None])
        ends = np.cumsum([part.shape[-1] for part in parts])
        spans = [np.arange(b - part.shape[-1], b) for b, part in zip(ends, parts, strict=True)]
        at = Places(
            model=int(spans[1][0]),
            bodies=spans[2],
            tilt=spans[3],
            rate=spans[4],
            drive=spans[5],
            loads=dict(zip(loads, spans[6:], strict=False)),
            window=spans[-1] if window is not None else np.zeros(0, dtype=np.intp),
        )
        matrix = np.ascontiguousarray(np.concatenate(parts, axis=-1).transpose(1, 0, 2))
        return Columns(matrix, at, sizes)
