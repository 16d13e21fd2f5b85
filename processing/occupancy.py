"""The map as probabilities: how likely a ray stops in each cell, with "unknown" kept apart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.laser_model import PRIOR_DENSITY, PRIOR_M

OCCUPIED = 0.65
FREE = 0.25
"""Thresholds of the picture with three values, as map_server's usual ones."""
LEAST_SEEN = 0.5
"""Metres of travel, in cells, or stops: a cell seen less is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """A map of square cells; row 0 is the lowest y, column 0 the lowest x."""

    probability: NDArray[np.float32]
    """(rows, cols) that the cell stops a ray, 0 .. 1; NaN where nobody has looked."""
    resolution_m: float
    origin_m: tuple[float, float]
    """x, y of the lower left corner, map frame."""

    def __post_init__(self) -> None:
        if self.probability.ndim != 2:
            raise ValueError(f"probability of {self.probability.ndim} dimensions, must be 2")
        if not self.resolution_m > 0:
            raise ValueError(f"resolution_m = {self.resolution_m}, must be over 0")

    def percent(self) -> NDArray[np.int8]:
        """Return 0 .. 100, and -1 for unknown, as nav_msgs/OccupancyGrid carries it."""
        unknown = np.isnan(self.probability)
        return np.where(unknown, -1, np.rint(np.where(unknown, 0.0, self.probability) * 100)).astype(np.int8)

    def trinary(self) -> NDArray[np.uint8]:
        """Return 0 = occupied, 254 = free, 205 = unknown or undecided, as map_server's pictures have it."""
        picture = np.full(self.probability.shape, 205, dtype=np.uint8)
        picture[self.probability > OCCUPIED] = 0
        picture[self.probability < FREE] = 254
        return picture


def occupancy_of(
    stops: NDArray[np.float64], metres: NDArray[np.float64], cell_m: float, origin_m: tuple[float, float]
) -> OccupancyGrid:
    """Turn stops and travelled metres into probabilities, and leave the border that nobody has seen.

    Args:
        stops: (rows, cols) rays that ended in each cell.
        metres: (rows, cols) that rays travelled through it.
        cell_m: Side of a cell.
        origin_m: Lower left corner of the first cell.
    """
    seen = stops + metres / cell_m >= LEAST_SEEN
    density = (stops + PRIOR_DENSITY * PRIOR_M) / (metres + PRIOR_M)
    probability = np.where(seen, 1.0 - np.exp(-density * cell_m), np.nan).astype(np.float32)
    rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if len(rows) == 0:
        return OccupancyGrid(np.full((1, 1), np.nan, dtype=np.float32), cell_m, origin_m)
    part = probability[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    corner = (origin_m[0] + float(cols[0]) * cell_m, origin_m[1] + float(rows[0]) * cell_m)
    return OccupancyGrid(np.ascontiguousarray(part), cell_m, corner)
