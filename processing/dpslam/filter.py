"""DP-SLAM: a particle filter over whole maps, moved by the scan matcher, each particle refined on its own map.

Every scan gives a pose; key scans, a quarter of a metre apart, are worked into the maps: predict with the motion and
its covariance, refine each particle on its own map, weigh by the laser model, select when few share the weight, write.
When the laser is found to have come back, the whole population relives its path along a smoothed one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.grid import CELL_M, METRES, STOPS
from processing.dpslam.loops import Loops
from processing.dpslam.memory import KeyScans
from processing.dpslam.population import Population
from processing.dpslam.proposal import carry
from processing.dpslam.resampling import effective_size
from processing.dpslam.sweep import Sweeper
from processing.dpslam.trail import Trail
from processing.motion import Motion
from processing.occupancy import OccupancyGrid, occupancy_of
from processing.scan import Scan
from processing.se2 import Pose


@dataclass(frozen=True, slots=True, eq=False)
class MapStep:
    """What the mapper knows after a scan."""

    map_t_laser: Pose
    """(3,) of the most probable particle."""
    updated: bool
    """Whether the scan was worked into the maps."""
    particles: Pose
    """(P, 3) at the newest key scan."""
    weights: NDArray[np.float64]
    """(P,) sum 1."""
    n_eff: float
    """How many particles share the weight."""
    resampled: bool
    closed: bool
    """Whether a loop was closed: the whole path has moved."""


class DpSlam:
    """The posterior over maps and paths; the same scans, motions and seed give the same bits."""

    def __init__(self, config: DpSlamConfig | None = None, seed: int = 0) -> None:
        self.config = config or DpSlamConfig()
        self.population = Population(self.config, seed)
        self.loops = Loops(self.config.loops) if self.config.close_loops else None
        self._scans = KeyScans()
        self._trail = Trail()
        self._sweeper: Sweeper | None = None
        self._key_odom: Pose = np.zeros(3)
        self._odom: Pose = np.zeros(3)
        self._covariance = np.zeros((3, 3))

    def step(self, scan: Scan, motion: Motion) -> MapStep:
        """Take one scan and the motion that leads to it.

        Raises:
            ValueError: the motion belongs to another scan, or the scan has other beams than the first.
        """
        if scan.stamp_ns != motion.stamp_ns:
            raise ValueError(f"motion of scan {motion.stamp_ns}, must be of scan {scan.stamp_ns}")
        if self._sweeper is None:
            self._sweeper = Sweeper(scan.beams, self.config.points, self.config.range_max_m)
        odom = np.array(motion.odom_t_laser, dtype=np.float64)
        first = self._trail.scans == 0
        if first:
            self._odom = self._key_odom = odom
        else:
            self._covariance = carry(self._covariance, se2.between(self._odom, odom)) + motion.covariance
        key_t_laser = se2.between(self._key_odom, odom)
        sweep = self._sweeper.take(scan, motion) if first or self._is_key(key_t_laser) else None
        self._odom = odom
        self._trail.add(scan.stamp_ns, odom)
        if sweep is None:
            return self._answer(key_t_laser)
        people = self.population
        resampled = False if first else people.update(sweep, key_t_laser, self._covariance)
        people.write(sweep.rays)
        self._scans.add(sweep.rays)
        self._trail.mark_key()
        moved = None
        if self.loops is not None:
            moved = self.loops.step(key_t_laser, self._covariance, sweep.points, people.path)
            if moved is not None:
                self.relive(moved)
        self._key_odom, self._covariance = odom, np.zeros((3, 3))
        return self._answer(np.zeros(3), updated=True, resampled=resampled, closed=moved is not None)

    def relive(self, path: Pose) -> None:
        """Move the whole population onto one path (K, 3), a pose for each key scan so far; maps are drawn anew."""
        self.population.relive(path, self._scans)

    def finish(self) -> None:
        """Lay the whole path as all its relations want it: for the end of a run, before its results are read."""
        if self.loops is not None and self.loops.places:
            self.relive(self.loops.smoothed())

    def trajectory(self) -> tuple[NDArray[np.int64], Pose]:
        """Return stamps (N,) and map_t_laser (N, 3) of every scan so far, by the best particle's ancestry."""
        return self._trail.stamps_ns, self._trail.lay(self.population.path)

    def occupancy(self) -> OccupancyGrid:
        """Return the best particle's map."""
        cells, corner = self.population.store.dense(self.population.best)
        stops, metres = cells[..., 0] / STOPS, cells[..., 1] / METRES
        return occupancy_of(stops, metres, CELL_M, (corner[1] * CELL_M, corner[0] * CELL_M))

    def _is_key(self, key_t_laser: Pose) -> bool:
        c = self.config
        way = np.hypot(key_t_laser[0], key_t_laser[1])
        return bool(way >= c.key_distance_m or abs(key_t_laser[2]) >= c.key_rotation_rad)

    def _answer(
        self, key_t_laser: Pose, updated: bool = False, resampled: bool = False, closed: bool = False
    ) -> MapStep:
        people = self.population
        return MapStep(
            map_t_laser=se2.compose(people.poses[people.best], key_t_laser),
            updated=updated,
            particles=people.poses.copy(),
            weights=np.exp(people.log_weights),
            n_eff=effective_size(people.log_weights),
            resampled=resampled,
            closed=closed,
        )
