"""Fewer points, evenly: what a search can take of a stretch of way."""

import numpy as np

from processing.ndt import Points


def thinned(points: Points, cell_m: float) -> Points:
    """Return of points (N, 2) the first in each cell of a grid."""
    cells = np.floor(points / cell_m).astype(np.int64)
    _, first = np.unique(cells[:, 0] * 2_000_003 + cells[:, 1], return_index=True)
    return points[first]


def picked(points: Points, most: int) -> Points:
    """Return at most so many of points (N, 2), at even steps through their order."""
    if len(points) > most:
        points = points[np.linspace(0, len(points) - 1, most).astype(np.int64)]
    return np.ascontiguousarray(points)
