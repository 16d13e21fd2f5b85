"""What the matcher tells the mapper: where the laser went since the last scan, and how well that is known.

Three kinds of motion, told apart by their covariance. A known one vouches for the whole way since the last
one that was not lost. A lost one says nothing, and its scan belongs nowhere; it may be merely doubted: the
track goes on, and only this scan contradicts what is known. One that begins anew says
nothing of the way to it, and is where the known ones after it begin: the first of a run, and the first after
a loss, unless the laser was only covered for a moment. Its pose is a guess: the mapper asks the whole map.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose, between

UNKNOWN_VARIANCE = 1e6
"""Variance (m^2, rad^2) of a motion of which nothing is known; the sign of a lost track."""
DOUBTED_VARIANCE = 2e6
"""The sign of a scan that is doubted."""
ANEW_VARIANCE = 4e6
"""The sign of a track that begins anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One step of the laser odometry, as the `odom` topic carries it, bit for bit."""

    stamp_ns: int
    """Of the scan that was matched."""
    odom_t_laser: Pose
    """(3,) smooth, drifting pose; its yaw lies on the grid of `se2.snap_yaw`."""
    covariance: NDArray[np.float64]
    """(3, 3) of the error of the way since the last scan not lost, in the laser's present frame; m, rad."""
    twist: NDArray[np.float64]
    """(3,) velocity in the laser's present frame, m/s and rad/s, for de-skewing."""

    @property
    def lost(self) -> bool:
        """Whether the matcher cannot tell where the laser is."""
        return bool(UNKNOWN_VARIANCE <= self.covariance[2, 2] < ANEW_VARIANCE)

    @property
    def doubted(self) -> bool:
        """Whether it counts as lost only because its scan contradicts the map: its pose is likely right."""
        return bool(DOUBTED_VARIANCE <= self.covariance[2, 2] < ANEW_VARIANCE)

    @property
    def anew(self) -> bool:
        """Whether the track begins here, the way to it unknown."""
        return bool(self.covariance[2, 2] >= ANEW_VARIANCE)


def lost_covariance() -> NDArray[np.float64]:
    """Return the covariance (3, 3) of a lost motion."""
    return np.diag((UNKNOWN_VARIANCE,) * 3)


def doubted_covariance() -> NDArray[np.float64]:
    """Return the covariance (3, 3) of a motion whose scan is doubted."""
    return np.diag((DOUBTED_VARIANCE,) * 3)


def anew_covariance() -> NDArray[np.float64]:
    """Return the covariance (3, 3) of a motion that begins anew."""
    return np.diag((ANEW_VARIANCE,) * 3)


def following(first: Motion, second: Motion) -> Motion:
    """Return the second motion, not a lost one, as it is seen when the scan of the first is left out."""
    if first.lost or second.anew:
        return second
    old_t_new = between(first.odom_t_laser, second.odom_t_laser)
    if first.anew:
        return replace(second, covariance=anew_covariance())
    return Motion(
        stamp_ns=second.stamp_ns,
        odom_t_laser=second.odom_t_laser,
        covariance=carried(first.covariance, old_t_new) + second.covariance,
        twist=second.twist,
    )


def carried(covariance: NDArray[np.float64], old_t_new: Pose) -> NDArray[np.float64]:
    """Express the covariance (3, 3) of a pose, given in its own frame, after a further motion.

    Args:
        covariance: Of the error of the old pose, in the old frame.
        old_t_new: The motion, taken as exact.

    Returns:
        (3, 3) of the error that it causes in the new pose, in the new frame.
    """
    x, y, yaw = old_t_new
    c, s = np.cos(yaw), np.sin(yaw)
    # A turn of the old frame swings the new one sideways.
    jacobian = np.array(((c, s, s * x - c * y), (-s, c, c * x + s * y), (0.0, 0.0, 1.0)))
    return np.asarray(jacobian @ covariance @ jacobian.T)
