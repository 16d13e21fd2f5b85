"""Compiled inner loop of the certainty of a match: what the slope of its score varies by.

Arrays in and out, laid out as in `processing.ndt_kernels`.
"""

import numpy as np
from numba import njit

from processing.ndt_kernels import across_wall

_GRID = "Tuple((f8[::1], i4[:,:,::1], f8[:,::1]))"


@njit(f"void(f8, f8, f8, f8, {_GRID}, f8, f8[::1])", cache=True, nogil=True)
def add_slope(x, y, nx, ny, grid, share, slope):
    """Add to `slope` `share` of the derivatives of one point's score: by x, y, xx, xy, yy.

    (nx, ny) is the unit normal of the point's wall, 0 for none. Block weights are held fixed, as in
    `ndt_kernels.derivatives`.
    """
    origin, slots, normals = grid
    inv = origin[2]
    u, v = x - origin[0], y - origin[1]
    col, row = int(np.floor(u * inv)), int(np.floor(v * inv))
    if row < 1 or col < 1 or row >= slots.shape[1] or col >= slots.shape[2]:
        return
    weights = gx = gy = xx = xy = yy = 0.0
    for r in range(row - 1, row + 1):
        for c in range(col - 1, col + 1):
            slot = slots[1, r, c]
            if slot < 0:
                continue
            w = (1.0 - abs(u * inv - c - 1.0)) * (1.0 - abs(v * inv - r - 1.0))
            weights += w
            du, dv = u - normals[slot, 0], v - normals[slot, 1]
            a, b, d = normals[slot, 2], normals[slot, 3], normals[slot, 4]
            if nx != 0.0 or ny != 0.0:
                tells, a, b, d = across_wall(nx, ny, a, b, d)
                if not tells:
                    continue
            qx, qy = a * du + b * dv, b * du + d * dv
            e = w * np.exp(-0.5 * (du * qx + dv * qy))
            gx -= e * qx
            gy -= e * qy
            xx += e * (qx * qx - a)
            xy += e * (qx * qy - b)
            yy += e * (qy * qy - d)
    if weights > 1e-9:
        k = share / weights
        slope[0] += k * gx
        slope[1] += k * gy
        slope[2] += k * xx
        slope[3] += k * xy
        slope[4] += k * yy


@njit(f"void(f8[:,::1], {_GRID}, {_GRID}, f8, f8[::1], f8[:,:,::1])", cache=True, nogil=True)
def spreads(points, wide, fine, share, pose, out):
    """Write what the slope of the score of points (N, 4) at `pose` varies by, (2, 3, 3), reference axes.

    First the sum of g g^T, g the slope of one point by x, y, yaw: what the residuals are. Second the sum of
    (G J)^T (G J), G the change of that slope with the point's place: what noise of unit variance does.
    `share` is that of the fine cells in the score.
    """
    cs, sn = np.cos(pose[2]), np.sin(pose[2])
    out[:] = 0.0
    slope, g = np.empty(5), np.empty(3)
    first, second = np.empty(3), np.empty(3)
    for k in range(points.shape[0]):
        rx, ry = cs * points[k, 0] - sn * points[k, 1], sn * points[k, 0] + cs * points[k, 1]
        nx, ny = cs * points[k, 2] - sn * points[k, 3], sn * points[k, 2] + cs * points[k, 3]
        slope[:] = 0.0
        add_slope(rx + pose[0], ry + pose[1], nx, ny, wide, 1.0 - share, slope)
        if share > 0.0:
            add_slope(rx + pose[0], ry + pose[1], nx, ny, fine, share, slope)
        g[0], g[1], g[2] = slope[0], slope[1], rx * slope[1] - ry * slope[0]
        first[0], first[1], first[2] = slope[2], slope[3], rx * slope[3] - ry * slope[2]
        second[0], second[1], second[2] = slope[3], slope[4], rx * slope[4] - ry * slope[3]
        for i in range(3):
            for j in range(3):
                out[0, i, j] += g[i] * g[j]
                out[1, i, j] += first[i] * first[j] + second[i] * second[j]
