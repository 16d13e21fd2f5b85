"""The particles: their maps, paths, poses and weights, and what a key scan does to them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam import kernels
from processing.dpslam.ancestry import Ancestry
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.grid import TileStore
from processing.dpslam.laser_model import judge_rays, place_rays
from processing.dpslam.memory import KeyScans
from processing.dpslam.proposal import Matrix, held, noise_root, priors
from processing.dpslam.resampling import effective_size, normalise, sparing, systematic_parents
from processing.dpslam.sweep import Sweep
from processing.scan import Beams
from processing.se2 import Pose

GAIN = 0.3
"""Weight of one point's NDT score against the prior: neighbouring points share their errors."""
CHEAP_EVERY = 3
"""The first scoring takes every third ray."""
NEGLIGIBLE = 13.0
"""Particles whose log weight is so far under the best after the cheap scoring are not scored in full."""

FAITH = 8.0
"""The best particle stays it until another one's log weight is so much higher. It goes where the motion says;
another one has strayed from there by chance, and on new ground nothing but chance tells them apart."""

MIX_EVERY, MIX = 4, 1.5
"""On new ground all are as probable, and there is a selection by chance after so many key scans, so that they
go on sharing what lies behind; and how unequal the chances are (deviation of their logarithms)."""

ARRIVAL = np.array((0.02, 0.02, 0.01))
"""How well a place found on the map is known, one sigma; m, m, rad."""
NEUTRAL, NEUTRAL_RAYS = -0.7, 10.0
"""Log-likelihood of a ray that ends on known ground, until so many rays have told."""
KNOWN = 0.3
MISFIT = -2.7
"""A scan of which the share KNOWN of the rays ends where the map knows something contradicts it if those rays
have less log-likelihood in the mean: they cross walls and end in the free."""


class Population:
    """P particles; random numbers depend on the seed and the number of the key scan alone."""

    def __init__(self, config: DpSlamConfig, seed: int) -> None:
        self.config = config
        self.seed = seed
        self.ancestry = Ancestry(config.particles)
        self.store = TileStore(config.particles)
        self.poses: Pose = np.zeros((config.particles, 3))
        self.log_weights = np.full(config.particles, -np.log(config.particles))
        self.best = 0
        self.keys = 0
        self.misfits = 0
        """Key scans in a row that contradicted the best particle's map."""

    @property
    def path(self) -> Pose:
        """(K, 3) the best particle's poses at the key scans."""
        return self.ancestry.path(self.best)

    def update(
        self, sweep: Sweep, key_t_laser: Pose, covariance: Matrix, old_ground: bool
    ) -> tuple[float, bool]:
        """Move, refine, weigh and select the particles; nothing is written yet.

        Args:
            sweep: The new key scan.
            key_t_laser: (3,) motion since the last key scan.
            covariance: (3, 3) of that motion, in the new laser frame.
            old_ground: Whether the maps know more of this place than the last scans. If not, they are the
                motions over again, and by them no particle is more probable than another.

        Returns:
            How many particles shared the weight, and whether there was a selection then.
        """
        random = np.random.Generator(np.random.Philox(key=self.seed, counter=(0, 0, 0, self.keys)))
        normal, uniform = random.standard_normal(self.poses.shape), float(random.random())
        # One goes where the motion says: where the map does not see, nothing is more likely.
        normal[self.best] = 0.0
        root = noise_root(covariance)
        predicted = np.ascontiguousarray(se2.compose(se2.compose(self.poses, key_t_laser), normal @ root.T))
        blind = self._refine(sweep, predicted, root)
        rays = sweep.rays[:: max(1, len(sweep.rays) // self.config.rays)].copy()
        if old_ground and not blind:
            # Where a direction is not seen the rays tell nothing of it, and all else was refined: what they
            # would weigh is how often the laser has looked at a wall, and those that lag behind would win.
            self._weigh(rays)
        heaviest = int(np.argmax(self.log_weights))
        if self.log_weights[heaviest] > self.log_weights[self.best] + FAITH:
            self.best = heaviest
        self._judge(rays)
        self.ancestry.extend(self.poses)
        chances, sharing = self.log_weights, effective_size(self.log_weights)
        if not old_ground:
            if self.keys % MIX_EVERY:
                return sharing, False
            chances = chances + MIX * random.standard_normal(len(chances))
        elif sharing >= self.config.particles / 2:
            return sharing, False
        self._select(systematic_parents(chances, uniform))
        return sharing, True

    def arrive(self, map_t_laser: Pose) -> None:
        """Put every particle at a place that was found, each on its own map, and take up its path there."""
        random = np.random.Generator(np.random.Philox(key=self.seed, counter=(0, 0, 1, self.keys)))
        spread = random.standard_normal(self.poses.shape) * ARRIVAL
        spread[self.best] = 0.0
        self.poses = np.ascontiguousarray(se2.compose(map_t_laser, spread))
        self.log_weights = np.full(len(self.poses), -np.log(len(self.poses)))
        self.misfits = 0
        self.ancestry.extend(self.poses)

    def write(self, rays: NDArray[np.float64]) -> None:
        """Write a key scan's rays (N, 4) into the map of each particle."""
        if self.keys == 0:
            self.ancestry.extend(self.poses)
        self.keys += 1
        if len(rays) == 0:
            return
        reach = float(np.hypot(rays[:, 2], rays[:, 3]).max())
        self.store.cover(self.poses[:, :2].min(axis=0) - reach, self.poses[:, :2].max(axis=0) + reach)
        done = 0
        while True:
            done = kernels.write_all(*self.store.maps, rays, self.poses, self.config.memory, done)
            if done == len(self.poses):
                self.store.note_use()
                return
            placed = np.empty_like(rays)
            place_rays(self.poses[done], rays, placed)
            self.store.reserve(kernels.tiles_under(placed))

    def relive(self, path: Pose, scans: KeyScans, beams: Beams) -> None:
        """Give the whole population one path, and maps drawn anew along it.

        The move step of a resample-move particle filter. Each particle keeps its offset from the best one as
        its place around the end of the path, and its weight.

        Args:
            path: (K, 3) poses of all key scans so far, all of them written.
            scans: What was seen from them.
            beams: The scanner.

        Raises:
            ValueError: path and key scans are not as many as were written.
        """
        if not len(path) == len(scans) == self.keys:
            raise ValueError(f"path of {len(path)} poses and {len(scans)} scans, must be {self.keys} both")
        offsets = se2.between(self.poses[self.best], self.poses)
        self.poses = np.ascontiguousarray(se2.compose(path[-1], offsets))
        self.ancestry.restart(np.ascontiguousarray(path[:-1]))
        self.ancestry.extend(self.poses)
        self.store.clear()
        first = 0
        for rays, ends in scans.rays(beams):
            part = np.ascontiguousarray(path[first : first + len(ends) - 1])
            first += len(part)
            low, high, tiles = kernels.bounds(rays, ends, part)
            self.store.cover(low, high)
            done = 0
            while done < len(part):
                self.store.reserve(tiles)
                done = kernels.write_path(*self.store.maps, rays, ends, part, self.config.memory, done)
        self.store.share(0)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `restore` takes it back."""
        parts = {f"store.{k}": v for k, v in self.store.state().items()}
        parts |= {f"ancestry.{k}": v for k, v in self.ancestry.state().items()}
        counts = np.array((self.seed, self.best, self.keys, self.misfits))
        return parts | {"poses": self.poses.copy(), "log_weights": self.log_weights.copy(), "counts": counts}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the population whose `state` was taken."""
        self.store.restore({k[6:]: v for k, v in state.items() if k.startswith("store.")})
        self.ancestry.restore({k[9:]: v for k, v in state.items() if k.startswith("ancestry.")})
        self.poses, self.log_weights = state["poses"].copy(), state["log_weights"].copy()
        self.seed, self.best, self.keys, self.misfits = (int(v) for v in state["counts"])

    def _refine(self, sweep: Sweep, predicted: Pose, root: Matrix) -> bool:
        """Lay each particle on its own map; return whether most of their weight does not see a direction."""
        c = self.config
        ties = priors(root, c.prior_m, c.prior_rad, predicted[:, 2])
        information, results = np.empty((c.particles, 3, 3)), np.empty((c.particles, 2))
        poses = np.empty_like(predicted)
        kernels.refine_all(*self.store.maps, sweep.points, predicted, ties, GAIN, poses, information, results)
        self.poses, blind = held(poses, predicted, information / GAIN)
        return bool(blind @ np.exp(self.log_weights) > 0.5)

    def _judge(self, rays: NDArray[np.float64]) -> None:
        """Count the key scans in a row that contradict the best particle's map."""
        known, fit = self._known(rays)
        self.misfits = self.misfits + 1 if known >= KNOWN and fit < MISFIT else 0

    def _weigh(self, rays: NDArray[np.float64]) -> None:
        c = self.config
        chosen = np.ones(c.particles, dtype=np.uint8)
        cheap, full = np.zeros(c.particles), np.zeros(c.particles)
        unseen = self._usual(rays)
        kernels.weigh_all(*self.store.maps, rays, self.poses, CHEAP_EVERY, False, unseen, chosen, cheap)
        estimate = self.log_weights + c.tempering * CHEAP_EVERY * cheap
        chosen = (estimate >= estimate.max() - NEGLIGIBLE).astype(np.uint8)
        kernels.weigh_all(*self.store.maps, rays, self.poses, 1, True, unseen, chosen, full)
        survivors = self.log_weights + c.tempering * full
        self.log_weights = normalise(np.where(chosen, survivors, -1e300))

    def _usual(self, rays: NDArray[np.float64]) -> float:
        """Return the usual likelihood of a ray that ends on known ground, by the best particle's map.

        A ray into the unseen counts as much: else particles that lag behind outweigh those that go on.
        """
        known, fit = self._known(rays)
        count = known * len(rays)
        return float(np.exp((count * fit + NEUTRAL_RAYS * NEUTRAL) / (count + NEUTRAL_RAYS)))

    def _known(self, rays: NDArray[np.float64]) -> tuple[float, float]:
        """Return the share of the rays that end on ground the best particle knows, and how well they fit."""
        placed = np.empty_like(rays)
        place_rays(self.poses[self.best], rays, placed)
        maps = self.store.maps
        known, fit = judge_rays(*maps[:2], self.best, *maps[2:], placed)
        return float(known), float(fit)

    def _select(self, parents: NDArray[np.int32]) -> None:
        parents, self.log_weights = sparing(parents, self.log_weights, self.best)
        self.ancestry.resample(parents)
        self.store.resample(parents)
        self.poses = self.poses[parents]
