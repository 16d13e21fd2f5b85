"""What a scan's motion rests on: walls, small things that were seen to stand, or things that may walk.

Along directions that walls see, nobody who walks can do harm. Where they do not, a match is drawn along by
whatever moves; so those who walk are left out there, and a velocity that only they tell is not believed.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from processing.matching import Matcher, Matching
from processing.ndt import Ndt, Oriented
from processing.observability import View, view
from processing.prediction import Twist
from processing.se2 import Pose, transform
from processing.walkers import Kind, Walkers

Directions = NDArray[np.float64]
Matrix = NDArray[np.float64]

SURE_SHARE = 0.5
"""Without a few things a direction must be known to this share of what counts as not seen."""
SURE_SCANS = 5
"""The velocity is the middle one of so many that were seen by what stands: the first ones after a while in
which nothing was seen also take back what was wrong till then."""
FEW = 2
"""So many small things may walk together."""
WALKING_M_S = 1.0
"""A laser that has been as fast as people walk cannot tell them by their speed."""
TELLING = 4.5
"""Log of a ratio of likelihoods that leaves no doubt: that of three sigmas."""
LEAST_POINTS = 10
"""Fewer points are no scan: nobody is left out then."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """By what a scan saw; (K, 2) unit vectors on the odometry's axes."""

    unseen: Directions = field(default_factory=lambda: np.zeros((0, 2)))
    """Directions that it did not see."""
    leaning: Directions = field(default_factory=lambda: np.zeros((0, 2)))
    """Those that it saw by nothing but things that may walk, or not at all."""


class Footing:
    """Remembers by what the last scans saw, and sorts the points of the next one by it.

    Args:
        matcher: Tells what points know.
        walkers: Whether anybody is looked for who walks.
    """

    def __init__(self, matcher: Matcher, walkers: bool) -> None:
        self._matcher = matcher
        self._walkers = Walkers() if walkers else None
        self.forget()

    def forget(self) -> None:
        """Begin anew: nothing has been seen."""
        self.sight = Sight()
        self._kinds = self._numbers = np.zeros(0, np.int64)
        self._sure: deque[Twist] = deque(maxlen=SURE_SCANS)
        self._fastest_m_s = 0.0
        if self._walkers is not None:
            self._walkers.forget()

    @property
    def firm(self) -> bool:
        """Whether the last scan saw every direction by what stands."""
        return len(self.sight.leaning) == 0

    def sure_twist(self, twist: Twist) -> Twist:
        """Return the velocity (3,) that what stands has told; if nothing yet has, the given one."""
        return np.median(self._sure, axis=0) if self._sure else twist

    def believe(self, twist: Twist) -> None:
        """Take in a velocity (3,) that was seen by what stands."""
        self._sure.append(twist.copy())
        middle = np.median(self._sure, axis=0)
        self._fastest_m_s = max(self._fastest_m_s, float(np.hypot(middle[0], middle[1])))

    def leave_out(
        self, points: Oriented, spans_m: NDArray[np.float64], yaw_rad: float, twist: Twist, duration_s: float
    ) -> Oriented:
        """Return the points (M, 4) of a scan to match: without those who would draw the match along.

        Args:
            points: (N, 4) of the scan, laser frame, with their walls.
            spans_m: (N,) how far the surface reaches that each is of.
            yaw_rad: Where the laser is expected to look.
            twist: The velocity that it is taken to have, (2,) or (3,), laser frame.
            duration_s: Since the scan before.
        """
        if self._walkers is None or self._fastest_m_s > WALKING_M_S:
            return self.trust(points)
        velocity = transform(np.array((0.0, 0.0, yaw_rad)), twist[None, :2])[0]
        kinds = self._walkers.look(
            points, spans_m, yaw_rad, velocity, self._fastest_m_s, self.sight.leaning, duration_s
        )
        out = np.zeros(len(points), np.bool_)
        if len(self.sight.leaning):
            out |= kinds == Kind.WALKS
        if len(self.sight.unseen):
            # What comes into a view that says nothing is believed when it has been seen to stand.
            out |= kinds == Kind.NEW
        if np.count_nonzero(~out) < LEAST_POINTS:
            out[:] = False
        self._kinds, self._numbers = kinds[~out], self._walkers.numbers[~out]
        return points[~out]

    def trust(self, points: Oriented) -> Oriented:
        """Return all points (N, 4) of a scan, in place of what `leave_out` returned of it."""
        self._kinds = np.full(len(points), Kind.WALL, np.int64)
        self._numbers = np.full(len(points), -1, np.int64)
        return points

    def learn(
        self, points: Oriented, matching: Matching, reference: Ndt, expected: Pose, limit_m: float
    ) -> View:
        """Note by what the points that were left (M, 4) saw, and return what they saw.

        Args:
            points: As `leave_out` returned them.
            matching: Of them, in
            reference: this.
            expected: (3,) where the scan should be.
            limit_m: Standard deviation from which a direction counts as not seen.
        """
        seen = view(matching.information, limit_m)
        if len(seen.unseen):
            held = seen.hold(matching.pose, expected)
            if self._matcher.log_ratio(points, reference, matching.pose, held) > TELLING:
                # However vaguely it tells where the laser is: it is not where it was expected.
                seen = View(np.zeros((0, 2)), matching.information)
        leaning = seen.unseen
        if len(leaning) == 0 and self._rests_on_few(points, matching, reference, SURE_SHARE * limit_m):
            stands = self._matcher.information(points[self._kinds <= Kind.STANDS], reference, matching.pose)
            leaning = view(stands, limit_m).unseen
        self.sight = Sight(seen.unseen, leaning)
        return seen

    def _rests_on_few(self, points: Oriented, matching: Matching, reference: Ndt, limit_m: float) -> bool:
        """Whether some direction is not seen when the few small things that tell most of it are gone.

        In clutter many things tell it, and they cannot all walk the same way.
        """

        def known(some: NDArray[np.bool_]) -> Matrix:
            return self._matcher.information(points[some], reference, matching.pose)

        walls = self._numbers < 0
        if walls.all():
            return False
        information = known(walls)
        unseen = view(information, limit_m).unseen
        if len(unseen) == 0:
            return False
        parts = [known(self._numbers == number) for number in np.unique(self._numbers[~walls])]
        parts.sort(key=lambda part: float(np.einsum("ki,ij,kj->", unseen, part[:2, :2], unseen)))
        information += sum(parts[:-FEW])
        return len(view(information, limit_m).unseen) > 0
