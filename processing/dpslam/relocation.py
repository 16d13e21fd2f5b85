"""What a search over the whole map answers, and the pieces of the map that it reads."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.alignment import align
from processing.dpslam.grid import CELL_M, METRES, PLACES, STOPS, TileStore
from processing.dpslam.laser_model import PRIOR_M, PRIOR_STOPS
from processing.se2 import Pose

CELL_FIT_M = 0.1
FIT_M = 0.12
"""Blur of the walls."""
WALL = 0.4
"""Cells that stop a ray with this probability are walls."""
GRAIN = np.array((0.1, 0.1, 0.05))
"""How far a found place may be from the true one, one sigma: the search goes in steps; m, m, rad."""
GAIN = 0.3
"""Weight of one point's score against that."""
RAYS = 134


@dataclass(frozen=True, slots=True, eq=False)
class Relocation:
    """What a search over the whole map found."""

    map_t_laser: Pose | None
    """(3,) the one place; None if there is none, or more than one."""
    places: tuple[Pose, ...]
    """Every place that fits: none, the one, or the two that cannot be told apart."""
    fits: tuple[float, ...]
    """Share of the points that find their wall, of each place that the search named."""


NOWHERE = Relocation(None, (), ())


def walls_of(store: TileStore, particle: int) -> NDArray[np.float64]:
    """Return the mean end points (N, 2) of one particle's walls, m, map frame."""
    cells, (row, col) = store.dense(particle)
    stops, metres = cells[..., 0] / STOPS, cells[..., 1] / METRES
    stop = 1.0 - np.exp(-(stops + PRIOR_STOPS) / (metres + PRIOR_M) * CELL_M)
    rows, cols = np.nonzero((stops > 0.0) & (stop >= WALL))
    x = (cols + col + cells[rows, cols, 2] / PLACES) * CELL_M
    y = (rows + row + cells[rows, cols, 3] / PLACES) * CELL_M
    return np.column_stack((x, y))


def polished(store: TileStore, particle: int, guess: Pose, points: NDArray[np.float64]) -> Pose:
    """Lay the points on the map as a particle is refined, from the place that the search found."""
    pose, information, result = np.empty(3), np.empty((3, 3)), np.empty(2)
    prior = np.diag(1.0 / GRAIN**2)
    align(*store.maps[:2], particle, *store.maps[2:], points, guess, prior, GAIN, pose, information, result)
    return pose
