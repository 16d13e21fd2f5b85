"""Who walks: small things followed from scan to scan, and what their ways say of the laser's own.

In a corridor the walls say nothing along themselves. One person in sight is then all that a scan says of that
direction, and a match that trusts him goes where he goes. Nothing in one scan tells legs from pillars, but
their ways do: what stands passes the laser as fast as the laser drives. So each small thing is followed, and
where walls do not see, it must first be seen to pass at a speed that the laser can have (tracking of moving
objects from a moving laser: Wang, Thorpe, Thrun, Hebert and Durrant-Whyte, IJRR 2007).
"""

import enum

import numpy as np
from numpy.typing import NDArray

from processing.ndt import Points
from processing.walker_kernels import NEW, STANDS, WALKS, WALL, WIDTH, look

Directions = NDArray[np.float64]


class Kind(enum.IntEnum):
    """What a point is of."""

    WALL = WALL
    STANDS = STANDS
    NEW = NEW
    """A small thing of which nothing is known yet."""
    WALKS = WALKS


class Walkers:
    """The small things around the laser."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew: nothing has been seen."""
        self._things = np.zeros((0, WIDTH))
        self.numbers = np.zeros(0, np.int64)
        """(N,) which of the small things in sight each point of the last scan is of, -1 for walls."""

    def look(
        self,
        points: Points,
        spans_m: NDArray[np.float64],
        yaw_rad: float,
        velocity: NDArray[np.float64],
        fastest_m_s: float,
        unseen: Directions,
        duration_s: float,
    ) -> NDArray[np.int64]:
        """Take in the next scan; return the `Kind` of each point (N,).

        Args:
            points: (N, 2) m, laser frame.
            spans_m: (N,) how far the surface reaches that each is of.
            yaw_rad: Of the laser.
            velocity: (2,) m/s that the laser is taken to have, odometry's axes.
            fastest_m_s: Its greatest speed so far.
            unseen: (K, 2) unit vectors along which no wall says so, on these axes too.
            duration_s: Since the scan before, > 0.
        """
        self.numbers, kinds = np.empty((2, len(points)), np.int64)
        unseen, things = np.ascontiguousarray(unseen), self._things
        self._things = look(
            points, spans_m, yaw_rad, velocity, fastest_m_s, unseen, duration_s, things, self.numbers, kinds
        )
        return kinds
