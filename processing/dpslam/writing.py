"""Writing a sweep: metres along each ray, a stop at its end, and the moments of the blocks it touched.

Only what is in `laser_model`'s words goes into a cell; the order of the rays is the order of the sweep.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.dpslam.grid import (
    _STORE,
    BLOCK,
    BLOCKS,
    CELL_M,
    METRES,
    MOMENTS,
    NONE,
    PLACES,
    STOPS,
    TILE,
    Arrays,
    Table,
    own_tile,
)
from processing.dpslam.laser_model import (
    CELLS_PER_M,
    NOWHERE,
    OCCUPIED,
    TILE_BITS,
    axis,
    stop_probability,
)

MOST_WEIGHT = 10.0
"""Stops beyond which a cell weighs no more in the matcher's reference."""
_BLOCK_BITS = 2


@njit("void(u2[:,::1], u2[:,::1], f4[:,::1], u1[:,::1], i4)", cache=True, nogil=True)
def renew_blocks(
    cells: NDArray[np.uint16],
    ends: NDArray[np.uint16],
    blocks: NDArray[np.float32],
    stale: NDArray[np.uint8],
    tile: int,
) -> None:
    """Compute anew the moments of the tile's blocks whose cells have changed."""
    stale[tile, 0] &= 1
    for block in range(BLOCKS * BLOCKS):
        if stale[tile, block] == 0:
            continue
        stale[tile, block] = 0
        n = sx = sy = sxx = sxy = syy = 0.0
        corner = ((block // BLOCKS) * BLOCK * TILE + (block % BLOCKS) * BLOCK) * 2
        for r in range(BLOCK):
            for c in range(BLOCK):
                at = corner + (r * TILE + c) * 2
                stops, metres = cells[tile, at] / STOPS, cells[tile, at + 1] / METRES
                if stops <= 0.0 or stop_probability(stops, metres, CELL_M) < OCCUPIED:
                    continue
                w = min(stops, MOST_WEIGHT)
                px, py = (c + ends[tile, at] / PLACES) * CELL_M, (r + ends[tile, at + 1] / PLACES) * CELL_M
                n += w
                sx += w * px
                sy += w * py
                sxx += w * px * px
                sxy += w * px * py
                syy += w * py * py
        at = block * MOMENTS
        blocks[tile, at], blocks[tile, at + 1], blocks[tile, at + 2] = n, sx, sy
        blocks[tile, at + 3], blocks[tile, at + 4], blocks[tile, at + 5] = sxx, sxy, syy


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

    `first_row`, `first_col`: tile of the table's corner. `memory`: observations after which a cell starts to
    forget (an exponential window), so that what has moved away fades. `touched` takes the tiles written to.

    Returns:
        The number of tiles in `touched`.
    """
    cells, ends, blocks, stale = store[0], store[1], store[2], store[3]
    most = int(memory * CELL_M * METRES)
    count = 0
    for i in range(rays_map.shape[0]):
        u0, v0 = rays_map[i, 0] * CELLS_PER_M, rays_map[i, 1] * CELLS_PER_M
        u1, v1 = rays_map[i, 2] * CELLS_PER_M, rays_map[i, 3] * CELLS_PER_M
        length = np.hypot(u1 - u0, v1 - v0) * CELL_M
        step, next_x, way_x = axis(u0, u1)
        step_x = int(step)
        step, next_y, way_y = axis(v0, v1)
        step_y = int(step)
        col, row = int(np.floor(u0)), int(np.floor(v0))
        tile_row, tile_col, tile = NOWHERE, NOWHERE, NONE
        at = 0.0
        while True:
            last = next_x >= 1.0 and next_y >= 1.0
            until = 1.0 if last else min(next_x, next_y)
            if row >> TILE_BITS != tile_row or col >> TILE_BITS != tile_col:
                tile_row, tile_col = row >> TILE_BITS, col >> TILE_BITS
                tile = own_tile(store, table, particle, tile_row - first_row, tile_col - first_col)
                if stale[tile, 0] < 2:
                    stale[tile, 0] |= 2
                    touched[count] = tile
                    count += 1
            r, c = row & (TILE - 1), col & (TILE - 1)
            k = (r * TILE + c) * 2
            stops = int(cells[tile, k])
            metres = int(cells[tile, k + 1]) + int((until - at) * length * METRES + 0.5)
            if last:
                stops += int(STOPS)
                share = STOPS / stops
                x = min(max((u1 - col) * PLACES, 0.0), PLACES - 1.0)
                y = min(max((v1 - row) * PLACES, 0.0), PLACES - 1.0)
                ends[tile, k] = int(ends[tile, k] + (x - ends[tile, k]) * share + 0.5)
                ends[tile, k + 1] = int(ends[tile, k + 1] + (y - ends[tile, k + 1]) * share + 0.5)
            if stops > 0:
                stale[tile, (r >> _BLOCK_BITS) * BLOCKS + (c >> _BLOCK_BITS)] |= 1
                seen = stops / STOPS + metres * (CELLS_PER_M / METRES)
                if seen > memory:
                    # Rounded down, so that what nobody sees any more does vanish.
                    stops, metres = int(stops * (memory / seen)), int(metres * (memory / seen))
                cells[tile, k] = stops
            cells[tile, k + 1] = min(metres, most)
            if last:
                break
            at = until
            if next_x <= next_y:
                col += step_x
                next_x += way_x
            else:
                row += step_y
                next_y += way_y
    for k in range(count):
        renew_blocks(cells, ends, blocks, stale, touched[k])
    return count
