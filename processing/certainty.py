"""How far a motion may be off: measured from the residuals of its match, not claimed by the cells.

A cell's deviation says how far points lie from a wall at all; most of that is the same in the next scan and
cancels in the motion. What stays is the noise of the rays, and, as the points slide over the cells, residuals
that are new. Both go through the curvature of the score: the sandwich of Huber (1967) and White (1982).
"""

import numpy as np
from numpy.typing import NDArray

from processing.certainty_kernels import spreads
from processing.matching import Matching
from processing.ndt import Ndt, Oriented, Points, oriented
from processing.prediction import LEAST_INFORMATION, Twist, turned
from processing.scan import Scan

Matrix = NDArray[np.float64]

NEW_M = 0.05
"""Slide of the points over the reference by which two thirds of their residuals are new."""
TWIST_GAIN = 1.268
"""Share of the difference of two poses that goes into the velocity between them: 3 - sqrt(3), the gain of a
constant-velocity filter whose poses are exact beside its motion."""
UNKNOWN_NOISE_M2 = 1e-4
"""Variance of a point until a scan told: of a ray of a cheap laser."""
LEAST_NOISE_M2 = 1e-8
_FADE = 0.1
"""Weight of the newest scan in the running noise."""


class RayNoise:
    """Running variance (m^2) of the mean of a stretch of rays."""

    def __init__(self) -> None:
        self._variance_m2: float | None = None
        self._rays_a_point = 1

    @property
    def ray_m(self) -> float:
        """Standard deviation of a single ray; 0 until a scan told."""
        return float(np.sqrt((self._variance_m2 or 0.0) * self._rays_a_point))

    def watch(self, scan: Scan, rays_a_point: int) -> float:
        """Take a scan in, and return the variance of the mean of so many rays.

        Along a straight wall 1/r is a sine of the bearing: what is left of it in second differences is noise.
        """
        self._rays_a_point = rays_a_point
        whole = scan.ranges_m[: len(scan.ranges_m) // rays_a_point * rays_a_point].astype(np.float64)
        valid = (whole >= scan.beams.range_min_m) & (whole <= scan.beams.range_max_m) & (whole > 0.0)
        inverse = np.where(valid, 1.0 / np.where(valid, whole, 1.0), np.nan)
        inverse = inverse.reshape(-1, rays_a_point).mean(axis=1)
        turn = 2.0 * np.cos(scan.beams.angle_increment_rad * rays_a_point)
        off = (inverse[:-2] + inverse[2:] - turn * inverse[1:-1]) / inverse[1:-1] ** 2
        off = np.abs(off[np.isfinite(off)])
        if len(off) >= 10:
            # 1.4826 medians are a standard deviation, and a second difference has six variances.
            newest = float((1.4826 * np.median(off)) ** 2 / 6.0)
            old = newest if self._variance_m2 is None else self._variance_m2
            self._variance_m2 = old + _FADE * (newest - old)
        return max(UNKNOWN_NOISE_M2 if self._variance_m2 is None else self._variance_m2, LEAST_NOISE_M2)


class Certainty:
    """Keeps what the scans so far told about their noise, and judges each motion by it."""

    def __init__(self, score_weight: float, fine_share: float) -> None:
        self.noise = RayNoise()
        self._score_weight = score_weight
        self._fine_share = fine_share
        self._spreads = np.empty((2, 3, 3))

    def judge(
        self,
        scan: Scan,
        rays: int,
        points: Points | Oriented,
        matching: Matching,
        reference: Ndt,
        twists: tuple[Twist, Twist],
        middle_s: float,
    ) -> Matrix:
        """Return the covariance (3, 3) of the motion since the last scan, on the laser's axes.

        Args:
            scan: The newest.
            rays: How many of its rays have a point.
            points: (N, 2) or (N, 4) their means that were matched, N >= 1.
            matching: Where they fit.
            reference: What they were matched against.
            twists: Velocity (3,) before the match and after it.
            middle_s: Time from the first ray, where the motion ends, to the moment that was matched.
        """
        noise_m2 = self.noise.watch(scan, max(1, round(rays / len(points))))
        fine = reference if reference.fine is None else reference.fine
        share = 0.0 if reference.fine is None else self._fine_share
        spreads(oriented(points), reference.grid, fine.grid, share, matching.pose, self._spreads)
        back = -matching.pose[2]
        information = turned(matching.information, back) / self._score_weight
        residual, white = turned(self._spreads[0], back), turned(self._spreads[1], back)
        # The pose of the first ray lies between two matched ones: (1 - a) of the newest and a of the old one.
        a = TWIST_GAIN * middle_s / scan.beams.period_s
        kept = (1.0 - a) ** 2 + (1.0 - 2.0 * a) ** 2 + a**2
        new = 1.0 - np.exp(-_slide_m(points, twists[1] * scan.beams.period_s) / NEW_M)
        inverse = np.linalg.inv(information + LEAST_INFORMATION * np.eye(3))
        meat = (1.0 - new) * kept * noise_m2 * white + 2.0 * new * residual
        # A velocity that changes during the sweep leaves this in the pose of its first ray.
        shake = 0.5 * (twists[1] - twists[0]) / scan.beams.period_s * middle_s**2
        return np.asarray(inverse @ meat @ inverse + np.diag(shake**2) + LEAST_NOISE_M2 * np.eye(3))


def _slide_m(points: Points, motion: Twist) -> float:
    """Return how far points (N, 2) slide over the reference in a small motion (3,), root mean square."""
    x = motion[0] - motion[2] * points[:, 1]
    y = motion[1] + motion[2] * points[:, 0]
    return float(np.sqrt(np.mean(x * x + y * y)))
