"""Scans of a drive through a building in simulated time: no threads, no clock, as fast as the machine can.

The same arguments give the same scans.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.world.building import Array, Building
from drivers.world.laser import Laser, Urg04lx
from drivers.world.pursuit import Pursuit, PursuitConfig

_STEP_S = 0.01
_FIRST_NS = 1_000_000_000
_STEADY_S = (5.0, 15.0)
"""For so long an unsteady hand keeps a speed."""


def simulate_scans(
    building: Building,
    route: ArrayLike | None = None,
    *,
    laser: Laser | None = None,
    speed_mps: float = 0.3,
    turn_rate_radps: float = 1.0,
    acceleration_mps2: float = 0.5,
    turn_acceleration_radps2: float = 3.0,
    unsteady: float = 0.0,
    laps: int = 1,
    max_scans: int | None = None,
    base_t_laser: ArrayLike = (0.0, 0.0, 0.0),
    rest_s: float = 0.5,
    seed: int = 0,
) -> Iterator[tuple[int, NDArray[np.float32], Array]]:
    """Drive a route and yield what the laser saw.

    Args:
        building: Where to drive.
        route: (W, 2) waypoints; the building's own route if None (closed if that is).
        laser: Its model; an URG-04LX if None.
        speed_mps: Speed on the straight.
        turn_rate_radps: Greatest turn rate, and the rate of turns on the spot.
        acceleration_mps2: Limit of the change of speed.
        turn_acceleration_radps2: Limit of the change of turn rate.
        unsteady: By which share at most the robot is driven slower, another one every few seconds.
        laps: How often to drive the whole route.
        max_scans: Stop earlier, after so many scans.
        base_t_laser: (3,) mounting of the laser on the robot.
        rest_s: How long the robot stands before it drives off.
        seed: Of the noise.

    Yields:
        Stamp of the first ray (ns), ranges (beams,) float32 in m (NaN no information, +inf no return), and
        the true map_t_laser (3,) at that stamp.  Each ray is cast from where the laser was at its own time.
    """
    laser = laser if laser is not None else Urg04lx()
    waypoints = building.route if route is None else np.asarray(route, dtype=np.float64)
    pursuit = Pursuit(
        waypoints,
        building.closed and route is None,
        PursuitConfig(speed_mps=speed_mps, turn_rate_radps=turn_rate_radps),
    )
    hand = _Hand(unsteady, seed)
    drive = _Drive(pursuit, hand, waypoints, acceleration_mps2, turn_acceleration_radps2, rest_s, laps)
    offsets_s = laser.time_increment_s * np.arange(laser.beams)
    rng = np.random.default_rng(seed)
    mounting = np.asarray(base_t_laser, dtype=np.float64)
    number = 0
    while max_scans is None or number < max_scans:
        began_s = number * laser.period_s
        times_s, map_t_base = drive.until(began_s + offsets_s[-1])
        if drive.over:
            return
        asked = began_s + offsets_s
        poses = np.stack([np.interp(asked, times_s, map_t_base[:, i]) for i in range(3)], axis=-1)
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, 0] += cosine * mounting[0] - sine * mounting[1]
        poses[:, 1] += sine * mounting[0] + cosine * mounting[1]
        poses[:, 2] += mounting[2]
        yield _FIRST_NS + round(began_s * 1e9), laser.measure(building, poses, rng), poses[0].copy()
        number += 1


class _Hand:
    """Whoever drives: not always at the same speed, up to a share slower."""

    def __init__(self, unsteady: float, seed: int) -> None:
        if not 0.0 <= unsteady < 1.0:
            raise ValueError(f"unsteady = {unsteady}, must be in [0, 1)")
        self._unsteady, self._rng = unsteady, np.random.default_rng((seed, 1))
        self._share, self._left = 1.0, 0

    def share(self) -> float:
        """Return at which share of the speed that is asked for the robot is driven in the next step."""
        if self._left == 0:
            self._left = round(self._rng.uniform(*_STEADY_S) / _STEP_S)
            self._share = 1.0 - self._unsteady * float(self._rng.random())
        self._left -= 1
        return self._share


class _Drive:
    """The motion of the base in steps of 10 ms, made as far as it is asked for."""

    def __init__(
        self,
        pursuit: Pursuit,
        hand: _Hand,
        route: Array,
        acceleration: float,
        turn_acceleration: float,
        rest_s: float,
        laps: int,
    ) -> None:
        heading = np.arctan2(*(route[1] - route[0])[::-1])
        self._pursuit, self._hand, self._laps, self._rest_s = pursuit, hand, laps, rest_s
        self._dv, self._dw = acceleration * _STEP_S, turn_acceleration * _STEP_S
        self._pose = (float(route[0, 0]), float(route[0, 1]), float(heading))
        self._v = self._w = 0.0
        self._knots: list[tuple[float, float, float, float]] = [(0.0, *self._pose)]
        self._steps = 0
        self.over = False
        """Whether the drive ended before the time that was asked for."""

    def until(self, time_s: float) -> tuple[Array, Array]:
        """Return times (K,) and poses (K, 3) of the last half second up to at least `time_s`."""
        while self._knots[-1][0] <= time_s and not self.over:
            self._step()
        del self._knots[:-64]
        knots = np.array(self._knots)
        return knots[:, 0], knots[:, 1:]

    def _step(self) -> None:
        finished = self._pursuit.laps >= self._laps
        if finished and self._v == 0.0 and self._w == 0.0:
            self.over = True
            return
        v, w = (0.0, 0.0)
        if self._steps * _STEP_S >= self._rest_s and not finished:
            share = self._hand.share()
            v, w = (share * asked for asked in self._pursuit.command(np.array(self._pose)))
        self._v += min(max(v - self._v, -self._dv), self._dv)
        self._w += min(max(w - self._w, -self._dw), self._dw)
        x, y, yaw = self._pose
        middle = yaw + self._w * _STEP_S / 2.0
        x += self._v * _STEP_S * np.cos(middle)
        y += self._v * _STEP_S * np.sin(middle)
        self._pose = (float(x), float(y), yaw + self._w * _STEP_S)
        self._steps += 1
        self._knots.append((self._steps * _STEP_S, *self._pose))
