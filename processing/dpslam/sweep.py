"""What the mapper takes from one scan: rays to write and to weigh with, points to align with; laser frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.motion import Motion
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Beams, Scan, end_points


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One scan, de-skewed to the moment of its stamp."""

    rays: NDArray[np.float64]
    """(N, 4) start x, y and end x, y of every ray that hit something, m, laser frame."""
    points: NDArray[np.float64]
    """(M, 2) means of stretches of the contour."""


NOTHING_SEEN = Sweep(np.zeros((0, 4)), np.zeros((0, 2)))


class Sweeper:
    """Turns the scans of one scanner into sweeps."""

    def __init__(self, beams: Beams, points: int, range_max_m: float) -> None:
        self._resampler = Resampler(ResamplingConfig(points=points), beams)
        self._range_max_m = range_max_m

    @property
    def beams(self) -> Beams:
        """The scanner's rays."""
        return self._resampler.beams

    def check(self, scan: Scan) -> None:
        """Refuse scans of another scanner: raises ValueError."""
        if scan.beams.count != self.beams.count:
            raise ValueError(
                f"scan of {scan.beams.count} beams, must be {self.beams.count} as the first scan"
            )

    def take(self, scan: Scan, motion: Motion) -> Sweep:
        """De-skew and resample; the laser is taken to keep its velocity during the sweep."""
        beams = self.beams
        ends, used = end_points(scan, motion.twist, range_max_m=self._range_max_m)
        vx, vy, rate = (float(v) for v in motion.twist)
        after_s = used * beams.time_increment_s
        angle = rate * after_s
        along = after_s * np.sinc(angle / np.pi)
        across = 0.5 * angle * after_s * np.sinc(0.5 * angle / np.pi) ** 2
        starts = np.stack((along * vx - across * vy, across * vx + along * vy), axis=1)
        self._resampler.points(scan, motion.twist)
        points = self._resampler.means()
        near = np.hypot(points[:, 0], points[:, 1]) <= self._range_max_m
        return Sweep(np.concatenate((starts, ends), axis=1), np.ascontiguousarray(points[near]))
