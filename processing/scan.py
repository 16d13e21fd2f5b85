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

    def bearings(self) -> NDArray[np.float64]:
        """Return the direction of each ray, (count,) rad, laser frame, counter-clockwise from straight ahead."""
        return self.angle_min_rad + self.angle_increment_rad * np.arange(self.count)


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
