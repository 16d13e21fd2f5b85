"""Could the scan have been seen from there? Walls hide what is behind them.

A place where a scan's points lie on walls is none if its rays would have to pass through other walls, or if
its points lie where an earlier scan has looked through.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from processing.ndt import Points
from processing.se2 import Pose, between, invert, transform

SECTOR_RAD = np.radians(1.0)
"""Rays and walls are compared within sectors of this width."""
SIGHT_M = 10.0
SLACK_M = 0.2
SLACK = 0.1
"""A ray ends behind a wall only when it is longer by so much and by this share: poses and walls are rough."""
THROUGH = 0.3
"""Share of the rays that may pass through walls of the map."""
BEFORE = 0.1
"""Share of the points that may lie where an earlier scan looked through."""


def plausible(
    points: Points, odom_t_laser: Pose, points_odom: Points, earlier: Iterable[tuple[Pose, Points]]
) -> bool:
    """Whether a scan can have been taken at a place.

    Args:
        points: (N, 2) of the scan, laser frame, N >= 1.
        odom_t_laser: The place.
        points_odom: (M, 2) all points of the map.
        earlier: Pose, and points (K, 2) in the odometry's frame, of each earlier scan.
    """
    wall_m = _nearest(transform(invert(odom_t_laser), points_odom))
    if np.mean(_behind(points, wall_m)) > THROUGH:
        return False
    hidden = []
    for odom_t_earlier, seen_odom in earlier:
        seen_m = _nearest(transform(invert(odom_t_earlier), seen_odom), 2)
        hidden.append(_before(transform(between(odom_t_earlier, odom_t_laser), points), seen_m, 2))
    return not hidden or float(np.mean(np.concatenate(hidden))) <= BEFORE


def _sectors(points: Points, width: int) -> NDArray[np.int64]:
    bearing = np.arctan2(points[:, 1], points[:, 0])
    sector = np.floor(bearing / (width * SECTOR_RAD)).astype(np.int64)
    return np.asarray(sector % round(2 * np.pi / (width * SECTOR_RAD)))


def _nearest(points: Points, width: int = 1) -> NDArray[np.float64]:
    """Return the distance of the nearest point in each sector; infinite where there is none."""
    distance = np.hypot(points[:, 0], points[:, 1])
    nearest = np.full(round(2 * np.pi / (width * SECTOR_RAD)), np.inf)
    near = distance < SIGHT_M
    np.minimum.at(nearest, _sectors(points[near], width), distance[near])
    return nearest


def _behind(points: Points, wall_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell of each point whose sector has a wall whether it lies behind the nearest one."""
    wall = wall_m[_sectors(points, 1)]
    known = np.isfinite(wall)
    distance = np.hypot(points[known, 0], points[known, 1])
    behind = distance > wall[known] + SLACK_M + SLACK * wall[known]
    return behind if len(behind) else np.zeros(1, np.bool_)


def _before(points: Points, seen_m: NDArray[np.float64], width: int) -> NDArray[np.bool_]:
    """Tell of each point whose sector an earlier scan looked into whether that scan looked past it."""
    seen = seen_m[_sectors(points, width)]
    known = np.isfinite(seen)
    distance = np.hypot(points[known, 0], points[known, 1])
    return np.asarray(distance < seen[known] - SLACK_M - SLACK * seen[known])
