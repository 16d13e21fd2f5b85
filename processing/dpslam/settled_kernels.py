"""Compiled inner loops of the settled map: normals kept up to date point by point, and how a scan fits them.

Same arrays as `processing.ndt_kernels`, but the map grows instead of being built anew. Arrays and scalars in
and out; nothing is checked here (`processing.dpslam.settled` does that).
"""

import numpy as np
from numba import njit

from processing.ndt_kernels import fit_block, point_score


@njit("i8(i8, i8, i4[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], i8)", cache=True, nogil=True)
def refit_around(row, col, slots, sums, normals, rule, normal, used):
    """Fit anew the four blocks that hold half cell (row, col); return how many rows of `normals` are used."""
    for block_row in range(row - 1, row + 1):
        for block_col in range(col - 1, col + 1):
            if fit_block(block_row, block_col, slots, sums, rule, normal):
                slot = slots[1, block_row, block_col]
                if slot < 0:
                    slot = used
                    slots[1, block_row, block_col] = slot
                    used += 1
                for m in range(normal.shape[0]):  # a slice assigned to a slice takes 1.6 s longer to compile
                    normals[slot, m] = normal[m]
    return used


@njit("i8(f8[:,::1], f8[::1], i4[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], i8)", cache=True, nogil=True)
def refit(points, origin, slots, sums, normals, rule, used):
    """Fit anew every block in which any point (N, 2) lies; return how many rows of `normals` are used."""
    rows, cols = slots.shape[1], slots.shape[2]
    normal = np.empty(5)
    for k in range(points.shape[0]):
        col = int(np.floor((points[k, 0] - origin[0]) * origin[2]))
        row = int(np.floor((points[k, 1] - origin[1]) * origin[2]))
        if 1 <= row < rows - 1 and 1 <= col < cols - 1:
            used = refit_around(row, col, slots, sums, normals, rule, normal, used)
    return used


@njit("i8(i4[:,::1], i8, i4[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], i8)", cache=True, nogil=True)
def refit_all(places, count, slots, sums, normals, rule, used):
    """Fit the blocks of the first `count` half cells of `places`; return how many are used."""
    normal = np.empty(5)
    for k in range(count):
        used = refit_around(places[k, 0], places[k, 1], slots, sums, normals, rule, normal, used)
    return used


@njit("void(f8[:,::1], f8[::1], i4[:,:,::1], f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True)
def fit_of_points(points, origin, slots, normals, pose, fits):
    """Write the score of each point (N, 2) moved to `pose`, 0 to 1; -1 where the map knows nothing."""
    cs, sn, inverse = np.cos(pose[2]), np.sin(pose[2]), origin[2]
    rows, cols = slots.shape[1], slots.shape[2]
    for k in range(points.shape[0]):
        u = cs * points[k, 0] - sn * points[k, 1] + pose[0] - origin[0]
        v = sn * points[k, 0] + cs * points[k, 1] + pose[1] - origin[1]
        col, row = int(np.floor(u * inverse)), int(np.floor(v * inverse))
        fits[k] = -1.0
        if row < 1 or col < 1 or row >= rows or col >= cols:
            continue
        known = False
        for r in range(row - 1, row + 1):
            for c in range(col - 1, col + 1):
                known = known or slots[1, r, c] >= 0
        if known:
            fits[k] = point_score(u, v, row, col, slots, normals, inverse, 0.0)
