"""
Starts ROS without the shared memory of Fast DDS, and sets the quality of service of topics.

The shared memory can block a publisher for 0.33 s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
import os
from pathlib import Path

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from ..errors import ConfigurationError

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
QUEUED = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

LOCAL_PROFILE = str(Path(__file__).with_name('local_udp.xml'))

_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
# Names for Fast DDS 2 and 3. If a profile were ignored, the node would be open to the network.
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'
_DEFAULT_PROFILES = 'DEFAULT_FASTRTPS_PROFILES.xml'  # read from the current folder if it exists
_RANGE, _OLD_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'
_WIDE_RANGES = '', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT'  # rcl takes any other value as LOCALHOST
_PEERS = 'ROS_STATIC_PEERS'
_SECURITY, _STRATEGY = 'ROS_SECURITY_ENABLE', 'ROS_SECURITY_STRATEGY'
_SECURE = 'rmw_fastrtps', 'rmw_cyclonedds', 'rmw_connextdds'


def start_ros(arguments: Sequence[str] | None = None) -> None:
    """
    Initialize rclpy, without its signal handlers and without shared memory.

    When a publisher sends its first message to a new subscriber, Fast DDS 2.14 opens a port in
    shared memory. A race between publisher and subscriber can then block the publisher for 0.33 s
    (issue 6535 of Fast DDS). Therefore messages use UDP, even within a machine. Child processes
    inherit the environment variables for UDP.

    `arguments` are ROS arguments, by default those of the process. Raise a ConfigurationError if
    ROS would start without the security that the environment requests.
    """
    rmw = get_rmw_implementation_identifier()
    check_security(rmw, os.environ)
    settings = udp_settings(rmw, os.environ)
    os.environ.update(settings)
    with _hidden_range() if _PROFILES[0] in settings else nullcontext():
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)


def stay_on_this_machine() -> None:
    """Keep ROS traffic on this machine, unless the user has set a discovery range."""
    os.environ.setdefault(_RANGE, 'LOCALHOST')


def check_security(rmw: str, environment: Mapping[str, str]) -> None:
    """
    Raise a ConfigurationError if ROS would silently start without the requested security.

    ROS expects exact spelling: ``True`` or ``1`` does not enable security, and ``enforce`` does
    not enforce security. Only DDS middleware reads the enclave; rmw_zenoh ignores the enclave.
    """
    enabled, strategy = environment.get(_SECURITY, ''), environment.get(_STRATEGY, '')
    if enabled not in ('', 'true', 'false'):
        raise ConfigurationError(
            f"{_SECURITY} is '{enabled}', expected true or false; with '{enabled}', ROS would "
            'start without security'
        )
    if enabled == 'true' and strategy not in ('', 'Enforce', 'Permissive'):
        raise ConfigurationError(
            f"{_STRATEGY} is '{strategy}', expected Enforce or Permissive; with '{strategy}', ROS "
            'would not enforce security'
        )
    if enabled == 'true' and strategy == 'Enforce' and not rmw.startswith(_SECURE):
        raise ConfigurationError(
            f'{rmw} does not enforce the security of ROS 2; with {_STRATEGY}=Enforce, use '
            f'one of {", ".join(_SECURE)}'
        )


def security_hints(error: Exception) -> list[str]:
    """Return advice for an error in ROS if security is on; otherwise an empty list."""
    if os.environ.get(_SECURITY) != 'true' or not isinstance(error, RuntimeError):
        return []
    return [
        f'{_SECURITY} is true: set ROS_SECURITY_KEYSTORE, choose an enclave with --ros-args '
        '--enclave or ROS_SECURITY_ENCLAVE_OVERRIDE, and permit all topics and services in its '
        'policy (config/sros2/policy.xml)'
    ]


@contextmanager
def explained_start() -> Iterator[None]:
    """Raise a short ConfigurationError if the `with` block cannot start ROS or create a node."""
    try:
        yield
    except RuntimeError as error:  # the base of rclpy's errors, which have no public names
        reason = ' '.join(str(error).partition(', at /')[0].split())
        text = '; '.join([f'ROS does not start: {reason}', *security_hints(error)])
        raise ConfigurationError(text) from None


def udp_settings(rmw: str, environment: Mapping[str, str]) -> dict[str, str]:
    """
    Return the environment variables that keep Fast DDS from using shared memory.

    The result is empty for other middleware, and if the user has chosen other transports or a
    profile. With the discovery range LOCALHOST, rmw_fastrtps requests shared memory even if the
    environment selects UDP. For LOCALHOST, the result therefore names a profile that uses only
    UDP and limits discovery to this machine. If static peers are also set, the result is empty,
    because the profile would have to list the peers.
    """
    profiles = {environment.get(name) or LOCAL_PROFILE for name in _PROFILES}
    has_other_transports = environment.get(_TRANSPORTS) not in (None, '', 'UDPv4')
    has_profile = profiles != {LOCAL_PROFILE} or os.path.exists(_DEFAULT_PROFILES)
    if has_other_transports or has_profile or not rmw.startswith('rmw_fastrtps'):
        return {}
    is_old_local = environment.get(_OLD_RANGE) == '1'
    if environment.get(_RANGE, '') in _WIDE_RANGES and not is_old_local:
        return {_TRANSPORTS: 'UDPv4'}
    has_peers = environment.get(_PEERS) and not is_old_local  # the old variable ignores peers
    if has_peers or not os.access(LOCAL_PROFILE, os.R_OK):
        return {}
    return dict.fromkeys(_PROFILES, LOCAL_PROFILE)


@contextmanager
def _hidden_range() -> Iterator[None]:
    """Hide the discovery range from rcl, because the profile already contains it."""
    before = {name: os.environ.pop(name) for name in (_RANGE, _OLD_RANGE) if name in os.environ}
    os.environ[_RANGE] = 'SYSTEM_DEFAULT'
    try:
        yield
    finally:
        del os.environ[_RANGE]
        os.environ.update(before)


def overridable() -> dict[str, QoSOverridingOptions]:
    """Return the options that let parameters set the quality of service of a topic."""
    return {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}
