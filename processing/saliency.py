"""Saliency-based resampling of scan points (after Tomono, IROS 2005): few points, all corners.

A point tells little on a long straight wall and much where the contour bends or is short. Saliency grows
along the contour with its length, and faster in bends and on short pieces; stretches of equal saliency
become one point each, the mean of theirs. Means, because a picked point carries its noise, and because
points picked by the way between noisy points are those that the noise pushed outward, which turns every
match to the same side.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.facing_kernels import NEAR_M, STRAIGHT, STRAIGHT_M, THIN, face, lean
from processing.saliency_kernels import end_points, resample
from processing.scan import Beams, Scan
from processing.wall_kernels import fill_walls

LENGTH_A_NOISE = 25.0
"""Of so many times its noise on both sides a wall looks a fifteenth as thick as long: thin enough."""
MOST_FILLED = 4000
"""Room for points between the rays of a sweep."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResamplingConfig:
    """How many points a match works on, and what counts as salient."""

    points: int = 134
    """Wanted number (the paper's, in a corridor); 0 keeps every point."""
    max_slant: float = 6.0
    """Neighbouring rays belong to one surface up to this stretch of their distance: 6 is a slant of 80
    degrees."""
    range_noise_m: float = 0.02
    """Standard deviation of a range; three of them are no gap between surfaces."""
    bend_support_m: float = 0.15
    """Length of contour each side over which its direction is read."""
    bend_weight: float = 4.0
    """Saliency of a right angle, in lengths of straight contour."""
    short_weight: float = 2.0
    """Saliency of a vanishing piece, in lengths of straight contour."""
    short_m: float = 0.5
    """Length at which a piece is half as short as can be."""

    def __post_init__(self) -> None:
        if self.points != 0 and not 10 <= self.points <= 10_000:
            raise ValueError(f"points = {self.points}, must be 0 (all) or in [10, 10000]")
        for name in ("max_slant", "range_noise_m", "bend_support_m", "short_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be positive")
        for name in ("bend_weight", "short_weight"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must not be negative")


class Resampler:
    """Turns the sweeps of one scanner into points, all and resampled; its buffers are kept between sweeps."""

    def __init__(self, config: ResamplingConfig, beams: Beams) -> None:
        bearings = beams.bearings()
        self.beams = beams
        self.noise_m = 0.0
        """Standard deviation of a ray: through a noisy laser only longer walls are told to be straight."""
        self._wanted = config.points
        self._directions = np.column_stack((np.cos(bearings), np.sin(bearings)))
        self._rule = np.array(
            (
                config.max_slant,
                config.range_noise_m,
                config.bend_support_m,
                config.bend_weight,
                config.short_weight,
                config.short_m,
            )
        )
        self._points = np.empty((beams.count, 2))
        self._rays = np.empty(beams.count, np.int64)
        self._means = np.empty((beams.count, 2))
        self._filled = np.empty((beams.count + MOST_FILLED, 2))
        self._normals = np.empty((beams.count + MOST_FILLED, 2))
        self._members = np.empty(beams.count, np.int64)
        self._numbers = np.arange(beams.count)
        self._work = np.empty((beams.count, 4))

    def points(self, scan: Scan, twist: NDArray[np.float64], instant_s: float = 0.0) -> NDArray[np.float64]:
        """Return the end points (M, 2) as `scan.end_points` does; valid until the next call."""
        beams = self.beams
        sweep = np.array((beams.range_min_m, beams.range_max_m, beams.time_increment_s, instant_s))
        self._count = int(end_points(scan.ranges_m, self._directions, sweep, twist, self._points, self._rays))
        return self._points[: self._count]

    def filled(self, most_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the points of the last sweep and more between them, and which way their walls face.

        Args:
            most_m: Greatest gap between two rays on one straight wall that is filled; 0 for none.

        Returns:
            Points (K, 2), and unit normals (K, 2) towards the laser, 0 for points of no wall; copies.
        """
        face(self._points, self._count, self._numbers[: self._count], NEAR_M, THIN, self._normals)
        written = fill_walls(self._points, self._rays, self._count, most_m, self._filled, self._normals)
        return self._filled[:written].copy(), self._normals[:written].copy()

    def means(self) -> NDArray[np.float64]:
        """Return the resampled points of the last sweep; (K, 2), K near the wanted number, a copy."""
        if self._wanted == 0:
            return self._points[: self._count].copy()
        written = resample(
            self._points,
            self._rays,
            self._count,
            abs(self.beams.angle_increment_rad),
            self._wanted,
            self._rule,
            self._means,
            self._members,
            self._work,
        )
        return self._means[:written].copy()

    def oriented_means(self, walls: bool = True) -> NDArray[np.float64]:
        """Return the same as `means` with the straight walls that they are on.

        Args:
            walls: Whether these are looked for.

        Returns:
            (K, 4): place, and unit normal of the wall towards the laser, 0 for points of no wall. Lone hits
            far away count as of walls along their rays.
        """
        means = self.means()
        if not walls:
            return np.hstack((means, np.zeros_like(means)))
        members = self._members[: len(means)]
        middles = np.cumsum(members) - (members + 1) // 2 if self._wanted else self._numbers[: len(means)]
        normals = np.empty_like(means)
        straight_m = max(STRAIGHT_M, LENGTH_A_NOISE * self.noise_m)
        face(self._points, self._count, middles, straight_m, STRAIGHT, normals)
        lean(self._points, self._rays, self._count, middles, abs(self.beams.angle_increment_rad), normals)
        return np.hstack((means, normals))

    def spans_m(self, count: int) -> NDArray[np.float64]:
        """Return how far the surface reaches from its first point that each of the last `count` means is of.

        Without resampling nothing is known of surfaces: all of them count as endless.
        """
        if self._wanted == 0 or count == 0:
            return np.full(count, np.inf)
        pieces = self._work[: self._count, 3].astype(np.int64)
        firsts = np.flatnonzero(np.diff(pieces, prepend=-1))
        reach = np.hypot(*(self._points[: self._count] - self._points[firsts[pieces]]).T)
        owners = pieces[np.cumsum(self._members[:count]) - 1]
        return np.asarray(np.maximum.reduceat(reach, firsts)[owners], np.float64)
