"""Each particle against its own whole map: Gauss-Newton on the normal distributions of its tiles.

The NDT cells are squares of 2 x 2 blocks that overlap by half in both directions (four shifted grids), built
from the block moments of the particle's own tiles. The motion is the prior: where the map constrains nothing,
it decides.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.dpslam.grid import (
    _STORE,
    BLOCK_M,
    BLOCKS,
    MOMENTS,
    NONE,
    Arrays,
    Table,
)

SPAN = 2
"""Blocks along the side of an NDT cell."""
LEAST_WEIGHT = 3.0
LEAST_SPREAD_M = 0.02
"""No wall is thinner: range noise and the cell's own width."""
THINNEST_M2 = 1e-6
"""Variance below which points on a line are as good as none."""
LONG = 6.0
STRETCH = 1e4
"""A cell whose long variance is LONG times its short one is a wall: it constrains across itself only, for
where its points end depends on where the cell lies. Its long variance is stretched by this factor. A wall
that two passes drew up to 0.05 m apart is one, too."""
ITERATIONS = 12


@njit(f"b1({_STORE}, i4[:,:,::1], i8, i8, i8, i8, i8, f8[:,::1], i8)", cache=True, nogil=True)
def _normal(
    store: Arrays,
    table: Table,
    particle: int,
    first_row: int,
    first_col: int,
    block_row: int,
    block_col: int,
    normals: NDArray[np.float64],
    slot: int,
) -> bool:
    """Write mean x, y and inverse covariance xx, xy, yy of one NDT cell; False if there is none.

    The mean is counted from the lower left corner of the block (block_row, block_col).
    """
    blocks = store[2]
    rows, cols = table.shape[1], table.shape[2]
    n = sx = sy = sxx = sxy = syy = 0.0
    for j in range(SPAN):
        for i in range(SPAN):
            row, col = block_row + j, block_col + i
            tile_row, tile_col = row >> 3, col >> 3
            at_row, at_col = tile_row - first_row, tile_col - first_col
            if at_row < 0 or at_row >= rows or at_col < 0 or at_col >= cols:
                continue
            tile = table[particle, at_row, at_col]
            if tile == NONE:
                continue
            at = ((row - tile_row * BLOCKS) * BLOCKS + col - tile_col * BLOCKS) * MOMENTS
            w = float(blocks[tile, at])
            if w <= 0.0:
                continue
            bx, by = float(blocks[tile, at + 1]), float(blocks[tile, at + 2])
            ox, oy = i * BLOCK_M, j * BLOCK_M
            n += w
            sx += bx + w * ox
            sy += by + w * oy
            sxx += blocks[tile, at + 3] + 2.0 * ox * bx + w * ox * ox
            sxy += blocks[tile, at + 4] + ox * by + oy * bx + w * ox * oy
            syy += blocks[tile, at + 5] + 2.0 * oy * by + w * oy * oy
    if n < LEAST_WEIGHT:
        return False
    mx, my = sx / n, sy / n
    xx, xy, yy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    long, short = middle + half, max(middle - half, 0.0)
    # Direction of the long axis; any direction if the cell is round.
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    c, s = np.cos(angle), np.sin(angle)
    # Judged before the floor is laid: else a short piece of wall is a blob, and holds points along the wall.
    wall = long > LONG * max(short, THINNEST_M2)
    short = max(short, 0.001 * long, LEAST_SPREAD_M**2)
    long = max(long, short)
    if wall:
        long *= STRETCH
    a, b_ = 1.0 / long, 1.0 / short
    normals[slot, 0], normals[slot, 1] = mx, my
    normals[slot, 2], normals[slot, 3], normals[slot, 4] = (
        a * c * c + b_ * s * s,
        (a - b_) * c * s,
        a * s * s + b_ * c * c,
    )
    return True


@njit("b1(f8[::1], f8[:,::1], f8, f8[::1], f8[:,::1], f8[::1])", cache=True, nogil=True)
def descend(
    predicted: NDArray[np.float64],
    prior: NDArray[np.float64],
    gain: float,
    g: NDArray[np.float64],
    H: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> bool:
    """Move `pose` by one step of Gauss-Newton on -score + prior, both positive definite.

    Args:
        predicted: (3,) mean of the prior.
        prior: (3, 3) its information.
        gain: Weight of the score.
        g: (3,) gradient of -score.
        H: (3, 3) its curvature.
        pose: (3,) where it is, and then where it has got to.

    Returns:
        Whether it hardly moved.
    """
    d0, d1 = pose[0] - predicted[0], pose[1] - predicted[1]
    d2 = (pose[2] - predicted[2] + np.pi) % (2.0 * np.pi) - np.pi
    a00, a01, a02 = (
        gain * H[0, 0] + prior[0, 0],
        gain * H[0, 1] + prior[0, 1],
        gain * H[0, 2] + prior[0, 2],
    )
    a11, a12, a22 = (
        gain * H[1, 1] + prior[1, 1],
        gain * H[1, 2] + prior[1, 2],
        gain * H[2, 2] + prior[2, 2],
    )
    b0 = gain * g[0] + prior[0, 0] * d0 + prior[0, 1] * d1 + prior[0, 2] * d2
    b1 = gain * g[1] + prior[0, 1] * d0 + prior[1, 1] * d1 + prior[1, 2] * d2
    b2 = gain * g[2] + prior[0, 2] * d0 + prior[1, 2] * d1 + prior[2, 2] * d2
    m00, m01, m02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    m11, m12, m22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    det = a00 * m00 + a01 * m01 + a02 * m02
    s0 = -(m00 * b0 + m01 * b1 + m02 * b2) / det
    s1 = -(m01 * b0 + m11 * b1 + m12 * b2) / det
    s2 = -(m02 * b0 + m12 * b1 + m22 * b2) / det
    pose[0] += s0
    pose[1] += s1
    pose[2] += s2
    return bool(abs(s0) < 1e-4 and abs(s1) < 1e-4 and abs(s2) < 1e-5)


@njit(
    f"void({_STORE}, i4[:,:,::1], i8, i8, i8, "
    "f8[:,::1], f8[::1], f8[:,::1], f8, f8[::1], f8[:,::1], f8[::1])",
    cache=True,
    nogil=True,
)
def align(
    store: Arrays,
    table: Table,
    particle: int,
    first_row: int,
    first_col: int,
    points: NDArray[np.float64],
    predicted: NDArray[np.float64],
    prior: NDArray[np.float64],
    gain: float,
    pose: NDArray[np.float64],
    information: NDArray[np.float64],
    result: NDArray[np.float64],
) -> None:
    """Move `pose` from `predicted` to the optimum of the scan on the particle's map and the prior together.

    Args:
        store: The tiles of all particles.
        table: Their tile numbers.
        particle: Whose map.
        first_row: Tile row of the table's corner.
        first_col: Tile column of the table's corner.
        points: (N, 2) m, laser frame.
        predicted: (3,) map frame; mean of the prior.
        prior: (3, 3) information of the prior, map frame axes.
        gain: Weight of one point's score; points of one scan are not independent.
        pose: (3,) the answer.
        information: (3, 3) of the answer, without the prior.
        result: (2,) mean score of the points (0 .. 1), share of the points on mapped ground.
    """
    count = points.shape[0]
    # Normals of the cells that points meet are built once and kept in an open hash.
    size = 64
    while size < 24 * count:
        size *= 2
    keys = np.full(size, -(1 << 62), dtype=np.int64)
    slots = np.full(size, NONE, dtype=np.int32)
    normals = np.empty((size, 5))
    built = 0
    for a in range(3):  # here and below: a slice assigned to a slice takes over a second to compile
        pose[a] = predicted[a]
    g, H = np.zeros(3), np.zeros((3, 3))
    for iteration in range(ITERATIONS + 1):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        g[:] = 0.0
        H[:] = 0.0
        total, mapped = 0.0, 0
        for i in range(count):
            rx, ry = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            u, v = (pose[0] + rx) / BLOCK_M, (pose[1] + ry) / BLOCK_M
            block_col, block_row = int(np.floor(u)), int(np.floor(v))
            met = False
            for j in range(SPAN):
                for k in range(SPAN):
                    row, col = block_row - j, block_col - k
                    key = (row << 32) ^ (col & 0xFFFFFFFF)
                    h = (row * 73856093 ^ col * 19349663) & (size - 1)
                    while keys[h] != key and keys[h] != -(1 << 62):
                        h = (h + 1) & (size - 1)
                    if keys[h] != key and 2 * built < size:
                        keys[h] = key
                        built += 1
                        slots[h] = NONE
                        if _normal(store, table, particle, first_row, first_col, row, col, normals, h):
                            slots[h] = h
                    if keys[h] != key or slots[h] == NONE:
                        continue
                    met = True
                    qx = (u - col) * BLOCK_M - normals[h, 0]
                    qy = (v - row) * BLOCK_M - normals[h, 1]
                    xx, xy, yy = normals[h, 2], normals[h, 3], normals[h, 4]
                    wx, wy = xx * qx + xy * qy, xy * qx + yy * qy
                    m = qx * wx + qy * wy
                    if m > 30.0:
                        continue
                    e = np.exp(-0.5 * m) / (SPAN * SPAN)
                    total += e
                    # d point / d yaw = (-ry, rx)
                    wa = -ry * wx + rx * wy
                    g[0] += e * wx
                    g[1] += e * wy
                    g[2] += e * wa
                    ax, ay = -ry * xx + rx * xy, -ry * xy + rx * yy
                    H[0, 0] += e * xx
                    H[0, 1] += e * xy
                    H[1, 1] += e * yy
                    H[0, 2] += e * ax
                    H[1, 2] += e * ay
                    H[2, 2] += e * (-ry * ax + rx * ay)
            if met:
                mapped += 1
        H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
        result[0], result[1] = total / max(count, 1), mapped / max(count, 1)
        for a in range(3):
            for b in range(3):
                information[a, b] = gain * H[a, b]
        if iteration == ITERATIONS:
            break
        if descend(predicted, prior, gain, g, H, pose):
            break
    pose[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
