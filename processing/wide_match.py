"""Wide search: where in a window do these points lie best on a map, and is another place as good?

Branch and bound over a pyramid of window maxima (Olson 2009; Hess et al. 2016): the best place of the whole
window, not of a basin. Bounds are exact, so nothing in the window is overlooked.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import wide_match_kernels as kernels
from processing.se2 import Pose

LEVELS = 6
"""Heights of the pyramid: the coarsest step is 2^5 cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """How well an end point fits at each place, 0 to 1, with its pyramid of maxima."""

    levels: NDArray[np.float32]
    """(LEVELS, rows, cols): level l holds the maximum over the 2^l x 2^l cells up and right of each cell."""
    resolution_m: float
    origin_m: NDArray[np.float64]
    """(2,) lower-left corner."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """One place where the points fit."""

    map_t_points: Pose
    score: float
    """Mean fit of the points there, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The best place in the window and the best of the places apart from it."""

    best: Place
    rival: Place | None
    """The best place that is not a neighbour of `best`, if one passes the least score."""


def build_field(
    points_map: NDArray[np.float64], resolution_m: float, sigma_m: float, margin_m: float
) -> Field:
    """Blur points (N, 2) of a map into a field; a Gaussian of `sigma_m` around each, the best of them counts.

    Args:
        points_map: (N, 2) m, N >= 1.
        resolution_m: Side of a cell.
        sigma_m: Standard deviation of the blur.
        margin_m: Empty border around the points.

    Raises:
        ValueError: there are no points.
    """
    if len(points_map) == 0:
        raise ValueError("0 points, must be at least 1")
    points = np.ascontiguousarray(points_map, dtype=np.float64)
    origin = np.floor((points.min(axis=0) - margin_m) / resolution_m) * resolution_m
    cols, rows = (np.ceil((points.max(axis=0) + margin_m - origin) / resolution_m).astype(int) + 1).tolist()
    levels = np.zeros((LEVELS, rows, cols), dtype=np.float32)
    kernels.blur(points, origin[0], origin[1], resolution_m, sigma_m, levels[0])
    kernels.raise_pyramid(levels)
    return Field(levels, resolution_m, origin)


def search(
    field: Field,
    points: NDArray[np.float64],
    map_t_guess: Pose,
    reach_m: float,
    reach_rad: float,
    least_score: float,
    apart_m: float = 0.6,
    apart_rad: float = 0.25,
) -> Search | None:
    """Find the place within the window around a guess where the points fit best, and its rival.

    Args:
        field: Of the map.
        points: (N, 2) m, in their own frame, N >= 1.
        map_t_guess: Middle of the window.
        reach_m: Half the side of the window.
        reach_rad: Half its width in rotation.
        least_score: Places below it are nobody's.
        apart_m: A rival lies at least so far from the best, or
        apart_rad: is turned by at least so much.

    Returns:
        None when no place of the window reaches `least_score`.
    """
    cloud = np.ascontiguousarray(points, dtype=np.float64)
    farthest = float(np.sqrt((cloud**2).sum(axis=1).max()))
    turn = field.resolution_m / max(farthest, 1.0)
    steps = int(np.ceil(reach_rad / turn))
    cells = int(np.ceil(reach_m / field.resolution_m))
    found = np.zeros(4)
    nowhere = np.full(3, np.inf)
    fixed = (field.levels, field.origin_m[0], field.origin_m[1], field.resolution_m, cloud)
    window = (np.asarray(map_t_guess, dtype=np.float64), turn, steps, cells)
    if not kernels.branch_and_bound(*fixed, *window, least_score, nowhere, apart_m, apart_rad, found):
        return None
    best = Place(found[:3].copy(), float(found[3]))
    if not kernels.branch_and_bound(
        *fixed, *window, least_score, best.map_t_points, apart_m, apart_rad, found
    ):
        return Search(best, None)
    return Search(best, Place(found[:3].copy(), float(found[3])))
