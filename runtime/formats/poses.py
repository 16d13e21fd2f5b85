"""Trajectories in recordings: whichever topic carries poses, as one TUM file would hold them."""

from pathlib import Path
from typing import Any

import numpy as np

from runtime.formats.errors import FormatError
from runtime.formats.mcap_log import McapReader
from runtime.formats.tum import Trajectory
from runtime.messages import BadMessageError, decode, stamp_ns_of

POSE_TYPES = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
}
PATH_TYPE = "nav_msgs/msg/Path"
PREFERRED = ("trajectory", "pose", "odom", "truth")
"""Which topic is taken when nobody says: the path of the map knows most."""


def read_poses(path: Path, topic: str | None = None) -> Trajectory:
    """Read the poses of one topic of an MCAP file; of a Path, the last one.

    Raises:
        FormatError: No topic of that name carries poses.
    """
    wanted = _choose(path, topic)
    stamped: list[tuple[int, Any]] = []
    for message in McapReader(path).messages():
        channel = message.channel
        if channel.topic != wanted:
            continue
        try:
            decoded = decode(message.payload, channel.msgtype)
        except BadMessageError as error:
            raise FormatError(path, f"{wanted}: {error}") from error
        if channel.msgtype == PATH_TYPE:
            stamped = [(stamp_ns_of(one.header.stamp), one.pose) for one in decoded.poses]
        else:
            stamped.append((stamp_ns_of(decoded.header.stamp), POSE_TYPES[channel.msgtype](decoded)))
    if not stamped:
        raise FormatError(path, f"0 poses on {wanted}, must be at least 1")
    rows = [
        (pose.position.x, pose.position.y, 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w))
        for _, pose in stamped
    ]
    return Trajectory(np.array([stamp for stamp, _ in stamped], dtype=np.int64), np.array(rows))


def _choose(path: Path, topic: str | None) -> str:
    found: dict[str, str] = {}
    for message in McapReader(path).messages():
        found.setdefault(message.channel.topic, message.channel.msgtype)
    carriers = [name for name, kind in found.items() if kind in POSE_TYPES or kind == PATH_TYPE]
    if topic is not None:
        carriers = [
            name for name in carriers if topic.strip("/") in (name.strip("/"), name.rsplit("/", 1)[-1])
        ]
    for ending in PREFERRED:
        for name in carriers:
            if name.rsplit("/", 1)[-1] == ending:
                return name
    if not carriers:
        wanted = f"topic {topic!r} carries no poses" if topic else "no topic carries poses"
        raise FormatError(path, f"{wanted}; the file holds {', '.join(sorted(found)) or 'nothing'}")
    return carriers[0]
