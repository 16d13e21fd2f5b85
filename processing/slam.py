"""The whole pipeline: where the laser went since the last scan, and which maps that speaks for."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam, MapStep
from processing.dpslam.resume import Returning
from processing.occupancy import OccupancyGrid
from processing.odometry import LaserOdometry, Match, OdometryConfig
from processing.scan import Scan
from processing.se2 import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamConfig:
    """The matcher and the mapper."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    mapping: DpSlamConfig = field(default_factory=DpSlamConfig)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What one scan told."""

    match: Match
    mapping: MapStep


class Slam:
    """Scans in, maps out; the same scans, configuration and seed give the same bits.

    Args:
        config: Of both.
        seed: Of both.
        mapping: Another mapper than a fresh one, such as one that goes on from a saved map.
    """

    def __init__(
        self, config: SlamConfig | None = None, seed: int = 0, mapping: DpSlam | Returning | None = None
    ) -> None:
        self.config = config or SlamConfig()
        self.odometry = LaserOdometry(self.config.odometry, seed)
        self.mapping = mapping or DpSlam(self.config.mapping, seed)

    def step(self, scan: Scan, missed: int = 0) -> Step:
        """Take the next scan; raises ValueError if it has other beams than the first.

        Args:
            scan: What the laser sees now.
            missed: How many scans before this one never came.
        """
        match = self.odometry.step(scan, missed)
        return Step(match, self.mapping.step(scan, match.motion))

    def finish(self) -> None:
        """Say that no scan follows: the path settles under everything that was seen. See `DpSlam.finish`."""
        self.mapping.finish()

    def trajectory(self) -> tuple[NDArray[np.int64], Pose]:
        """Return stamps (N,) and map_t_laser (N, 3) of every scan so far."""
        return self.mapping.trajectory()

    def occupancy(self) -> OccupancyGrid:
        """Return the most probable map."""
        return self.mapping.occupancy()
