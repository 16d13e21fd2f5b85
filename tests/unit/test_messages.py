"""Bytes, keys and tokens are those of ROS 2 and rmw_zenoh, and no byte from the wire can break us."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime import messages
from runtime.messages import Attachment, BadMessageError
from runtime.topics import TOPICS

# As ROS 2 ships them, in the type description files of its own packages.
RIHS01 = {
    "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "nav_msgs/msg/OccupancyGrid": "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    ),
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/msg/PoseArray": "af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
    "nav_msgs/msg/Path": "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "rosgraph_msgs/msg/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
}


def scan(count=3):
    return messages.LaserScan(
        header=messages.header(1_500_000_000_123_456_789, "laser"),
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=1.0,
        time_increment=0.25,
        scan_time=0.125,
        range_min=0.5,
        range_max=4.0,
        ranges=np.arange(count, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


@pytest.mark.parametrize("msgtype", sorted(RIHS01))
def test_a_type_has_the_hash_that_ros_knows(msgtype):
    assert messages.type_hash(msgtype) == f"RIHS01_{RIHS01[msgtype]}"


def test_a_scan_is_the_cdr_that_ros_writes():
    # By the CDR rules: header, little endian; strings with length and zero; arrays with length.
    expected = (
        b"\x00\x01\x00\x00"
        + (1_500_000_000).to_bytes(4, "little")
        + (123_456_789).to_bytes(4, "little")
        + b"\x06\x00\x00\x00laser\x00"
        + b"\x00\x00"
        + np.array([-1, 1, 1, 0.25, 0.125, 0.5, 4], "<f4").tobytes()
        + b"\x03\x00\x00\x00"
        + np.array([0, 1, 2], "<f4").tobytes()
        + b"\x00\x00\x00\x00"
    )
    assert messages.encode(scan()) == expected


def test_a_message_comes_back_as_it_was():
    back = messages.decode(messages.encode(scan(682)), "sensor_msgs/msg/LaserScan")
    assert back.header == scan().header
    assert back.ranges.tolist() == list(range(682))


def test_a_part_of_a_map_has_the_type_of_map_msgs():
    update = messages.OccupancyGridUpdate(
        header=messages.header(5, "map"), x=-1, y=2, width=2, height=1, data=np.array([0, 100], np.int8)
    )
    back = messages.decode(messages.encode(update), "map_msgs/msg/OccupancyGridUpdate")
    assert (back.x, back.y, back.data.tolist()) == (-1, 2, [0, 100])


@given(st.binary(max_size=200), st.sampled_from(sorted({row.type for row in TOPICS.values()})))
def test_any_bytes_are_a_message_or_a_bad_message_and_nothing_else(payload, msgtype):
    text = msgtype
    with contextlib.suppress(BadMessageError):  # any other error fails this test
        text = messages.decode(payload, msgtype).__msgtype__
    assert text == msgtype


@given(st.integers(0, 200))
def test_a_cut_scan_is_a_bad_message(length):
    whole = messages.encode(scan(40))
    with pytest.raises(BadMessageError, match="LaserScan"):
        messages.decode(whole[: min(length, len(whole) - 5)], "sensor_msgs/msg/LaserScan")


def test_a_length_that_no_payload_could_hold_costs_no_memory():
    payload = b"\x00\x01\x00\x00" + b"\x00" * 8 + b"\xff\xff\xff\x7f" + b"x" * 40
    with pytest.raises(BadMessageError):
        messages.decode(payload, "sensor_msgs/msg/LaserScan")


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_a_stamp_survives_and_is_read_without_decoding(stamp_ns):
    message = messages.PoseStamped(
        messages.header(stamp_ns, "map"),
        messages.Pose(messages.Point(x=0.0, y=0.0, z=0.0), messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)),
    )
    assert messages.stamp_ns_of(message.header.stamp) == stamp_ns
    assert messages.peek_stamp_ns(messages.encode(message)) == stamp_ns


def test_too_few_bytes_have_no_stamp():
    assert messages.peek_stamp_ns(b"\x00\x01\x00\x00123") is None


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_has_33_bytes_and_comes_back(sequence, published_ns, gid):
    data = Attachment(sequence, published_ns, gid).encode()
    assert len(data) == 33
    assert data[16] == 16
    assert Attachment.decode(data) == Attachment(sequence, published_ns, gid)


@given(st.none() | st.binary(max_size=64))
def test_any_other_attachment_is_none(data):
    decoded = Attachment.decode(data)
    assert decoded is None or (len(data) == 33 and data[16] == 16)


def test_a_key_is_that_of_rmw_zenoh():
    assert messages.topic_key("/robot/scan", "sensor_msgs/msg/LaserScan", domain=7) == (
        f"7/robot/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_{RIHS01['sensor_msgs/msg/LaserScan']}"
    )


def test_tokens_name_node_topic_type_and_quality():
    assert messages.node_token("abc", "robot", "matcher") == "@ros2_lv/0/abc/0/0/NN/%/%robot/matcher"
    token = messages.endpoint_token(
        "abc", 3, "MP", "robot", "mapper", "robot/map", "nav_msgs/msg/OccupancyGrid", ":1:,1:,:,:,,"
    )
    assert token == (
        "@ros2_lv/0/abc/0/3/MP/%/%robot/mapper/%robot%map/nav_msgs::msg::dds_::OccupancyGrid_/"
        f"RIHS01_{RIHS01['nav_msgs/msg/OccupancyGrid']}/:1:,1:,:,:,,"
    )
    assert messages.endpoints_of([token]) == [
        messages.Endpoint(
            "MP",
            "mapper",
            "robot/map",
            "nav_msgs/msg/OccupancyGrid",
            f"RIHS01_{RIHS01['nav_msgs/msg/OccupancyGrid']}",
            latched=True,
        )
    ]
    assert messages.node_of_token(messages.node_token("abc", "robot", "matcher")) == "matcher"
    assert messages.node_of_token(token) is None


def test_quality_of_service_is_written_as_ros_does():
    assert messages.qos_text(latched=False, depth=10) == "::,10:,:,:,,"
    assert messages.qos_text(latched=True, depth=1) == ":1:,1:,:,:,,"
