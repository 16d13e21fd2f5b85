"""ROS bags of both generations, written here, read without ROS."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from runtime.formats.errors import FormatError
from runtime.formats.logs import open_log

SCAN = "sensor_msgs/msg/LaserScan"
TYPES1, TYPES2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)


def scan(types, ranges, stamp_ns, scan_time=0.1, angle_min=-1.0):
    extra = {"seq": 0} if types is TYPES1 else {}
    time = types.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return types.types[SCAN](
        header=types.types["std_msgs/msg/Header"](stamp=time, frame_id="laser", **extra),
        angle_min=angle_min,
        angle_max=1.0,
        angle_increment=0.5,
        time_increment=0.001,
        scan_time=scan_time,
        range_min=0.1,
        range_max=5.0,
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def write1(path: Path, messages):
    with Writer1(path) as writer:
        connections = {}
        for topic, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, SCAN, typestore=TYPES1)
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            writer.write(connections[topic], stamp_ns, TYPES1.serialize_ros1(message, SCAN))
    return path


def write2(path: Path, messages, plugin=StoragePlugin.SQLITE3):
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, SCAN, typestore=TYPES2)
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            writer.write(connections[topic], stamp_ns, TYPES2.serialize_cdr(message, SCAN))
    return path


def two_scans(types, **kwargs):
    rows = ([1.0, 0.0, 6.0, -1.0, 0.05], [2.0, np.nan, np.inf, 5.0, 0.1])
    return [scan(types, row, (7 + i) * 10**9 + 123456789, **kwargs) for i, row in enumerate(rows)]


@pytest.fixture(params=["ros1", "ros2 sqlite", "ros2 mcap"])
def bag(request, tmp_path):
    if request.param == "ros1":
        return write1(tmp_path / "a.bag", [("/scan", one) for one in two_scans(TYPES1)])
    plugin = StoragePlugin.SQLITE3 if "sqlite" in request.param else StoragePlugin.MCAP
    return write2(tmp_path / "bag", [("/scan", one) for one in two_scans(TYPES2)], plugin)


def test_scans_of_a_bag_come_with_stamps_geometry_and_rep_117(bag):
    log = open_log(bag)
    assert log.stamps_ns.tolist() == [7_123_456_789, 8_123_456_789]
    g = log.geometry
    assert (g.count, g.angle_min_rad, g.angle_increment_rad) == (5, -1.0, 0.5)
    assert (g.time_increment_s, g.period_s) == (np.float32(0.001), np.float32(0.1))
    expected = [[1.0, np.nan, np.inf, np.nan, np.nan], [2.0, np.nan, np.inf, np.inf, 0.1]]
    np.testing.assert_array_equal([record.ranges_m for record in log], np.array(expected, dtype=np.float32))


def test_a_bag_can_be_read_again(bag):
    log = open_log(bag)
    assert len(list(log)) == len(list(log)) == len(log) == 2


def test_the_file_inside_a_ros2_bag_is_enough(bag):
    files = [one for one in bag.iterdir() if one.suffix != ".yaml"] if bag.is_dir() else [bag]
    assert len(open_log(files[0])) == 2


def test_a_sensor_that_leaves_its_rate_open_gets_that_of_the_stamps(tmp_path):
    scans = [scan(TYPES2, [1.0] * 5, 10**9 + i * 200_000_000, scan_time=0.0) for i in range(9)]
    log = open_log(write2(tmp_path / "bag", [("/scan", one) for one in scans]))
    assert log.geometry.period_s == pytest.approx(0.2)


def test_of_several_lasers_one_must_be_chosen(tmp_path):
    (a, b) = two_scans(TYPES2)
    path = write2(tmp_path / "bag", [("/front", a), ("/rear", b)])
    with pytest.raises(FormatError, match="2 lasers, choose one with --topic: /front, /rear"):
        open_log(path)
    assert open_log(path, "rear").stamps_ns.tolist() == [8_123_456_789]
    with pytest.raises(FormatError, match="topic 'up' is no LaserScan; LaserScan topics: /front, /rear"):
        open_log(path, "up")


def test_a_bag_without_a_laser_is_told_what_it_holds(tmp_path):
    with Writer2(tmp_path / "bag", version=9) as writer:
        writer.add_connection("/chatter", "std_msgs/msg/String", typestore=TYPES2)
    with pytest.raises(FormatError, match="no sensor_msgs/msg/LaserScan topic; the bag holds /chatter"):
        open_log(tmp_path / "bag")


def test_a_laser_that_changes_in_mid_log_is_an_error_with_the_place(tmp_path):
    scans = [scan(TYPES2, [1.0] * 5, 10**9), scan(TYPES2, [1.0] * 4, 2 * 10**9)]
    path = write2(tmp_path / "bag", [("/scan", one) for one in scans])
    with pytest.raises(FormatError, match=r"/scan scan 2: beams, angles \(4, .*must stay \(5, "):
        open_log(path)


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_a_cut_bag_is_one_line(tmp_path, keep):
    path = write1(tmp_path / "a.bag", [("/scan", one) for one in two_scans(TYPES1)])
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(FormatError, match=r"a\.bag: the bag c") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)
