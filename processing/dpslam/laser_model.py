"""The laser model of DP-SLAM 2.0: how far a ray travels through a cell against how often rays stop there.

A cell that rays crossed for d metres and in which h of them stopped has the density rho = (h + rho0 d0) / (d + d0),
where rho0 is the density of unseen space and d0 its strength. A ray stops within a stretch x of the cell with
probability 1 - exp(-rho x). The likelihood of a reading is the sum, over the cells of its ray, of
P(it came so far) P(it stops here) exp(-e^2 / 2 sigma^2), e being the reading's distance from the cell.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.dpslam.grid import (
    _STORE,
    BLOCK,
    BLOCKS,
    CELL_M,
    NONE,
    TILE,
    Arrays,
    Table,
    own_tile,
)

PRIOR_DENSITY = 1.0 / 8.0
"""Stops per metre in unseen space."""
PRIOR_M = 0.05
"""Metres of travel that the prior weighs as much as."""
NEAR_M = 0.2
"""How far before and behind a reading the likelihood looks for what stopped it: 4 sigma."""
SIGMA_M = 0.05
FLOOR = 0.01
"""Likelihood of a reading by whatever the map does not know: people, glass, dirt."""
OCCUPIED = 0.25
"""A cell counts for the matcher's reference if a ray that crosses its width stops with this probability."""


@njit("UniTuple(f8, 4)(f8, f8)", cache=True, nogil=True)
def _axis(start: float, end: float) -> tuple[float, float, float, float]:
    """Prepare one axis of a walk over cells: first cell, step, way to the first border, way between borders.

    `start` and `end` in cells; ways in fractions of the ray.
    """
    cell = np.floor(start)
    d = end - start
    if d > 0.0:
        return cell, 1.0, (cell + 1.0 - start) / d, 1.0 / d
    if d < 0.0:
        return cell, -1.0, (cell - start) / d, -1.0 / d
    return cell, 0.0, np.inf, np.inf


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
    density = (stops + PRIOR_DENSITY * PRIOR_M) / (travelled + PRIOR_M)
    return float(1.0 - np.exp(-density * stretch))


@njit("void(f4[:,:,:,::1], f4[:,:,:,::1], u1[:,:,::1], i4)", cache=True, nogil=True)
def _renew_blocks(
    cells: NDArray[np.float32], blocks: NDArray[np.float32], stale: NDArray[np.uint8], tile: int
) -> None:
    """Compute anew the moments of the tile's blocks whose cells have changed."""
    stale[tile, 0, 0] &= 1
    for block_row in range(BLOCKS):
        for block_col in range(BLOCKS):
            if stale[tile, block_row, block_col] == 0:
                continue
            stale[tile, block_row, block_col] = 0
            n = sx = sy = sxx = sxy = syy = 0.0
            for r in range(BLOCK):
                for c in range(BLOCK):
                    cell = cells[tile, block_row * BLOCK + r, block_col * BLOCK + c]
                    if cell[0] <= 0.0 or stop_probability(cell[0], cell[1], CELL_M) < OCCUPIED:
                        continue
                    w = min(float(cell[0]), 10.0)
                    px, py = cell[2] / cell[0] + c * CELL_M, cell[3] / cell[0] + r * CELL_M
                    n += w
                    sx += w * px
                    sy += w * py
                    sxx += w * px * px
                    sxy += w * px * py
                    syy += w * py * py
            block = blocks[tile, block_row, block_col]
            block[0], block[1], block[2] = n, sx, sy
            block[3], block[4], block[5] = sxx, sxy, syy


@njit(f"i8({_STORE}, i4[:,:,::1], i8, i8, i8, f8[:,::1], f8, i4[::1])", cache=True, nogil=True)
def write_rays(
    store: Arrays,
    table: Table,
    particle: int,
    first_row: int,
    first_col: int,
    rays_map: NDArray[np.float64],
    memory: float,
    touched: NDArray[np.int32],
) -> int:
    """Write the sweep into one particle's map: metres along each ray, a stop at its end.

    `first_row`, `first_col`: tile of the table's corner. `memory`: observations after which a cell starts to forget
    (an exponential window), so that what has moved away fades. `touched` takes the tiles written to.

    Returns:
        The number of tiles in `touched`.
    """
    cells, blocks, stale = store[0], store[1], store[2]
    count = 0
    for i in range(rays_map.shape[0]):
        u0, v0 = rays_map[i, 0] / CELL_M, rays_map[i, 1] / CELL_M
        u1, v1 = rays_map[i, 2] / CELL_M, rays_map[i, 3] / CELL_M
        length = np.hypot(u1 - u0, v1 - v0) * CELL_M
        x, step_x, next_x, way_x = _axis(u0, u1)
        y, step_y, next_y, way_y = _axis(v0, v1)
        col, row = int(x), int(y)
        at = 0.0
        tile_row, tile_col, tile = -(1 << 30), -(1 << 30), NONE
        while True:
            last = next_x >= 1.0 and next_y >= 1.0
            until = 1.0 if last else min(next_x, next_y)
            if row // TILE != tile_row or col // TILE != tile_col:
                tile_row, tile_col = row // TILE, col // TILE
                tile = own_tile(store, table, particle, tile_row - first_row, tile_col - first_col)
                if stale[tile, 0, 0] < 2:
                    stale[tile, 0, 0] |= 2
                    touched[count] = tile
                    count += 1
            r, c = row - tile_row * TILE, col - tile_col * TILE
            cell = cells[tile, r, c]
            cell[1] += np.float32((until - at) * length)
            if last:
                cell[0] += np.float32(1.0)
                cell[2] += np.float32((u1 - col) * CELL_M)
                cell[3] += np.float32((v1 - row) * CELL_M)
            if cell[0] > 0.0:
                stale[tile, r // BLOCK, c // BLOCK] |= 1
                seen = cell[0] + cell[1] / CELL_M
                if seen > memory:
                    keep = np.float32(memory / seen)
                    for k in range(4):
                        cell[k] *= keep
            elif cell[1] > memory * CELL_M:
                cell[1] = np.float32(memory * CELL_M)
            if last:
                break
            at = until
            if next_x <= next_y:
                col += int(step_x)
                next_x += way_x
            else:
                row += int(step_y)
                next_y += way_y
    for k in range(count):
        _renew_blocks(cells, blocks, stale, touched[k])
    return count


@njit(f"f8({_STORE}, i4[:,:,::1], i8, i8, i8, f8[:,::1], i8, i8, b1)", cache=True, nogil=True)
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
) -> float:
    """Return the log-likelihood of rays `begin`, `begin + every`, ... in one particle's map.

    `whole`: walk from the laser; else only the stretch around the reading, as if the way there were free.
    """
    cells = store[0]
    rows, cols = table.shape[1], table.shape[2]
    total = 0.0
    for i in range(begin, rays_map.shape[0], every):
        dx, dy = rays_map[i, 2] - rays_map[i, 0], rays_map[i, 3] - rays_map[i, 1]
        reading = np.hypot(dx, dy)
        if reading <= 0.0:
            continue
        dx, dy = dx / reading, dy / reading
        start = 0.0 if whole else max(0.0, reading - NEAR_M)
        end = reading + NEAR_M
        u0, v0 = (rays_map[i, 0] + start * dx) / CELL_M, (rays_map[i, 1] + start * dy) / CELL_M
        u1, v1 = (rays_map[i, 0] + end * dx) / CELL_M, (rays_map[i, 1] + end * dy) / CELL_M
        length = end - start
        x, step_x, next_x, way_x = _axis(u0, u1)
        y, step_y, next_y, way_y = _axis(v0, v1)
        col, row = int(x), int(y)
        at = 0.0
        depth = 0.0
        likelihood = 0.0
        tile_row, tile_col, tile = -(1 << 30), -(1 << 30), NONE
        while True:
            last = next_x >= 1.0 and next_y >= 1.0
            until = 1.0 if last else min(next_x, next_y)
            if row // TILE != tile_row or col // TILE != tile_col:
                tile_row, tile_col = row // TILE, col // TILE
                tile = NONE
                if 0 <= tile_row - first_row < rows and 0 <= tile_col - first_col < cols:
                    tile = table[particle, tile_row - first_row, tile_col - first_col]
            density = PRIOR_DENSITY
            if tile != NONE:
                cell = cells[tile, row - tile_row * TILE, col - tile_col * TILE]
                density = (cell[0] + PRIOR_DENSITY * PRIOR_M) / (cell[1] + PRIOR_M)
            thick = density * (until - at) * length
            error = start + 0.5 * (at + until) * length - reading
            if abs(error) < NEAR_M:
                stops = np.exp(-depth) - np.exp(-depth - thick)
                likelihood += stops * np.exp(-0.5 * (error / SIGMA_M) ** 2)
            depth += thick
            # Nothing comes through any more: what follows cannot add to the sum.
            if last or depth > 30.0:
                break
            at = until
            if next_x <= next_y:
                col += int(step_x)
                next_x += way_x
            else:
                row += int(step_y)
                next_y += way_y
        total += np.log(FLOOR + likelihood)
    return total
