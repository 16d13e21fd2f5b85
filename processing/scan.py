"""Geometry of one laser sweep: where each ray points, when it was taken, and where it ended."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """The rays of a scanner, equal in every scan; rad, s, m.

    All values are rounded to single precision, as the LaserScan message carries them, so that a run in one
    process and a run through messages compute with the same numbers.
    """

    count: int
    angle_min_rad: float
    angle_increment_rad: float
    time_increment_s: float = 0.0
    """Time between neighbouring rays; 0 when it is not known (no de-skew)."""
    period_s: float = 0.1
    """Time from one sweep to the next, by the sensor's own rate."""
    range_min_m: float = 0.02
    range_max_m: float = 30.0

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ValueError(f"beam count = {self.count}, must be at least 1")
        for field in fields(self):
            if field.type in (float, "float"):
                object.__setattr__(self, field.name, float(np.float32(getattr(self, field.name))))
        if not 0.0 < self.period_s <= 10.0:
            raise ValueError(f"scan period = {self.period_s} s, must be in (0, 10]")
        if not 0.0 <= self.range_min_m < self.range_max_m:
            raise ValueError(f"ranges {self.range_min_m} .. {self.range_max_m} m, must be 0 <= min < max")

    @property
    def sweep_s(self) -> float:
        """Time from the first ray to the last."""
        return self.time_increment_s * (self.count - 1)

    def bearings(self) -> NDArray[np.float64]:
        """Return the direction of each ray: (count,) rad, laser frame, counter-clockwise from ahead."""
        return self.angle_min_rad + self.angle_increment_rad * np.arange(self.count, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One sweep: a range for each ray, NaN where there is no information, +inf where nothing returned."""

    stamp_ns: int
    """When the first ray was taken."""
    ranges_m: NDArray[np.float32]
    beams: Beams

    def __post_init__(self) -> None:
        if self.ranges_m.shape != (self.beams.count,):
            raise ValueError(f"{self.ranges_m.shape} ranges, must be ({self.beams.count},)")
        # A view of a message or of a file is read-only or strided; compiled loops take neither.
        own = np.require(self.ranges_m, dtype=np.float32, requirements=("C", "W"))
        object.__setattr__(self, "ranges_m", own)


def end_points(
    scan: Scan, twist: NDArray[np.float64], instant_s: float = 0.0, range_max_m: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Turn a sweep into points as they lie seen from the laser at one instant of it.

    A range of NaN, infinity, zero, under the sensor's least or over its greatest is not a point.

    Args:
        scan: The sweep.
        twist: (3,) velocity of the laser in its own frame at that instant, m/s, m/s, rad/s; held over the
            sweep.
        instant_s: Time of that instant after the first ray.
        range_max_m: Leave out farther points than this, too.

    Returns:
        (M, 2) points, m, and (M,) the numbers of their rays, rising.
    """
    ranges = scan.ranges_m.astype(np.float64)
    farthest = min(range_max_m, scan.beams.range_max_m)
    with np.errstate(invalid="ignore"):
        kept = np.flatnonzero((ranges >= scan.beams.range_min_m) & (ranges <= farthest) & (ranges > 0.0))
    bearing = scan.beams.bearings()[kept]
    x, y = ranges[kept] * np.cos(bearing), ranges[kept] * np.sin(bearing)
    after_s = kept * scan.beams.time_increment_s - instant_s
    angle = twist[2] * after_s
    # The path of a constant twist: along = sin(a)/w and across = (1 - cos(a))/w of the velocity, without
    # the 0/0.
    along = after_s * np.sinc(angle / np.pi)
    across = 0.5 * angle * after_s * np.sinc(0.5 * angle / np.pi) ** 2
    c, s = np.cos(angle), np.sin(angle)
    moved_x = c * x - s * y + along * twist[0] - across * twist[1]
    moved_y = s * x + c * y + across * twist[0] + along * twist[1]
    return np.column_stack((moved_x, moved_y)), kept
