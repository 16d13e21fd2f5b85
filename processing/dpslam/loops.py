"""Loops: knowing that the laser has come back, and bending the whole path so that it has.

The paths of a particle filter do not reach round a large loop: after a few hundred key scans all particles
share one past. So the past itself is moved, as in resample-move particle filters (Gilks and Berzuini 2001):
while the laser is on new ground, the drift since it last was on old ground bounds a window; the last metres
of points are searched in that window of the settled map, wholly (`closing`); where they fit once and only
once, the path is smoothed under all its relations (`way`), and the maps are drawn anew along it.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.closing import FIELD_CELL_M, Closing, Question
from processing.dpslam.drift import drift_of
from processing.dpslam.judging import FITTING, ROUGH, Finding, Judge, away_m
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.old_ground import OldGround
from processing.dpslam.part_judge import PartJudge, disputed
from processing.dpslam.places import DOUBT
from processing.dpslam.proposal import WIDE_M
from processing.dpslam.thinning import picked, thinned
from processing.dpslam.way import NO_POINTS, POINT_GAIN, Way, in_map
from processing.ndt import Points
from processing.observability import view
from processing.se2 import Pose, between

Matrix = NDArray[np.float64]

KNOWN_SHARE = 0.4
"""Share of a scan that lies where the settled map knows something, for the scan to be tried on it."""
MOST_CORRECTION = np.array((0.2, 0.2, 0.1))
"""A scan that would have to move farther to lie on the settled map does not lie on it."""
PATIENCE = 8
"""Key scans in a row that do not lie on the settled map before the ground counts as new."""
UNSEEN_M = 1.5 * WIDE_M
"""Deviation of the motion between key scans from which the odometry did not see: half as much again as that
up to which one that it saw is doubted."""
QUERY_POINTS = 400
LEAST_PART = 0.08
"""Share of the points that must lie on walls, less those that lie where rays have passed, for a place to be
found at all on partly known ground."""
PAST = 20
"""Settled key scans without which there is nothing to come back to."""


class Loops:
    """The way of one lineage, and whether it has come back to where it was."""

    def __init__(self, config: LoopConfig) -> None:
        self.config = config
        self.way = Way()
        self.linked = True
        """Whether the newest key scans lie on the settled map, or there is none yet."""
        self.closures = 0
        self._old = OldGround(self.way, config)
        self._misses = 0
        self._tried_m = 0.0
        self._judge, self._part_judge = Judge(config), PartJudge(config)
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
        points = np.ascontiguousarray(points, dtype=np.float64)
        self.way.go_on(motion, drift_of(covariance, motion, points, self.config), points)
        if len(self.way.points) == 1:
            return None
        self._old.grow()
        if self.linked:
            self._place()
            return None
        self.look_on()
        if self._closing is None:
            self._closing = self._ask() if self._old.keys >= PAST and self._due() else None
            return None
        return self._close(self._closing) if self._closing.ended else None

    def look_on(self) -> None:
        """Go on with the search for an earlier place, if there is one: with each scan between key scans."""
        if self._closing is not None and not self._closing.ended:
            self._closing.go_on()

    def conclude(self) -> Pose | None:
        """Bring the search to its end, where no scan follows; return the path (K, 3) if it has moved."""
        while (closing := self._closing) is not None:
            while not closing.ended:
                closing.go_on()
            moved = self._close(closing)
            if moved is not None:
                return moved
        return None

    @property
    def on_settled_map(self) -> bool:
        """Whether the newest key scans lie where the laser was before, and not only a moment ago."""
        return self.linked and self._old.keys > 0

    def forget(self, key: int) -> None:
        """Let go of the points of a settled key scan that newer ones of its place stand for."""
        if key < self._old.keys:
            self.way.forget(key)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `restore` takes it back."""
        closing = {} if self._closing is None else self._closing.state()
        return {
            **self.way.state(),
            "flags": np.array((self.linked, self.closures, self._old.keys, self._misses)),
            "tried_m": np.array(self._tried_m),
            "judge": self._judge.state(),
            "part_judge": self._part_judge.state(),
            **{f"map.{name}": part for name, part in self._old.map.state().items()},
            **{f"closing.{name}": part for name, part in closing.items()},
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the loops whose `state` was taken."""
        self.way.restore(state)
        linked, self.closures, self._old.keys, self._misses = state["flags"].tolist()
        self.linked = bool(linked)
        self._tried_m = float(state["tried_m"])
        self._judge.restore(state["judge"])
        self._part_judge.restore(state["part_judge"])
        self._old.map.restore({name[4:]: part for name, part in state.items() if name.startswith("map.")})
        closing = {name[8:]: part for name, part in state.items() if name.startswith("closing.")}
        self._closing = Closing.from_state(closing) if closing else None

    def _follow(self, path: Pose) -> None:
        """Take over the path; where its settled part has moved, build the map anew."""
        moved = self._old.has_moved(path)
        self.way.path = np.array(path)
        if moved:
            self._closing = None
            self._old.redraw()

    def _place(self) -> None:
        """Note where the newest key scan lies on the settled map; give up the link after misses in a row."""
        way, there = self.way, self._old.map
        at, points = way.path[-1], way.points[-1]
        self._misses += 1
        count = len(points)
        points = points[~there.away(points, at)]
        if np.count_nonzero(there.fits(points, at) >= 0.0) > KNOWN_SHARE * count:
            prior = way.drift.steps.rows[-1] + np.diag((0.03**2, 0.03**2, 0.01**2))
            fit = there.refine(points, at, np.asarray(np.linalg.inv(in_map(prior, at[2]))))
            fits = there.fits(points, fit.map_t_points)
            good = (fits > FITTING).sum() > 0.5 * max(int((fits >= 0.0).sum()), 1)
            if good and (np.abs(between(at, fit.map_t_points)) < MOST_CORRECTION).all():
                near = self._old.witness(points, fit.map_t_points)
                if near is not None:
                    way.relate(near, fit.map_t_points, self._honest(fit.information, at[2]), DOUBT)
                self._misses = 0
        if self._misses > PATIENCE:
            self.linked = False
            self._forget_findings()

    def _honest(self, information: Matrix, yaw_rad: float) -> Matrix:
        """Return what the map tells of the newest key scan (3, 3), map axes, without what it cannot know.

        Along a corridor the edge of what is known ties a scan to wherever it happens to lie. That is so where
        neither the map nor the odometry sees; few points on a wall at right angles are rough but true.
        """
        moved = in_map(self.way.drift.steps.rows[-1], yaw_rad)[:2, :2]
        unseen = view(information).unseen
        return _blinded(information, [one for one in unseen if one @ moved @ one > UNSEEN_M**2])

    def _due(self) -> bool:
        waits = self._judge.waits or self._part_judge.waits
        every = self.config.try_every_m * (0.5 if waits else 1.0)
        return bool(self.way.lengths_m[-1] - self._tried_m > every)

    def _forget_findings(self) -> None:
        self._judge.forget()
        self._part_judge.forget()

    def _ask(self, partly: bool = False) -> Closing | None:
        """Begin to search the last metres in the settled map, if it has anything where they may lie.

        Args:
            partly: Whether points that lie where it knows nothing say nothing, in place of speaking against.
                What is left may fit anywhere, so that likely drifts go first.
        """
        way, c = self.way, self.config
        self._tried_m = way.lengths_m[-1]
        drift, at = self._old.drift(), way.path[-1]
        reach_m = min(3.0 * away_m(drift) + 0.5, c.most_window_m)
        reach_rad = min(3.0 * float(np.sqrt(drift[2, 2])) + 0.1, c.most_window_rad)
        cloud = self._old.cloud(at, reach_m)
        if cloud is None:
            return None
        query = picked(way.since(self._first_asked()), QUERY_POINTS)
        if len(cloud) < 100 or len(query) < 50:
            return None
        passed, costs, least_score = NO_POINTS, np.zeros((3, 3)), c.least_score
        if partly:
            passed, least_score = self._old.passed(at, reach_m), LEAST_PART
            if len(passed) == 0:
                return None
            known = np.asarray(np.linalg.inv(in_map(drift + ROUGH, at[2])), np.float64)
            costs = known / (2.0 * POINT_GAIN * len(query))
        return Closing(
            Question(
                cloud=thinned(cloud, FIELD_CELL_M),
                passed=passed,
                points=query,
                map_t_laser=at,
                key=len(way.path) - 1,
                reach_m=reach_m,
                reach_rad=reach_rad,
                costs=costs,
                least_score=least_score,
            )
        )

    def _close(self, closing: Closing) -> Pose | None:
        """Take what a search found; where it is one place and no other, smooth the path."""
        self._closing = None
        way, first = self.way, self._first_asked()
        recent = way.since(first)
        found = self._judged(closing, recent)
        if found is None:
            if closing.found() is None and not closing.question.partly:
                self._closing = self._ask(partly=True)
            return None
        query = picked(recent, QUERY_POINTS)
        hold = np.diag((1.0 / 0.1**2, 1.0 / 0.1**2, 1.0 / 0.05**2))
        fit = self._old.map.refine(query, found.place, hold)
        if (np.abs(between(found.place, fit.map_t_points)) > MOST_CORRECTION).any():
            return None
        if self._old.is_behind_walls(fit.map_t_points, first, closing.question.partly):
            return None
        # As much as one scan tells; the newest may be one of those of which nothing was kept.
        share = float(np.mean([len(points) for points in way.points[first:] if len(points)])) / len(query)
        near = self._old.witness(query, fit.map_t_points)
        if near is None:
            return None
        unknown = disputed(found, self.config) if closing.question.partly else None
        told = fit.information if unknown is None else _blinded(fit.information, [unknown])
        known = way.relate(near, fit.map_t_points, share * told, 0.0)
        way.drift.close(near, way.path, known)
        self.closures += 1
        if not closing.question.partly:
            # A part tells where the path is, not that the next scans lie on the settled map.
            self.linked, self._misses = True, 0
        self._forget_findings()
        way.path = way.smoothed()
        self._old.redraw()
        return way.path.copy()

    def _judged(self, closing: Closing, recent: Points) -> Finding | None:
        """Return where the newest key scan is on the settled map, if the last metres (N, 2) believe it."""
        found, way = closing.found(), self.way
        if found is None:
            return None
        place = closing.carried(found.best.map_t_points, way.path)
        near = self._old.witness(recent, place)
        if near is None:
            return None
        finding = Finding(
            place=place,
            rival=closing.carried(found.rival.map_t_points, way.path) if found.rival else None,
            score=found.best.score,
            rival_ratio=found.rival.score / found.best.score if found.rival else 0.0,
            at=way.path[-1],
            drift=way.drift.since(near, between(way.path[near], way.path[-1])),
            points=recent,
            way_m=float(way.lengths_m[-1]),
        )
        if closing.question.partly:
            query = picked(recent, QUERY_POINTS)
            here, there = (closing.fits(query, at) for at in (finding.place, finding.at))
            return finding if self._part_judge.believes(finding, here, there) else None
        return finding if self._judge.believes(finding, self._old.map) else None

    def away_m(self) -> float:
        """How far the path may be off from what was mapped around, in the worst direction, one sigma."""
        return away_m(self._old.drift())

    def _first_asked(self) -> int:
        """Return the first key scan of the last metres: the more may be off, the more must be recognised."""
        c, lengths_m = self.config, self.way.lengths_m
        length_m = min(max(c.query_m, 6.0 * self.away_m()), c.most_query_m)
        return int(np.searchsorted(lengths_m, lengths_m[-1] - length_m))


def _blinded(information: Matrix, directions: Iterable[NDArray[np.float64]]) -> Matrix:
    """Return the information (3, 3) without what it tells along directions, (2,) unit vectors."""
    seen = np.eye(3)
    for direction in directions:
        seen[:2, :2] -= np.outer(direction, direction)
    return np.asarray(seen @ information @ seen)
