"""Publishes a payload to a running node, and waits until the node reports that payload."""

from __future__ import annotations

import math
import time

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
from rclpy.node import Node
from std_msgs.msg import Header

from ..errors import ConfigurationError
from ..robot.rigid_body import RigidBody
from .middleware import QUEUED
from .observer import Observer

_PATIENCE = 10.0  # [s]; diagnostics come once a second
_REPETITION = 3.0  # [s]; a message is lost if the subscriber is not ready yet
_PRECISION = 1e-3  # precision of masses (relative) and of positions [m]
_POLL = 0.02  # [s]


def apply_payload(
    node: Node, observer: Observer, link: str, payload: RigidBody, replaces: bool = False
) -> None:
    """
    Publish a payload in the frame of its link, and wait until the node uses it.

    Raise a ConfigurationError if the node carries a payload on another link, unless `replaces`
    removes it. Raise a ConfigurationError too if the node does not use the payload within 10 s.
    This error quotes the last warning in the log of the node.
    """
    topic = f'{observer.name}/payload'
    publisher = node.create_publisher(InertiaStamped, topic, QUEUED)
    end, due = time.monotonic() + _PATIENCE, 0.0
    while True:
        observer.poll()
        loads = observer.status.payloads() if observer.status else []
        others = [each for each in loads if each[0] != link]
        if others and not replaces:
            carried = ', '.join(f"{mass:g} kg on link '{name}'" for name, mass, _ in others)
            raise ConfigurationError(
                f'{observer.name} carries another payload: {carried}; use --replace to remove it'
            )
        if not others and any(_is(load, payload) for load in loads):
            return
        now = time.monotonic()
        if now > end:
            last = f': {observer.last_warning}' if observer.last_warning else ''
            raise ConfigurationError(
                f'{observer.name} does not use the payload sent on {topic}{last}'
            )
        if now > due and observer.status and publisher.get_subscription_count():
            for name, _, _ in others:
                publisher.publish(InertiaStamped(header=Header(frame_id=name)))  # no mass
            publisher.publish(_message(link, payload))
            due = now + _REPETITION
        time.sleep(_POLL)


def _message(link: str, payload: RigidBody) -> InertiaStamped:
    mass, com, inertia = payload
    return InertiaStamped(
        header=Header(frame_id=link),
        inertia=Inertia(
            m=mass,
            com=Vector3(x=float(com[0]), y=float(com[1]), z=float(com[2])),
            ixx=float(inertia[0, 0]),
            ixy=float(inertia[0, 1]),
            ixz=float(inertia[0, 2]),
            iyy=float(inertia[1, 1]),
            iyz=float(inertia[1, 2]),
            izz=float(inertia[2, 2]),
        ),
    )


def _is(load: tuple[str, float, list[float]], payload: RigidBody) -> bool:
    """Return whether a reported load is the payload."""
    _, mass, com = load
    is_mass = math.isclose(mass, payload.mass, rel_tol=_PRECISION)
    return is_mass and math.dist(com, payload.com.tolist()) < _PRECISION
