"""What the mapper takes from one scan: rays to write and to weigh with, points to align with; laser frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.motion import Motion
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Beams, Scan


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One scan, de-skewed to the moment of its stamp."""

    ranges_m: NDArray[np.float32]
    """(N,) of every ray that hit something."""
    numbers: NDArray[np.uint16]
    """(N,) which rays of the scanner these are."""
    twist: NDArray[np.float64]
    """(3,) velocity of the laser during the sweep."""
    rays: NDArray[np.float64]
    """(N, 4) start x, y and end x, y of each, m, laser frame."""
    points: NDArray[np.float64]
    """(M, 2) means of stretches of the contour."""


NOTHING_SEEN = Sweep(
    np.zeros(0, np.float32), np.zeros(0, np.uint16), np.zeros(3), np.zeros((0, 4)), np.zeros((0, 2))
)


def cast_rays(
    beams: Beams,
    ranges_m: NDArray[np.float32],
    numbers: NDArray[np.uint16],
    twist: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return start x, y and end x, y (N, 4) of rays, seen from where the first ray of their scan left.

    Args:
        beams: The scanner.
        ranges_m: (N,) how far each ray went.
        numbers: (N,) which rays of the scanner.
        twist: (N, 3) or (3,) velocity of the laser during the sweep of each; it is taken to be kept.
    """
    after_s = numbers * beams.time_increment_s
    vx, vy, rate = twist[..., 0], twist[..., 1], twist[..., 2]
    angle = rate * after_s
    # The path of a constant twist: along = sin(a)/w and across = (1 - cos(a))/w of the velocity, without the
    # 0/0.
    along = after_s * np.sinc(angle / np.pi)
    across = 0.5 * angle * after_s * np.sinc(0.5 * angle / np.pi) ** 2
    rays = np.empty((len(numbers), 4))
    rays[:, 0], rays[:, 1] = along * vx - across * vy, across * vx + along * vy
    bearing = beams.bearings()[numbers] + angle
    rays[:, 2] = rays[:, 0] + ranges_m * np.cos(bearing)
    rays[:, 3] = rays[:, 1] + ranges_m * np.sin(bearing)
    return rays


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
        beams, ranges_m = self.beams, scan.ranges_m
        farthest = min(self._range_max_m, beams.range_max_m)
        with np.errstate(invalid="ignore"):
            seen = (ranges_m >= beams.range_min_m) & (ranges_m <= farthest) & (ranges_m > 0.0)
        numbers = np.flatnonzero(seen).astype(np.uint16)
        twist = np.array(motion.twist, dtype=np.float64)
        rays = cast_rays(beams, ranges_m[numbers], numbers, twist)
        self._resampler.points(scan, motion.twist)
        points = self._resampler.means()
        near = np.hypot(points[:, 0], points[:, 1]) <= self._range_max_m
        return Sweep(ranges_m[numbers], numbers, twist, rays, np.ascontiguousarray(points[near]))
