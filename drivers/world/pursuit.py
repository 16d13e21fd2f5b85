"""Steering along a route, as somebody would who sees the building: pure pursuit, and turning on the spot."""

from dataclasses import dataclass

import numpy as np

from drivers.world.building import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class PursuitConfig:
    """Speeds and distances of the steering."""

    speed_mps: float = 0.3
    turn_rate_radps: float = 1.0
    lookahead_m: float = 0.35
    arrived_m: float = 0.08
    """A waypoint counts as reached when so much of its leg is left."""
    turn_on_spot_rad: float = 0.7
    """Beyond this error of heading the robot turns without driving."""

    def __post_init__(self) -> None:
        for name in ("speed_mps", "turn_rate_radps", "lookahead_m", "arrived_m", "turn_on_spot_rad"):
            if not 0.0 < getattr(self, name) <= 10.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in (0, 10]")


class Pursuit:
    """Drives a route (W, 2) once, or round and round if it is closed; answers a pose with a velocity."""

    def __init__(self, route: Array, closed: bool, config: PursuitConfig | None = None) -> None:
        route = np.asarray(route, dtype=np.float64).reshape(-1, 2)
        if len(route) < 2:
            raise ValueError(f"a route has {len(route)} waypoints, must be at least 2")
        self._ends = np.vstack((route[1:], route[:1])) if closed else route[1:]
        self._starts = route if closed else route[:-1]
        self._closed = closed
        self._config = config or PursuitConfig()
        self._leg = 0
        self.laps = 0
        """How often the whole route was driven."""

    @property
    def done(self) -> bool:
        """Whether an open route has been driven to its end."""
        return not self._closed and self.laps > 0

    def command(self, map_t_base: Array) -> tuple[float, float]:
        """Return forward speed (m/s) and turn rate (rad/s, left positive) for the present pose (3,)."""
        config = self._config
        position = np.asarray(map_t_base[:2], dtype=np.float64)
        for _ in range(len(self._ends)):
            start, end = self._starts[self._leg], self._ends[self._leg]
            length = float(np.hypot(*(end - start)))
            direction = (end - start) / max(length, 1e-9)
            covered = float((position - start) @ direction)
            if length - covered > config.arrived_m:
                break
            self._leg = (self._leg + 1) % len(self._ends)
            self.laps += self._leg == 0
            if self.done:
                break
        if self.done:
            return 0.0, 0.0
        target = self._target(start, direction, length, max(covered, 0.0) + config.lookahead_m)
        dx, dy = target - position
        error = (np.arctan2(dy, dx) - map_t_base[2] + np.pi) % (2.0 * np.pi) - np.pi
        if abs(error) > config.turn_on_spot_rad:
            return 0.0, float(np.copysign(config.turn_rate_radps, error))
        distance = max(float(np.hypot(dx, dy)), 0.1)
        # Slow down where the arc to the target would need more than the turn rate.
        curvature = 2.0 * np.sin(error) / distance
        speed = config.speed_mps * np.cos(error)
        if abs(speed * curvature) > config.turn_rate_radps:
            speed = config.turn_rate_radps / abs(curvature)
        return float(speed), float(speed * curvature)

    def _target(self, start: Array, direction: Array, length: float, along: float) -> Array:
        """Return the point of the route to steer for; it turns into the next leg unless that leads back."""
        following = (self._leg + 1) % len(self._ends)
        if along <= length or (following == 0 and not self._closed):
            return np.asarray(start + direction * min(along, length))
        end, way = self._ends[self._leg], self._ends[following] - self._starts[following]
        way = way / max(float(np.hypot(*way)), 1e-9)
        # Past a sharp corner the target would pull the robot back before it has arrived.
        return np.asarray(
            end + way * (along - length) if way @ direction > -0.2 else start + direction * length
        )
