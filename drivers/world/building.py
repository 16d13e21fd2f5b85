"""A building seen by a laser at one height: straight walls and round pillars, and a free way through it.

The law of the file: a building never changes.  What moves is the robot, and it lives in `robot.py`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max in metres."""


@dataclass(frozen=True, eq=False)
class Building:
    """Walls and pillars in the map frame, metres, and a route along which a robot can drive."""

    walls: Array
    """(S, 4): x, y of one end, x, y of the other."""
    pillars: Array = field(default_factory=lambda: np.empty((0, 3)))
    """(P, 3): x, y of the centre, radius."""
    dark: NDArray[np.bool_] | None = None
    """(S,) walls that reflect so little that a laser sees them only from near; None = no such wall."""
    route: Array = field(default_factory=lambda: np.zeros((1, 2)))
    """(W, 2) waypoints of a free way; the first is where the robot starts, looking at the second."""
    closed: bool = False
    """Whether the route leads from its last waypoint back to its first."""
    name: str = "building"

    def __post_init__(self) -> None:
        walls = np.ascontiguousarray(self.walls, dtype=np.float64).reshape(-1, 4)
        pillars = np.ascontiguousarray(self.pillars, dtype=np.float64).reshape(-1, 3)
        dark = np.zeros(len(walls), dtype=bool) if self.dark is None else np.asarray(self.dark, dtype=bool)
        if dark.shape != (len(walls),):
            raise ValueError(f"dark has shape {dark.shape}, must be ({len(walls)},), one for each wall")
        if len(pillars) and pillars[:, 2].min() <= 0.0:
            raise ValueError(f"radius of a pillar = {pillars[:, 2].min()} m, must be positive")
        for name, value in (("walls", walls), ("pillars", pillars), ("dark", dark)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "route", np.asarray(self.route, dtype=np.float64).reshape(-1, 2))

    @property
    def extent_m(self) -> Rectangle:
        """Smallest upright rectangle around all walls and pillars."""
        ends = self.walls.reshape(-1, 2)
        low, high = [ends], [ends]
        if len(self.pillars):
            low.append(self.pillars[:, :2] - self.pillars[:, 2:])
            high.append(self.pillars[:, :2] + self.pillars[:, 2:])
        (x0, y0), (x1, y1) = np.concatenate(low).min(axis=0), np.concatenate(high).max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    @property
    def start(self) -> Array:
        """Pose (3,) at the first waypoint, looking along the route."""
        here, ahead = self.route[0], self.route[min(1, len(self.route) - 1)]
        return np.array((*here, np.arctan2(ahead[1] - here[1], ahead[0] - here[0])))

    def nearest(self, point: ArrayLike) -> tuple[float, Array]:
        """Return the distance from a point (2,) to what is nearest, and the place (2,) where that is."""
        point = np.asarray(point, dtype=np.float64)
        best, place = np.inf, np.full(2, np.nan)
        if len(self.walls):
            feet = nearest_on_walls(self.walls, point)
            distances = np.hypot(feet[:, 0] - point[0], feet[:, 1] - point[1])
            at = int(np.argmin(distances))
            best, place = float(distances[at]), feet[at]
        if len(self.pillars):
            away = point - self.pillars[:, :2]
            reach = np.hypot(away[:, 0], away[:, 1])
            at = int(np.argmin(reach - self.pillars[:, 2]))
            if (distance := float(reach[at] - self.pillars[at, 2])) < best:
                outward = away[at] / reach[at] if reach[at] > 0.0 else np.array((1.0, 0.0))
                best, place = distance, self.pillars[at, :2] + outward * self.pillars[at, 2]
        return best, place


def nearest_on_walls(walls: Array, point: Array) -> Array:
    """Return for each wall (S, 4) its place (S, 2) nearest to the point (2,)."""
    start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    length_2 = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    share = np.clip(np.einsum("ij,ij->i", point - start, along) / length_2, 0.0, 1.0)
    return np.asarray(start + share[:, None] * along)


def box(x_min: float, y_min: float, x_max: float, y_max: float) -> Array:
    """Return the four walls (4, 4) of a piece of furniture."""
    return np.array(
        (
            (x_min, y_min, x_max, y_min),
            (x_max, y_min, x_max, y_max),
            (x_max, y_max, x_min, y_max),
            (x_min, y_max, x_min, y_min),
        )
    )


def outline(free: Iterable[Rectangle]) -> Array:
    """Return the walls (S, 4) around a floor that is the union of upright rectangles.

    Rooms, corridors and the thickness of walls in doors are all such rectangles, so no generator has to keep
    wall ends together by hand: where the floor ends there is a wall, and a building cannot leak.
    """
    rectangles = np.asarray(list(free), dtype=np.float64).reshape(-1, 4)
    if not len(rectangles):
        raise ValueError("a floor needs at least one rectangle")
    if (bad := (rectangles[:, 0] >= rectangles[:, 2]) | (rectangles[:, 1] >= rectangles[:, 3])).any():
        raise ValueError(
            f"rectangle {tuple(rectangles[bad][0].tolist())}, must be x_min < x_max, y_min < y_max"
        )
    xs, ys = np.unique(rectangles[:, 0::2]), np.unique(rectangles[:, 1::2])
    floor = np.zeros((len(xs) + 1, len(ys) + 1), dtype=bool)  # with a rim of "outside"
    for x0, y0, x1, y1 in rectangles:
        columns = slice(np.searchsorted(xs, x0) + 1, np.searchsorted(xs, x1) + 1)
        floor[columns, np.searchsorted(ys, y0) + 1 : np.searchsorted(ys, y1) + 1] = True
    upright = floor[1:, :] != floor[:-1, :]
    flat = floor[:, 1:] != floor[:, :-1]
    walls = [
        (x, ys[a - 1], x, ys[b - 1]) for x, edge in zip(xs, upright, strict=True) for a, b in _runs(edge)
    ]
    walls += [
        (xs[a - 1], y, xs[b - 1], y) for y, edge in zip(ys, flat.T, strict=True) for a, b in _runs(edge)
    ]
    return np.array(walls)


def _runs(flags: NDArray[np.bool_]) -> Sequence[tuple[int, int]]:
    """Return first index and index after the last of each run of true values."""
    steps = np.flatnonzero(np.diff(np.concatenate(((False,), flags, (False,))).astype(np.int8)))
    return [(int(a), int(b)) for a, b in steps.reshape(-1, 2)]
