"""Between what `processing` computes with and what the topics carry, bit for bit.

A run through messages must give the same bytes as a run in one process: single-precision fields are rounded
by `Beams` already, and yaw angles lie on the grid of `se2.snap_yaw`, which survives the quaternion.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.motion import Motion
from processing.scan import Beams, Scan
from runtime import messages
from runtime.messages import BadMessageError

UNKNOWN_PERIOD_S = 0.1
"""Taken for the sweep of a publisher that leaves it open."""

_PLANAR = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z, roll, pitch, yaw


def scan_to_message(scan: Scan, frame: str = "laser") -> messages.LaserScan:
    """Return the LaserScan of a scan; its `angle_max` is that of the last ray."""
    beams = scan.beams
    return messages.LaserScan(
        header=messages.header(scan.stamp_ns, frame),
        angle_min=beams.angle_min_rad,
        angle_max=float(np.float32(beams.angle_min_rad + beams.angle_increment_rad * (beams.count - 1))),
        angle_increment=beams.angle_increment_rad,
        time_increment=beams.time_increment_s,
        scan_time=beams.period_s,
        range_min=beams.range_min_m,
        range_max=beams.range_max_m,
        ranges=np.ascontiguousarray(scan.ranges_m, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def scan_from_message(message: Any) -> Scan:
    """Return the scan of a LaserScan; its ranges are a writable copy.

    Raises:
        BadMessageError: The message describes no possible scanner.
    """
    try:
        beams = Beams(
            count=len(message.ranges),
            angle_min_rad=message.angle_min,
            angle_increment_rad=message.angle_increment,
            time_increment_s=message.time_increment,
            period_s=message.scan_time or UNKNOWN_PERIOD_S,
            range_min_m=message.range_min,
            range_max_m=message.range_max,
        )
        stamp_ns = messages.stamp_ns_of(message.header.stamp)
        return Scan(stamp_ns, np.array(message.ranges, dtype=np.float32), beams)
    except ValueError as error:
        raise BadMessageError(f"LaserScan: {error}") from error


def motion_to_message(motion: Motion, parent: str = "odom", child: str = "laser") -> messages.Odometry:
    """Return the Odometry of a motion: pose in `parent`; covariance and twist in the laser's frame."""
    covariance = np.zeros((6, 6))
    covariance[_PLANAR] = motion.covariance
    vx, vy, yaw_rate = map(float, motion.twist)
    twist = messages.Twist(
        linear=messages.Vector3(x=vx, y=vy, z=0.0), angular=messages.Vector3(x=0.0, y=0.0, z=yaw_rate)
    )
    return messages.Odometry(
        header=messages.header(motion.stamp_ns, parent),
        child_frame_id=child,
        pose=messages.PoseWithCovariance(
            pose=pose_to_message(motion.odom_t_laser), covariance=covariance.ravel()
        ),
        twist=messages.TwistWithCovariance(twist=twist, covariance=np.zeros(36)),
    )


def motion_from_message(message: Any) -> Motion:
    """Return the motion of an Odometry that `motion_to_message` made."""
    twist = message.twist.twist
    return Motion(
        stamp_ns=messages.stamp_ns_of(message.header.stamp),
        odom_t_laser=se2.snap_yaw(pose_from_message(message.pose.pose)),
        covariance=np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)[_PLANAR],
        twist=np.array((twist.linear.x, twist.linear.y, twist.angular.z)),
    )


def pose_to_message(a_t_b: NDArray[np.float64]) -> messages.Pose:
    """Return the Pose of a planar pose (3,)."""
    x, y, yaw = map(float, a_t_b)
    return messages.Pose(position=messages.Point(x=x, y=y, z=0.0), orientation=_quaternion(yaw))


def pose_from_message(pose: Any) -> NDArray[np.float64]:
    """Return the planar part (3,) of a Pose."""
    q = pose.orientation
    return np.array((pose.position.x, pose.position.y, 2.0 * np.arctan2(q.z, q.w)))


def transform_to_message(
    stamp_ns: int, parent: str, child: str, parent_t_child: NDArray[np.float64]
) -> messages.TransformStamped:
    """Return the TransformStamped of a planar pose (3,)."""
    x, y, yaw = map(float, parent_t_child)
    return messages.TransformStamped(
        header=messages.header(stamp_ns, parent),
        child_frame_id=child,
        transform=messages.Transform(
            translation=messages.Vector3(x=x, y=y, z=0.0), rotation=_quaternion(yaw)
        ),
    )


def _quaternion(yaw: float) -> messages.Quaternion:
    return messages.Quaternion(x=0.0, y=0.0, z=float(np.sin(yaw / 2.0)), w=float(np.cos(yaw / 2.0)))
