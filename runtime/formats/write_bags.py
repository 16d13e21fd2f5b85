"""Laser logs and recordings as MCAP files and ROS bags of both generations.

Readers sort by the time of arrival, so messages are written under times that never go backwards; the raw
stamps stand in the headers.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from runtime.formats.laser_log import LaserLog
from runtime.formats.mcap_log import LATCHED_QOS, McapChannel, McapMessage
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.tum import Trajectory
from runtime.messages import (
    TYPES,
    LaserScan,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    encode,
    header,
)
from runtime.topics import TOPICS

SCAN_CHANNEL = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "00" * 16})
POSE_CHANNEL = McapChannel("/robot/pose", "geometry_msgs/msg/PoseStamped", {"gid": "00" * 16})


def scan_messages(log: LaserLog) -> Iterator[McapMessage]:
    """Yield a log as the messages that its lasers would have published, with the holes that it has."""
    g = log.geometry
    arrived_ns = -1
    for record in log:
        arrived_ns = max(arrived_ns + 1, record.stamp_ns)
        message = LaserScan(
            header=header(record.stamp_ns, "laser"),
            angle_min=g.angle_min_rad,
            angle_max=g.angle_min_rad + g.angle_increment_rad * (g.count - 1),
            angle_increment=g.angle_increment_rad,
            time_increment=g.time_increment_s,
            scan_time=g.period_s,
            range_min=g.range_min_m,
            range_max=g.range_max_m,
            ranges=np.ascontiguousarray(record.ranges_m),
            intensities=np.zeros(0, dtype=np.float32),
        )
        channel = replace(SCAN_CHANNEL, metadata={"gid": f"{record.publisher:032x}"})
        yield McapMessage(channel, record.sequence, arrived_ns, arrived_ns, encode(message))


def pose_messages(trajectory: Trajectory) -> Iterator[McapMessage]:
    """Yield a trajectory as poses in the map frame."""
    arrived_ns = -1
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True)
    for number, (stamp_ns, (x, y, yaw)) in enumerate(rows, start=1):
        arrived_ns = max(arrived_ns + 1, stamp_ns)
        turn = Quaternion(x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
        pose = Pose(position=Point(x=x, y=y, z=0.0), orientation=turn)
        message = PoseStamped(header=header(stamp_ns, "map"), pose=pose)
        yield McapMessage(POSE_CHANNEL, number, arrived_ns, arrived_ns, encode(message))


def write_mcap(path: Path, messages: Iterable[McapMessage], about: dict[str, str] | None = None) -> int:
    """Write messages into one MCAP file; return how many."""
    writer = McapWriter(path, {"hallway": about or {}})
    count = 0
    for message in messages:
        writer.add(message.channel, message.sequence, message.log_ns, message.publish_ns, message.payload)
        count += 1
    writer.finish()
    return count


def write_ros2(folder: Path, messages: Iterable[McapMessage]) -> int:
    """Write messages into the folder of a ROS 2 bag; return how many."""
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.metadata import parse_qos

    count = 0
    connections: dict[str, Any] = {}
    with Writer(folder, version=9) as writer:
        for message in messages:
            channel = message.channel
            if channel.topic not in connections:
                row = TOPICS.get(channel.name)
                offered = parse_qos(LATCHED_QOS) if row is not None and row.latched else []
                connections[channel.topic] = writer.add_connection(
                    channel.topic, channel.msgtype, typestore=TYPES, offered_qos_profiles=offered
                )
            writer.write(connections[channel.topic], message.log_ns, message.payload)
            count += 1
    return count


def write_ros1(path: Path, messages: Iterable[McapMessage]) -> tuple[int, dict[str, int]]:
    """Write the laser scans among messages into a ROS 1 bag; return how many, and what each topic lost."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    from runtime.messages import decode

    types = get_typestore(Stores.ROS1_NOETIC)
    scan_type = SCAN_CHANNEL.msgtype
    count, left_out = 0, dict[str, int]()
    connections: dict[str, Any] = {}
    with Writer(path) as writer:
        for message in messages:
            topic = message.channel.topic
            if message.channel.msgtype != scan_type:
                left_out[topic] = left_out.get(topic, 0) + 1
                continue
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, scan_type, typestore=types)
            scan = decode(message.payload, scan_type)
            # A ROS 1 header has a number of its own, which ROS 2 has dropped.
            old = types.types["std_msgs/msg/Header"](
                seq=message.sequence or count + 1, stamp=scan.header.stamp, frame_id=scan.header.frame_id
            )
            fields = {name: getattr(scan, name) for name in _SCAN_FIELDS}
            as_ros1 = types.types[scan_type](header=old, **fields)
            writer.write(connections[topic], message.log_ns, types.serialize_ros1(as_ros1, scan_type))
            count += 1
    return count, left_out


_SCAN_FIELDS = (
    "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max",
    "ranges", "intensities",
)  # fmt: skip
