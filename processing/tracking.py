"""Whether the laser is still where the track has it: each score is judged against what is usual here.

A scan that fits its place scores about as the scans before it did, whatever the scene; one taken elsewhere
scores a fraction of that, and does not fit the scan before it either. Such a bad scan does not become a part
of the local map, so that a wrong place cannot make itself at home. The laser is looked for around at once;
when that finds nothing for too long, the track is lost, and the search grows (`recovery`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from processing.local_map import KeyScan
from processing.matching import Matcher, Matching
from processing.ndt import Ndt, NdtConfig, Oriented, Points
from processing.prediction import ConstantVelocity, Prior
from processing.recovery import LEAST_KNOWN, SURPRISE, Recovery, sight_of

FIT = 0.5
"""Share of the usual score from which a scan fits.

On real logs one scan in some thousands scores less where it is; carried elsewhere, most score under 0.3.
"""
SURE = 0.75
"""The same after a scan that did not fit, or a hole: the laser may be elsewhere."""
STRAIGHTER = 1.25
"""By so much better a bent scan fits when it is set straight."""
DOUBTFUL = 0.75
"""The same, where the map knows what the scan should see: something else moves."""
DOUBT_S = 2.0
"""After so much time of it the map is wrong, not the scan."""
SHOCK = 6.0
"""Sigmas beyond which it must not be."""
CONTINUOUS = 0.27
"""Score on the last good scan from which two scans are of one place.

Neighbouring scans of real logs score 0.29 and more on each other, other pairs mostly under 0.1.
"""
USUAL_S = 5.0
"""For how long a score counts as usual."""
LOST_S = 0.4
"""After so much time without a good scan the track is lost; a hand before the laser is no loss at once."""


class Watch:
    """Knows the usual score, how long no scan has fitted, and where to look for the laser then."""

    def __init__(self, period_s: float, ndt: NdtConfig) -> None:
        self._share = min(1.0, period_s / USUAL_S)
        # As near to the wait as scans come.
        self._patience = max(1, round(LOST_S / period_s))
        self._usual = 0.0
        self._misses = 0
        self._duration_s = period_s
        self._doubts, self._most_doubts = 0, max(1, round(DOUBT_S / period_s))
        self._calm = self._most_doubts
        self.doubtful = False
        """Whether the scan fits so badly on known ground that it may be anywhere that the motion allows."""
        self.since_s = period_s
        """Time from the last good scan to this one."""
        self.elsewhere = False
        """Whether this scan was found elsewhere than expected: likely, but for the whole map to confirm."""
        self._recovery: Recovery | None = None
        self._ndt = ndt
        self._last: Points = np.zeros((0, 2))

    @property
    def lost(self) -> bool:
        """Whether it has been too long since a scan fitted."""
        return self._misses >= self._patience

    @property
    def trying(self) -> bool:
        """Whether the laser may have been found again: the scans that follow must tell."""
        return self._recovery is not None and self._recovery.trying

    @property
    def hopeless(self) -> bool:
        """Whether it is time to begin anew: the laser sees, and is nowhere on the local map."""
        return self.lost and self._recovery is not None and self._recovery.hopeless

    @property
    def shaken(self) -> bool:
        """Whether a scan contradicted the map a moment ago: what moved may have drawn the match with it."""
        return self._calm < self._most_doubts

    def begin(self) -> None:
        """Forget what is usual: a new local map begins."""
        self._usual, self._misses, self._recovery = 0.0, 0, None

    def expect(self, filter_: ConstantVelocity, duration_s: float) -> Prior:
        """Let time pass; say where the laser should be: a lost one counts as standing where it was."""
        self._duration_s, self.elsewhere = duration_s, False
        self.since_s = duration_s if self._recovery is None else self.since_s + duration_s
        if self._recovery is None:
            return filter_.advance(duration_s)
        self._recovery.since_s = self.since_s
        stands = self.lost and not self._recovery.trying
        return self._recovery.stand(filter_) if stands else filter_.advance(duration_s)

    def straight_score(self, matching: Matching) -> float | None:
        """Return what a scan must score that was bent and is set straight; None if it fits as it is."""
        if self.lost or matching.score >= SURE * self._usual:
            return None
        return max(STRAIGHTER * matching.score, FIT * self._usual)

    def accept(self, points: Oriented, matching: Matching, prior: Prior, keys: Sequence[KeyScan]) -> bool:
        """Judge the match of a scan; one that fits goes into what is usual.

        Args:
            points: (N, 4) of the scan, N >= 1.
            matching: Where it fits best.
            prior: Where it should be.
            keys: The scans of the local map.
        """
        share = matching.score / self._usual if self._usual > 0.0 else 1.0
        sight = sight_of(points, matching.pose, keys) if share < SURE else None
        explained = share if sight is None else share / max(sight.known, LEAST_KNOWN)
        self._doubts = self._doubts + 1 if explained < DOUBTFUL else 0
        self.doubtful = 0 < self._doubts <= self._most_doubts
        self._calm = 0 if self._doubts else self._calm + 1
        calm = self._misses == 0 and self._duration_s <= LOST_S
        if self.lost or self.trying or share < (FIT if calm else SURE):
            return False
        sigmas = prior.sigmas(matching.pose) if share < SURE else 0.0
        if sigmas > SHOCK or (sigmas > SURPRISE and sight is not None and not sight.free):
            return False
        self.take(matching)
        return True

    def take(self, matching: Matching) -> None:
        """Go on with a match, whatever its score."""
        self._good(matching.score)

    def remember(self, points_odom: Points) -> None:
        """Keep the points (N, 2) of the last good scan."""
        self._last = points_odom

    def follow(self, points: Oriented, prior: Prior, matcher: Matcher, reference: Ndt) -> Matching | None:
        """Match a scan that does not fit the local map by way of the last good scan, if it fits that.

        Where the map is poor, two scans of one place still fit each other.

        Args:
            points: (N, 4) of the scan, N >= 1.
            prior: Where it should be.
            matcher: Matches.
            reference: The local map.
        """
        if self.lost or self.trying:
            return None
        before = Ndt(self._ndt, capacity=1024)
        before.build(self._last)
        step = matcher.match(points, before, prior)
        if step.score < CONTINUOUS or prior.sigmas(step.pose) > SURPRISE:
            return None
        if matcher.has_turned_on(step.pose, prior):
            # To the other side it may fit as well: rooms look alike from four sides, and nobody looked.
            return None
        expected = Prior(step.pose, prior.information + step.information)
        matching = matcher.match(points, reference, expected)
        self._misses, self._recovery = 0, None
        return replace(matching, information=step.information + matching.information)

    def find(
        self,
        points: Oriented,
        near: Matching,
        filter_: ConstantVelocity,
        matcher: Matcher,
        reference: Ndt,
        keys: Sequence[KeyScan],
    ) -> tuple[Matching, bool]:
        """Look for the laser farther away, or go on with a place that is on trial.

        Args:
            points: (N, 4) of the scan, N >= 1.
            near: The match that was not accepted.
            filter_: Of the motion.
            matcher: Polishes places.
            reference: The local map, and
            keys: the scans that it was made of.

        Returns:
            The match to go on with, and whether it is accepted.
        """
        recovery = self._recovery = self._recovery or Recovery(filter_, self._duration_s)
        if recovery.trying:
            known = max(sight_of(points, near.pose, keys).known, LEAST_KNOWN)
            passed = recovery.judge(near.score / (self._usual * known), self._duration_s, self.lost)
            if passed:
                self.elsewhere = recovery.elsewhere
                self._good(near.score)
            if passed is not False:
                return near, bool(passed)
            # The filter has followed a wrong place.
            self._misses = max(self._misses, self._patience)
            recovery.stand(filter_)
        found = recovery.look(points, near, matcher, reference, keys, self._usual, self._duration_s)
        if found is None:
            return near, False
        hole = self._duration_s > LOST_S and recovery.since_s == self._duration_s
        if hole and recovery.is_expected(found.pose):
            # Nothing was seen that did not fit, and it is where the motion led.
            self._good(found.score)
            return found, True
        recovery.arrive(filter_, found.pose)
        return found, False

    def miss(self, filter_: ConstantVelocity, missed: int) -> None:
        """Note a scan that told nothing, and the missing ones before it."""
        self._recovery = self._recovery or Recovery(filter_, self._duration_s)
        self._misses += 1 + missed

    def _good(self, score: float) -> None:
        self._misses, self._recovery = 0, None
        self._usual = score if self._usual == 0.0 else self._usual + self._share * (score - self._usual)
