"""Which directions a scan does not see: a plain corridor says nothing along itself.

A match has a score with a slope everywhere, also where it means nothing: the laser's own pattern of rays and
the edge of the known map pull it to a standstill. Its information tells where that is so. There the motion
prior is kept and the scan is taken to say nothing (solution remapping: Zhang, Kaess and Singh, ICRA 2016).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose

Matrix = NDArray[np.float64]

BLIND_M = 0.03
"""Standard deviation of one scan from which a direction counts as not seen.

Rooms, halls and corridors with something in sight know every direction of a scan to 0.003 .. 0.015 m, by the
information of the score; a plain corridor leaves the one along it at 0.026 m and more, a corner just behind
or the edge of the map in sight included.
"""
BLIND_SHARE = 1.5
"""What counts as not seen is at least so many times what the motion is uncertain by: from there on a scan
would hardly change what is expected. A slow laser's scan, a quarter as certain as a fast one's, still tells:
held to the same limit, a robot that sets out where little is in sight is taken to stand still."""
UNSEEN_SPEED_M_S = 0.3
"""How far the velocity along an unseen direction may be off, where none was steady: robots of this kind go no
faster, and one that sets out, or comes out of a turn, may go on at any of their speeds."""
SPEED_ERROR_M_S = 0.03
"""How far it may be off where it was steady for STEADY_S. It keeps its error: that adds up along the way, not
by chance."""
STEADY_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a scan sees of its own motion, on the axes of its information."""

    unseen: NDArray[np.float64]
    """(K, 2) unit vectors of the directions that are not seen, K = 0, 1 or 2."""
    information: Matrix
    """(3, 3) without what was claimed along them."""

    def hold(self, found: Pose, expected: Pose) -> Pose:
        """Return the found pose (3,) with the expected one's position along what is not seen."""
        held = found.copy()
        for direction in self.unseen:
            held[:2] -= direction * float(direction @ (held[:2] - expected[:2]))
        return held


def blind_m(motion_m: float) -> float:
    """Return from which standard deviation a scan does not see, where the motion is known to `motion_m`."""
    return max(BLIND_M, BLIND_SHARE * motion_m)


def view(information: Matrix, limit_m: float = BLIND_M) -> View:
    """Tell what is seen from the information (3, 3) of a match: x, y (m), yaw (rad), up to a limit."""
    position = _of_position(information)
    if _least(position) >= 1.0 / limit_m**2:
        # Nearly every scan sees every direction.
        return View(np.zeros((0, 2)), information)
    values, vectors = np.linalg.eigh(0.5 * (position + position.T))
    unseen = vectors.T[values < 1.0 / limit_m**2]
    seen = np.eye(3)
    seen[:2, :2] -= unseen.T @ unseen
    return View(unseen, np.asarray(seen @ information @ seen))


def deviation_m(information: Matrix) -> float:
    """Return the standard deviation of a match's position in the direction that it sees worst."""
    return 1.0 / math.sqrt(max(_least(_of_position(information)), 1e-9))


def _of_position(information: Matrix) -> Matrix:
    """Return what is left (2, 2) of the information (3, 3) of the position when the yaw is not known."""
    shared = information[:2, 2]
    return np.asarray(information[:2, :2] - np.outer(shared, shared) / max(float(information[2, 2]), 1e-9))


def _least(matrix: Matrix) -> float:
    """Return the smaller eigenvalue of a symmetric matrix (2, 2)."""
    xx, xy, yy = float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])
    return 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)


class Blindness:
    """How long a direction has not been seen, and how far the laser may have strayed along it since."""

    def __init__(self) -> None:
        self._blind_s = 0.0
        self._speed_m_s = UNSEEN_SPEED_M_S

    def widened(
        self, covariance: Matrix, unseen: NDArray[np.float64], duration_s: float, steady_s: float
    ) -> Matrix:
        """Return the covariance (3, 3) of the next motion, honestly wide along unseen directions (K, 2).

        Args:
            covariance: What the match claims.
            unseen: Unit vectors, on the axes of the covariance.
            duration_s: Time of the motion.
            steady_s: For how long the velocity had been steady with which the laser is taken to go on; a
                sharp turn ends that, and what was unseen does not become better known.
        """
        if len(unseen) == 0:
            self._blind_s = 0.0
            return covariance
        error_m_s = SPEED_ERROR_M_S * STEADY_S / max(min(steady_s, STEADY_S), 1e-3)
        least_m_s = 0.0 if self._blind_s == 0.0 else self._speed_m_s
        self._speed_m_s = max(least_m_s, min(error_m_s, UNSEEN_SPEED_M_S))
        before_s, self._blind_s = self._blind_s, self._blind_s + duration_s
        variance = self._speed_m_s**2 * (self._blind_s**2 - before_s**2)
        seen = np.eye(3)
        seen[:2, :2] -= unseen.T @ unseen
        wide = seen @ covariance @ seen
        wide[:2, :2] += variance * unseen.T @ unseen
        return np.asarray(wide)
