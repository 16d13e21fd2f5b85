"""Where on a saved map did this drive begin? The last metres of the drive are searched over the whole map.

A drive maps itself until it is found; what it has seen on its last metres, laid together along its own path,
is the question. End points name the places (branch and bound over everything), rays from several key scans
judge between them. One place is believed when it is far better than all others and the next look says the
same; where two are as good, both are named, and the question grows with the drive. A guess of somebody else
is judged, too, and believed where nothing contradicts it: whoever goes on to new ground sees too little that
is known for any place to be found.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2, wide_match
from processing.dpslam.grid import CELL_M, TileStore
from processing.dpslam.laser_model import judge_rays, place_rays
from processing.dpslam.relocation import (
    CELL_FIT_M,
    FIT_M,
    NOWHERE,
    RAYS,
    Relocation,
    polished,
    walls_of,
)
from processing.dpslam.sweep import Sweep
from processing.dpslam.thinning import picked, thinned
from processing.ndt import extent
from processing.se2 import Pose

EVERY_M = 0.4
"""Way between two looks, or"""
EVERY_RAD = 0.7
"""turning."""
STRETCH_M = 12.0
"""Way whose points are laid together, at most."""
SIGHT_M = 10.0
"""Points farther from the newest place are left out: the step of the search in rotation falls with them."""
MOST_GLIMPSES = 200
"""Key scans of it, at most."""
QUERY_POINTS = 200
GRAIN_M = 0.1
GROUND_STEP = 4
"""Cells between two that are asked whether they are free."""
LEAST_POINTS = 40
LEAST_FIT = 0.6
"""Share of the points that must find their wall."""
LEAST_BELIEF = 0.75
"""The same, for a place to be believed and not only named: a corner alone looks like many corners."""
LEAST_SHARE = 0.8
"""Places that fit so much worse than the best one are not judged."""
MOST_PLACES = 6
LEAST_RAY = -1.8
"""Least mean log-likelihood of a ray that ends where the map knows something."""
LEAST_KNOWN = 0.6
"""Share of the rays that must end there."""
EXPECTED_KNOWN = 0.5
"""The same at a place that was guessed, and"""
EXPECTED_RAY = -1.2
"""the least of those that end there: -0.2 to -0.8 where a guess is right, -2 and less 0.3 rad off."""
STRANGE_RAY = -3.0
"""What a ray counts that ends where the map knows nothing."""
JUDGES = 6
"""Key scans whose rays judge, evenly over the stretch."""
EQUAL = 0.3
"""Places whose rays differ by less log-likelihood in the mean fit equally: by so much the maps of two rooms
alike differ by chance, however many rays are asked."""
AGREE = np.array((0.3, 0.3, 0.1))
"""Two looks that say the same differ by less; m, m, rad."""


@dataclass(frozen=True, slots=True, eq=False)
class Glimpse:
    """One key scan of the drive that looks for itself."""

    points: NDArray[np.float64]
    """(N, 2) m, laser frame."""
    rays: NDArray[np.float64]
    """(M, 4) thinned, laser frame."""


class Finder:
    """Looks for a drive on one particle's map, which does not change meanwhile."""

    def __init__(self, store: TileStore, particle: int) -> None:
        self._store, self._particle = store, particle
        walls = walls_of(store, particle)
        self._field: wide_match.Field | None = None
        if len(walls) >= LEAST_POINTS:
            self._field = wide_match.build_field(walls, CELL_FIT_M, FIT_M, 0.5)
            low, high = extent(walls)
            self._middle = np.array((*((low + high) / 2.0), 0.0))
            self._reach_m = float((high - low).max()) / 2.0
            self._ground = ground_of(store, particle)
        self._glimpses: list[Glimpse] = []
        self._looked_at: Pose | None = None
        self._before: Pose | None = None
        self._expected: Pose | None = None
        self.looks = 0
        """How often the map was searched."""
        self.equals = 0
        """How often more than one place fitted."""
        self.found: Relocation = NOWHERE
        """What the last look found; a single place only when it was believed."""

    def expect(self, map_t_laser: Pose, here: Pose) -> None:
        """Take somebody else's guess: for a place to be judged, and for a look, of which two must agree.

        Args:
            map_t_laser: (3,) the guess, on the map.
            here: (3,) the same place in the drive's own frame.
        """
        self._before = self._expected = se2.compose(map_t_laser, se2.invert(here))

    def take(self, path: Pose, sweep: Sweep) -> Relocation:
        """Take the next key scan and look, if the laser has gone on since the last look.

        Args:
            path: (K, 3) every key scan of the drive so far, this one included, in the drive's own frame.
            sweep: What was seen at this one.
        """
        rays = np.ascontiguousarray(sweep.rays[:: max(1, len(sweep.rays) // RAYS)])
        self._glimpses.append(Glimpse(sweep.points, rays))
        del self._glimpses[:-MOST_GLIMPSES]
        if self._looked_at is not None:
            way = se2.between(self._looked_at, path[-1])
            if np.hypot(way[0], way[1]) < EVERY_M and abs(way[2]) < EVERY_RAD:
                return self.found
        self._looked_at = path[-1].copy()
        self.found = self._look(path)
        return self.found

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was gathered as arrays; `restore` takes it back."""
        none, glimpses = np.zeros((0, 3)), self._glimpses
        return {
            "points": np.vstack((np.zeros((0, 2)), *(one.points for one in glimpses))),
            "rays": np.vstack((np.zeros((0, 4)), *(one.rays for one in glimpses))),
            "counts": np.array([(len(one.points), len(one.rays)) for one in glimpses], int).reshape(-1, 2),
            "looked_at": none if self._looked_at is None else self._looked_at[None],
            "before": none if self._before is None else self._before[None],
            "expected": none if self._expected is None else self._expected[None],
            "looks": np.array((self.looks, self.equals)),
            "places": np.array(self.found.places).reshape(-1, 3),
            "fits": np.array(self.found.fits, dtype=np.float64),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the finder whose `state` was taken, on the same map, before it found the one place."""
        points, rays = state["points"].copy(), state["rays"].copy()
        ends = np.cumsum(state["counts"], axis=0)
        self._glimpses = [
            Glimpse(*parts)
            for parts in zip(np.split(points, ends[:-1, 0]), np.split(rays, ends[:-1, 1]), strict=True)
        ][: len(ends)]
        self._looked_at = next(iter(state["looked_at"].copy()), None)
        self._before = next(iter(state["before"].copy()), None)
        self._expected = next(iter(state["expected"].copy()), None)
        self.looks, self.equals = state["looks"].tolist()
        self.found = Relocation(None, tuple(state["places"].copy()), tuple(state["fits"].tolist()))

    def forget(self) -> None:
        """Let go of the map; nothing is looked for any more."""
        self._store, self._field, self._glimpses = TileStore(1, 1), None, []

    def _look(self, path: Pose) -> Relocation:
        first = self._first(path)
        here = se2.between(path[-1], path[first:])
        glimpses = self._glimpses[first - len(path) :]
        query = _question([se2.transform(at, one.points) for at, one in zip(here, glimpses, strict=True)])
        if self._field is None or len(query) < LEAST_POINTS:
            return NOWHERE
        self.looks += 1
        window = (self._middle, self._reach_m, np.pi)
        search = wide_match.Window(
            self._field,
            query,
            *window,
            LEAST_FIT,
            apart_m=1.0,
            apart_rad=0.5,
            most=MOST_PLACES,
            least_share=LEAST_SHARE,
            ground=self._ground,
        )
        search.go_on()
        chosen = np.unique(np.linspace(0, len(glimpses) - 1, JUDGES).round().astype(np.int64)).tolist()
        seen = [(here[k], glimpses[k].rays) for k in chosen]
        judged = []
        for place in search.places:
            pose = polished(self._store, self._particle, place.map_t_points, query)
            judged.append((*self._judge(pose, seen), place.score, pose))
        return self._as_expected(judged, query, seen, path[-1]) or self._decide(judged, path[-1])

    def _as_expected(
        self,
        judged: list[tuple[float, float, float, Pose]],
        query: NDArray[np.float64],
        seen: list[tuple[Pose, NDArray[np.float64]]],
        here: Pose,
    ) -> Relocation | None:
        """Return the place that was guessed, if what is known there speaks for it and no other is as good."""
        if self._expected is None:
            return None
        pose = polished(self._store, self._particle, se2.compose(self._expected, here), query)
        fit, known = self._judge(pose, seen)
        ray = (fit - (1.0 - known) * STRANGE_RAY) / max(known, 1e-9)
        rivals = [other for other in judged if not _agree(other[3], pose)]
        if known < EXPECTED_KNOWN or ray < EXPECTED_RAY or any(fit - other[0] < EQUAL for other in rivals):
            return None
        return Relocation(pose, (pose,), ())

    def _decide(self, judged: list[tuple[float, float, float, Pose]], here: Pose) -> Relocation:
        """Believe in one place, or name those that are as good."""
        before, self._before = self._before, None
        judged.sort(key=lambda one: -one[0])
        if not judged or judged[0][0] < LEAST_RAY or judged[0][1] < LEAST_KNOWN:
            return NOWHERE
        equal = [one for one in judged if judged[0][0] - one[0] < EQUAL]
        places, fits = tuple(one[3] for one in equal), tuple(one[2] for one in equal)
        if len(equal) > 1 or fits[0] < LEAST_BELIEF:
            self.equals += len(equal) > 1
            return Relocation(None, places, fits)
        self._before = se2.compose(places[0], se2.invert(here))
        if before is None:
            return Relocation(None, places, fits)
        return Relocation(places[0] if _agree(se2.compose(before, here), places[0]) else None, places, fits)

    def _first(self, path: Pose) -> int:
        """Return the first key scan of the stretch that is asked for."""
        steps = np.diff(path[:, :2], axis=0)
        back_m = np.cumsum(np.hypot(steps[::-1, 0], steps[::-1, 1]))
        back = min(int(np.searchsorted(back_m, STRETCH_M)), len(self._glimpses) - 1)
        return len(path) - 1 - back

    def _judge(self, pose: Pose, seen: list[tuple[Pose, NDArray[np.float64]]]) -> tuple[float, float]:
        """Return the mean log-likelihood of all rays, and the share that ends where the map has been seen."""
        known = total = 0.0
        count = 0
        for at, rays in seen:
            placed = np.empty_like(rays)
            place_rays(se2.compose(pose, at), rays, placed)
            share, mean = judge_rays(*self._store.maps[:2], self._particle, *self._store.maps[2:], placed)
            known += share * len(rays)
            total += share * len(rays) * mean + (1.0 - share) * len(rays) * STRANGE_RAY
            count += len(rays)
        return total / max(count, 1), known / max(count, 1)


def _agree(one: Pose, other: Pose) -> bool:
    return bool((np.abs(se2.between(one, other)) < AGREE).all())


def ground_of(store: TileStore, particle: int) -> NDArray[np.float64]:
    """Return where a laser may be on one particle's map: (N, 2) m, free cells, one of each few."""
    cells, (row, col) = store.dense(particle)
    part = cells[::GROUND_STEP, ::GROUND_STEP]
    rows, cols = np.nonzero((part[..., 0] == 0) & (part[..., 1] > 0))
    return np.asarray((np.column_stack((cols, rows)) * GROUND_STEP + (col, row) + 0.5) * CELL_M)


def _question(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Thin the points of a stretch evenly; what is out of sight of the newest place is left out."""
    points = np.vstack((np.zeros((0, 2)), *parts))
    points = points[np.hypot(points[:, 0], points[:, 1]) < SIGHT_M]
    return picked(thinned(points, GRAIN_M), QUERY_POINTS)
