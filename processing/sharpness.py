"""How crisp a map is, from the points that made it: no ground truth needed, and no figure to trust alone.

Crispness rewards collapsed rooms, parallel walls miss a slip along a wall, rays miss slow drift: read all.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

CELL_M = 0.05
NEIGHBOURHOOD_CELLS = 5
"""Half the edge of the square in which spread and direction are measured: 0.25 m around a cell."""
MIN_NEIGHBOURS = 8
MIN_LINEARITY = 0.9
_VARIANCE_FLOOR_M2 = 1e-6
"""A millimetre: below the noise of any sensor, so that equal points do not count as infinitely crisp."""


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Figures of one map; lower is better except for `walls`."""

    occupied_cells: int
    """Cells of 5 cm in which a ray ended."""
    mean_map_entropy: float
    """Mean differential entropy of the points around each point (Droeschel and Behnke 2014), nat."""
    walls: float
    """|mean exp(4i alpha)| of the directions of straight stretches: 1 where all are parallel or square."""
    ray_conflict: float
    """Share of the end points in cells that more rays crossed than ended in."""


def sharpness(
    points_map: Sequence[NDArray[np.float64]], origins_map: NDArray[np.float64], cell_m: float = CELL_M
) -> Sharpness:
    """Measure the map that these scans make.

    Args:
        points_map: End points (M_i, 2) of each scan in the map frame, m, finite.
        origins_map: (N, 2) where the laser stood at each scan.
        cell_m: Edge of a cell.

    Raises:
        ValueError: No points, or not as many origins as scans.
    """
    if len(points_map) != len(origins_map):
        raise ValueError(f"{len(origins_map)} origins for {len(points_map)} scans")
    counts = np.array([len(points) for points in points_map])
    if counts.sum() == 0:
        raise ValueError("0 points, must be at least 1 to measure a map")
    points = np.vstack([points for points in points_map if len(points)])
    origins = np.repeat(np.asarray(origins_map, dtype=np.float64)[:, :2], counts, axis=0)
    corner = np.floor(np.minimum(points.min(axis=0), origins.min(axis=0)) / cell_m) - 1.0
    points = points - corner * cell_m
    origins = origins - corner * cell_m
    shape = np.ceil(np.maximum(points.max(axis=0), origins.max(axis=0)) / cell_m).astype(int) + 2
    cols, rows = np.floor(points / cell_m).astype(np.int64).T
    moments = np.zeros((6, int(shape[1]), int(shape[0])))
    x, y = points.T
    for plane, values in zip(moments, (np.ones(len(x)), x, y, x * x, x * y, y * y), strict=True):
        np.add.at(plane, (rows, cols), values)
    hits = moments[0].copy()
    entropy, walls = _spread(hits, moments)
    passes = np.zeros(hits.shape)
    count_passes(passes, origins, points, cell_m)
    conflict = float(hits[passes > hits].sum() / hits.sum())
    return Sharpness(int(np.count_nonzero(hits)), entropy, walls, conflict)


def _spread(hits: NDArray[np.float64], moments: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean map entropy and wall score from the moments (6, rows, cols) of the points in each cell."""
    occupied = hits > 0
    n, sx, sy, sxx, sxy, syy = (_box_sum(plane)[occupied] for plane in moments)
    weight = hits[occupied]
    dense = n >= MIN_NEIGHBOURS
    if not dense.any():
        return math.nan, math.nan
    n, sx, sy, sxx, sxy, syy, weight = (v[dense] for v in (n, sx, sy, sxx, sxy, syy, weight))
    vxx = np.maximum(sxx / n - (sx / n) ** 2, 0.0) + _VARIANCE_FLOOR_M2
    vyy = np.maximum(syy / n - (sy / n) ** 2, 0.0) + _VARIANCE_FLOOR_M2
    vxy = sxy / n - (sx / n) * (sy / n)
    determinant = np.maximum(vxx * vyy - vxy**2, _VARIANCE_FLOOR_M2**2)
    entropy = float(np.average(0.5 * np.log((2.0 * np.pi * np.e) ** 2 * determinant), weights=weight))
    half_gap = np.hypot(0.5 * (vxx - vyy), vxy)
    linearity = 2.0 * half_gap / (0.5 * (vxx + vyy) + half_gap)  # 1 - smaller / larger eigenvalue
    straight = linearity >= MIN_LINEARITY
    if not straight.any():
        return entropy, math.nan
    alpha = 0.5 * np.arctan2(2.0 * vxy, vxx - vyy)[straight]
    return entropy, float(abs(np.average(np.exp(4j * alpha), weights=weight[straight])))


def _box_sum(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum each cell's neighbourhood; zero padding."""
    k = NEIGHBOURHOOD_CELLS
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (k + 1, k)
        total = np.cumsum(np.pad(plane, padding), axis=axis)
        size = plane.shape[axis]
        plane = np.take(total, range(2 * k + 1, 2 * k + 1 + size), axis) - np.take(total, range(size), axis)
    return plane


@njit("void(f8[:,::1], f8[:,::1], f8[:,::1], f8)", cache=True, nogil=True)
def count_passes(
    passes: NDArray[np.float64], origins: NDArray[np.float64], points: NDArray[np.float64], cell_m: float
) -> None:
    """Add one to each cell (rows, cols) that a ray crosses on its way from origin to point, both (M, 2).

    The last two cells of a ray do not count: a beam is wider than its axis, a wall as thick as its noise.
    """
    rows, cols = passes.shape
    for i in range(points.shape[0]):
        dx = points[i, 0] - origins[i, 0]
        dy = points[i, 1] - origins[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        steps = int(length / cell_m) - 2
        for k in range(steps):
            t = k * cell_m / length
            col = int((origins[i, 0] + t * dx) / cell_m)
            row = int((origins[i, 1] + t * dy) / cell_m)
            if 0 <= row < rows and 0 <= col < cols:
                passes[row, col] += 1.0
