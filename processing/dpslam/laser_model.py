"""The laser model of DP-SLAM 2.0: how far a ray travels through a cell against how often rays stop there.

A cell that rays crossed for d metres and in which h of them stopped has the density rho = (h + rho0 d0) / (d
+ d0), where rho0 is the density of unseen space and d0 its strength. A ray stops within a stretch x of the
cell with probability 1 - exp(-rho x). The likelihood of a reading is the sum, over the cells of its ray, of
P(it came so far) P(it stops here) N(e), where e is the reading's distance from the cell and N falls like a
normal density from 1 at 0: N(e) = (1 - (e / 4 sigma)^2)^8, without its endless ends.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.dpslam.grid import (
    _STORE,
    METRES,
    NONE,
    STOPS,
    TILE,
    Arrays,
    Table,
)

PRIOR_DENSITY = 1.0 / 8.0
"""Stops per metre in unseen space."""
PRIOR_M = 0.05
"""Metres of travel that the prior weighs as much as."""
PRIOR_STOPS = PRIOR_DENSITY * PRIOR_M
SIGMA_M = 0.05
NEAR_M = 4.0 * SIGMA_M
"""How far before and behind a reading the likelihood looks for what stopped it."""
FLOOR = 0.01
"""Likelihood of a reading by whatever the map does not know: people, glass, dirt."""
OCCUPIED = 0.25
"""A cell counts for the matcher's reference if a ray that crosses its width stops with this probability."""
OPAQUE = 30.0
"""Optical depth through which nothing comes."""

CELLS_PER_M = 20.0
TILE_BITS = 5
NOWHERE = -(1 << 40)
_STOPS_PER_METRES = METRES / STOPS
_PRIOR_STOPS = PRIOR_STOPS * METRES
_PRIOR_METRES = PRIOR_M * METRES


@njit("UniTuple(f8, 3)(f8, f8)", cache=True, nogil=True)
def axis(start: float, end: float) -> tuple[float, float, float]:
    """Prepare one axis of a walk over cells: step, way to the first border, way between borders.

    `start` and `end` in cells; ways in fractions of the ray.
    """
    cell = np.floor(start)
    d = end - start
    if d > 0.0:
        return 1.0, (cell + 1.0 - start) / d, 1.0 / d
    if d < 0.0:
        return -1.0, (cell - start) / d, -1.0 / d
    return 0.0, np.inf, np.inf


@njit("void(f8[::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def place_rays(
    map_t_laser: NDArray[np.float64], rays_laser: NDArray[np.float64], rays_map: NDArray[np.float64]
) -> None:
    """Move rays (N, 4) = start x, y, end x, y from the laser's frame to the map's."""
    c, s = np.cos(map_t_laser[2]), np.sin(map_t_laser[2])
    for i in range(rays_laser.shape[0]):
        for k in range(0, 4, 2):
            x, y = rays_laser[i, k], rays_laser[i, k + 1]
            rays_map[i, k] = c * x - s * y + map_t_laser[0]
            rays_map[i, k + 1] = s * x + c * y + map_t_laser[1]


@njit("f8(f8, f8, f8)", cache=True, nogil=True)
def stop_probability(stops: float, travelled: float, stretch: float) -> float:
    """Return the probability that a ray stops within `stretch` metres of a cell."""
    density = (stops + PRIOR_STOPS) / (travelled + PRIOR_M)
    return float(1.0 - np.exp(-density * stretch))


@njit(f"f8({_STORE}, i4[:,:,::1], i8, i8, i8, f8[:,::1], i8, b1, f8)", cache=True, nogil=True)
def _likelihood(
    store: Arrays,
    table: Table,
    particle: int,
    first_row: int,
    first_col: int,
    rays_map: NDArray[np.float64],
    i: int,
    whole: bool,
    unseen: float,
) -> float:
    """Return the likelihood of ray i; see `score_rays`."""
    cells = store[0]
    rows, cols = table.shape[1], table.shape[2]
    dx, dy = rays_map[i, 2] - rays_map[i, 0], rays_map[i, 3] - rays_map[i, 1]
    reading = np.hypot(dx, dy)
    if reading <= 0.0:
        return FLOOR
    dx, dy = dx / reading, dy / reading
    start = 0.0 if whole else max(0.0, reading - NEAR_M)
    length = reading + NEAR_M - start
    u0 = (rays_map[i, 0] + start * dx) * CELLS_PER_M
    v0 = (rays_map[i, 1] + start * dy) * CELLS_PER_M
    u1 = (rays_map[i, 0] + (start + length) * dx) * CELLS_PER_M
    v1 = (rays_map[i, 1] + (start + length) * dy) * CELLS_PER_M
    step, next_x, way_x = axis(u0, u1)
    step_x = int(step)
    step, next_y, way_y = axis(v0, v1)
    step_y = int(step)
    col, row = int(np.floor(u0)), int(np.floor(v0))
    tile_row, tile_col, tile = NOWHERE, NOWHERE, NONE
    at = depth = likelihood = 0.0
    through = -1.0
    frontier = False
    while True:
        last = next_x >= 1.0 and next_y >= 1.0
        until = 1.0 if last else min(next_x, next_y)
        if row >> TILE_BITS != tile_row or col >> TILE_BITS != tile_col:
            tile_row, tile_col = row >> TILE_BITS, col >> TILE_BITS
            tile = NONE
            if 0 <= tile_row - first_row < rows and 0 <= tile_col - first_col < cols:
                tile = table[particle, tile_row - first_row, tile_col - first_col]
        density, seen = PRIOR_DENSITY, False
        if tile != NONE:
            k = ((row & (TILE - 1)) * TILE + (col & (TILE - 1))) * 2
            seen = cells[tile, k + 1] != 0
            density = (cells[tile, k] * _STOPS_PER_METRES + _PRIOR_STOPS) / (
                cells[tile, k + 1] + _PRIOR_METRES
            )
        thick = density * ((until - at) * length)
        off = (start + 0.5 * (at + until) * length - reading) * (1.0 / NEAR_M)
        near = 1.0 - off * off
        if near > 0.0:
            if through < 0.0:
                through = np.exp(-depth)
            passed = through * np.exp(-thick)
            near *= near
            near *= near
            if not (seen or frontier):
                frontier = True
                likelihood += unseen * through * (near * near if off > 0.0 else 1.0)
            likelihood += (through - passed) * (near * near)
            through = passed
        else:
            depth += thick
        if last or depth > OPAQUE or (through >= 0.0 and near <= 0.0):
            break
        at = until
        if next_x <= next_y:
            col += step_x
            next_x += way_x
        else:
            row += step_y
            next_y += way_y
    return float(FLOOR + likelihood)


@njit(f"f8({_STORE}, i4[:,:,::1], i8, i8, i8, f8[:,::1], i8, i8, b1, f8)", cache=True, nogil=True)
def score_rays(
    store: Arrays,
    table: Table,
    particle: int,
    first_row: int,
    first_col: int,
    rays_map: NDArray[np.float64],
    begin: int,
    every: int,
    whole: bool,
    unseen: float,
) -> float:
    """Return the log-likelihood of rays `begin`, `begin + every`, ... in one particle's map.

    `whole`: walk from the laser; else only the stretch around the reading, as if the way there were free.
    `unseen`: what a ray gains by coming to space that nobody has looked into where it was read, or before.
    """
    total = 0.0
    for i in range(begin, rays_map.shape[0], every):
        total += np.log(_likelihood(store, table, particle, first_row, first_col, rays_map, i, whole, unseen))
    return total


@njit(f"UniTuple(f8, 2)({_STORE}, i4[:,:,::1], i8, i8, i8, f8[:,::1])", cache=True, nogil=True)
def judge_rays(
    store: Arrays, table: Table, particle: int, first_row: int, first_col: int, rays_map: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the share of the rays that end in cells seen before, and the mean log-likelihood of those."""
    rows, cols = table.shape[1], table.shape[2]
    known, total = 0, 0.0
    for i in range(rays_map.shape[0]):
        col = int(np.floor(rays_map[i, 2] * CELLS_PER_M))
        row = int(np.floor(rays_map[i, 3] * CELLS_PER_M))
        at_row, at_col = (row >> TILE_BITS) - first_row, (col >> TILE_BITS) - first_col
        if at_row < 0 or at_row >= rows or at_col < 0 or at_col >= cols:
            continue
        tile = table[particle, at_row, at_col]
        if tile == NONE or store[0][tile, ((row & (TILE - 1)) * TILE + (col & (TILE - 1))) * 2 + 1] == 0:
            continue
        known += 1
        total += np.log(_likelihood(store, table, particle, first_row, first_col, rays_map, i, True, 0.0))
    return known / max(rays_map.shape[0], 1), total / max(known, 1)
