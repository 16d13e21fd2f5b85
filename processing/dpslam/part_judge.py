"""Is a place the one where the laser is, if the map knows only a part of what is seen from there?

A laser that sees four metres comes back to a room through its other half: hardly a third of the last metres'
points lie where the map knows anything. Those outside say nothing. Of the others many must lie on walls and
few where rays have passed; where the path has the laser it must be the other way round; and the same must be
found again and again.
"""

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.judging import FITTING, SAME, Finding, Sighting, strangeness
from processing.dpslam.loop_config import LoopConfig
from processing.se2 import between

Fits = NDArray[np.float64]

PASSED = -0.5
"""Fit up to which a point lies where rays have passed."""
LEAST_FITTING = 30
"""So many points must lie on walls: fewer may be one chair's."""
FOR_ONE_AGAINST = 3.0
"""And so many times as many as lie where rays have passed."""
LIKELY = 0.5
"""Greatest strangeness of the drift: that a part of the ground is known makes a place no likelier."""
MOVED_SIGMAS = 4.0
"""So many more points must fit better than on the path than fit worse, in standard deviations of their number
if both were as good,"""
MOVED_RATIO = 2.5
"""and so many times as many."""
REFUTED_SIGMAS = 3.0
"""On the path so many more must lie where rays have passed: along a corridor the part that is known always
fits better than the one beyond its end, which nothing speaks against."""
NEAR = np.array((0.2, 0.2, 0.1))
"""A place no farther from the path (m, m, rad) needs not refute it,"""
NEAR_FITTING, NEAR_FOR_ONE_AGAINST, NEAR_RIVAL = 60, 10.0, 0.6
"""but must fit the better, and stand the more alone."""
TIMES = 3
"""So often the same drift must be found, over half of the least way that is asked for,"""
KEPT_M = 6.0
"""and within that way."""


def disputed(finding: Finding, config: LoopConfig) -> NDArray[np.float64] | None:
    """Return the direction in which a place is not known, (2,) unit vector, map frame; None if there is none.

    A rival that is as good lies along a corridor, most often; of the place across it and of the heading both
    say the same. A path that has drifted across gets rid of that at once, and not only at the next corner.
    """
    if finding.rival is None or finding.rival_ratio < config.far_rival_ratio:
        return None
    if abs(between(finding.place, finding.rival)[2]) > SAME[2]:
        return None
    way = finding.rival[:2] - finding.place[:2]
    return np.asarray(way / np.hypot(*way))


class PartJudge:
    """Believes or doubts what searches on partly known ground find, one after the other."""

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        self._sightings: list[Sighting] = []

    @property
    def waits(self) -> bool:
        """Whether a place waits to be found once more."""
        return bool(self._sightings)

    def forget(self) -> None:
        """Begin anew: the laser is known to be where the path has it, or nowhere."""
        self._sightings = []

    def believes(self, finding: Finding, here: Fits, there: Fits) -> bool:
        """Say whether the laser is where it was found.

        Args:
            finding: Place and drift.
            here: (N,) how the last metres' points fit at the place: 1 on a wall, 0 where nothing is known,
                -1 where rays have passed;
            there: (N,) and how where the path has them.
        """
        recent = [one for one in self._sightings if finding.way_m - one.way_m < KEPT_M]
        self._sightings = recent
        if not self._speaks(finding, here, there):
            return False
        self._sightings = [*(one for one in recent if one.is_same(finding, SAME)), Sighting.of(finding)]
        along_m = finding.way_m - self._sightings[0].way_m
        return len(self._sightings) >= TIMES and along_m >= 0.5 * self._config.query_m

    def state(self) -> NDArray[np.float64]:
        """Return everything as an array (S, 4); `restore` takes it back."""
        return np.array([one.row for one in self._sightings]).reshape(-1, 4)

    def restore(self, state: NDArray[np.float64]) -> None:
        """Become the judge whose `state` was taken."""
        self._sightings = [Sighting.of_row(row) for row in state]

    def _speaks(self, finding: Finding, here: Fits, there: Fits) -> bool:
        """Whether this look, by itself, speaks for the place."""
        fitting, against = np.count_nonzero(here > FITTING), np.count_nonzero(here < PASSED)
        likely = strangeness(finding) < LIKELY
        if not likely or fitting < LEAST_FITTING or fitting <= FOR_ONE_AGAINST * against:
            return False
        if finding.rival_ratio >= self._config.far_rival_ratio and disputed(finding, self._config) is None:
            return False
        better, worse = np.count_nonzero(here > there + 0.5), np.count_nonzero(there > here + 0.5)
        refuted = np.count_nonzero(there < PASSED)
        if (
            better > MOVED_RATIO * worse
            and better - worse > MOVED_SIGMAS * np.sqrt(better + worse)
            and refuted - against > REFUTED_SIGMAS * np.sqrt(refuted + against)
        ):
            return True
        return bool(
            (np.abs(finding.off_by) < NEAR).all()
            and better >= worse
            and fitting >= NEAR_FITTING
            and fitting > NEAR_FOR_ONE_AGAINST * against
            and finding.rival_ratio < NEAR_RIVAL
        )
