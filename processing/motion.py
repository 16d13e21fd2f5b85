"""What the scan matcher tells the mapper: where the laser went since the last scan, and how well that is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose

UNKNOWN_VARIANCE = 1e6
"""Variance (m^2, rad^2) of a motion of which nothing is known; the sign of a lost track."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One step of the laser odometry, as the `odom` topic carries it, bit for bit."""

    stamp_ns: int
    """Of the scan that was matched."""
    odom_t_laser: Pose
    """(3,) smooth, drifting pose; its yaw lies on the grid of `se2.snap_yaw`."""
    covariance: NDArray[np.float64]
    """(3, 3) of the error of the motion since the previous scan, in the laser's present frame; m, rad."""
    twist: NDArray[np.float64]
    """(3,) velocity in the laser's present frame, m/s and rad/s, for de-skewing."""

    @property
    def lost(self) -> bool:
        """Whether the matcher could not tell where the laser went."""
        return bool(self.covariance[2, 2] >= UNKNOWN_VARIANCE)
