"""What a laser makes of a building: noise, systematic error, and the places where it sees nothing.

Three models: an URG-04LX as its specification and a real recording describe it (error codes and all), a
long range laser of the SICK kind, and a cheap one that turns all around, slowly.  Randomness comes in as a
generator: a seed gives the same ranges again.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.world.building import Array, Building
from drivers.world.raycast import Hits, cast

TOO_DIM = 0
"""URG error code: no usable return.  More than half of the rays of real recordings end so."""
NEIGHBOUR = 7
"""URG error code: the neighbouring steps are in error."""
SAME_STEP = 9
"""URG error code: this step was in error in the last two scans."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Laser(ABC):
    """Geometry and timing of a scanner, and what it makes of what it sees."""

    beams: int
    angle_min_rad: float
    angle_increment_rad: float
    time_increment_s: float
    period_s: float
    range_min_m: float
    range_max_m: float

    @abstractmethod
    def measure(
        self, building: Building, map_t_laser: Array, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return ranges (beams,) m for the pose (beams, 3) that the laser had at each ray."""


def bearings(laser: Laser) -> Array:
    """Return the direction of each ray, (beams,) rad, laser frame, from right to left."""
    return np.asarray(laser.angle_min_rad + laser.angle_increment_rad * np.arange(laser.beams))


def _look(laser: Laser, building: Building, map_t_laser: Array) -> Hits:
    """Send the rays of one sweep from the poses (beams, 3) of the laser."""
    return cast(building, map_t_laser[:, :2], map_t_laser[:, 2] + bearings(laser), laser.range_max_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Urg04lx(Laser):
    """URG-04LX: 682 rays at 360/1024 degrees, ten times a second."""

    beams: int = 682
    angle_min_rad: float = (44 - 384) * 2.0 * np.pi / 1024
    angle_increment_rad: float = 2.0 * np.pi / 1024
    time_increment_s: float = 0.099889 / 1024
    period_s: float = 0.099889
    range_min_m: float = 0.02
    range_max_m: float = 5.6
    noise_m: float = 0.004
    """Random part, standard deviation."""
    bias: float = 0.5
    """Size of the systematic part, as a share of its bound max(10 mm, 1 %)."""
    dropouts: float = 0.02
    """Share of the rays in sight of something that return nothing all the same."""
    reach_m: float = 4.6
    """From where a white wall, met head-on, is seen in half of the sweeps."""

    def measure_mm(
        self, building: Building, map_t_laser: Array, rng: np.random.Generator
    ) -> NDArray[np.int32]:
        """Return what the sensor reports for each ray (beams,): mm, or an error code below 20."""
        hits = _look(self, building, map_t_laser)
        true_m, seen = hits.ranges_m, np.isfinite(hits.ranges_m)
        distance = np.where(seen, true_m, 0.0)
        # Light comes back weaker from slanted and dark surfaces; what limits the reach is light.
        reach_m = (
            self.reach_m * np.sqrt(np.maximum(hits.incidence_cos, 1e-4)) * np.where(hits.dark, 0.35, 1.0)
        )
        lit = rng.random(self.beams) < 1.0 / (1.0 + np.exp(np.clip((distance - reach_m) / 0.12, -60.0, 60.0)))
        # One or two dropouts side by side: what real recordings show most.
        dropped = rng.random(self.beams) < self.dropouts / 1.5
        dropped[1:] |= dropped[:-1] & (rng.random(self.beams - 1) < 0.5)
        measured = self._mix_edges(distance, seen, rng)
        measured += self._systematic(distance) + self._smooth_noise(rng)
        codes = np.where(rng.random(self.beams) < 0.85, NEIGHBOUR, SAME_STEP)
        millimetres = np.rint(np.clip(measured, self.range_min_m, self.range_max_m) * 1000.0)
        good = seen & lit & ~dropped & (distance >= self.range_min_m)
        result = np.where(good, millimetres, np.where(seen & lit & dropped, codes, TOO_DIM))
        return result.astype(np.int32)

    def measure(
        self, building: Building, map_t_laser: Array, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return ranges (beams,) m, NaN for every error code.  See `Laser.measure`."""
        millimetres = self.measure_mm(building, map_t_laser, rng)
        return np.where(millimetres < 20, np.nan, millimetres / 1000.0).astype(np.float32)

    def _systematic(self, distance_m: Array) -> Array:
        """Error that stays: a smooth function of direction and distance, the same in every scan."""
        bearing = bearings(self)
        shape = 0.6 * np.sin(3.0 * bearing + 0.7) + 0.4 * np.sin(2.1 * distance_m + 1.3 * bearing)
        return np.asarray(self.bias * np.maximum(0.010, 0.01 * distance_m) * shape)

    def _smooth_noise(self, rng: np.random.Generator) -> Array:
        """Random error (beams,): neighbours share a part of it, because the sensor smooths."""
        white = rng.standard_normal(self.beams + 2)
        smooth = 0.25 * white[:-2] + 0.5 * white[1:-1] + 0.25 * white[2:]
        return np.asarray(smooth * (self.noise_m / np.sqrt(0.375)))

    def _mix_edges(self, distance_m: Array, seen: NDArray[np.bool_], rng: np.random.Generator) -> Array:
        """Put some rays that straddle an edge between the near and the far surface."""
        mixed = distance_m.copy()
        step = np.flatnonzero((np.abs(np.diff(distance_m)) > 0.05) & seen[1:] & seen[:-1])
        step = step[rng.random(len(step)) < 0.3]
        share = rng.random(len(step))
        mixed[step] = share * distance_m[step] + (1.0 - share) * distance_m[step + 1]
        return mixed


@dataclass(frozen=True, slots=True, kw_only=True)
class Sick(Laser):
    """A long range laser: half a circle, 1 cm, sees everything."""

    beams: int = 180
    angle_min_rad: float = -np.pi / 2
    angle_increment_rad: float = np.pi / 180
    time_increment_s: float = 1.0 / 75 / 360
    period_s: float = 0.2
    range_min_m: float = 0.1
    range_max_m: float = 80.0
    noise_m: float = 0.01

    @classmethod
    def half_degree(cls) -> "Sick":
        """Return the model with 360 rays, half a degree apart."""
        return cls(beams=360, angle_increment_rad=np.pi / 360, time_increment_s=1.0 / 75 / 720)

    def measure(
        self, building: Building, map_t_laser: Array, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return ranges (beams,) m in whole centimetres, +inf for no return.  See `Laser.measure`."""
        ranges = _look(self, building, map_t_laser).ranges_m
        ranges = ranges + self.noise_m * rng.standard_normal(self.beams)
        return np.round(np.maximum(ranges, self.range_min_m), 2).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spinning(Sick):
    """A cheap laser that turns all around: a degree between rays, a revolution in a fifth of a second."""

    beams: int = 360
    angle_min_rad: float = -np.pi
    angle_increment_rad: float = np.pi / 180
    time_increment_s: float = 1.0 / 5.5 / 360
    period_s: float = 1.0 / 5.5
    range_min_m: float = 0.15
    range_max_m: float = 12.0
    noise_m: float = 0.02
