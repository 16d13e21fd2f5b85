"""The velocity that a laser has had for a while: with it, it goes on where its way is not seen."""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from processing.habits import SHARP_RAD_S, STEADY_M_S, SURE_M, TurnSpeeds, UsualVelocity
from processing.prediction import Twist, logarithm
from processing.se2 import Pose

CRUISE_S = (8.0, 6.0, 4.0, 3.0, 2.0, 1.0, 0.5)
"""Times over which a velocity may have been steady, the longest first."""
EVEN_M_S = 0.03
"""What the means of the two parts of such a time may differ by."""
TURNING_RAD_S = 0.1
"""Who turns faster drives at another speed than straight on,"""
TURNING_S = 0.5
"""in the mean over so long."""
USUAL_S = 2.0
"""A velocity that was steady for so long is the one that the laser takes up again when it speeds up."""
ERRATIC_M_S = 0.1
"""What speeds of half a second may be off a straight line, in the mean, when a robot drives."""
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
        self._usual = UsualVelocity()
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
        self._note_usual()

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
            self._held, self.steady_s = self._hold(twist, doubt_m_s)
        if abs(turn_rate_rad_s) <= SHARP_RAD_S[0]:
            return self._held
        self.steady_s = 0.0
        in_turn = self._in_turns.velocity(turn_rate_rad_s)
        return self._held if in_turn is None else in_turn

    def _hold(self, twist: Twist, doubt_m_s: float) -> tuple[NDArray[np.float64], float]:
        """Return the velocity (2,) to go on with straight on, and for how long it had been steady, s."""
        twists, weights = np.array((*self._seen, twist)), np.array((*self._weights, 1.0 / SURE_M**2))
        first = self._first_straight(twists)
        straight, weights = twists[first:, :2], weights[first:]
        for velocity, seeing in self._even_means(straight, weights, self._counts):
            if seeing < min(LEAST_SCANS, self._counts[-1]):
                break
            if np.hypot(*(velocity - twist[:2])) < max(STEADY_M_S, doubt_m_s):
                velocity = self._usual.better(velocity, seeing * self._period_s)
                sets_out = np.hypot(*velocity) < STANDING_M_S and seeing < self._long
                return velocity, 0.0 if sets_out else seeing * self._period_s
        return self._aim(twist, doubt_m_s), 0.0

    def _note_usual(self) -> None:
        if len(self._seen) < self._long:
            return
        twists, weights = np.array(self._seen), np.array(self._weights)
        straight = len(twists) - self._first_straight(twists)
        counts = [count for count in self._counts if count <= straight]
        velocity, seeing = next(self._even_means(twists[:, :2], weights, counts), (np.zeros(2), 0.0))
        if round(seeing) >= self._long:
            self._usual.see(velocity, seeing * self._period_s)

    def _even_means(
        self, velocities: NDArray[np.float64], weights: NDArray[np.float64], counts: Iterable[int]
    ) -> Iterator[tuple[NDArray[np.float64], float]]:
        """Yield the mean of the newest so many velocities (M, 2), weights (M,), wherever they are even.

        Args:
            velocities: (M, 2), M >= 1, the newest last.
            weights: (M,)
            counts: How many of them, one mean each.

        Yields:
            The mean (2,), and how many scans that see are as good.
        """
        for window in (slice(-count, None) for count in counts):
            if self._is_even(velocities[window], weights[window]):
                yield _mean(velocities[window], weights[window]), _seeing(weights[window])

    def _aim(self, twist: Twist, doubt_m_s: float) -> NDArray[np.float64]:
        """Return the velocity (2,) of a laser that has no steady one: the present one, or the usual one.

        Who comes out of a turn into a corridor where nothing is seen drives on as before the turn, and not as
        slowly as at its end. And who does not know better drives as usual: a little slower is noise; all of a
        sudden faster than ever, or to and fro, is drawn along by somebody.

        Args:
            twist: (3,) the present one.
            doubt_m_s: How far that may be off, one sigma.
        """
        usual = self._usual.mean
        usual_m_s = float(np.linalg.norm(usual))
        if usual_m_s < EVEN_M_S:
            return twist[:2].copy()
        ahead = usual / usual_m_s
        present_m_s = float(twist[:2] @ ahead)
        newest = list(islice(reversed(self._seen), max(4, self._turning)))
        speeds = np.array(newest)[::-1, :2] @ ahead
        half = len(speeds) // 2
        rises = half > 0 and speeds[half:].mean() > speeds[:half].mean() + EVEN_M_S
        line = np.polynomial.Polynomial.fit(np.arange(len(speeds)), speeds, 1)
        erratic = float(np.std(speeds - line(np.arange(len(speeds))))) > ERRATIC_M_S
        speeds_up = rises and EVEN_M_S < present_m_s < usual_m_s
        slower = usual_m_s - present_m_s > min(STEADY_M_S, 0.5 * usual_m_s)
        known = np.hypot(*(twist[:2] - usual)) > 2.0 * doubt_m_s
        as_usual = speeds_up or not (known or (slower and not erratic))
        return usual.copy() if as_usual else twist[:2].copy()

    def _first_straight(self, twists: NDArray[np.float64]) -> int:
        """Return which twist of (M, 3) is the first since the last turn, or of the shortest time at least."""
        count = min(self._turning, len(twists))
        turn_rates = np.convolve(twists[:, 2], np.full(count, 1.0 / count), mode="same")
        turns = np.flatnonzero(np.abs(turn_rates) > TURNING_RAD_S)
        first = int(turns[-1]) + 1 if len(turns) else 0
        return min(first, max(0, len(twists) - self._counts[-1]))

    def _is_even(self, velocities: NDArray[np.float64], weights: NDArray[np.float64]) -> bool:
        """Whether velocities (M, 2), M >= 1, weights (M,), are the same in both halves of their time.

        And whether the laser did not speed up in the first quarter, where that is long enough to tell.
        """
        count = len(velocities)
        quarter = count // 4 if count >= self._long else 0
        return all(_change(velocities, weights, first) < EVEN_M_S for first in (count // 2, quarter) if first)

    def forget(self) -> None:
        """Begin anew: what was is no more."""
        self._seen.clear()
        self._weights.clear()
        self._held, self._usual = None, UsualVelocity()


def _mean(velocities: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted mean (2,) of velocities (M, 2), M >= 1."""
    return np.asarray(weights @ velocities / weights.sum())


def _change(velocities: NDArray[np.float64], weights: NDArray[np.float64], first: int) -> float:
    """Return by how much velocities (M, 2), weights (M,), changed after the first so many."""
    change = _mean(velocities[first:], weights[first:]) - _mean(velocities[:first], weights[:first])
    return float(np.hypot(change[0], change[1]))


def _seeing(weights: NDArray[np.float64]) -> float:
    """Return how many scans that see are as good as those of weights (M,): some hardly do."""
    return round(float(SURE_M**2 * weights.sum()), 6)
