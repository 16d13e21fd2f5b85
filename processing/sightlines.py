"""Could the scan have been seen from there? Walls hide what is behind them.

A place where a scan's points lie on walls is none if its rays would have to pass through other walls, or if
its points lie where an earlier scan has looked through.
"""

from collections.abc import Iterable
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class Sight:
    """What earlier scans say of a scan at a place."""

    possible: bool
    """Whether it can have been seen from there."""
    known: float
    """Share of its points that lie where the earlier scans have looked."""


def judge(
    points: Points, odom_t_laser: Pose, points_odom: Points, earlier: Iterable[tuple[Pose, Points]]
) -> Sight:
    """Ask the local map whether a scan can have been taken at a place.

    Args:
        points: (N, 2) of the scan, laser frame, N >= 1.
        odom_t_laser: The place.
        points_odom: (M, 2) all points of the map.
        earlier: Pose, and points (K, 2) in the odometry's frame, of each earlier scan.
    """
    wall_m = _nearest(transform(invert(odom_t_laser), points_odom))[_sectors(points)]
    distance = np.hypot(points[:, 0], points[:, 1])
    walled = max(int(np.count_nonzero(np.isfinite(wall_m))), 1)
    through = int(np.count_nonzero(distance > _longer(wall_m))) / walled
    known = np.zeros(len(points), np.bool_)
    before, looks = 0, 0
    for odom_t_earlier, seen_odom in earlier:
        seen_m = _nearest(transform(invert(odom_t_earlier), seen_odom), 2)
        placed = transform(between(odom_t_earlier, odom_t_laser), points)
        end_m, away_m = seen_m[_sectors(placed, 2)], np.hypot(placed[:, 0], placed[:, 1])
        looked = np.isfinite(end_m)
        known |= looked & (away_m <= _longer(end_m))
        before += int(np.count_nonzero(_longer(away_m[looked]) < end_m[looked]))
        looks += int(np.count_nonzero(looked))
    return Sight(through <= THROUGH and before <= BEFORE * max(looks, 1), float(known.mean()))


def _longer(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return from where on something lies behind what is so far away."""
    return distance_m + (SLACK_M + SLACK * distance_m)


def _sectors(points: Points, width: int = 1) -> NDArray[np.int64]:
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
