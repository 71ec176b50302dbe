"""The settings of the middleware: transports, and the security that the environment requests."""

from contextlib import nullcontext
from pathlib import Path

from inverse_dynamics_node.errors import ConfigurationError
import pytest

pytest.importorskip('rclpy')

from inverse_dynamics_node.ros import middleware
from inverse_dynamics_node.ros.middleware import check_security, LOCAL_PROFILE, udp_settings

UDP = {'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}
PROFILE = {
    'FASTRTPS_DEFAULT_PROFILES_FILE': LOCAL_PROFILE,
    'FASTDDS_DEFAULT_PROFILES_FILE': LOCAL_PROFILE,
}
LOCAL = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


@pytest.mark.parametrize(
    ('environment', 'expected'),
    [
        ({}, UDP),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, UDP),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_STATIC_PEERS': '10.0.0.2'}, UDP),
        (LOCAL, PROFILE),
        ({'ROS_LOCALHOST_ONLY': '1'}, PROFILE),
        ({'ROS_LOCALHOST_ONLY': '0'}, UDP),
        ({**LOCAL, 'ROS_STATIC_PEERS': '10.0.0.2'}, {}),
        ({'ROS_LOCALHOST_ONLY': '1', 'ROS_STATIC_PEERS': '10.0.0.2'}, PROFILE),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'localhost'}, PROFILE),
        (UDP, UDP),
        ({**LOCAL, **UDP}, PROFILE),
        ({**LOCAL, **PROFILE}, PROFILE),
        ({**LOCAL, **dict.fromkeys(PROFILE, '')}, PROFILE),
        ({**LOCAL, 'FASTDDS_DEFAULT_PROFILES_FILE': 'mine.xml'}, {}),
        ({**LOCAL, 'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'}, {}),
        ({**LOCAL, 'FASTDDS_BUILTIN_TRANSPORTS': 'LARGE_DATA'}, {}),
        ({'FASTDDS_BUILTIN_TRANSPORTS': 'SHM'}, {}),
    ],
)
def test_settings(environment, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert udp_settings('rmw_fastrtps_cpp', environment) == expected
    assert udp_settings('rmw_cyclonedds_cpp', environment) == {}


def test_a_profile_in_the_current_folder_is_respected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('DEFAULT_FASTRTPS_PROFILES.xml').write_text('<profiles/>')
    assert udp_settings('rmw_fastrtps_cpp', LOCAL) == {}


def test_the_range_is_kept_if_the_profile_is_missing(monkeypatch):
    monkeypatch.setattr(middleware, 'LOCAL_PROFILE', '/no/such/file.xml')
    assert udp_settings('rmw_fastrtps_cpp', LOCAL) == {}


@pytest.mark.parametrize(
    ('rmw', 'enabled', 'strategy', 'words'),
    [
        ('rmw_zenoh_cpp', 'true', 'Enforce', 'rmw_zenoh_cpp does not enforce the security'),
        ('rmw_zenoh_cpp', 'true', 'Permissive', ''),
        ('rmw_zenoh_cpp', 'false', 'Enforce', ''),
        ('rmw_cyclonedds_cpp', 'true', 'Enforce', ''),
        ('rmw_fastrtps_cpp', 'true', 'Enforce', ''),
        ('rmw_fastrtps_cpp', 'True', 'Enforce', "ENABLE is 'True', expected true or false"),
        ('rmw_fastrtps_cpp', 'true', 'enforce', "'enforce', expected Enforce or Permissive"),
        ('rmw_fastrtps_cpp', 'false', 'enforce', ''),
    ],
)
def test_ros_does_not_start_without_the_security_that_is_requested(rmw, enabled, strategy, words):
    settings = {'ROS_SECURITY_ENABLE': enabled, 'ROS_SECURITY_STRATEGY': strategy}
    with pytest.raises(ConfigurationError, match=words) if words else nullcontext():
        check_security(rmw, settings)
