"""Wide search: where in a window do these points lie best on a map, and is another place as good?

Branch and bound over a pyramid of window maxima (Olson 2009; Hess et al. 2016): the best place of the whole
window, not of a basin. Bounds are exact, so nothing in the window is overlooked.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import wide_match_kernels as kernels
from processing.ndt import extent
from processing.se2 import Pose, transform

LEVELS = 6
"""Heights of the pyramid: the coarsest step is 2^5 cells."""
NEAR_WALL = 0.1
"""Fit from which a place is a wall's, whatever passed there: some two deviations of the blur off."""


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """How well an end point fits at each place, 0 to 1, with its pyramid of maxima.

    Where rays are known to have passed, -1: an end point there speaks against its place, one where nothing is
    known does not.
    """

    levels: NDArray[np.float32]
    """(LEVELS, rows, cols): level l holds the maximum over the 2^l x 2^l cells up and right of each cell."""
    resolution_m: float
    origin_m: NDArray[np.float64]
    """(2,) lower-left corner."""

    def at(self, points: NDArray[np.float64], map_t_points: Pose) -> NDArray[np.float64]:
        """Return how well each of the points (N, 2), moved to a pose (3,), fits where it lies; 0 outside."""
        rows, cols = self.levels.shape[1:]
        cells = np.floor((transform(map_t_points, points) - self.origin_m) / self.resolution_m).astype(int)
        inside = ((cells >= 0) & (cells < (cols, rows))).all(axis=1)
        fits = np.zeros(len(points))
        fits[inside] = self.levels[0, cells[inside, 1], cells[inside, 0]]
        return fits


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """One place where the points fit."""

    map_t_points: Pose
    score: float
    """Mean fit of the points there, at most 1, less what the offset costs."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The best place in the window and the best of the places apart from it."""

    best: Place
    rival: Place | None
    """The best place that is not a neighbour of `best`, if one passes the least score."""


def build_field(
    points_map: NDArray[np.float64],
    resolution_m: float,
    sigma_m: float,
    margin_m: float,
    passed_map: NDArray[np.float64] | None = None,
    passed_edge_m: float = 0.0,
) -> Field:
    """Blur points (N, 2) of a map into a field; a Gaussian of `sigma_m` around each, the best of them counts.

    Args:
        points_map: (N, 2) m, N >= 1.
        resolution_m: Side of a cell.
        sigma_m: Standard deviation of the blur.
        margin_m: Empty border around the points.
        passed_map: (M, 2) m, the middles of squares through which rays passed, and
        passed_edge_m: their edge, a multiple of `resolution_m`.

    Raises:
        ValueError: there are no points.
    """
    if len(points_map) == 0:
        raise ValueError("0 points, must be at least 1")
    points = np.ascontiguousarray(points_map, dtype=np.float64)
    least, greatest = extent(points)
    origin = np.floor((least - margin_m) / resolution_m) * resolution_m
    cols, rows = (np.ceil((greatest + margin_m - origin) / resolution_m).astype(int) + 1).tolist()
    levels = np.zeros((LEVELS, rows, cols), dtype=np.float32)
    grid = (origin[0], origin[1], resolution_m)
    kernels.blur(points, *grid, sigma_m, levels[0])
    if passed_map is not None:
        kernels.lower(np.ascontiguousarray(passed_map), *grid, passed_edge_m, NEAR_WALL, levels[0])
    kernels.raise_pyramid(levels)
    return Field(levels, resolution_m, origin)


class Window:
    """The search for the places of a window where the points fit; it may be left off and gone on with.

    However often it is left off, it finds the same places.

    Args:
        field: Of the map.
        points: (N, 2) m, in their own frame, N >= 1.
        map_t_guess: Middle of the window.
        reach_m: Half the side of the window.
        reach_rad: Half its width in rotation.
        least_score: Places below it are nobody's.
        apart_m: Two places lie at least so far apart, or
        apart_rad: are turned by at least so much.
        most: So many places at most.
        least_share: Places whose score is a smaller share of the best one's do not count.
        least_rival: What the others must reach, if it is another score than the best place's.
        ground: (M, 2) where the origin of the points may lie, m, map frame: squares of the coarsest step in
            which there is none of it are not searched; None: anywhere.
        costs: (3, 3) a quadratic form of the offset from the middle in x, y (m) and rotation (rad) that is
            taken off the score of a place, and off its bound; None: all places are as likely.
    """

    def __init__(
        self,
        field: Field,
        points: NDArray[np.float64],
        map_t_guess: Pose,
        reach_m: float,
        reach_rad: float,
        least_score: float,
        apart_m: float = 0.6,
        apart_rad: float = 0.25,
        most: int = 8,
        least_share: float = 0.0,
        least_rival: float | None = None,
        ground: NDArray[np.float64] | None = None,
        costs: NDArray[np.float64] | None = None,
    ) -> None:
        cloud = np.ascontiguousarray(points, dtype=np.float64)
        farthest = float(np.sqrt((cloud**2).sum(axis=1).max()))
        turn = field.resolution_m / max(farthest, 1.0)
        steps = int(np.ceil(reach_rad / turn))
        cells = int(np.ceil(reach_m / field.resolution_m))
        guess = np.array(map_t_guess, dtype=np.float64)
        self.places: list[Place] = []
        """What was found so far, the best first."""
        self._map = (field.levels, field.origin_m[0], field.origin_m[1], field.resolution_m)
        form = np.zeros((3, 3)) if costs is None else np.ascontiguousarray(costs, dtype=np.float64)
        self._window = (cloud, guess, turn, steps, cells, form)
        self._apart = (apart_m, apart_rad, _open_nodes(field, guess, cells, ground))
        self._most, self._least_share = most, least_share
        self._least_score = least_score
        self._least_rival = least_score if least_rival is None else least_rival
        self._turn, self._best = 0, np.zeros(4)

    def go_on(self, squares: int = 2**62) -> bool:
        """Look at about so many squares more and return whether the search is at its end.

        Args:
            squares: Of 2^level cells; to look at one is to add up the field under all points, or as many as
                it takes to know that it will not do.
        """
        progress = np.array((self._turn, squares))
        while len(self.places) < self._most:
            shunned = np.array([place.map_t_points for place in self.places]).reshape(-1, 3)
            least = self._least()
            if self._turn == 0:
                self._best = np.array((0.0, 0.0, 0.0, least))
            ended = kernels.branch_and_bound(
                *self._map, *self._window, shunned, *self._apart, self._best, progress
            )
            self._turn = int(progress[0])
            if not ended:
                return False
            if self._best[3] <= least:
                break
            self.places.append(Place(self._best[:3].copy(), float(self._best[3])))
            self._turn = progress[0] = 0
        return True

    def search(self) -> Search | None:
        """Search to the end; return the best place and the one after it, None if there is none."""
        self.go_on()
        if not self.places:
            return None
        return Search(self.places[0], self.places[1] if len(self.places) > 1 else None)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return how far the search is; a new one of the same window goes on from there by `restore`."""
        places = [(*place.map_t_points, place.score) for place in self.places]
        return {
            "turn": np.array(self._turn),
            "best": self._best.copy(),
            "places": np.array(places).reshape(-1, 4),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Be as far as the search whose `state` was taken."""
        self._turn, self._best = int(state["turn"]), state["best"].copy()
        self.places = [Place(row[:3].copy(), float(row[3])) for row in state["places"]]

    def _least(self) -> float:
        """Return what the next place must pass."""
        if not self.places:
            return self._least_score
        return max(self._least_rival, self._least_share * self.places[0].score)


def _open_nodes(
    field: Field, map_t_guess: Pose, reach: int, ground: NDArray[np.float64] | None
) -> NDArray[np.uint8]:
    """Return which squares of the coarsest step hold ground."""
    side = 1 << kernels.top_of(len(field.levels), reach)
    across = (2 * reach + side) // side
    if ground is None:
        return np.ones(across * across, dtype=np.uint8)
    at = np.floor((ground - map_t_guess[:2]) / field.resolution_m).astype(np.int64) + reach
    at = at[((at >= 0) & (at <= 2 * reach)).all(axis=1)] // side
    nodes = np.zeros((across, across), dtype=np.uint8)
    nodes[at[:, 1], at[:, 0]] = 1
    return nodes.ravel()
