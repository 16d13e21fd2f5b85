"""Loops: knowing that the laser has come back, and bending the whole path so that it has.

The paths of a particle filter do not reach round a large loop: after a few hundred key scans all particles
share one past. So the past itself is moved, as in resample-move particle filters (Gilks and Berzuini 2001):
while the laser is on new ground, the drift since it last was on old ground bounds a window; the last metres
of points are searched in that window of the settled map, wholly (`closing`); where they fit once and only
once, the path is smoothed under all its relations (`smoothing`), and the maps are drawn anew along it.

Relations are of two kinds: the motions of the scan matcher between key scans, never doubted; and places where
a key scan lay on the settled map, which may be wrong and are doubted when they disagree.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.closing import FIELD_CELL_M, Closing, Question
from processing.dpslam.drift import Drift, drift_of
from processing.dpslam.judging import FITTING, Finding, Judge, away_m
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.places import Places
from processing.dpslam.proposal import WIDE_M
from processing.dpslam.settled import SettledMap
from processing.dpslam.thinning import picked, thinned
from processing.growing import Growing
from processing.ndt import Points
from processing.observability import view
from processing.se2 import Pose, between, compose, transform
from processing.smoothing import Relations, smooth

Matrix = NDArray[np.float64]


KNOWN_SHARE = 0.4
"""Share of a scan that lies where the settled map knows something, for the scan to be tried on it."""
MOST_CORRECTION = np.array((0.2, 0.2, 0.1))
"""A scan that would have to move farther to lie on the settled map does not lie on it."""
PATIENCE = 8
"""Key scans in a row that do not lie on the settled map before the ground counts as new."""
POINT_GAIN = 0.3
"""Information of a point that fits: neighbouring points err alike."""
DOUBT = 12.0
"""Chi-square at which a place is doubted: 3 degrees of freedom pass it once in a hundred."""
UNSEEN_M = 1.5 * WIDE_M
"""Deviation of the motion between key scans from which the odometry did not see: half as much again as that
up to which one that it saw is doubted."""
MOST_BEHIND = 0.1
"""Share of the points that fit which may lie on walls that are known from their other side only."""
QUERY_POINTS = 400
NO_POINTS = np.zeros((0, 2))
PAST = 20
"""Settled key scans without which there is nothing to come back to."""


class Loops:
    """The path of one lineage, its relations, and the map of what lies behind."""

    def __init__(self, config: LoopConfig) -> None:
        self.config = config
        self.path: Pose = np.zeros((0, 3))
        self.points: list[Points] = []
        self._points_kept = 0
        self.places = Places()
        self._motions, self._way_m = Growing((3,)), Growing()
        self._drift = Drift()
        self.linked = True
        """Whether the newest key scans lie on the settled map, or there is none yet."""
        self.closures = 0
        self._map = SettledMap()
        self._settled = 0
        self._misses = 0
        self._tried_m = 0.0
        self._judge = Judge(config)
        self._closing: Closing | None = None

    def step(self, motion: Pose, covariance: Matrix, points: Points, path: Pose) -> Pose | None:
        """Take the next key scan.

        Args:
            motion: (3,) from the key scan before; of the first, anything.
            covariance: (3, 3) of that motion, in the new laser frame.
            points: (N, 2) m, laser frame.
            path: (K, 3) map_t_laser of every key scan, this one included, of the lineage to follow.

        Returns:
            The whole path (K, 3), moved, if the laser was found to have come back; else None.
        """
        self._follow(path)
        first = not self.points
        self.points.append(np.ascontiguousarray(points, dtype=np.float64))
        self._points_kept += len(points)
        self._motions.append(motion)
        step_m = 0.0 if first else float(np.hypot(motion[0], motion[1]))
        self._way_m.append(step_m + (0.0 if first else self.way_m[-1]))
        self._drift.go_on(drift_of(covariance, motion, self.points[-1], self.config), motion)
        if first:
            return None
        self._settle()
        if self.linked:
            self._place()
            return None
        self.look_on()
        if self._closing is None:
            self._closing = self._ask() if self._settled >= PAST and self._due() else None
            return None
        return self._close(self._closing) if self._closing.ended else None

    def look_on(self) -> None:
        """Go on with the search for an earlier place, if there is one: with each scan between key scans."""
        if self._closing is not None and not self._closing.ended:
            self._closing.go_on()

    def conclude(self) -> Pose | None:
        """Bring the search to its end, where no scan follows; return the path (K, 3) if it has moved."""
        if self._closing is None:
            return None
        while not self._closing.ended:
            self._closing.go_on()
        return self._close(self._closing)

    @property
    def way_m(self) -> NDArray[np.float64]:
        """(K,) length of the way up to each key scan."""
        return self._way_m.rows

    @property
    def bytes_used(self) -> int:
        """Memory of the points kept."""
        return self._points_kept * 16

    @property
    def on_settled_map(self) -> bool:
        """Whether the newest key scans lie where the laser was before, and not only a moment ago."""
        return self.linked and self._settled > 0

    def smoothed(self) -> Pose:
        """Return the path (K, 3) that satisfies all relations best."""
        return smooth(self.path, self._relations()).poses if len(self.path) > 1 else self.path.copy()

    def forget(self, key: int) -> None:
        """Let go of the points of a settled key scan that newer ones of its place stand for."""
        if key < self._settled:
            self._points_kept -= len(self.points[key])
            self.points[key] = NO_POINTS

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `restore` takes it back."""
        places = self.places
        closing = {} if self._closing is None else self._closing.state()
        return {
            "path": self.path.copy(),
            "points": np.vstack((np.zeros((0, 2)), *self.points)),
            "counts": np.array([len(points) for points in self.points], dtype=np.int64),
            "motions": self._motions.rows.copy(),
            "covariances": self._drift.steps.rows.copy(),
            "drift": self._drift.errors.rows.copy(),
            "way_m": self.way_m.copy(),
            "place_ends": places.ends.rows.copy(),
            "place_poses": places.poses.rows.copy(),
            "place_informations": places.informations.rows.copy(),
            "place_doubts": places.doubts.rows.copy(),
            "flags": np.array((self.linked, self.closures, self._settled, self._misses)),
            "tried_m": np.array(self._tried_m),
            "judge": self._judge.state(),
            **{f"map.{name}": part for name, part in self._map.state().items()},
            **{f"closing.{name}": part for name, part in closing.items()},
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the loops whose `state` was taken."""
        self.path = state["path"].copy()
        self._points_kept = len(state["points"])
        ends = np.cumsum(state["counts"])[:-1]
        self.points = [part.copy() for part in np.split(state["points"], ends)] if len(self.path) else []
        self._motions.replace(state["motions"])
        self._drift.steps.replace(state["covariances"])
        self._drift.errors.replace(state["drift"])
        self._way_m.replace(state["way_m"])
        self.places.ends.replace(state["place_ends"])
        self.places.poses.replace(state["place_poses"])
        self.places.informations.replace(state["place_informations"])
        self.places.doubts.replace(state["place_doubts"])
        linked, self.closures, self._settled, self._misses = state["flags"].tolist()
        self.linked = bool(linked)
        self._tried_m = float(state["tried_m"])
        self._judge.restore(state["judge"])
        self._map.restore({name[4:]: part for name, part in state.items() if name.startswith("map.")})
        closing = {name[8:]: part for name, part in state.items() if name.startswith("closing.")}
        self._closing = Closing.from_state(closing) if closing else None

    def _follow(self, path: Pose) -> None:
        """Take over the path; where its settled part has moved, build the map anew."""
        known = min(self._settled, len(self.path))
        moved = np.abs(between(self.path[:known], path[:known]))
        self.path = np.array(path)
        if known and (moved[:, :2].max() > 0.01 or moved[:, 2].max() > 0.003):
            self._closing = None
            self._map.rebuild(self.points[: self._settled], self.path[: self._settled])

    def _settle(self) -> None:
        while self.way_m[self._settled] < self.way_m[-1] - self.config.reach_m:
            self._map.add(self.points[self._settled], self.path[self._settled])
            self._settled += 1

    def _place(self) -> None:
        """Note where the newest key scan lies on the settled map; give up the link after misses in a row."""
        at, points = self.path[-1], self.points[-1]
        self._misses += 1
        count = len(points)
        points = points[~self._map.away(points, at)]
        if np.count_nonzero(self._map.fits(points, at) >= 0.0) > KNOWN_SHARE * count:
            prior = self._drift.steps.rows[-1] + np.diag((0.03**2, 0.03**2, 0.01**2))
            fit = self._map.refine(points, at, np.asarray(np.linalg.inv(_in_map(prior, at[2]))))
            fits = self._map.fits(points, fit.map_t_points)
            good = (fits > FITTING).sum() > 0.5 * max(int((fits >= 0.0).sum()), 1)
            if good and (np.abs(between(at, fit.map_t_points)) < MOST_CORRECTION).all():
                near = self._seen_by(points, fit.map_t_points)
                if near is not None:
                    self._relate(near, fit.map_t_points, self._honest(fit.information, at[2]), DOUBT)
                self._misses = 0
        if self._misses > PATIENCE:
            self.linked = False
            self._judge.forget()

    def _seen_by(self, points: Points, map_t_laser: Pose) -> int | None:
        """Return the settled key scan to which a place is tied by those points that lie on walls there.

        Who merely stands near may have seen other walls, and drifted since. Of the stretch of way that was
        the first to see these it is the key scan nearest to the place.

        Args:
            points: (N, 2) m, laser frame.
            map_t_laser: (3,) the place.
        """
        on_walls = points[self._map.fits(points, map_t_laser) > FITTING]
        owners = self._map.owners(on_walls, map_t_laser)
        if len(owners) == 0:
            return None
        way_m = self.way_m[: self._settled]
        middle = np.sort(owners)[len(owners) // 2]
        stretch = np.flatnonzero(np.abs(way_m - way_m[middle]) <= self.config.reach_m)
        off = np.abs(between(map_t_laser, self.path[stretch]))
        return int(stretch[(np.hypot(off[:, 0], off[:, 1]) + 0.5 * off[:, 2]).argmin()])

    def _relate(self, near: int, map_t_laser: Pose, information: Matrix, doubt: float) -> Matrix:
        """Add the relation of the newest key scan, where it was found (3,), to a settled one.

        Args:
            near: The settled one.
            map_t_laser: (3,) the place of the newest.
            information: (3, 3) of the place, map axes, one unit a point.
            doubt: Chi-square at which the relation is doubted; 0 for never.

        Returns:
            What the relation is taken to know, (3, 3) in the newest laser's frame.
        """
        known = _in_map(POINT_GAIN * information, -map_t_laser[2]) + 1e-3 * np.eye(3)
        measured = between(self.path[near], map_t_laser)
        self.places.add((near, len(self.path) - 1), measured, known, doubt)
        self._drift.find(near, measured, known)
        return known

    def _honest(self, information: Matrix, yaw_rad: float) -> Matrix:
        """Return what the map tells of the newest key scan (3, 3), map axes, without what it cannot know.

        Along a corridor the edge of what is known ties a scan to wherever it happens to lie. That is so where
        neither the map nor the odometry sees; few points on a wall at right angles are rough but true.
        """
        moved = _in_map(self._drift.steps.rows[-1], yaw_rad)[:2, :2]
        seen = np.eye(3)
        for direction in view(information).unseen:
            if direction @ moved @ direction > UNSEEN_M**2:
                seen[:2, :2] -= np.outer(direction, direction)
        return np.asarray(seen @ information @ seen)

    def _due(self) -> bool:
        every = self.config.try_every_m * (0.5 if self._judge.waits else 1.0)
        return bool(self.way_m[-1] - self._tried_m > every)

    def _ask(self) -> Closing | None:
        """Begin to search the last metres in the settled map, if it has anything where they may lie."""
        self._tried_m = self.way_m[-1]
        c, at = self.config, self.path[-1]
        drift = self._drift_here()
        reach_m = min(3.0 * away_m(drift) + 0.5, c.most_window_m)
        reach_rad = min(3.0 * float(np.sqrt(drift[2, 2])) + 0.1, c.most_window_rad)
        settled = self.path[: self._settled]
        off = np.hypot(settled[:, 0] - at[0], settled[:, 1] - at[1])
        if (off < reach_m + 3.0).sum() < 5:
            return None
        near = np.flatnonzero(off < reach_m + c.reach_m)
        cloud = np.vstack([transform(settled[k], self.points[k]) for k in near])
        cloud = cloud[(np.abs(cloud - at[:2]) < reach_m + c.reach_m + 5.0).all(axis=1)]
        query = picked(self._recent(), QUERY_POINTS)
        if len(cloud) < 100 or len(query) < 50:
            return None
        cloud = thinned(cloud, FIELD_CELL_M)
        return Closing(Question(cloud, query, at, len(self.path) - 1, reach_m, reach_rad, c.least_score))

    def _close(self, closing: Closing) -> Pose | None:
        """Take what a search found; where it is one place and no other, smooth the path."""
        self._closing = None
        recent = self._recent()
        place = self._judged(closing, recent)
        if place is None:
            return None
        query = picked(recent, QUERY_POINTS)
        hold = np.diag((1.0 / 0.1**2, 1.0 / 0.1**2, 1.0 / 0.05**2))
        fit = self._map.refine(query, place, hold)
        if (np.abs(between(place, fit.map_t_points)) > MOST_CORRECTION).any():
            return None
        if self._is_behind_walls(fit.map_t_points):
            return None
        share = len(self.points[-1]) / len(query)
        near = self._seen_by(query, fit.map_t_points)
        if near is None:
            return None
        known = self._relate(near, fit.map_t_points, share * fit.information, 0.0)
        self._drift.close(near, self.path, known)
        self.closures += 1
        self.linked, self._misses = True, 0
        self._judge.forget()
        self.path = self.smoothed()
        self._map.rebuild(self.points[: self._settled], self.path[: self._settled])
        return self.path.copy()

    def _judged(self, closing: Closing, recent: Points) -> Pose | None:
        """Return where the newest key scan is on the settled map, if the last metres (N, 2) believe it."""
        found = closing.found()
        if found is None:
            return None
        place = closing.carried(found.best.map_t_points, self.path)
        near = self._seen_by(recent, place)
        if near is None:
            return None
        finding = Finding(
            place=place,
            rival=closing.carried(found.rival.map_t_points, self.path) if found.rival else None,
            score=found.best.score,
            rival_ratio=found.rival.score / found.best.score if found.rival else 0.0,
            at=self.path[-1],
            drift=self._drift.since(near, between(self.path[near], self.path[-1])),
            points=recent,
            way_m=float(self.way_m[-1]),
        )
        return finding.place if self._judge.believes(finding, self._map) else None

    def _is_behind_walls(self, map_t_laser: Pose) -> bool:
        """Whether the last metres fit because the walls of one room lie on those of the next one.

        Args:
            map_t_laser: (3,) where the newest key scan was found.
        """
        fitting = behind = 0
        for key in range(self._first_asked(), len(self.points)):
            points, at = self.points[key], compose(map_t_laser, between(self.path[-1], self.path[key]))
            fits = self._map.fits(points, at) > FITTING
            fitting += int(np.count_nonzero(fits))
            behind += int(np.count_nonzero(fits & self._map.away(points, at)))
        return behind > MOST_BEHIND * fitting

    def away_m(self) -> float:
        """How far the path may be off from what was mapped around, in the worst direction, one sigma."""
        return away_m(self._drift_here())

    def _drift_here(self) -> Matrix:
        """Return how far the newest key scan may be off (3, 3), seen from the best known one around."""
        total = self._drift.now
        if self._settled == 0:
            return total
        at = self.path[-1]
        settled = self.path[: self._settled]
        reach_m = min(3.0 * away_m(total) + 0.5, self.config.most_window_m) + 3.0
        around = np.flatnonzero(np.hypot(settled[:, 0] - at[0], settled[:, 1] - at[1]) < reach_m)
        if len(around) == 0:
            return total
        best = int(around[np.trace(self._drift.errors.rows[around, :2, :2], axis1=1, axis2=2).argmin()])
        return self._drift.since(best, between(settled[best], at))

    def _recent(self) -> Points:
        """Gather the points of the last metres of way, evenly, in the newest laser frame."""
        first = self._first_asked()
        here = self.path[-1]
        parts = [
            transform(between(here, self.path[k]), self.points[k]) for k in range(first, len(self.points))
        ]
        return thinned(np.vstack(parts), 0.1)

    def _first_asked(self) -> int:
        """Return the first key scan of the last metres: the more may be off, the more must be recognised."""
        c = self.config
        length_m = min(max(c.query_m, 6.0 * self.away_m()), c.most_query_m)
        return int(np.searchsorted(self.way_m, self.way_m[-1] - length_m))

    def _relations(self) -> Relations:
        chain = np.arange(1, len(self.path))
        places = self.places
        return Relations(
            np.concatenate((np.column_stack((chain - 1, chain)), places.ends.rows)),
            np.concatenate((self._motions.rows[1:], places.poses.rows)),
            np.concatenate((np.linalg.inv(self._drift.steps.rows[1:]), places.informations.rows)),
            np.concatenate((np.zeros(len(chain)), places.doubts.rows)),
        )


def _in_map(covariance: Matrix, yaw_rad: float) -> Matrix:
    """Turn a covariance or information (3, 3) of the laser's frame into the map's axes."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(turn @ covariance @ turn.T)
