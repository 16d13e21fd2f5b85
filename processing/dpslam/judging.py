"""Is a place that a search found the one where the laser is? Corridors and rooms look alike.

Two explanations compete: the path drifted so far, or the place is another one that looks alike. What speaks
for the first: that the drift is likely; that no other place fits; that other points of the same stretch find
their wall there and not elsewhere; and that the same drift is found again farther along the way.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.settled import SettledMap
from processing.ndt import Points
from processing.se2 import Pose, between, compose

Matrix = NDArray[np.float64]

FITTING = 0.3
"""Score from which a point counts as lying on its wall."""
GATE = 20.0
"""Chi-square of a closure against the drift beyond which it is another place that looks alike. On the way
there the place must fit better and better, up to every point: of two explanations, a strange drift and a
likeness of places, the score must rule one out."""
ROUGH = np.diag((0.05**2, 0.05**2, 0.01**2))
"""Covariance of a place that a search finds, beside that of the drift; m^2, rad^2."""
FAR_M = 0.5
"""Drift (one sigma) from which neighbouring doors may be mistaken for each other."""
APART_SIGMAS = 8.0
"""Of the points that lie on a wall at one of two places only, so many more must do so at the better one for
the other to be ruled out: in standard deviations of their number if both were as good."""
APART_RATIO = 4.0
"""And so many times as many."""
APART_SHARE = 0.75
"""And such a share of all points must lie on a wall there: of two wrong places one may be much better."""
SAME = np.array((0.3, 0.3, 0.07))
"""Two drifts are one within that; m, m, rad."""
STILL_SAME = np.array((0.5, 0.5, 0.1))
"""The same where there is a long way between them."""
PERSISTENT_M = 15.0
"""An odd drift that stays the same over so long a way, as far as a laser sees, is one."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What a search found, and what it is to be judged by."""

    place: Pose
    """(3,) map_t_laser of the newest key scan where the last metres fit best,"""
    rival: Pose | None
    """(3,) and where they fit next best, apart from there;"""
    score: float
    """share of the points searched for that found their wall,"""
    rival_ratio: float
    """and the share of that which the rival has; 0 without one."""
    at: Pose
    """(3,) map_t_laser as the path has it,"""
    drift: Matrix
    """(3, 3) covariance of its error, in the laser's frame."""
    points: Points
    """(N, 2) m, the last metres, laser frame."""
    way_m: float
    """Length of the way so far."""

    @property
    def off_by(self) -> Pose:
        """(3,) where it was found, seen from where the path has it."""
        return between(self.at, self.place)


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A drift that was found: the path's axes on the map's."""

    way_m: float
    shift: Pose
    """(3,) map_t_path."""

    @classmethod
    def of(cls, finding: Finding) -> "Sighting":
        """Return what a finding shows of it."""
        return cls(finding.way_m, compose(finding.place, between(finding.at, np.zeros(3))))

    @classmethod
    def of_row(cls, row: NDArray[np.float64]) -> "Sighting":
        """Return the one whose `row` was taken."""
        return cls(float(row[0]), row[1:].copy())

    @property
    def row(self) -> NDArray[np.float64]:
        """(4,) everything."""
        return np.array((self.way_m, *self.shift))

    def is_same(self, finding: Finding, tolerance: Pose) -> bool:
        """Whether a later finding shows the same drift, each of (3,) within the tolerance."""
        apart = np.abs(between(compose(self.shift, finding.at), finding.place))
        return bool((apart < tolerance).all())


class Judge:
    """Believes or doubts what the searches find, one after the other."""

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        self.forget()

    def forget(self) -> None:
        """Begin anew: the laser is known to be where the path has it, or nowhere."""
        self._before: Sighting | None = None
        self._odd: Sighting | None = None

    @property
    def waits(self) -> bool:
        """Whether a place waits to be found once more."""
        return self._before is not None

    def believes(self, finding: Finding, settled: SettledMap) -> bool:
        """Say whether the laser is where it was found."""
        c = self._config
        far = away_m(finding.drift) > FAR_M
        if finding.score < c.least_score + (1.0 - c.least_score) * strangeness(finding):
            return finding.rival_ratio <= c.far_rival_ratio and self._persists(finding, settled)
        if finding.rival is not None and finding.rival_ratio > (c.far_rival_ratio if far else c.rival_ratio):
            here, there = _on_walls(finding, settled, finding.rival)
            if here.mean() <= APART_SHARE or not _is_more(here, there):
                return False
        risky = far or finding.rival_ratio > c.far_rival_ratio
        return not risky or self._is_confirmed(finding)

    def state(self) -> NDArray[np.float64]:
        """Return everything as an array (2, 4); `restore` takes it back."""
        kept = (self._before, self._odd)
        return np.array([(np.nan,) * 4 if one is None else one.row for one in kept])

    def restore(self, state: NDArray[np.float64]) -> None:
        """Become the judge whose `state` was taken."""
        self._before, self._odd = (None if np.isnan(row[0]) else Sighting.of_row(row) for row in state)

    def _is_confirmed(self, finding: Finding) -> bool:
        """Whether the finding before showed the same drift."""
        before, self._before = self._before, Sighting.of(finding)
        # A search through a wide window takes its time: the next one begins some metres farther on.
        recent = before is not None and finding.way_m - before.way_m < self._config.most_query_m
        return before is not None and recent and before.is_same(finding, SAME)

    def _persists(self, finding: Finding, settled: SettledMap) -> bool:
        """Whether a drift that is not likely has been found again and again, along a long way.

        A room that looks alike ends after some metres; an odometry that slipped, and does not know, is off by
        the same in every room.
        """
        if not _is_more(*_on_walls(finding, settled, finding.at)):
            return False
        if self._odd is None or not self._odd.is_same(finding, STILL_SAME):
            self._odd = Sighting.of(finding)
        return finding.way_m - self._odd.way_m > PERSISTENT_M


def strangeness(finding: Finding) -> float:
    """Return the chi-square of a drift, in units of the gate."""
    return float(finding.off_by @ np.linalg.solve(finding.drift + ROUGH, finding.off_by) / GATE)


def away_m(drift: Matrix) -> float:
    """Return how far a path of that drift (3, 3) may be off in the direction known worst, one sigma."""
    return float(np.sqrt(np.linalg.eigvalsh(drift[:2, :2]).max()))


def _on_walls(
    finding: Finding, settled: SettledMap, other: Pose
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which of the points (N,) lie on a wall where they were found, and which at another (3,)."""
    here, there = (settled.fits(finding.points, at) > FITTING for at in (finding.place, other))
    return here, there


def _is_more(here: NDArray[np.bool_], there: NDArray[np.bool_]) -> bool:
    """Whether clearly more of the points (N,) lie on a wall here and not there than the other way round.

    Along a corridor most points lie on its walls wherever it is taken to be, and the scores say little; the
    few that are left say which doors these are. McNemar's test (1947), with a bound for points that go
    together.
    """
    speak_for, speak_against = np.count_nonzero(here & ~there), np.count_nonzero(there & ~here)
    return bool(
        speak_for > APART_RATIO * speak_against
        and speak_for - speak_against > APART_SIGMAS * np.sqrt(speak_for + speak_against)
    )
