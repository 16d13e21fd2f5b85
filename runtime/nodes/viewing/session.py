"""Tell a session as if its drives were watched: the map as it was saved, and each scan where it was made."""

import io
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from processing.motion import Motion
from processing.se2 import Pose, between
from runtime import messages
from runtime.bus.pulling import grid_message
from runtime.formats.map_server import FREE, OCCUPIED
from runtime.formats.session import SCAN_TYPE, Parts, Session, scans_of
from runtime.formats.tum import kept_ns, read_tum
from runtime.messages import decode
from runtime.nodes.convert import motion_to_message, pose_to_message
from runtime.port import Received
from runtime.tiles import Picture

_LONGEST_NS = 1_000_000_000
"""Between two scans of one drive at most, to tell a velocity from their poses."""


def told(session: Session) -> Iterator[Received]:
    """Yield what a session says, as messages of a robot: its map, then scan, pose and motion of each scan.

    A scan without a pose in the saved trajectory is left out. Each drive begins a path of its own.
    """
    poses = _poses(session.parts)
    drive_before, stamp_before, pose_before = 0, 0, np.zeros(3)
    for drive, stamp_ns, payload in scans_of(session.path):
        pose = poses.get(kept_ns(stamp_ns))
        if pose is None:
            continue
        header = messages.header(stamp_ns, "map")
        if drive_before == 0:
            picture = Picture(
                cells=cells_of(session.parts.picture),
                resolution_m=session.parts.resolution_m,
                origin_m=session.parts.origin_m,
                stamp_ns=stamp_ns,
                published_ns=stamp_ns,
            )
            yield Received("map", grid_message(picture), received_ns=stamp_ns)
        if drive != drive_before:
            yield Received("trajectory", messages.Path(header=header, poses=[]), received_ns=stamp_ns)
        elapsed_ns = stamp_ns - stamp_before
        known = drive == drive_before and 0 < elapsed_ns <= _LONGEST_NS
        twist = between(pose_before, pose) / (1e-9 * elapsed_ns) if known else np.zeros(3)
        motion = Motion(stamp_ns=stamp_ns, odom_t_laser=pose, covariance=np.zeros((3, 3)), twist=twist)
        placed = messages.PoseWithCovariance(pose=pose_to_message(pose), covariance=np.zeros(36))
        yield Received("scan", decode(payload, SCAN_TYPE), received_ns=stamp_ns)
        yield Received(
            "pose", messages.PoseWithCovarianceStamped(header=header, pose=placed), received_ns=stamp_ns
        )
        yield Received("odom", motion_to_message(motion, parent="map"), received_ns=stamp_ns)
        drive_before, stamp_before, pose_before = drive, stamp_ns, pose


def cells_of(picture: bytes) -> NDArray[np.int8]:
    """Return the cells (rows, cols) of a saved picture as ROS has them: 0 free, 100 a wall, -1 unknown.

    Its first row is the highest y, that of the cells the lowest.
    """
    grey = np.asarray(Image.open(io.BytesIO(picture)).convert("L"))[::-1]
    cells = np.full(grey.shape, -1, dtype=np.int8)
    cells[grey == FREE] = 0
    cells[grey == OCCUPIED] = 100
    return cells


def _poses(parts: Parts) -> dict[int, Pose]:
    """Return the saved poses by their stamps, ns, as TUM keeps them."""
    with tempfile.NamedTemporaryFile(suffix=".tum") as file:
        file.write(parts.trajectory)
        file.flush()
        trajectory = read_tum(Path(file.name))
    return dict(zip(trajectory.stamps_ns.tolist(), trajectory.poses, strict=True))
