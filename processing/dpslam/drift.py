"""How a path drifts: what of the errors of its motions adds up along the way."""

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.proposal import WIDE_M
from processing.ndt import Points
from processing.se2 import Pose

Matrix = NDArray[np.float64]

WIDE_RAD = 0.01
"""The deviation of heading that is to it what `WIDE_M` is to the way: more is not seen, less is."""
STEADYING_M = 10.0
"""Points farther away than that do not hold the heading any better: the bearings are not that true."""
MOST_VARIANCE = 4.0
"""Nothing is known worse than this, m^2, rad^2: the next scans will tell, and searches have their bounds."""


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
    claimed = np.minimum(covariance, MOST_VARIANCE)
    along, axes = np.linalg.eigh(claimed[:2, :2])
    drift: Matrix = np.diag((aside_m**2, aside_m**2, turn_rad**2))
    drift[:2, :2] += (axes * _unseen(along, WIDE_M)) @ axes.T
    drift[2:, 2] += _unseen(claimed[2:, 2], WIDE_RAD)
    return drift


def _unseen(variance: NDArray[np.float64], wide: float) -> NDArray[np.float64]:
    """Return what of variances is not seen: nearly all of the wider ones, nearly nothing of narrow ones."""
    return np.asarray(np.square(variance) / (variance + wide**2))
