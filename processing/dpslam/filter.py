"""DP-SLAM: a particle filter over whole maps, each particle refined on its own map.

Every scan gives a pose; key scans, a quarter of a metre apart, are worked into the maps: predict with the
motion and its covariance, refine each particle on its own map, weigh by the laser model, select when few
share the weight, write. When the laser is found to have come back, the whole population relives its path
along a smoothed one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.grid import CELL_M, METRES, STOPS
from processing.dpslam.judging import FAR_M
from processing.dpslam.loops import Loops
from processing.dpslam.memory import KeyScans
from processing.dpslam.population import Population
from processing.dpslam.proposal import Matrix, doubted
from processing.dpslam.resampling import effective_size
from processing.dpslam.search import Search
from processing.dpslam.sweep import NOTHING_SEEN, Sweep, Sweeper
from processing.dpslam.trail import Trail
from processing.motion import UNKNOWN_VARIANCE, Motion, carried
from processing.occupancy import OccupancyGrid, occupancy_of
from processing.scan import Beams, Scan
from processing.se2 import Pose

MISFITS = 5
"""Key scans in a row that contradict the own map before the track counts as lost."""
_BEAMS = tuple(field.name for field in fields(Beams))


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
    """How many particles share the weight; at a selection, shared it before."""
    resampled: bool
    closed: bool
    """Whether a loop was closed: the whole path has moved."""
    lost: bool
    """Whether the scan fits nowhere, or the laser is searched for; the pose is a guess, nothing is mapped."""
    places: tuple[Pose, ...]
    """While lost: the places on the map that fit equally well."""


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
        self._search: Search | None = None
        self._strange = True
        self.fixed = False
        """Whether the maps stay as they are: the laser is followed on them, and nothing is written."""

    def step(self, scan: Scan, motion: Motion) -> MapStep:
        """Take one scan and the motion that leads to it.

        Raises:
            ValueError: the motion belongs to another scan, or the scan has other beams than the first.
        """
        if scan.stamp_ns != motion.stamp_ns:
            raise ValueError(f"motion of scan {motion.stamp_ns}, must be of scan {scan.stamp_ns}")
        if self._sweeper is None:
            self._sweeper = Sweeper(scan.beams, self.config.points, self.config.range_max_m)
        self._sweeper.check(scan)
        odom = np.array(motion.odom_t_laser, dtype=np.float64)
        strange, self._strange = self._strange, False
        if strange:
            # The odometry of another session starts anywhere.
            self._odom = self._key_odom = odom
        if not motion.lost:
            self._covariance = carried(self._covariance, se2.between(self._odom, odom))
            self._covariance += doubted(motion.covariance, self.config.motion_doubt)
            self._odom = odom
        self._trail.add(scan.stamp_ns, odom)
        if strange and self.population.keys:
            self._trail.break_off()
        key_t_laser = se2.between(self._key_odom, odom)
        if motion.lost:
            # It belongs nowhere; the next motion that is known vouches for the way over it.
            return self._answer(key_t_laser, lost=not motion.doubted)
        if motion.anew and self.population.keys:
            # What was gathered before is not held together with what comes.
            self._search = Search(self._predicted(key_t_laser) if self._search is None else None)
            self._trail.break_off()
        if self._search is not None:
            return self._look(self._search, self._sweeper.take(scan, motion), key_t_laser)
        if self.population.keys and not self._is_key(key_t_laser):
            if self.loops is not None:
                self.loops.look_on()
            return self._answer(key_t_laser)
        sweep = self._sweeper.take(scan, motion)
        n_eff, resampled = float(self.config.particles), False
        if self.population.keys:
            known = self._on_old_ground()
            n_eff, resampled = self.population.update(sweep, key_t_laser, self._covariance, known)
        if not self._is_located():
            self.population.misfits = 0
        if self.population.misfits:
            # What contradicts the map shall not overwrite it: next time it would fit.
            sweep = NOTHING_SEEN
        closed = self._write(sweep, key_t_laser, self._covariance)
        if self.population.misfits >= MISFITS:
            self._search = Search()
            self._trail.break_off()
        return self._answer(np.zeros(3), updated=True, n_eff=n_eff, resampled=resampled, closed=closed)

    def find_itself(self) -> None:
        """Say that the next scan may be anywhere on the map: at the start of a session on a saved one."""
        self._strange = True
        self._search = Search()

    def _look(self, search: Search, sweep: Sweep, key_t_laser: Pose) -> MapStep:
        """Search the map for the laser; where it is found, go on mapping from there."""
        people = self.population
        place = search.look(self._odom, sweep, people.store, people.best).map_t_laser
        if place is None:
            return self._answer(key_t_laser)
        self._search = None
        before = people.poses[people.best]
        people.arrive(place)
        self._write(sweep, se2.between(before, place), np.diag((UNKNOWN_VARIANCE,) * 3))
        return self._answer(np.zeros(3), updated=True)

    def _write(self, sweep: Sweep, key_t_laser: Pose, covariance: Matrix) -> bool:
        """Write a key scan into all maps; return whether that closed a loop."""
        people = self.population
        if self.fixed:
            sweep = NOTHING_SEEN
        people.write(sweep.rays)
        replaced = self._scans.add(sweep, people.poses[people.best])
        self._trail.mark_key()
        moved = None
        if self.loops is not None:
            if replaced is not None:
                self.loops.forget(replaced)
            moved = self.loops.step(key_t_laser, covariance, sweep.points, people.path)
            if moved is not None:
                self.relive(moved)
        self._key_odom, self._covariance = self._odom, np.zeros((3, 3))
        return moved is not None

    def relive(self, path: Pose) -> None:
        """Move the population onto one path (K, 3), a pose a key scan; the maps are drawn anew."""
        if self._sweeper is not None:
            self.population.relive(path, self._scans, self._sweeper.beams)

    def finish(self) -> None:
        """Lay the path as all its relations want it, at the end of a run, before its results are read."""
        if self.loops is None:
            return
        self.loops.conclude()
        if self.loops.way.places:
            self.relive(self.loops.way.settled())

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the whole posterior as arrays; `from_state` goes on from it, bit for bit."""
        parts = {
            "people": self.population.state(),
            "scans": self._scans.state(),
            "trail": self._trail.state(),
        }
        if self.loops is not None:
            parts["loops"] = self.loops.state()
        own = {
            "key_odom_t_laser": self._key_odom.copy(),
            "odom_t_laser": self._odom.copy(),
            "covariance": self._covariance.copy(),
            "particles": np.array(self.config.particles),
            "strange": np.array(self._strange),
            "fixed": np.array(self.fixed),
        }
        if self._search is not None:
            parts["search"] = self._search.state()
        if self._sweeper is not None:
            b = self._sweeper.beams
            own["beams"] = np.array([getattr(b, name) for name in _BEAMS])
        return own | {
            f"{part}.{name}": value for part, arrays in parts.items() for name, value in arrays.items()
        }

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[Any]], config: DpSlamConfig | None = None) -> "DpSlam":
        """Return the mapper whose `state` was taken, under the same configuration.

        Raises:
            ValueError: the configuration is of other particles, or closes loops where the state has none.
        """
        slam = cls(config)
        particles = int(state["particles"])
        if particles != slam.config.particles:
            raise ValueError(
                f"{slam.config.particles} particles, must be {particles} as when the state was taken"
            )

        def part(name: str) -> dict[str, NDArray[Any]]:
            skip = len(name) + 1
            return {key[skip:]: value for key, value in state.items() if key.startswith(f"{name}.")}

        if (slam.loops is not None) != bool(part("loops")):
            raise ValueError(f"close_loops = {slam.config.close_loops}, must be as when the state was taken")
        slam.population.restore(part("people"))
        slam._scans.restore(part("scans"))
        slam._trail.restore(part("trail"))
        if slam.loops is not None:
            slam.loops.restore(part("loops"))
        slam._key_odom, slam._odom = state["key_odom_t_laser"].copy(), state["odom_t_laser"].copy()
        slam._covariance, slam._strange = state["covariance"].copy(), bool(state["strange"])
        slam.fixed = bool(state["fixed"])
        if searched := part("search"):
            slam._search = Search.from_state(searched)
        if "beams" in state:
            count, *angles = state["beams"].tolist()
            beams = Beams(count=int(count), **dict(zip(_BEAMS[1:], angles, strict=True)))
            slam._sweeper = Sweeper(beams, slam.config.points, slam.config.range_max_m)
        return slam

    def trajectory(self, most: int | None = None) -> tuple[NDArray[np.int64], Pose]:
        """Return stamps (N,) and map_t_laser (N, 3) of every scan so far, by the best particle's ancestry.

        `most`: of so many at most, evenly, the newest among them; those left out cost nothing.
        """
        if most is None:
            return self._trail.stamps_ns, self._trail.lay(self.population.path)
        every = max(1, -(-self._trail.scans // most))
        scans = np.arange(self._trail.scans - 1, -1, -every)[::-1]
        return self._trail.stamps_of(scans), self._trail.lay(self.population.path, scans)

    def odometry(self) -> Pose:
        """Return odom_t_laser (N, 3) of every scan so far, as the motions said."""
        return self._trail.odom_t_laser

    def occupancy(self) -> OccupancyGrid:
        """Return the best particle's map."""
        cells, corner = self.population.store.dense(self.population.best)
        stops, metres = cells[..., 0] / STOPS, cells[..., 1] / METRES
        return occupancy_of(stops, metres, CELL_M, (corner[1] * CELL_M, corner[0] * CELL_M))

    @property
    def bytes_held(self) -> int:
        """Memory of all maps, and of the key scans that they are drawn from: it grows with the area."""
        points = 0 if self.loops is None else self.loops.way.bytes_used
        return self.population.store.bytes_held + self._scans.bytes_used + points

    def _on_old_ground(self) -> bool:
        return self.loops is None or self.loops.on_settled_map

    def _is_located(self) -> bool:
        """Whether the path is known well enough for a scan to contradict the map, and not only the drift."""
        return self._on_old_ground() or (self.loops is not None and self.loops.away_m() < FAR_M)

    def _is_key(self, key_t_laser: Pose) -> bool:
        c = self.config
        way = np.hypot(key_t_laser[0], key_t_laser[1])
        return bool(way >= c.key_distance_m or abs(key_t_laser[2]) >= c.key_rotation_rad)

    def _answer(
        self,
        key_t_laser: Pose,
        updated: bool = False,
        n_eff: float | None = None,
        resampled: bool = False,
        closed: bool = False,
        lost: bool = False,
    ) -> MapStep:
        people = self.population
        return MapStep(
            map_t_laser=self._predicted(key_t_laser),
            updated=updated,
            particles=people.poses.copy(),
            weights=np.exp(people.log_weights),
            n_eff=effective_size(people.log_weights) if n_eff is None else n_eff,
            resampled=resampled,
            closed=closed,
            lost=lost or self._search is not None,
            places=() if self._search is None else self._search.found.places,
        )

    def _predicted(self, key_t_laser: Pose) -> Pose:
        return se2.compose(self.population.poses[self.population.best], key_t_laser)
