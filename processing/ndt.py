"""The Normal Distributions Transform of a reference (Biber and Strasser, IROS 2003), built to be searched.

Points become normal distributions on four grids shifted by half a cell; the score of a point is the mean of
its four densities exp(-m/2), weighted by how near it is to the middle of each cell, so that the field has
no steps. A raster of that field serves the search. The arrays stay from one reference to the next: building
costs what the points cost.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.ndt_kernels import (
    EMPTY,
    SIDE,
    accumulate,
    clear,
    derivatives,
    fit_blocks,
    sample_tiles,
    sampled_score,
)
from processing.se2 import Pose

Points = NDArray[np.float64]
Oriented = NDArray[np.float64]
"""(N, 4): places, and unit normals of the walls that they are on; 0 for points of no wall."""
Matrix = NDArray[np.float64]

_RIM = 3
"""Half cells kept free around the points: a block reaches one, a point beside it another, rounding the
third."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NdtConfig:
    """What a cell is."""

    cell_m: float = 0.5
    """Side of a cell (the paper's Table 1)."""
    fine_cell_m: float = 0.25
    """Side of the finer cells that are kept beside; 0 for none. Fine ones place a scan, wide ones find it and
    know far walls, of which there are few points."""
    min_points: int = 3
    """Fewer points than this have no distribution."""
    min_deviation_m: float = 0.02
    """Least standard deviation: no surface is known better than a ray of a cheap laser."""
    min_ratio: float = 0.001
    """Least ratio of the variances (Biber and Strasser)."""
    flat_ratio: float = 0.1
    """A cell whose variances have a smaller ratio is a piece of wall."""
    flat_stretch: float = 1e4
    """Factor on the long variance of a wall: it constrains across itself only. 1 keeps the cell as it is."""

    def __post_init__(self) -> None:
        if not 0.05 <= self.cell_m <= 5.0:
            raise ValueError(f"cell_m = {self.cell_m}, must be in [0.05, 5]")
        if self.fine_cell_m != 0.0 and not 0.05 <= self.fine_cell_m <= self.cell_m:
            raise ValueError(f"fine_cell_m = {self.fine_cell_m}, must be 0 (none) or in [0.05, cell_m]")
        if self.min_points < 2:
            raise ValueError(f"min_points = {self.min_points}, must be at least 2")
        if not 0.001 <= self.min_deviation_m <= self.cell_m:
            raise ValueError(f"min_deviation_m = {self.min_deviation_m}, must be in [0.001, cell_m]")
        if not 0.0 <= self.min_ratio <= 1.0 or not 0.0 <= self.flat_ratio <= 1.0:
            raise ValueError(
                f"min_ratio, flat_ratio = {self.min_ratio}, {self.flat_ratio}, must be in [0, 1]"
            )
        if not self.flat_stretch >= 1.0:
            raise ValueError(f"flat_stretch = {self.flat_stretch}, must be at least 1")


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Sum of the point scores at a pose, with its derivatives by x, y, yaw."""

    value: float
    gradient: NDArray[np.float64]
    """(3,)"""
    hessian: Matrix
    """(3, 3), block weights held fixed."""
    information: Matrix
    """(3, 3) Gauss-Newton part of the negative Hessian, never negative definite."""


def extent(points: Points) -> tuple[Points, Points]:
    """Return the least and the greatest x and y, (2,) each, of points (N, 2), N >= 1.

    NumPy takes forty times as long along the columns of such an array.
    """
    rows = np.ascontiguousarray(points.T)
    return rows.min(axis=1), rows.max(axis=1)


def oriented(points: Points) -> Oriented:
    """Return points (N, 2) as points of no wall; oriented ones as they are."""
    return points if points.shape[1] == 4 else np.hstack((points, np.zeros((len(points), 2))))


class Ndt:
    """A reference that scans can be matched against, its points and the poses in one frame."""

    def __init__(self, config: NdtConfig, capacity: int = 4096) -> None:
        self.config = config
        self._half_m = 0.5 * config.cell_m
        self._rule = np.array(
            (
                config.min_points,
                config.min_deviation_m**2,
                config.min_ratio,
                config.flat_ratio,
                config.flat_stretch,
            )
        )
        # Variance of the distance between a place and the sample that stands for it, twice that of a square,
        # so that neighbouring samples overlap.
        self.raster_variance = 2.0 * (self._half_m / SIDE) ** 2 / 12.0
        self.origin = np.zeros(3)
        self._counts = np.zeros(3, np.int64)
        self.fine: Ndt | None = None
        """The same points in finer cells, which have no raster."""
        if config.fine_cell_m > 0.0:
            self.fine = Ndt(replace(config, cell_m=config.fine_cell_m, fine_cell_m=0.0), capacity)
        self._allocate(capacity)
        self._open(64, 64)

    def _allocate(self, capacity: int) -> None:
        self._sums = np.zeros((capacity, 6))
        self._places = np.zeros((capacity, 2), np.int32)
        # A point opens at most four blocks and nine tiles; neighbours share nearly all of them, and memory
        # that nobody touches costs nothing.
        self.normals = np.zeros((4 * capacity, 5))
        self._blocks = np.zeros((4 * capacity, 2), np.int32)
        self.tiles = np.zeros((9 * capacity, SIDE * SIDE), np.float32)
        self._tile_places = np.zeros((len(self.tiles), 2), np.int32)

    def _open(self, rows: int, cols: int) -> None:
        self.slots = np.full((3, rows, cols), EMPTY, np.int32)

    @property
    def grid(self) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
        """Origin, slots and normals, as `ndt_kernels` lays them out."""
        return self.origin, self.slots, self.normals

    @property
    def cells(self) -> int:
        """Number of cells that the points touch, on all four grids."""
        return int(self._counts[1])

    def build(self, points: Points) -> None:
        """Replace the reference by finite points (N, 2); none makes it empty."""
        self._fit(points)
        if len(points) > 0:
            sample_tiles(
                self.origin,
                self.slots,
                self.normals,
                self._blocks,
                self.tiles,
                self._tile_places,
                self.raster_variance,
                self._counts,
            )
        if self.fine is not None:
            self.fine._fit(points)

    def _fit(self, points: Points) -> None:
        """Make the cells, without their raster."""
        clear(self.slots, self._places, self._blocks, self._tile_places, self._counts)
        if len(points) == 0:
            return
        least, greatest = extent(points)
        low = np.floor(least / self._half_m) - _RIM
        high = np.floor(greatest / self._half_m) + _RIM + 1
        cols, rows = int(high[0] - low[0]), int(high[1] - low[1])
        if rows > self.slots.shape[1] or cols > self.slots.shape[2]:
            self._open(max(rows + 32, self.slots.shape[1]), max(cols + 32, self.slots.shape[2]))
        if len(points) > len(self._sums):
            self._allocate(2 * len(points))
        self.origin[:] = low[0] * self._half_m, low[1] * self._half_m, 1.0 / self._half_m
        accumulate(points, self.origin, self.slots, self._sums, self._places, self._counts)
        fit_blocks(
            self.origin,
            self.slots,
            self._sums,
            self._places,
            self.normals,
            self._blocks,
            self._rule,
            self._counts,
        )

    def score(self, points: Points | Oriented, frame_t_points: Pose, blur_m2: float = 0.0) -> Score:
        """Rate points (N, 2) or (N, 4) moved to a pose, exactly.

        Args:
            points: Those on a wall tell across it only.
            frame_t_points: (3,) the pose.
            blur_m2: Is added to the variances of the cells.
        """
        gradient, hessian, information = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        value = derivatives(
            oriented(points),
            self.origin,
            self.slots,
            self.normals,
            frame_t_points,
            blur_m2,
            gradient,
            hessian,
            information,
        )
        return Score(float(value), gradient, hessian, information)

    def sampled_score(self, points: Points, frame_t_points: Pose) -> float:
        """Rate points (N, 2) moved to a pose, by the raster that the search looks up."""
        x, y, yaw = frame_t_points
        columns = np.ascontiguousarray(points.T, np.float32)
        samples = np.empty(len(points), np.int32)
        return float(sampled_score(columns, self.origin, self.slots, self.tiles, x, y, yaw, samples))
