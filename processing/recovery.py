"""Finding a lost laser on the local map: is there one place, and only one, where its scan fits?

The farther back the last good scan is, the farther away the laser is looked for. A place counts when the scan
fits there nearly as scans usually do, and when no other place in reach comes near it. A laser that was only
covered for a moment, though, counts as being where it was, if it may be: in a plain corridor nothing else can
tell. A place is on trial first: the scans that follow must fit, too, followed from there.
"""

from collections.abc import Sequence

import numpy as np

from processing import wide_match
from processing.local_map import KeyScan
from processing.matching import Matcher, Matching
from processing.ndt import Ndt, Oriented, Points
from processing.observability import view
from processing.prediction import ConstantVelocity, Prior, turned
from processing.se2 import Pose, between
from processing.sightlines import Sight, judge

SURPRISE = 3.0
"""Sigmas from the expected pose beyond which a scan must be one that can be seen there."""
CELL_M = 0.1
FIT_M = 0.12
"""Blur of the walls in the wide search."""
SIGHT_M = 10.0
"""Points farther away are left out: the step of the search in rotation falls with the farthest point."""
LEAST_FIT = 0.6
"""Share of the points that must find their wall."""
AGAIN = 0.75
"""Share of the usual score at which the laser is found again."""
TRIAL_S = 1.0
"""For so long a place is on trial:"""
PASSED = 0.85
"""the scans after the first must have this share of the usual score in the mean,"""
FAILED = 0.6
"""and none may have less than this."""
LEAST_KNOWN = 0.6
"""Points that lie where no scan has looked before can not fit; so many must lie where one has."""
ALIKE = 0.8
"""A second place with this share of the best one's score makes the first one nobody's."""
APART_M = 0.5
APART_RAD = 0.3
"""Places nearer to each other than this are one."""
GRAIN = np.array((0.1, 0.1, 0.03))
"""How far the polish may go from a place of the wide search; m, m, rad."""

REACH_M = 0.6
REACH_RAD = 1.3
"""How far the laser is looked for at once,"""
SPEED_M_S = 1.5
TURN_RAD_S = 1.0
"""and by how much farther with every second."""
MOMENT_S = 3.0
"""A laser covered for less is taken up where it was when the scan fits there as well as anywhere:"""
NEARLY = 0.95
"""with this share of the best score."""
PATIENCE_S = 3.0
"""After so much time of seeing, a new local map begins."""
LEAST_POINTS = 20
COVER_M = 0.3
"""A laser that sees fewer points, or nearly all of them nearer than this, is covered."""


class Recovery:
    """Looks for the laser from the first scan that did not fit on."""

    def __init__(self, filter_: ConstantVelocity, since_s: float) -> None:
        self._held = filter_.pose.copy()
        self._covariance = filter_.covariance[:3, :3].copy()
        self._field: wide_match.Field | None = None
        self.since_s = since_s
        """Time since the last good scan."""
        self._seeing_s = 0.0
        self._trial: list[float] | None = None
        self.elsewhere = False
        """Whether the place on trial is another one than where the laser was expected."""

    @property
    def trying(self) -> bool:
        """Whether a place is on trial."""
        return self._trial is not None

    def judge(self, share: float, period_s: float, lost: bool) -> bool | None:
        """Take the next scan of the trial.

        Args:
            share: Its score as a share of the usual one.
            period_s: From scan to scan.
            lost: Whether the track counts as lost by now. As long as it does not, the next scan that fits
                confirms a place where the laser was expected.

        Returns:
            Whether the place was right; None while that is open.
        """
        trial = self._trial if self._trial is not None else []
        trial.append(share)
        if not (lost or self.elsewhere) and share >= AGAIN:
            self._trial = None
            return True
        if share >= FAILED and len(trial) * period_s < TRIAL_S:
            return None
        self._trial = None
        right = bool(share >= FAILED and np.mean(trial) >= PASSED)
        if not right:
            self._seeing_s += len(trial) * period_s
        return right

    @property
    def hopeless(self) -> bool:
        """Whether the laser sees enough, has done so for long, and is nowhere on the local map."""
        return self._seeing_s >= PATIENCE_S

    def stand(self, filter_: ConstantVelocity) -> Prior:
        """Hold the filter where the track was lost, with the doubt of a way that nobody saw."""
        self.arrive(filter_, self._held)
        covariance = filter_.covariance[:3, :3]
        return Prior(filter_.pose, turned(np.asarray(np.linalg.inv(covariance)), self._held[2]))

    def arrive(self, filter_: ConstantVelocity, pose: Pose) -> None:
        """Put the filter at a pose (3,), at rest, with the doubt of a way that nobody saw."""
        filter_.forget_velocity()
        filter_.pose = pose.copy()
        start = np.diag(filter_.covariance)[3:6]
        filter_.covariance[:3, :3] = self._covariance + np.diag(start * self.since_s**2)

    def look(
        self,
        points: Oriented,
        near: Matching,
        matcher: Matcher,
        reference: Ndt,
        keys: Sequence[KeyScan],
        usual: float,
        duration_s: float,
    ) -> Matching | None:
        """Return where the scan fits, if it is one place; that is on trial then.

        Args:
            points: (N, 4) of the scan, N >= 1.
            near: The best match around where the laser was expected.
            matcher: Polishes.
            reference: The local map, and
            keys: the scans that it was made of.
            usual: Score of scans that fit.
            duration_s: Time that the scan stands for.
        """
        found = self._only_place(points, near, matcher, reference, keys, usual)
        if found is not None:
            self._trial, self.elsewhere = [], found is not near and _apart(found.pose, near.pose)
        elif not covered(points):
            self._seeing_s += duration_s
        return found

    def _only_place(
        self,
        points: Oriented,
        near: Matching,
        matcher: Matcher,
        reference: Ndt,
        keys: Sequence[KeyScan],
        usual: float,
    ) -> Matching | None:
        points_odom = np.concatenate([key.points_odom for key in keys])
        found = [near, *self._places(points, near.pose, matcher, reference, points_odom)]
        best = max(found, key=lambda matching: matching.score)
        sight = sight_of(points, best.pose, keys)
        least = AGAIN * usual * max(sight.known, LEAST_KNOWN)
        if best.score < least or not (sight.possible or self.is_expected(best.pose)):
            return None
        alike = near.score >= least and near.score >= NEARLY * best.score
        if self.since_s < MOMENT_S and self._seeing_s == 0.0 and alike:
            return near
        if len(view(best.information).unseen):
            return None
        rivals = [other for other in found if _apart(best.pose, other.pose)]
        return None if any(other.score > ALIKE * best.score for other in rivals) else best

    def is_expected(self, pose: Pose) -> bool:
        """Whether the motion alone may have led to a pose (3,) since the last good scan."""
        if self._seeing_s > 0.0:
            return False
        information = np.asarray(np.linalg.inv(self._covariance))
        return Prior(self._held, turned(information, self._held[2])).sigmas(pose) <= SURPRISE

    def _places(
        self, points: Points, guess: Pose, matcher: Matcher, reference: Ndt, points_odom: Points
    ) -> list[Matching]:
        query = points[np.hypot(points[:, 0], points[:, 1]) < SIGHT_M, :2]
        if len(query) < LEAST_POINTS:
            return []
        if self._field is None:
            around = (np.abs(points_odom - self._held[:2]) < SIGHT_M + SPEED_M_S * PATIENCE_S).all(axis=1)
            if not around.any():
                return []
            self._field = wide_match.build_field(points_odom[around], CELL_M, FIT_M, 0.5)
        reach_m = REACH_M + SPEED_M_S * min(self.since_s, PATIENCE_S)
        reach_rad = min(REACH_RAD + TURN_RAD_S * self.since_s, np.pi)
        window = (guess, reach_m, reach_rad, LEAST_FIT)
        result = wide_match.Window(self._field, query, *window, APART_M, APART_RAD, most=2).search()
        if result is None:
            return []
        places = [result.best] if result.rival is None else [result.best, result.rival]
        return [
            matcher.match(points, reference, Prior(place.map_t_points, np.diag(1.0 / GRAIN**2)), 2.0 * GRAIN)
            for place in places
        ]


def sight_of(points: Points, odom_t_laser: Pose, keys: Sequence[KeyScan]) -> Sight:
    """Ask the local map whether a scan (N, 2) or (N, 4), laser frame, can have been taken at a place."""
    ends = np.cumsum([len(key.points_odom) for key in keys])
    poses = np.array([key.odom_t_laser for key in keys])
    return judge(points[:, :2], odom_t_laser, np.concatenate([key.points_odom for key in keys]), ends, poses)


def covered(points: Points) -> bool:
    """Whether points (N, 2), laser frame, are too few or too near to be a view of anything."""
    if len(points) < LEAST_POINTS:
        return True
    return shaded(points)


def shaded(points: Points) -> bool:
    """Whether nearly all points (N, 2), laser frame, N >= 1, are those of a hand before the laser."""
    near = points[:, 0] ** 2 + points[:, 1] ** 2 < COVER_M**2
    return bool(np.count_nonzero(near) > 0.8 * len(points))


def _apart(one: Pose, other: Pose) -> bool:
    off = between(one, other)
    return bool(np.hypot(off[0], off[1]) >= APART_M or abs(off[2]) >= APART_RAD)
