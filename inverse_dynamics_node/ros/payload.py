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


def apply_payload(node: Node, observer: Observer, link: str, payload: RigidBody) -> None:
    """
    Publish a payload in the frame of its link, and wait until the node uses it.

    Raise a ConfigurationError if the node does not use the payload within 10 s. The error quotes
    the last warning in the log of the node.
    """
    mass, com, inertia = payload
    message = InertiaStamped(
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
    topic = f'{observer.name}/payload'
    publisher = node.create_publisher(InertiaStamped, topic, QUEUED)
    end, due = time.monotonic() + _PATIENCE, 0.0
    while not _has_payload(observer, link, payload):
        now = time.monotonic()
        if now > end:
            last = f': {observer.log[-1].text}' if observer.log else ''
            raise ConfigurationError(
                f'{observer.name} does not use the payload sent on {topic}{last}'
            )
        if now > due and publisher.get_subscription_count():
            publisher.publish(message)
            due = now + _REPETITION
        time.sleep(_POLL)
        observer.poll()


def _has_payload(observer: Observer, link: str, payload: RigidBody) -> bool:
    loads = observer.status.payloads() if observer.status else []
    return any(
        name == link
        and math.isclose(mass, payload.mass, rel_tol=_PRECISION)
        and math.dist(com, payload.com.tolist()) < _PRECISION
        for name, mass, com in loads
    )
