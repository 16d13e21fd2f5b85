"""A drive that begins somewhere on a saved map, or beside it: mapped by itself until it is found there.

Then the two become one, in the frame of the saved map, from the first scan of the drive on: nothing that was
seen before it was found is lost. A drive that is never found stays a map of its own.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam, MapStep
from processing.dpslam.finding import Finder
from processing.dpslam.joining import joined
from processing.dpslam.layer import Layer
from processing.dpslam.past import Past, past_of
from processing.dpslam.population import Population
from processing.dpslam.redrawing import rebuild
from processing.dpslam.sweep import Sweeper
from processing.motion import Motion
from processing.occupancy import OccupancyGrid
from processing.scan import Scan
from processing.se2 import Pose


class Returning:
    """Steps like `DpSlam`; `MapStep.lost` says that the drive is not found yet, and its pose is its own.

    Args:
        past: The saved map.
        config: Of the mapper; it need not be that of the saved map.
        seed: Of its random numbers.
        fixed: The saved map stays as it is: the laser is followed on it, and nothing is mapped.
        layer: What is painted on the saved map: the drive is found, and followed, on the map as painted.
    """

    def __init__(
        self,
        past: Past,
        config: DpSlamConfig | None = None,
        seed: int = 0,
        *,
        fixed: bool = False,
        layer: Layer | None = None,
    ) -> None:
        self.config = config or DpSlamConfig()
        self.seed, self.fixed = seed, fixed
        self._past, self._layer = past, layer or Layer.none()
        self.saved = rebuild(past, self.config, seed, fixed=True)
        """The saved map as painted; it does not change, and is the mapper's own when the drive is found."""
        people = self.saved.population
        self._layer.write_on(people.store, past.map_t_laser)
        self.finder = Finder(people.store, people.best)
        self._mapper = DpSlam(self.config, seed)
        self._sweeper: Sweeper | None = None
        self._drives = np.zeros(1, dtype=np.int64)
        self.found = False
        """Whether the drive was found on the saved map."""

    @property
    def population(self) -> Population:
        """The particles, of the drive alone or of both."""
        return self._mapper.population

    @property
    def first_scan(self) -> int:
        """Number of this drive's first scan in `trajectory`."""
        return int(self._drives[-1])

    def step(self, scan: Scan, motion: Motion) -> MapStep:
        """Take one scan and the motion that leads to it.

        Raises:
            ValueError: as `DpSlam.step`, or the scan has other beams than those of the saved map.
        """
        if self.found:
            return self._mapper.step(scan, motion)
        if self._sweeper is None:
            saved = self._past.scanner
            if scan.beams.count != saved.count:
                raise ValueError(
                    f"scan of {scan.beams.count} beams, must be {saved.count} as on the saved map"
                )
            self._sweeper = Sweeper(scan.beams, self.config.points, self.config.range_max_m)
        step = self._mapper.step(scan, motion)
        if step.updated:
            sweep = self._sweeper.take(scan, motion)
            place = self.finder.take(self._mapper.population.path, sweep).map_t_laser
            if place is not None:
                return self._arrive(step, place)
        return replace(step, lost=True, places=self.finder.found.places)

    def _arrive(self, step: MapStep, map_t_laser: Pose) -> MapStep:
        """Join the drive, whose newest scan is a key scan, to the saved map."""
        own = past_of(self._mapper)
        both = joined(self._past, own.unseen() if self.fixed else own, len(own.keys) - 1, map_t_laser)
        self._mapper = rebuild(both, self.config, self.seed, going_on=True, fixed=self.fixed)
        self._drives, self.found = both.drives, True
        # Nobody looks on the saved map any more: it need not be kept, nor written down with every checkpoint.
        self._past, self.saved = both, self._mapper
        self.finder.forget()
        if self.fixed:
            self._layer.write_on(self._mapper.population.store, both.map_t_laser)
        people = self._mapper.population
        return replace(
            step, map_t_laser=map_t_laser, particles=people.poses.copy(), closed=True, lost=False, places=()
        )

    def finish(self) -> None:
        """See `DpSlam.finish`."""
        self._mapper.finish()

    def trajectory(self, most: int | None = None) -> tuple[NDArray[np.int64], Pose]:
        """Return stamps (N,) and map_t_laser (N, 3) of every scan of all drives; of this one if not found.

        `most`: see `DpSlam.trajectory`.
        """
        return self._mapper.trajectory(most)

    def odometry(self) -> Pose:
        """Return odom_t_laser (N, 3) of the scans of `trajectory`; each drive has a frame of its own."""
        return self._mapper.odometry()

    def occupancy(self) -> OccupancyGrid:
        """Return the map of everything, as painted; of this drive alone if it was not found."""
        grid = self._mapper.occupancy()
        return self._layer.over(grid, self.population.path) if self.found else grid

    @property
    def bytes_held(self) -> int:
        """See `DpSlam.bytes_held`."""
        return self._mapper.bytes_held

    def past(self) -> Past:
        """Return what is to be saved; `finish` first."""
        return past_of(self._mapper, self._drives)
