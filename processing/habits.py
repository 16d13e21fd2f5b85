"""How a robot is driven: the speed that it has straight on, and the speeds that it has in turns.

Whoever drives keeps to a few speeds. A glimpse of the way tells which of them it is, and not how fast that
is.
"""

import numpy as np
from numpy.typing import NDArray

from processing.prediction import Twist

STEADY_M_S = 0.15
"""What a velocity may be off a steady one, if it is not known to be worse; farther, and the laser has changed
its speed."""
SURE_M = 0.03
"""Motions whose ends are known better than this all weigh the same."""
SAME_M = 0.5 * SURE_M
"""Two velocities may be one if the way seen of one would be so much longer by the other: matches err by some
millimetres at both its ends."""
ANOTHER_SHARE = 0.5
"""Of the time for which the usual velocity was seen another one must have been: robots slow down for a while,
as in a bend or before a door."""
SHARP_RAD_S = (0.3, 0.6)
"""Who turns faster than this, and than that, drives at a speed that belongs to it: robots slow down there."""
SHARP_SCANS = 10
"""So many scans of such turns tell the speed that belongs to them,"""
SHARP_MEMORY = 100
"""and so many of the newest count."""


class UsualVelocity:
    """The velocity that was steady for longest, until another one was steady for half as long."""

    def __init__(self) -> None:
        self._mean: NDArray[np.float64] = np.zeros(2)
        self._seen_s = 0.0

    @property
    def mean(self) -> NDArray[np.float64]:
        """(2,) laser frame; 0 as long as there is none."""
        return self._mean

    def see(self, velocity: NDArray[np.float64], seen_s: float) -> None:
        """Take in a velocity (2,) that was steady for so long, seen with every direction."""
        share = 1.0 if self._may_be(velocity, seen_s) else ANOTHER_SHARE
        if seen_s >= share * self._seen_s:
            self._mean, self._seen_s = velocity, seen_s

    def better(self, velocity: NDArray[np.float64], seen_s: float) -> NDArray[np.float64]:
        """Return a velocity (2,) that was seen for so long, better known where it may be the usual one.

        Behind a corner a corridor shows the way along it for a second: enough to tell that the robot drives
        as it always does, and too little to tell at which speed.
        """
        if seen_s >= self._seen_s or not self._may_be(velocity, seen_s):
            return velocity
        # What is seen of a way errs at its ends, however long it is.
        share = self._seen_s**2 / (self._seen_s**2 + seen_s**2)
        return velocity + share * (self._mean - velocity)

    def _may_be(self, velocity: NDArray[np.float64], seen_s: float) -> bool:
        off_m_s = float(np.hypot(*(velocity - self._mean)))
        return off_m_s * seen_s < min(SAME_M, STEADY_M_S * seen_s)


class TurnSpeeds:
    """At which velocity a robot drives while it turns sharply, as it was seen to."""

    def __init__(self) -> None:
        self._means = np.zeros((len(SHARP_RAD_S), 2))
        self._counts = np.zeros(len(SHARP_RAD_S), np.int64)

    def see(self, twist: Twist) -> None:
        """Take in a twist (3,) that was seen, whatever it is."""
        sharp = _sharpness(twist[2])
        if sharp >= 0:
            self._counts[sharp] += 1
            share = 1.0 / min(self._counts[sharp], SHARP_MEMORY)
            self._means[sharp] += share * (twist[:2] - self._means[sharp])

    def velocity(self, turn_rate_rad_s: float) -> NDArray[np.float64] | None:
        """Return the velocity (2,) of turns as sharp as this, or nearly; None if too few were seen."""
        known = np.flatnonzero(self._counts[: _sharpness(turn_rate_rad_s) + 1] >= SHARP_SCANS)
        return self._means[known[-1]].copy() if len(known) else None


def _sharpness(turn_rate_rad_s: float) -> int:
    """Return which of SHARP_RAD_S a turn exceeds, the fastest of them; -1 for none."""
    return int(np.searchsorted(SHARP_RAD_S, abs(turn_rate_rad_s))) - 1
