"""Has the laser come back? The last metres of its way, searched in a window of the settled map.

A wide window takes more time than lies between two scans. So the search does a share of its work with each
scan and is at its end some scans later; what it found is carried on along the way since.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.old_ground import PASSED_M
from processing.ndt import Points
from processing.se2 import Pose, between, compose
from processing.wide_match import Search, Window, build_field

FIELD_CELL_M, FIELD_SIGMA_M = 0.05, 0.08
RIVAL_SCORE = 0.1
"""A second place counts from a score that is so much below what the best one must reach."""
SQUARES = 10_000
"""Share of the work that is done with a scan, see `Window.go_on`: ten milliseconds or so, a third of what a
key scan takes otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What is searched for, and where."""

    cloud: Points
    """(N, 2) the settled map around, m, map frame,"""
    passed: Points
    """(P, 2) and the middles of squares of edge PASSED_M through which rays passed, if it is to count where
    nothing is known; else none."""
    points: Points
    """(M, 2) the last metres of the way, m, frame of the newest key scan."""
    map_t_laser: Pose
    """(3,) where that key scan is thought to be: the middle of the window."""
    key: int
    """Its number."""
    reach_m: float
    """Half the side of the window."""
    reach_rad: float
    """Half its width in rotation."""
    costs: NDArray[np.float64]
    """(3, 3) what an offset from the middle takes off the score, see `Window`."""
    least_score: float
    """Share of the points that must find their wall; less those where rays passed."""

    @property
    def partly(self) -> bool:
        """Whether points that lie where nothing is known say nothing, in place of speaking against."""
        return len(self.passed) > 0


class Closing:
    """One search, begun at one key scan and brought to its end with the scans after it."""

    def __init__(self, question: Question) -> None:
        self.question = q = question
        passed = (q.passed, PASSED_M) if q.partly else ()
        self._field = build_field(q.cloud, FIELD_CELL_M, FIELD_SIGMA_M, 0.3, *passed)
        self._window = Window(
            self._field,
            q.points,
            q.map_t_laser,
            q.reach_m,
            q.reach_rad,
            q.least_score,
            most=2,
            least_rival=q.least_score - (0.0 if q.partly else RIVAL_SCORE),
            costs=q.costs,
        )
        self.ended = False
        """Whether there is nothing left to search."""

    def go_on(self, squares: int = SQUARES) -> None:
        """Do a share of the work."""
        self.ended = self.ended or self._window.go_on(squares)

    def found(self) -> Search | None:
        """Return the best place of the key scan at which it began, and its rival; None if there is none."""
        return self._window.search()

    def fits(self, points: Points, map_t_points: Pose) -> NDArray[np.float64]:
        """Return how each of the points (N, 2) m fits at a pose (3,), see `Field`."""
        return self._field.at(points, map_t_points)

    def carried(self, place: Pose, path: Pose) -> Pose:
        """Return where the newest key scan of a path (K, 3) is, if the one of the question is at `place`."""
        return compose(place, between(path[self.question.key], path[-1]))

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_state` takes it back."""
        q = self.question
        return {
            "cloud": q.cloud,
            "passed": q.passed,
            "costs": q.costs,
            "points": q.points,
            "map_t_laser": q.map_t_laser,
            "reach": np.array((q.reach_m, q.reach_rad, q.least_score)),
            "flags": np.array((q.key, self.ended)),
            **self._window.state(),
        }

    @classmethod
    def from_state(cls, state: dict[str, NDArray[Any]]) -> "Closing":
        """Return the search whose `state` was taken."""
        key, ended = state["flags"].tolist()
        reach_m, reach_rad, least_score = state["reach"].tolist()
        question = Question(
            cloud=state["cloud"].copy(),
            passed=state["passed"].copy(),
            costs=state["costs"].copy(),
            points=state["points"].copy(),
            map_t_laser=state["map_t_laser"].copy(),
            key=int(key),
            reach_m=reach_m,
            reach_rad=reach_rad,
            least_score=least_score,
        )
        closing = cls(question)
        closing._window.restore(state)
        closing.ended = bool(ended)
        return closing
