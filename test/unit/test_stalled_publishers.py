"""Silence of publishers that are connected."""

from inverse_dynamics_node.control.monitor import StalledPublishers
import pytest


def test_silence_begins_with_the_last_message():
    publishers = StalledPublishers(10.0)
    assert [publishers.update(t, 10.5, True) for t in (11.0, 12.0, 13.0)] == [0.5, 1.5, 2.5]
    assert publishers.update(14.0, 13.5, True) == 0.5


def test_time_without_publishers_is_not_silence():
    publishers = StalledPublishers(10.0)
    assert [publishers.update(t, 10.0, False) for t in (11.0, 12.0, 13.0)] == [0.0, 0.0, 0.0]
    assert publishers.update(14.0, 10.0, True) == 1.0


@pytest.mark.parametrize('last_message', [11.0, 11.9])
def test_time_in_which_this_process_did_not_run_is_not_silence(last_message):
    publishers = StalledPublishers(10.0)
    publishers.update(12.0, last_message, True)
    assert publishers.update(42.0, last_message, True) == pytest.approx(12.0 - last_message)
    assert publishers.update(43.0, last_message, True) == pytest.approx(13.0 - last_message)


def test_a_message_after_a_pause_is_not_in_the_future():
    assert StalledPublishers(10.0).update(40.0, 39.9, True) == 0.0
