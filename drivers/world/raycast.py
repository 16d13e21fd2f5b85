"""Rays against walls and pillars, all at once.

Each ray has its own origin and direction, because a laser moves while it sweeps.  What no ray of the sweep
can reach is left out first; the rest is three small matrix products.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.world.building import Array, Building, nearest_on_walls

_SEAM_M = 1e-9
"""By how much a wall is taken longer at both ends, so that no ray slips through a corner."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where the rays of one sweep end."""

    ranges_m: Array
    """(N,) distance to what was hit first, +inf if nothing."""
    incidence_cos: Array
    """(N,) cosine between ray and surface normal: 1 head-on, 0 grazing; 0 where nothing was hit."""
    dark: NDArray[np.bool_]
    """(N,) whether the surface reflects little."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Origins relative to `centre`, unit directions; the two shapes of every product below."""

    centre: Array
    ox: Array
    oy: Array
    dx: Array
    dy: Array
    reach_m: float
    """As far as anything is looked for, from any origin."""
    cull_m: float
    """What is further than this from `centre` no ray can reach."""


def cast(building: Building, origins: ArrayLike, bearings_rad: ArrayLike, reach_m: float = np.inf) -> Hits:
    """Send rays into a building.

    Args:
        building: What stands in the way.
        origins: (2,) for all rays or (N, 2) for each, m, map frame.
        bearings_rad: (N,) directions in the map frame.
        reach_m: Nothing further away is looked for.

    Returns:
        The first hit of each ray, in the order of the rays.
    """
    bearings = np.asarray(bearings_rad, dtype=np.float64)
    origins = np.broadcast_to(np.asarray(origins, dtype=np.float64), (len(bearings), 2))
    if len(bearings) == 0:
        return Hits(np.empty(0), np.empty(0), np.empty(0, dtype=bool))
    centre = origins[len(origins) // 2]
    ox, oy = np.ascontiguousarray((origins - centre).T)
    cull_m = reach_m + float(np.hypot(ox, oy).max())
    rays = _Rays(centre, ox, oy, np.cos(bearings), np.sin(bearings), reach_m, cull_m)
    walls, pillars = _walls(building, rays), _pillars(building.pillars, rays)
    if pillars is None:
        return walls
    nearer = pillars.ranges_m < walls.ranges_m
    return Hits(
        np.where(nearer, pillars.ranges_m, walls.ranges_m),
        np.where(nearer, pillars.incidence_cos, walls.incidence_cos),
        walls.dark & ~nearer,
    )


def _walls(building: Building, rays: _Rays) -> Hits:
    """Meet every ray with every wall in reach; O(rays x walls in reach)."""
    walls, dark = building.walls, building.dark
    assert dark is not None  # filled in by Building
    if np.isfinite(rays.reach_m):
        away = nearest_on_walls(walls, rays.centre) - rays.centre
        near = np.hypot(away[:, 0], away[:, 1]) <= rays.cull_m
        walls, dark = walls[near], dark[near]
    count = len(rays.dx)
    if not len(walls):
        return Hits(np.full(count, np.inf), np.zeros(count), np.zeros(count, dtype=bool))
    # Relative to the middle of the sweep the products below lose nothing to large coordinates.
    ax, ay = walls[:, 0] - rays.centre[0], walls[:, 1] - rays.centre[1]
    ex, ey = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    length = np.maximum(np.hypot(ex, ey), 1e-12)
    ex, ey = ex / length, ey / length
    ox, oy, dx, dy = rays.ox, rays.oy, rays.dx, rays.dy
    # Ray o + t d meets wall a + u e, |d| = |e| = 1: t = (a - o) x e / d x e, u = (a - o) x d / d x e.
    sine = np.stack((dx, dy), axis=1) @ np.stack((ey, -ex))
    along_ray = np.stack((np.ones(count), ox, oy), axis=1) @ np.stack((ax * ey - ay * ex, -ey, ex))
    along_wall = np.stack((dy, -dx, dx * oy - dy * ox), axis=1) @ np.stack((ax, ay, np.ones(len(ax))))
    with np.errstate(divide="ignore", invalid="ignore"):
        along_ray /= sine
        along_wall /= sine
    met = (along_ray > 0.0) & (along_wall >= -_SEAM_M) & (along_wall <= length + _SEAM_M)
    along_ray[~met] = np.inf
    first, rows = np.argmin(along_ray, axis=1), np.arange(count)
    distance = along_ray[rows, first]
    hit = distance <= rays.reach_m
    return Hits(
        np.where(hit, distance, np.inf),
        np.abs(sine[rows, first]) * hit,
        dark[first] & hit & np.isfinite(distance),
    )


def _pillars(pillars: Array, rays: _Rays) -> Hits | None:
    """Meet every ray with every pillar in reach; None if there is none."""
    if not len(pillars):
        return None
    px, py, radius = pillars[:, 0] - rays.centre[0], pillars[:, 1] - rays.centre[1], pillars[:, 2]
    near = np.hypot(px, py) - radius <= rays.cull_m
    if not near.any():
        return None
    px, py, radius = px[near] - rays.ox[:, None], py[near] - rays.oy[:, None], radius[near]
    dx, dy = rays.dx[:, None], rays.dy[:, None]
    ahead, aside = px * dx + py * dy, px * dy - py * dx
    half_2 = radius**2 - aside**2
    half = np.sqrt(np.maximum(half_2, 0.0))
    distance = np.where((half_2 > 0.0) & (ahead > half), ahead - half, np.inf)
    first, rows = np.argmin(distance, axis=1), np.arange(len(rays.dx))
    nearest = distance[rows, first]
    hit = nearest <= rays.reach_m
    cosine = (half[rows, first] / radius[first]) * hit
    return Hits(np.where(hit, nearest, np.inf), cosine, np.zeros(len(hit), dtype=bool))
