"""People who walk through simulated buildings while a laser looks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.world import Building, Laser

STRIDE_M, LEG_M = 0.7, 0.07
"""From footfall to footfall, and the radius of a leg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Walks to and fro between two places, (2,) m each."""

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    speed_mps: float
    ahead_m: float = 0.0
    """Way from the start at which he is when time begins."""

    def legs(self, time_s: float) -> NDArray[np.float64]:
        """Return x, y, radius (2, 3) of both legs."""
        way = self.end - self.start
        length = float(np.hypot(*way))
        gone = self.ahead_m + self.speed_mps * time_s
        along = gone % (2.0 * length)
        along, sign = (along, 1.0) if along <= length else (2.0 * length - along, -1.0)
        forward, left = way / length, np.array((-way[1], way[0])) / length
        swing = 0.25 * np.sin(np.pi * gone / STRIDE_M)
        body = self.start + forward * along
        feet = [body + forward * sign * swing * side + left * 0.1 * side for side in (1.0, -1.0)]
        return np.array([(*foot, LEG_M) for foot in feet])


class Peopled:
    """A laser that sees people walk; quacks as the laser does."""

    def __init__(self, laser: Laser, people: Sequence[Person]) -> None:
        self._laser, self._people, self._scans = laser, people, 0

    def __getattr__(self, name: str):
        return getattr(self._laser, name)

    def measure(self, building: Building, map_t_laser, rng):
        """Return what the laser measures (beams,) with the people where they are at this scan."""
        time_s = self._scans * self._laser.period_s
        self._scans += 1
        legs = [person.legs(time_s) for person in self._people]
        here = map_t_laser[0, :2]
        # Nobody walks through the robot.
        legs = [pair for pair in legs if np.hypot(*(pair[:, :2] - here).T).min() > 0.4]
        return self._laser.measure(
            replace(building, pillars=np.vstack((building.pillars, *legs))), map_t_laser, rng
        )
