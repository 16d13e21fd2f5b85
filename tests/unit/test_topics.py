"""The topic table is complete and agrees with ROS 2."""

import pytest

from runtime import messages
from runtime.errors import ConfigError
from runtime.topics import TOPICS, topic


def test_every_topic_carries_a_standard_type_that_we_can_write():
    assert all(row.type in messages.TYPES.types for row in TOPICS.values())


def test_a_row_is_found_by_its_own_name():
    assert all(topic(name).name == name for name in TOPICS)


def test_an_unknown_topic_is_an_error_that_lists_the_known():
    with pytest.raises(ConfigError, match=r"topic 'lidar': unknown; known: scan, odom"):
        topic("lidar")
    with pytest.raises(ConfigError, match=r"topic 'scam': unknown; did you mean 'scan'\?"):
        topic("scam")


def test_every_subscription_is_bounded():
    assert all(1 <= row.keep <= 4096 for row in TOPICS.values())


def test_scans_give_way_to_newer_ones_and_only_diagnostics_and_tf_are_shared():
    assert topic("scan").keep == 1
    assert {name for name, row in TOPICS.items() if row.shared} == {"tf", "diagnostics"}
    assert {name for name, row in TOPICS.items() if row.latched} == {"map", "trajectory", "tf_static"}


def test_a_period_is_the_inverse_of_the_rate():
    assert topic("scan").period_ns == 100_000_000
    assert topic("map").period_ns == 0
