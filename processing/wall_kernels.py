"""Compiled inner loop that continues the walls of a Normal Distributions Transform past their seen ends.

At the border of what was seen a scan shows more of a wall than the map has. Each point beyond would count as
a misfit, and the scan be drawn back along the wall to where fewer are: a robot in a corridor would stand
still. Arrays as in `processing.ndt_kernels`.
"""

import numpy as np
from numba import njit

WALL_INFORMATION = 1.0
"""Information (1/m^2) along a block under which it is a wall; the least of any other is about twelve."""


@njit("i8(f8[::1], i4[:,:,::1], f8[:,::1], i4[:,::1], i8, i8)", cache=True, nogil=True)
def continue_walls(origin, slots, normals, blocks, steps, count):
    """Lay the walls among the first `count` blocks over empty ones ahead of their ends; return the new count.

    A wall goes on straight for `steps` half cells. Blocks past the capacity are left out.
    """
    inv = origin[2]
    rows, cols = slots.shape[1], slots.shape[2]
    used = count
    for step in range(1, steps + 1):
        for k in range(count):
            slot = slots[1, blocks[k, 0], blocks[k, 1]]
            if slot < 0:
                continue
            a, b, d = normals[slot, 2], normals[slot, 3], normals[slot, 4]
            if 0.5 * (a + d) - np.hypot(0.5 * (a - d), b) > WALL_INFORMATION:
                continue
            across = 0.5 * np.arctan2(2.0 * b, a - d)
            for sign in (-1.0, 1.0):
                u = normals[slot, 0] * inv - sign * np.sin(across) * step
                v = normals[slot, 1] * inv + sign * np.cos(across) * step
                # The block whose middle is nearest to that place of the wall.
                col, row = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
                if row < 1 or col < 1 or row >= rows - 2 or col >= cols - 2 or used == normals.shape[0]:
                    continue
                if slots[1, row, col] >= 0:
                    continue
                slots[1, row, col] = used
                blocks[used, 0], blocks[used, 1] = row, col
                for j in range(5):
                    normals[used, j] = normals[slot, j]
                used += 1
    return used
