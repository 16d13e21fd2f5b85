"""Where on a finished map is the laser? Searched over the whole map, and refused when two places fit equally.

End points choose the candidates (`wide_match`, branch and bound over everything), rays judge between them: a
place whose walls fit but whose rays would have to cross other walls is none.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import wide_match
from processing.dpslam.alignment import align
from processing.dpslam.grid import CELL_M, METRES, PLACES, STOPS, TileStore
from processing.dpslam.laser_model import PRIOR_M, PRIOR_STOPS, place_rays, score_rays
from processing.se2 import Pose

CELL_FIT_M = 0.1
FIT_M = 0.12
"""Blur of the walls."""
SIGHT_M = 10.0
"""Points farther away are left out: the step of the search in rotation falls with the farthest point."""
LEAST_FIT = 0.75
"""Share of the points that must find their wall."""
LEAST_RAY = -1.8
"""Least mean log-likelihood of a ray."""
EQUAL = 5.0
"""Two places whose log-likelihoods, tempered, differ by less than this fit equally: e^5 is 150 to 1."""
TEMPERING = 0.2
WALL = 0.4
"""Cells that stop a ray with this probability are walls."""
GRAIN = np.array((0.1, 0.1, 0.05))
"""How far a found place may be from the true one, one sigma: the search goes in steps; m, m, rad."""
GAIN = 0.3
"""Weight of one point's score against that."""
NEAR_M = 3.0
NEAR_RAD = 1.0
"""Where a track that was lost for a moment is looked for first."""
QUERY_POINTS = 200
RAYS = 134


@dataclass(frozen=True, slots=True, eq=False)
class Relocation:
    """What a search over the whole map found."""

    map_t_laser: Pose | None
    """(3,) the one place; None if there is none, or more than one."""
    places: tuple[Pose, ...]
    """Every place that fits: none, the one, or the two that cannot be told apart."""
    fits: tuple[float, ...]
    """Share of the points that find their wall, of each place."""


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


def relocate(
    store: TileStore,
    particle: int,
    points: NDArray[np.float64],
    rays: NDArray[np.float64],
    guess: Pose | None = None,
) -> Relocation:
    """Find the laser on one particle's map.

    Args:
        store: The maps.
        particle: Whose map.
        points: (N, 2) what was seen on the last metres, in the newest laser frame.
        rays: (M, 4) the newest scan.
        guess: Look within `NEAR_M`, `NEAR_RAD` of this pose only; None: anywhere.
    """
    walls = walls_of(store, particle)
    points = points[np.hypot(points[:, 0], points[:, 1]) < SIGHT_M]
    if len(walls) < 30 or len(points) < 30 or len(rays) == 0:
        return NOWHERE
    low, high = walls.min(axis=0), walls.max(axis=0)
    window = (np.array((*((low + high) / 2.0), 0.0)), float((high - low).max()) / 2.0, np.pi)
    if guess is not None:
        window = (guess, NEAR_M, NEAR_RAD)
        walls = walls[(np.abs(walls - guess[:2]) < NEAR_M + SIGHT_M).all(axis=1)]
        if len(walls) < 30:
            return NOWHERE
    query = np.ascontiguousarray(points[:: max(1, len(points) // QUERY_POINTS)])
    field = wide_match.build_field(walls, CELL_FIT_M, FIT_M, 0.5)
    found = wide_match.search(field, query, *window, LEAST_FIT, apart_m=1.0, apart_rad=0.5)
    if found is None:
        return NOWHERE
    places = [found.best] if found.rival is None else [found.best, found.rival]
    poses = [polished(store, particle, place.map_t_points, query) for place in places]
    likely = [_per_ray(store, particle, pose, rays) for pose in poses]
    best = int(np.argmax(likely))
    if likely[best] < LEAST_RAY:
        return NOWHERE
    equal = [k for k in range(len(poses)) if (likely[best] - likely[k]) * RAYS * TEMPERING < EQUAL]
    answer = poses[best] if len(equal) == 1 else None
    return Relocation(answer, tuple(poses[k] for k in equal), tuple(places[k].score for k in equal))


def polished(store: TileStore, particle: int, guess: Pose, points: NDArray[np.float64]) -> Pose:
    """Lay the points on the map as a particle is refined, from the place that the search found."""
    pose, information, result = np.empty(3), np.empty((3, 3)), np.empty(2)
    prior = np.diag(1.0 / GRAIN**2)
    align(*store.maps[:2], particle, *store.maps[2:], points, guess, prior, GAIN, pose, information, result)
    return pose


def _per_ray(store: TileStore, particle: int, pose: Pose, rays: NDArray[np.float64]) -> float:
    """Return the mean log-likelihood of the scan's rays at a pose."""
    thinned = rays[:: max(1, len(rays) // RAYS)].copy()
    placed = np.empty_like(thinned)
    place_rays(pose, thinned, placed)
    return score_rays(*store.maps[:2], particle, *store.maps[2:], placed, 0, 1, True) / len(thinned)
