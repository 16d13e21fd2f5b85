"""The velocity that a laser has had for a while: with it, it goes on where its way is not seen."""

from collections import deque
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from processing.prediction import Twist, logarithm
from processing.se2 import Pose

CRUISE_S = (8.0, 6.0, 4.0, 3.0, 2.0, 1.0, 0.5)
"""Times over which a velocity may have been steady, the longest first."""
EVEN_M_S = 0.03
"""What the means of the two halves of such a time may differ by."""
TURNING_RAD_S = 0.1
"""Who turns faster drives at another speed than straight on,"""
TURNING_S = 0.5
"""in the mean over so long."""
SHARP_RAD_S = (0.3, 0.6)
"""Who turns faster than this, and than that, drives at a speed that belongs to it: robots slow down there."""
SHARP_SCANS = 10
"""So many scans of such turns tell the speed that belongs to them,"""
SHARP_MEMORY = 100
"""and so many of the newest count."""
STEADY_M_S = 0.15
"""What the filter's velocity may be off a steady one, if it does not know itself to be worse; farther, and
the laser has changed its speed."""
USUAL_S = 2.0
"""A velocity that was steady for so long is the one that the laser takes up again when it speeds up."""
SURE_M = 0.03
"""Motions whose ends are known better than this all weigh the same."""
LEAST_SCANS = 3
"""Of fewer that see no velocity was steady."""
STANDING_M_S = 0.05
"""Who is slower stands, as far as matches tell. One that has not stood for USUAL_S yet, as after a turn on
the spot, may set out at any moment: that it stands is no velocity to go on with."""


class Cruise:
    """The velocity that the laser has had for a while: where its way is not seen, it goes on with it.

    The filter follows every jerk, and so the noise of every match; a mean over seconds of what was seen is
    known many times as well.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._counts = [max(1, round(window_s / period_s)) for window_s in CRUISE_S]
        self._turning = max(1, round(TURNING_S / period_s))
        self._seen: deque[Twist] = deque(maxlen=self._counts[0])
        self._weights: deque[float] = deque(maxlen=self._counts[0])
        self._held: NDArray[np.float64] | None = None
        self._usual: NDArray[np.float64] | None = None
        self._in_turns = TurnSpeeds()
        self._long = max(2, round(USUAL_S / period_s))
        self.steady_s = 0.0
        """For how long the velocity last returned had been steady; 0 if it was not."""

    def see(self, motion: Pose, duration_s: float, deviation_m: float = 0.0) -> None:
        """Take in a motion (3,) of which every direction was seen.

        Args:
            motion: From scan to scan.
            duration_s: Of it.
            deviation_m: How far each end of it may be off, one sigma; a slow laser's scans count as seeing
                when they know four times less than others, and weigh as much less.
        """
        self._seen.append(logarithm(motion) / duration_s)
        self._weights.append(1.0 / max(deviation_m, SURE_M) ** 2)
        self._held = None
        self._in_turns.see(self._seen[-1])
        newest = np.array(list(islice(reversed(self._seen), self._long)))
        if len(newest) == self._long and _is_straight(newest):
            weights = np.array(list(islice(reversed(self._weights), self._long)))
            if _is_even(newest[:, :2], weights):
                self._usual = _mean(newest[:, :2], weights)

    def velocity(self, twist: Twist, doubt_m_s: float, turn_rate_rad_s: float = 0.0) -> NDArray[np.float64]:
        """Return the velocity (2,), laser frame, to go on with until everything is seen again.

        It is the mean over the longest time since the last turn in which it was about the present one and
        did not change; the present one if there is none. In a sharp turn it is what sharp turns were driven
        at before, as far as there were any, and none of that is steady.

        Args:
            twist: (3,) of the filter: the present one, roughly.
            doubt_m_s: How far the filter's velocity may be off, one sigma: the last scans before nothing is
                seen any more know so little that it can be off by most of itself.
            turn_rate_rad_s: Of the laser now: walls tell it where they do not tell the way along them.
        """
        if self._held is None:
            off_m_s = max(STEADY_M_S, doubt_m_s)
            twists, weights = np.array((*self._seen, twist)), np.array((*self._weights, 1.0 / SURE_M**2))
            first = self._first_straight(twists)
            straight, weights = twists[first:, :2], weights[first:]
            windows = ((straight[-count:], weights[-count:]) for count in self._counts)
            # A scan that hardly sees is as good as a part of one that does.
            means = ((_mean(*window), SURE_M**2 * window[1].sum()) for window in windows if _is_even(*window))
            steady = ((mean, count) for mean, count in means if np.hypot(*(mean - twist[:2])) < off_m_s)
            self._held, count = next(steady, (self._aim(twist), 0.0))
            sets_out = np.hypot(*self._held) < STANDING_M_S and count < self._long
            too_few = count < min(LEAST_SCANS, self._counts[-1])
            self.steady_s = 0.0 if sets_out or too_few else float(count * self._period_s)
        if abs(turn_rate_rad_s) <= SHARP_RAD_S[0]:
            return self._held
        self.steady_s = 0.0
        in_turn = self._in_turns.velocity(turn_rate_rad_s)
        return self._held if in_turn is None else in_turn

    def _aim(self, twist: Twist) -> NDArray[np.float64]:
        """Return the velocity (2,) of a laser that has no steady one: the usual one, if it speeds up to it.

        Who comes out of a turn into a corridor where nothing is seen drives on as before the turn, and not as
        slowly as at its end.

        Args:
            twist: (3,) the present one.
        """
        usual = self._usual
        if usual is None or np.linalg.norm(usual) < EVEN_M_S:
            return twist[:2].copy()
        ahead = usual / np.linalg.norm(usual)
        speeds = np.array(list(islice(reversed(self._seen), 2 * self._turning)))[::-1, :2] @ ahead
        half = len(speeds) // 2
        rises = half > 0 and speeds[half:].mean() > speeds[:half].mean() + EVEN_M_S
        below = EVEN_M_S < float(twist[:2] @ ahead) < float(usual @ ahead)
        return usual.copy() if rises and below else twist[:2].copy()

    def _first_straight(self, twists: NDArray[np.float64]) -> int:
        """Return which twist of (M, 3) is the first since the last turn, or of the shortest time at least."""
        count = min(self._turning, len(twists))
        turn_rates = np.convolve(twists[:, 2], np.full(count, 1.0 / count), mode="same")
        turns = np.flatnonzero(np.abs(turn_rates) > TURNING_RAD_S)
        first = int(turns[-1]) + 1 if len(turns) else 0
        return min(first, max(0, len(twists) - self._counts[-1]))

    def forget(self) -> None:
        """Begin anew: what was is no more."""
        self._seen.clear()
        self._weights.clear()
        self._held = self._usual = None


def _is_straight(twists: NDArray[np.float64]) -> bool:
    """Whether twists (M, 3), M >= 1, do not turn."""
    return abs(float(twists[:, 2].mean())) < TURNING_RAD_S


def _mean(velocities: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted mean (2,) of velocities (M, 2), M >= 1."""
    return np.asarray(weights @ velocities / weights.sum())


def _is_even(velocities: NDArray[np.float64], weights: NDArray[np.float64]) -> bool:
    """Whether velocities (M, 2), M >= 1, weights (M,), are the same in both halves of their time."""
    half = len(velocities) // 2
    if half == 0:
        return True
    change = _mean(velocities[half:], weights[half:]) - _mean(velocities[:half], weights[:half])
    return bool(np.hypot(change[0], change[1]) < EVEN_M_S)


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
