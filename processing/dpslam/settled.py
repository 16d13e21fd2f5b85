"""The settled map: an NDT of the key scans that lie so far behind that the laser sees them no more.

Being found on it means having come back. It only grows; when the path below it moves, it is built anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.settled_kernels import fit_of_points, look_away, note_views, refit, refit_all
from processing.growing import longer
from processing.local_map import BEHIND_M, BEHIND_SLANT
from processing.matching_kernels import polish
from processing.ndt import NdtConfig, Points, extent, oriented
from processing.ndt_kernels import accumulate
from processing.se2 import Pose, transform

CELL_M = 0.25
"""Many scans fill a cell here, so it may be smaller than the half metre that one scan needs."""
_STAGES = np.array(((0.01, 0.0), (0.0, 0.0)))
"""Variances (m^2) that widen the cells: first a decimetre, for the basin; then as they are. No finer
cells."""
FLAT = 0.25
"""A cell whose variances have a smaller ratio is a wall: of many passes it is thicker than of one scan."""
_FREE = 1e9
"""Degrees of freedom of a normal prior."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a scan lies on the map."""

    map_t_points: Pose
    information: NDArray[np.float64]
    """(3, 3) Gauss-Newton information of the score, map axes, one unit a point that fits."""


class SettledMap:
    """Normal distributions of everything added so far."""

    def __init__(self) -> None:
        c = NdtConfig(cell_m=CELL_M, flat_ratio=FLAT)
        self._half_m = 0.5 * CELL_M
        self._rule = np.array((c.min_points, c.min_deviation_m**2, c.min_ratio, c.flat_ratio, c.flat_stretch))
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._origin = np.array((0.0, 0.0, 1.0 / self._half_m))
        self._slots = np.full((3, 0, 0), -1, dtype=np.int32)
        self._sums: NDArray[np.float64] = np.zeros((0, 6))
        self._places: NDArray[np.int32] = np.zeros((0, 2), dtype=np.int32)
        self._normals: NDArray[np.float64] = np.zeros((0, 5))
        self._views: NDArray[np.float64] = np.zeros((0, 2))
        self._owners: NDArray[np.int32] = np.zeros(0, dtype=np.int32)
        self._counts = np.zeros(3, dtype=np.int64)
        self._scans = 0

    def add(self, points: Points, map_t_laser: Pose) -> None:
        """Work the points (N, 2), laser frame, of the next scan into the map; it was taken at a pose (3,)."""
        self._scans += 1
        if len(points) == 0:
            return
        placed = np.ascontiguousarray(transform(map_t_laser, points))
        self._cover(placed)
        self._accumulate(placed, map_t_laser[:2], self._scans - 1)
        self._counts[1] = refit(
            placed, self._origin, self._slots, self._sums, self._normals, self._rule, self._counts[1]
        )

    def rebuild(self, scans: Sequence[Points], path: Pose) -> None:
        """Forget everything and take these scans at once, as if added one after the other.

        Args:
            scans: The points of each, (N, 2) m, laser frame.
            path: (K, 3) map_t_laser of each.
        """
        self.clear()
        if sum(len(points) for points in scans) == 0:
            return
        counts = [len(points) for points in scans]
        poses = np.repeat(path, counts, axis=0)
        points = np.vstack(scans)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x = c * points[:, 0] - s * points[:, 1] + poses[:, 0]
        y = s * points[:, 0] + c * points[:, 1] + poses[:, 1]
        placed = np.column_stack((x, y))
        self._cover(placed)
        ends = np.cumsum(counts)
        for scan, (first, end) in enumerate(zip(ends - counts, ends, strict=True)):
            self._accumulate(placed[first:end], path[scan, :2], scan)
        self._scans = len(counts)
        self._counts[1] = refit_all(
            self._places, self._counts[0], self._slots, self._sums, self._normals, self._rule, self._counts[1]
        )

    def away(self, points: Points, map_t_points: Pose) -> NDArray[np.bool_]:
        """Return which of the points (N, 2) of a scan lie on walls whose other side was seen, and only that.

        A wall between two rooms has a side in each; matched on the wrong one, the scan would be off by the
        thickness of the wall. See `processing.local_map`.
        """
        away = np.empty(len(points), np.bool_)
        grid = (self._origin, self._slots, self._sums, self._normals, self._views)
        look_away(points, map_t_points, *grid, BEHIND_M, BEHIND_SLANT, away)
        return away

    def fits(self, points: Points, map_t_points: Pose) -> NDArray[np.float64]:
        """Score each of the points (N, 2) at a pose, 0 to 1; -1 where the map knows nothing."""
        fits = np.empty(len(points))
        fit_of_points(points, self._origin, self._slots, self._normals, map_t_points, fits)
        return fits

    def owners(self, points: Points, map_t_points: Pose) -> NDArray[np.int64]:
        """Return which scans were the first to see the places on which points (N, 2) lie at a pose (3,).

        Returns:
            (M,) numbers of scans, counted from 0, for the points that lie where the map has any.
        """
        places = np.floor((transform(map_t_points, points) - self._origin[:2]) * self._origin[2]).astype(
            np.int64
        )
        rows, cols = self._slots.shape[1:]
        inside = ((places >= 0) & (places < (cols, rows))).all(axis=1)
        slots = self._slots[0, places[inside, 1], places[inside, 0]]
        return np.asarray(self._owners[slots[slots >= 0]], np.int64)

    def refine(self, points: Points, map_t_guess: Pose, information: NDArray[np.float64]) -> Fit:
        """Lay points (N, 2) on the map, from a guess held with the given information (3, 3), map axes."""
        prior = np.concatenate((map_t_guess, information.ravel(), (_FREE, 1.0)))
        pose, curvature, report = np.array(map_t_guess), np.zeros((2, 3, 3)), np.zeros(3)
        grid = (self._origin, self._slots, self._normals)
        polish(oriented(points), grid, grid, prior, _STAGES, pose, curvature, report)
        return Fit(pose, curvature[1])

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `restore` takes it back, bit for bit."""
        return {
            "origin": self._origin.copy(),
            "slots": self._slots.copy(),
            "sums": self._sums.copy(),
            "places": self._places.copy(),
            "normals": self._normals.copy(),
            "views": self._views.copy(),
            "owners": self._owners.copy(),
            "counts": self._counts.copy(),
            "scans": np.array(self._scans),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the map whose `state` was taken."""
        self._origin, self._slots = state["origin"].copy(), state["slots"].copy()
        self._sums, self._places = state["sums"].copy(), state["places"].copy()
        self._normals, self._counts = state["normals"].copy(), state["counts"].copy()
        self._views, self._owners = state["views"].copy(), state["owners"].copy()
        self._scans = int(state["scans"])

    def _accumulate(self, points: Points, laser: NDArray[np.float64], scan: int) -> None:
        """Add points (N, 2) within the window, seen from (2,) by a scan, to the sums of their half cells."""
        known = int(self._counts[0])
        need = known + len(points)
        if need > len(self._sums):
            size = 2 * need
            self._sums = longer(self._sums, size)
            self._places = longer(self._places, size)
            self._normals = longer(self._normals, 4 * size)
            self._views = longer(self._views, size)
            self._owners = longer(self._owners, size)
        accumulate(points, self._origin, self._slots, self._sums, self._places, self._counts)
        self._owners[known : self._counts[0]] = scan
        note_views(points, laser, self._origin, self._slots, self._views)

    def _cover(self, points: Points) -> None:
        """Let the window cover the points (N, 2) with a border."""
        least, greatest = extent(points)
        low = np.floor(least / self._half_m).astype(np.int64) - 2
        high = np.floor(greatest / self._half_m).astype(np.int64) + 3
        old_low = np.round(self._origin[:2] / self._half_m).astype(np.int64)
        shape = np.array(self._slots.shape[:0:-1])
        if shape[0] == 0:
            old_low = low
        if (low < old_low).any() or (high > old_low + shape).any():
            grown = np.maximum(np.maximum(shape, 64) // 4, 8)
            new_low = np.where(low < old_low, low - grown, old_low)
            new_high = np.where(high > old_low + shape, high + grown, old_low + shape)
            cols, rows = (new_high - new_low).tolist()
            slots = np.full((3, rows, cols), -1, dtype=np.int32)
            (at_col, at_row), (n_col, n_row) = (old_low - new_low).tolist(), shape.tolist()
            slots[:, at_row : at_row + n_row, at_col : at_col + n_col] = self._slots
            self._slots = slots
            self._origin[:2] = new_low * self._half_m
            self._shift(np.asarray((old_low - new_low) * self._half_m, dtype=np.float64))

    def _shift(self, moved: NDArray[np.float64]) -> None:
        """Express sums and normals from a corner that lies `moved` (2,) m down and left of the old one."""
        n, (x, y) = self._sums[:, 0], moved
        su, sv = self._sums[:, 1].copy(), self._sums[:, 2].copy()
        self._sums[:, 1] += n * x
        self._sums[:, 2] += n * y
        self._sums[:, 3] += 2.0 * x * su + n * x * x
        self._sums[:, 4] += x * sv + y * su + n * x * y
        self._sums[:, 5] += 2.0 * y * sv + n * y * y
        self._normals[:, :2] += moved
