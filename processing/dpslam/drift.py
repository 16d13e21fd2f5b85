"""How a path drifts: what of the errors of its motions adds up along the way, and what a return takes back.

Each key scan knows how far it may be off from where the path began. One that is found to lie on an earlier
one is known as well as that one, and no better: who comes back to a place of the newest ground still knows no
more of the oldest.
"""

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.proposal import WIDE_M
from processing.growing import Growing
from processing.motion import carried
from processing.ndt import Points
from processing.se2 import Pose, between, invert

Matrix = NDArray[np.float64]

WIDE_RAD = 0.01
"""The deviation of heading that is to it what `WIDE_M` is to the way: more is not seen, less is."""
STEADYING_M = 10.0
"""Points farther away than that do not hold the heading any better: the bearings are not that true."""
MOST_VARIANCE = 4.0
"""Nothing is known worse than this, m^2, rad^2: the next scans will tell, and searches have their bounds."""
LEAST = np.diag((1e-9, 1e-9, 1e-9))
"""Keeps what is known exactly invertible; m^2, rad^2."""


class Drift:
    """Covariances of the errors of all key scans of a path, each in the frame of its laser; m, rad."""

    def __init__(self) -> None:
        self.steps = Growing((3, 3))
        """(K, 3, 3) what the motion to each key scan added,"""
        self.errors = Growing((3, 3))
        """(K, 3, 3) and how far each may be off, seen from the first."""

    @classmethod
    def retold(
        cls, steps: Matrix, motions: Pose, ends: NDArray[np.int64], poses: Pose, informations: Matrix
    ) -> "Drift":
        """Return the drift of a saved path, loops not spread: never less than it was.

        Args:
            steps: (K, 3, 3) what the motion to each key scan added.
            motions: (K, 3) from the key scan before.
            ends: (R, 2) key scans of which the second was found to lie on the first.
            poses: (R, 3) the second seen from the first.
            informations: (R, 3, 3) of that.
        """
        drift = cls()
        order = np.argsort(ends[:, 1], kind="stable")
        firsts = np.searchsorted(ends[order, 1], np.arange(len(steps) + 1))
        for key, (step, motion) in enumerate(zip(steps, motions, strict=True)):
            drift.go_on(step, motion)
            for found in order[firsts[key] : firsts[key + 1]]:
                drift.find(int(ends[found, 0]), poses[found], informations[found])
        return drift

    @property
    def now(self) -> Matrix:
        """How far the newest key scan may be off, (3, 3)."""
        return np.asarray(self.errors.rows[-1], np.float64) if len(self.errors) else np.zeros((3, 3))

    def go_on(self, step: Matrix, motion: Pose) -> None:
        """Add a key scan, after a motion (3,) that may be off by `step` (3, 3)."""
        self.steps.append(step)
        self.errors.append(carried(self.now, motion) + step if len(self.errors) else 0.0)

    def since(self, key: int, key_t_here: Pose) -> Matrix:
        """Return how far the newest key scan may be off, seen from an earlier one (3, 3).

        Args:
            key: The earlier one: what it is off by, the newest is off by as well.
            key_t_here: (3,) the newest seen from there.
        """
        return self._apart(carried(self.errors.rows[key], key_t_here))[1]

    def find(self, key: int, key_t_here: Pose, information: Matrix) -> None:
        """Take in that the newest key scan was found to lie on an earlier one.

        Args:
            key: The earlier one.
            key_t_here: (3,) the newest seen from there, as it was found.
            information: (3, 3) of that, in the newest laser's frame.
        """
        shared, own = self._apart(carried(self.errors.rows[key], key_t_here))
        found = np.asarray(np.linalg.inv(information + LEAST), np.float64)
        self.errors.rows[-1] = shared + _both(own, found)

    def close(self, key: int, path: Pose, information: Matrix) -> None:
        """Spread what `find` was told over the loop, from the earlier key scan on: both its ends are known.

        Args:
            key: The earlier one.
            path: (K, 3) all key scans.
            information: (3, 3) as `find` was given it.
        """
        # All errors on the axes of the earlier key scan, where motions add and carry nothing.
        loop, ways = np.arange(key + 1, len(path)), between(path[key], path[key + 1 :])
        steps = np.array(
            [carried(self.steps.rows[k], invert(way)) for k, way in zip(loop, ways, strict=True)]
        )
        forward = np.cumsum(steps, axis=0)
        found = carried(np.asarray(np.linalg.inv(information + LEAST), np.float64), invert(ways[-1]))
        backward = found + np.cumsum(steps[::-1], axis=0)[::-1] - steps
        base = self.errors.rows[key]
        for k, way, there, back in zip(loop[:-1], ways, forward, backward, strict=False):
            known = carried(base + _both(there, back), way)
            if np.linalg.det(known) < np.linalg.det(self.errors.rows[k]):
                self.errors.rows[k] = known

    def _apart(self, old: Matrix) -> tuple[Matrix, Matrix]:
        """Split what the newest key scan may be off by: what an old error (3, 3) explains, and its own."""
        values, vectors = np.linalg.eigh(self.now)
        lengths = np.sqrt(np.maximum(values, np.diag(LEAST)))
        shares, axes = np.linalg.eigh((vectors / lengths).T @ old @ (vectors / lengths))
        axes = (vectors * lengths) @ axes
        shares = np.clip(shares, 0.0, 1.0)
        return np.asarray((axes * shares) @ axes.T), np.asarray((axes * (1.0 - shares)) @ axes.T)


def _both(one: Matrix, other: Matrix) -> Matrix:
    """Return the covariance (3, 3) of what two independent sources tell."""
    return np.asarray(np.linalg.inv(np.linalg.inv(one + LEAST) + np.linalg.inv(other + LEAST)))


def drift_of(covariance: Matrix, motion: Pose, points: Points, config: LoopConfig) -> Matrix:
    """Return the covariance (3, 3) by which a path drifts in one motion, from what the motion claims.

    Two motions in a row share the pose between them: what they claim where the laser saw is the noise of its
    matches on one local map, which does not add up along the way. What was not seen does. And the heading is
    held by the points: the better, the farther away they are.

    Args:
        covariance: (3, 3) that is claimed of the motion, in the new laser frame; m, rad.
        motion: (3,) from the key scan before.
        points: (N, 2) m, of the new key scan, laser frame.
        config: Has the least drift of any scan matcher.
    """
    step_m = float(np.hypot(motion[0], motion[1]))
    reach_m = float(np.sqrt(np.square(points).sum() / len(points))) if len(points) else 0.0
    aside_m = config.drift * step_m + 0.003
    turn_rad = config.drift_rad_per_m * step_m + 0.001
    if reach_m > 0.0:
        turn_rad = min(turn_rad, aside_m / min(reach_m, STEADYING_M))
    turn_rad += config.drift_rad_per_m * abs(float(motion[2]))
    along, axes = np.linalg.eigh(covariance[:2, :2])
    drift: Matrix = np.diag((aside_m**2, aside_m**2, turn_rad**2))
    drift[:2, :2] += (axes * _unseen(along, WIDE_M)) @ axes.T
    drift[2:, 2] += _unseen(covariance[2:, 2], WIDE_RAD)
    return drift


def _unseen(variance: NDArray[np.float64], wide: float) -> NDArray[np.float64]:
    """Return what of variances is not seen: nearly all of the wider ones, nearly nothing of narrow ones."""
    variance = np.clip(variance, 0.0, MOST_VARIANCE)
    return np.asarray(np.square(variance) / (variance + wide**2))
