"""Old ground: the key scans that lie so far behind that the laser sees them no more, and the map of them."""

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.judging import FITTING, away_m
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.settled import SettledMap
from processing.dpslam.settled_kernels import look_through
from processing.dpslam.way import Way
from processing.ndt import Points
from processing.se2 import Pose, between, compose, transform

Matrix = NDArray[np.float64]

MOST_BEHIND = 0.1
"""Share of the points that fit which may lie on walls that are known from their other side only,"""
MOST_BEHIND_IN_PART = 0.2
"""and where only a part of the ground is known: the other half of a room shows its furniture from behind (a
tenth of what fits, in a laboratory), but not as much as a wall between two rooms does (three tenths)."""
MOVED_M, MOVED_RAD = 0.01, 0.003
"""A path that has moved by more needs its map anew."""
SIGHT_M = 3.0
"""So far beyond where the laser may be something of what it sees is looked for."""
BEYOND_M = 5.0
"""And so far beyond what matters around the map is taken along."""
PASSED_M = 0.1
"""Edge of the squares through which rays passed."""
PASSES = 2
"""So many rays make it known: one alone may have been a chance."""
PASSED_SHORT_M = 0.2
"""No ray tells anything of the last bit before its end: it is as wide as that far away, or runs along a
wall."""
PASSED_MOST_M = 8.0
"""Nor of what is farther away, where neighbouring rays lie squares apart and the pose's error tells."""
MOST_LOOKS = 200
"""Key scans whose rays are asked, at most, evenly."""


class OldGround:
    """The settled part of a way."""

    def __init__(self, way: Way, config: LoopConfig) -> None:
        self._way, self._config = way, config
        self.map = SettledMap()
        self.keys = 0
        """How many key scans are settled: the first so many of the way."""

    @property
    def path(self) -> Pose:
        """(S, 3) map_t_laser of the settled key scans."""
        return self._way.path[: self.keys]

    def grow(self) -> None:
        """Take what has come to lie far enough behind into the map."""
        way = self._way
        while way.lengths_m[self.keys] < way.lengths_m[-1] - self._config.reach_m:
            self.map.add(way.points[self.keys], way.path[self.keys])
            self.keys += 1

    def redraw(self) -> None:
        """Build the map anew, along the path as it is now."""
        self.map.rebuild(self._way.points[: self.keys], self.path)

    def has_moved(self, path: Pose) -> bool:
        """Return whether another path (K, 3) of the same key scans has its settled part elsewhere."""
        known = min(self.keys, len(self._way.path))
        moved = np.abs(between(self._way.path[:known], path[:known]))
        return bool(known and (moved[:, :2].max() > MOVED_M or moved[:, 2].max() > MOVED_RAD))

    def witness(self, points: Points, map_t_laser: Pose) -> int | None:
        """Return the settled key scan to which a place is tied by those points that lie on walls there.

        Who merely stands near may have seen other walls, and drifted since. Of the stretch of way that was
        the first to see these it is the key scan nearest to the place.

        Args:
            points: (N, 2) m, laser frame.
            map_t_laser: (3,) the place.
        """
        on_walls = points[self.map.fits(points, map_t_laser) > FITTING]
        owners = self.map.owners(on_walls, map_t_laser)
        if len(owners) == 0:
            return None
        lengths_m = self._way.lengths_m[: self.keys]
        middle = np.sort(owners)[len(owners) // 2]
        stretch = np.flatnonzero(np.abs(lengths_m - lengths_m[middle]) <= self._config.reach_m)
        off = np.abs(between(map_t_laser, self._way.path[stretch]))
        return int(stretch[(np.hypot(off[:, 0], off[:, 1]) + 0.5 * off[:, 2]).argmin()])

    def is_behind_walls(self, map_t_laser: Pose, first: int, partly: bool) -> bool:
        """Return whether a stretch of way fits because the walls of one room lie on those of the next one.

        Args:
            map_t_laser: (3,) where the newest key scan was found.
            first: Key scan at which the stretch begins.
            partly: Whether the ground is known in part.
        """
        way, fitting, behind = self._way, 0, 0
        for key in range(first, len(way.points)):
            points, at = way.points[key], compose(map_t_laser, between(way.path[-1], way.path[key]))
            fits = self.map.fits(points, at) > FITTING
            fitting += int(np.count_nonzero(fits))
            behind += int(np.count_nonzero(fits & self.map.away(points, at)))
        return behind > (MOST_BEHIND_IN_PART if partly else MOST_BEHIND) * fitting

    def drift(self) -> Matrix:
        """Return how far the newest key scan may be off (3, 3), seen from the best known one around."""
        way = self._way
        total = way.drift.now
        if self.keys == 0:
            return total
        at = way.path[-1]
        reach_m = min(3.0 * away_m(total) + 0.5, self._config.most_window_m) + SIGHT_M
        around = np.flatnonzero(self._off_m(at) < reach_m)
        if len(around) == 0:
            return total
        best = int(around[np.trace(way.drift.errors.rows[around, :2, :2], axis1=1, axis2=2).argmin()])
        return way.drift.since(best, between(way.path[best], at))

    def cloud(self, at: Pose, reach_m: float) -> Points | None:
        """Return all points (N, 2) m, map frame, that may be seen from a pose (3,), or from not far off.

        Args:
            at: The pose.
            reach_m: How far off.

        Returns:
            None where hardly a key scan lies around.
        """
        off_m = self._off_m(at)
        if (off_m < reach_m + SIGHT_M).sum() < 5:
            return None
        near = np.flatnonzero(off_m < reach_m + self._config.reach_m)
        points = np.vstack([transform(self._way.path[k], self._way.points[k]) for k in near])
        return points[(np.abs(points - at[:2]) < reach_m + self._config.reach_m + BEYOND_M).all(axis=1)]

    def passed(self, at: Pose, reach_m: float) -> Points:
        """Return the middles (N, 2) m, map frame, of the squares of edge PASSED_M that were looked through.

        Args:
            at: (3,) the pose around which `cloud` is asked,
            reach_m: and how far off.
        """
        near = np.flatnonzero(self._off_m(at) < reach_m + self._config.reach_m)
        half_m = reach_m + self._config.reach_m + BEYOND_M
        origin = np.floor((at[:2] - half_m) / PASSED_M) * PASSED_M
        side = int(2.0 * half_m / PASSED_M) + 2
        passed = np.zeros((side, side), np.uint8)
        for k in near[:: -(-len(near) // MOST_LOOKS)]:
            pose = self._way.path[k]
            ends = np.ascontiguousarray(transform(pose, self._way.points[k][::2]))
            rule = (PASSED_M, PASSED_SHORT_M, PASSED_MOST_M)
            look_through(np.ascontiguousarray(pose[:2]), ends, origin, *rule, passed)
        rows, cols = np.nonzero(passed >= PASSES)
        return np.asarray(origin + (np.column_stack((cols, rows)) + 0.5) * PASSED_M)

    def _off_m(self, at: Pose) -> NDArray[np.float64]:
        path = self.path
        return np.asarray(np.hypot(path[:, 0] - at[0], path[:, 1] - at[1]))
