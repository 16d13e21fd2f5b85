"""What a scan's motion rests on: walls, small things that were seen to stand, or things that may walk.

Along directions that walls see, nobody who walks can do harm. Where they do not, a match is drawn along by
whatever moves; so those who walk are left out there, and a velocity that only they tell is not believed.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from processing.matching import Matcher, Matching
from processing.ndt import Ndt, Points
from processing.observability import View, view
from processing.prediction import Twist
from processing.se2 import transform
from processing.walkers import Kind, Walkers

Directions = NDArray[np.float64]

ROUGH = 0.5
"""Who walks is left out where walls alone know a direction worse than this share of what is not seen."""
SURE_SCANS = 5
"""The velocity is the middle one of so many that were seen by what stands: the first ones after a while in
which nothing was seen also take back what was wrong till then."""
LEAST_POINTS = 10
"""Fewer points are no scan: nobody is left out then."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """By what a scan saw; (K, 2) unit vectors on the odometry's axes."""

    unseen: Directions = field(default_factory=lambda: np.zeros((0, 2)))
    """Directions that it did not see."""
    leaning: Directions = field(default_factory=lambda: np.zeros((0, 2)))
    """Those that it saw by nothing but things that may walk, or not at all."""
    rough: bool = False
    """Whether walls alone leave some direction uncertain."""


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
        self._kinds = np.zeros(0, np.int64)
        self._sure: deque[Twist] = deque(maxlen=SURE_SCANS)
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

    def leave_out(
        self, points: Points, spans_m: NDArray[np.float64], yaw_rad: float, twist: Twist, duration_s: float
    ) -> Points:
        """Return the points (M, 2) of a scan to match: without those who would draw the match along.

        Args:
            points: (N, 2) of the scan, laser frame.
            spans_m: (N,) how far the surface reaches that each is of.
            yaw_rad: Where the laser is expected to look.
            twist: The velocity that it is taken to have, (2,) or (3,), laser frame.
            duration_s: Since the scan before.
        """
        self._kinds = np.full(len(points), Kind.WALL, np.int64)
        if self._walkers is None:
            return points
        velocity = transform(np.array((0.0, 0.0, yaw_rad)), twist[None, :2])[0]
        kinds = self._walkers.look(points, spans_m, yaw_rad, velocity, self.sight.leaning, duration_s)
        out = np.zeros(len(points), np.bool_)
        if self.sight.rough:
            out |= kinds == Kind.WALKS
        if len(self.sight.unseen):
            # What comes into a view that says nothing is believed when it has been seen to stand.
            out |= kinds == Kind.NEW
        if np.count_nonzero(~out) < LEAST_POINTS:
            out[:] = False
        self._kinds = kinds[~out]
        return points[~out]

    def learn(self, points: Points, matching: Matching, reference: Ndt, limit_m: float) -> View:
        """Note by what the points that were left (M, 2) saw, and return what they saw.

        Args:
            points: As `leave_out` returned them.
            matching: Of them, in
            reference: this.
            limit_m: Standard deviation from which a direction counts as not seen.
        """

        def unseen(some: NDArray[np.bool_], limit_m: float) -> Directions:
            known = self._matcher.information(points[some], reference, matching.pose)
            return view(known, limit_m).unseen

        seen = view(matching.information, limit_m)
        walls = self._kinds == Kind.WALL
        blind = len(seen.unseen) > 0
        rough = blind if walls.all() else len(unseen(walls, ROUGH * limit_m)) > 0
        leaning = seen.unseen
        if rough and not blind:
            leaning = unseen(self._kinds <= Kind.STANDS, limit_m)
        self.sight = Sight(seen.unseen, leaning, rough)
        return seen
