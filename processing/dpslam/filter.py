"""DP-SLAM: a particle filter over whole maps, moved by the scan matcher, each particle refined on its own map.

One key scan: predict with the motion and its covariance; refine each particle on its own map with the motion as
prior; weigh by the laser model; select when few particles share the weight; write the scan into every map.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam import kernels
from processing.dpslam.ancestry import Ancestry
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.grid import CELL_M, TileStore
from processing.dpslam.resampling import effective_size, normalise, systematic_parents
from processing.dpslam.sweep import Sweep, Sweeper
from processing.dpslam.trail import Trail
from processing.motion import Motion
from processing.occupancy import OccupancyGrid, occupancy_of
from processing.scan import Scan
from processing.se2 import Pose

NEGLIGIBLE = 13.0
"""Particles whose log weight is so far under the best after the cheap scoring are not scored in full."""
NOISE_M = 0.005
NOISE_RAD = 0.002
"""Least noise of a predicted motion: no matcher is better than its points."""
MOST_NOISE = np.array((0.5, 0.5, 0.3))
"""Noise beyond which a motion is as good as unknown; m, m, rad."""


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


class DpSlam:
    """The posterior over maps and paths; the same scans, motions and seed give the same bits."""

    def __init__(self, config: DpSlamConfig | None = None, seed: int = 0) -> None:
        self.config = config or DpSlamConfig()
        self.seed = seed
        particles = self.config.particles
        self._ancestry = Ancestry(particles)
        self._store = TileStore(particles)
        self._trail = Trail()
        self._sweeper: Sweeper | None = None
        self._poses = np.zeros((particles, 3))
        self._log_weights = np.full(particles, -np.log(particles))
        self._best = 0
        self._key_odom: Pose = np.zeros(3)
        self._covariance = np.zeros((3, 3))
        self._last_odom: Pose = np.zeros(3)

    def step(self, scan: Scan, motion: Motion) -> MapStep:
        """Take one scan and the motion that leads to it.

        Raises:
            ValueError: the motion belongs to another scan.
        """
        if scan.stamp_ns != motion.stamp_ns:
            raise ValueError(f"motion of scan {motion.stamp_ns}, must be of scan {scan.stamp_ns}")
        odom = np.asarray(motion.odom_t_laser, dtype=np.float64)
        first = self._trail.scans == 0
        self._trail.add(scan.stamp_ns, odom)
        if not first:
            self._covariance = (
                _carry(self._covariance, se2.between(self._last_odom, odom)) + motion.covariance
            )
        self._last_odom = odom
        key_t_laser = se2.between(self._key_odom, odom)
        if not first and not self._moved(key_t_laser):
            return self._answer(key_t_laser, updated=False, resampled=False)
        if self._sweeper is None:
            self._sweeper = Sweeper(scan.beams, self.config.points, self.config.range_max_m)
        sweep = self._sweeper.take(scan, motion)
        resampled = False
        if not first:
            resampled = self._update(sweep, key_t_laser)
        self._trail.mark_key()
        self._ancestry_write(sweep)
        self._key_odom = odom
        self._covariance = np.zeros((3, 3))
        return self._answer(np.zeros(3), updated=True, resampled=resampled)

    def trajectory(self) -> tuple[NDArray[np.int64], Pose]:
        """Return stamps (N,) and map_t_laser (N, 3) of every scan so far, by the best particle's ancestry."""
        return self._trail.stamps_ns, self._trail.lay(self._ancestry.path(self._best))

    def occupancy(self) -> OccupancyGrid:
        """Return the best particle's map."""
        cells, corner = self._store.dense(self._best)
        return occupancy_of(cells, CELL_M, (corner[1] * CELL_M, corner[0] * CELL_M))

    def _moved(self, key_t_laser: Pose) -> bool:
        c = self.config
        return bool(
            np.hypot(key_t_laser[0], key_t_laser[1]) >= c.key_distance_m
            or abs(key_t_laser[2]) >= c.key_rotation_rad
        )

    def _update(self, sweep: Sweep, key_t_laser: Pose) -> bool:
        """Move, refine, weigh and select the particles; return whether there was a selection."""
        c = self.config
        particles = c.particles
        random = np.random.Generator(np.random.Philox(key=self.seed, counter=(0, 0, 0, self._trail.keys)))
        normal, uniform = random.standard_normal((particles, 3)), float(random.random())
        root = _root(self._covariance)
        moved = se2.compose(self._poses, key_t_laser)
        predicted = np.ascontiguousarray(se2.compose(moved, normal @ root.T))
        poses, information, results = self._refine(sweep, predicted, root @ root.T)
        self._poses = poses
        self._weigh(sweep)
        self._best = int(np.argmax(self._log_weights))
        self._ancestry.extend(self._poses)
        if effective_size(self._log_weights) >= particles / 2:
            return False
        parents = systematic_parents(self._log_weights, uniform)
        self._select(parents)
        return True

    def _refine(
        self, sweep: Sweep, predicted: Pose, covariance: NDArray[np.float64]
    ) -> tuple[Pose, NDArray[np.float64], NDArray[np.float64]]:
        c, e = self.config, self._store.extent
        particles = c.particles
        trust = np.diag((c.prior_m**2, c.prior_m**2, c.prior_rad**2)) + covariance
        priors = _turned(np.linalg.inv(trust), predicted[:, 2])
        poses, information, results = (
            np.empty((particles, 3)),
            np.empty((particles, 3, 3)),
            np.empty((particles, 2)),
        )
        kernels.refine_all(
            self._store.arrays,
            self._store.table,
            e.first_row,
            e.first_col,
            sweep.points,
            predicted,
            priors,
            GAIN,
            poses,
            information,
            results,
        )
        return poses, information, results

    def _weigh(self, sweep: Sweep) -> None:
        c, e = self.config, self._store.extent
        rays = sweep.rays[:: max(1, len(sweep.rays) // c.rays)].copy()
        where = (self._store.arrays, self._store.table, e.first_row, e.first_col)
        chosen = np.ones(c.particles, dtype=np.uint8)
        cheap, full = np.zeros(c.particles), np.zeros(c.particles)
        kernels.weigh_all(*where, rays, self._poses, 3, False, chosen, cheap)
        estimate = self._log_weights + c.tempering * 3.0 * cheap
        chosen = (estimate >= estimate.max() - NEGLIGIBLE).astype(np.uint8)
        kernels.weigh_all(*where, rays, self._poses, 1, True, chosen, full)
        survivors = self._log_weights + c.tempering * full
        self._log_weights = normalise(np.where(chosen, survivors, -1e300))

    def _select(self, parents: NDArray[np.int32]) -> None:
        self._best = int(np.flatnonzero(parents == self._best)[0])
        self._ancestry.resample(parents)
        self._store.resample(parents)
        self._poses = self._poses[parents]
        self._log_weights = np.full(len(parents), -np.log(len(parents)))

    def _ancestry_write(self, sweep: Sweep) -> None:
        if self._trail.keys == 1:
            self._ancestry.extend(self._poses)
        if len(sweep.rays) == 0:
            return
        reach = float(np.hypot(sweep.rays[:, 2], sweep.rays[:, 3]).max())
        self._store.cover(self._poses[:, :2].min(axis=0) - reach, self._poses[:, :2].max(axis=0) + reach)
        e = self._store.extent
        done = 0
        while done < self.config.particles:
            done = kernels.write_all(
                self._store.arrays,
                self._store.table,
                e.first_row,
                e.first_col,
                sweep.rays,
                self._poses,
                self.config.memory,
                done,
            )
            if done < self.config.particles:
                placed = np.empty_like(sweep.rays)
                kernels.place_rays(self._poses[done], sweep.rays, placed)
                self._store.reserve(kernels.tiles_under(placed))

    def _answer(self, key_t_laser: Pose, updated: bool, resampled: bool) -> MapStep:
        weights = np.exp(self._log_weights)
        return MapStep(
            map_t_laser=se2.compose(self._poses[self._best], key_t_laser),
            updated=updated,
            particles=self._poses.copy(),
            weights=weights,
            n_eff=effective_size(self._log_weights),
            resampled=resampled,
        )


GAIN = 0.3
"""Weight of one point's NDT score against the prior: neighbouring points share their errors."""


def _carry(covariance: NDArray[np.float64], old_t_new: Pose) -> NDArray[np.float64]:
    """Express the covariance of a pose, given in its old frame, in its new frame after a further motion."""
    c, s = np.cos(old_t_new[2]), np.sin(old_t_new[2])
    x, y = old_t_new[0], old_t_new[1]
    # A turn in the old frame swings the new one sideways.
    jacobian = np.array(((c, s, s * x - c * y), (-s, c, c * x + s * y), (0.0, 0.0, 1.0)))
    jacobian[0, 2], jacobian[1, 2] = -c * y + s * x, s * y + c * x
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a root R with R R^T = covariance + the least noise, its spread held under the most."""
    values, vectors = np.linalg.eigh(covariance + np.diag((NOISE_M**2, NOISE_M**2, NOISE_RAD**2)))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    spread = np.sqrt((root**2).sum(axis=1))
    return np.asarray(root * np.minimum(1.0, MOST_NOISE / spread)[:, None])


def _turned(information: NDArray[np.float64], yaw_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn an information matrix (3, 3) of the laser's frame into the map's axes, for each yaw; (P, 3, 3)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.zeros((len(yaw_rad), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    return np.ascontiguousarray(turn @ information @ turn.transpose(0, 2, 1))
