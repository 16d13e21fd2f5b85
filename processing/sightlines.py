"""Could the scan have been seen from there? Walls hide what is behind them.

A place where a scan's points lie on walls is none if its rays would have to pass through other walls, or if
its points lie where an earlier scan has looked through.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.ndt import Points
from processing.se2 import Pose, transform
from processing.sight_kernels import SLACK, SLACK_M, look_back, nearest, sector

SECTORS = 360
"""Rays and walls are compared within sectors of a degree, and of two for earlier scans."""
SIGHT_M = 10.0
SOLID = 2
"""A wall hides a ray when it stands before so many sectors on both sides, too: a chair's leg does not, nor
the wall that the ray runs along."""
THROUGH = 0.3
"""Share of the rays that may pass through walls of the map."""
BEFORE = 0.1
"""Share of the points that may lie where an earlier scan looked through."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What earlier scans say of a scan at a place."""

    possible: bool
    """Whether it can have been seen from there."""
    free: bool
    """Whether, besides, few of its rays pass anything that the map has, be it as thin as a chair's leg."""
    known: float
    """Share of its points that lie where the earlier scans have looked."""


def solid(nearest_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return from which distance on each sector's rays are hidden, given the nearest point of each (S,)."""
    turns = range(-SOLID, SOLID + 1)
    return np.asarray(np.max([np.roll(nearest_m, turn) for turn in turns], axis=0))


def judge(
    points: Points, odom_t_laser: Pose, points_odom: Points, ends: NDArray[np.int64], poses: Pose
) -> Sight:
    """Ask the local map whether a scan can have been taken at a place.

    Args:
        points: (N, 2) of the scan, laser frame, N >= 1.
        odom_t_laser: The place.
        points_odom: (M, 2) all points of the map, one earlier scan after the other, up to
        ends: (K,) each, and
        poses: (K, 3) odom_t_laser of the earlier scans.
    """
    wall_m, seen_m = np.empty(SECTORS), np.empty(SECTORS // 2)
    nearest(points_odom, 0, len(points_odom), odom_t_laser, SIGHT_M, wall_m)
    sectors = [sector(x, y, SECTORS) for x, y in points]
    distance_m = np.hypot(points[:, 0], points[:, 1])
    through, through_solid = (_through(distance_m, m[sectors]) for m in (wall_m, solid(wall_m)))
    known, counts = np.empty(len(points), np.uint8), np.zeros(2, np.int64)
    placed = np.ascontiguousarray(transform(odom_t_laser, points))
    look_back(placed, points_odom, ends, poses, SIGHT_M, seen_m, known, counts)
    before, looks = counts.tolist()
    possible = through_solid <= THROUGH and before <= BEFORE * max(looks, 1)
    return Sight(possible, possible and through <= THROUGH, float(known.mean()))


def _through(distance_m: NDArray[np.float64], wall_m: NDArray[np.float64]) -> float:
    """Return which share of the rays (N,) that have a wall on their way end behind it."""
    walled = max(int(np.count_nonzero(np.isfinite(wall_m))), 1)
    return int(np.count_nonzero(distance_m > wall_m + (SLACK_M + SLACK * wall_m))) / walled
