"""Compiled inner loops of the Normal Distributions Transform.

One grid of half cells holds sums of the reference's points. Every block of 2 x 2 half cells is one NDT
cell, and the blocks at all half-cell places are together the four shifted grids of Biber and Strasser: a
point lies in four. Arrays and scalars in and out; nothing is validated here (`processing.ndt` does); twins
in tests/unit/naive_odometry.py.

Layout of the arrays, all preallocated by `processing.ndt.Ndt`:
    origin (3,): x and y of the lower-left corner of half cell (0, 0), and 1 / half-cell side.
    slots (3, rows, cols) i4: half cell -> row in `sums`, block -> row in `normals`, half cell -> row in
    `tiles`;
        -1 is empty, -2 (blocks) holds too few points.
    normals (K, 5): mean x, y; inverse covariance xx, xy, yy, of a block.
    tiles (K, 16) f4: the point score sampled at 4 x 4 places of a half cell, row by row; the last row stays
        0, and is what -1 counts from the end: a half cell without a tile needs no branch.
"""

import numpy as np
from numba import njit

EMPTY = -1
SPARSE = -2
THINNEST = 1e-6
"""Variance (m^2) of a line: points nearer to each other than a few of its deviations are no wall."""
FLAT = 0.01
"""Least ratio of the determinant of a cell's inverse covariance and its squared trace; less is a wall."""
SIDE = 4
"""Samples of the score field along the side of a half cell; a tile is one cache line."""

_0, _2, _3, _4 = np.int32(0), np.int32(2), np.int32(3), np.int32(4)
# Unsigned, so that no index is looked at for being negative.
_FOUR, _FIFTEEN = np.uint32(4), np.uint32(15)
_EXP_STEPS = 32
_EXP_END = 12.0
_EXP = np.exp(-0.5 * np.arange(0.0, _EXP_END, 1.0 / _EXP_STEPS)).astype(np.float32)


@njit("i8[::1](f8[:,::1], f8[::1], i4[:,:,::1], f8[:,::1], i4[:,::1], i8[::1])", cache=True, nogil=True)
def accumulate(points, origin, slots, sums, places, counts):
    """Add points (N, 2) to the sums of their half cells.

    Points off the grid or past the capacity are left out. `places` (K, 2) lists the used half cells,
    `counts[0]` how many they are.
    """
    rows, cols = slots.shape[1], slots.shape[2]
    used = counts[0]
    for k in range(points.shape[0]):
        u = points[k, 0] - origin[0]
        v = points[k, 1] - origin[1]
        # One half cell is kept free around the map: a block at the rim reaches past its last point.
        col = int(np.floor(u * origin[2]))
        row = int(np.floor(v * origin[2]))
        if row < 1 or col < 1 or row >= rows - 1 or col >= cols - 1:
            continue
        slot = slots[0, row, col]
        if slot < 0:
            if used == sums.shape[0]:
                continue
            slot = used
            slots[0, row, col] = slot
            places[slot, 0] = row
            places[slot, 1] = col
            sums[slot, :] = 0.0
            used += 1
        sums[slot, 0] += 1.0
        sums[slot, 1] += u
        sums[slot, 2] += v
        sums[slot, 3] += u * u
        sums[slot, 4] += u * v
        sums[slot, 5] += v * v
    counts[0] = used
    return counts


@njit("b1(f8, f8, f8, f8, f8, f8, f8[::1], f8[::1])", cache=True, nogil=True)
def fit(n, su, sv, suu, suv, svv, rule, normal):
    """Fit the normal distribution of one block from its sums; False where the points are too few.

    `rule`: least number of points, least variance (m^2), least ratio of the eigenvalues, ratio under which a
    block is flat, factor by which the long eigenvalue of a flat block is stretched.
    """
    if n < rule[0]:
        return False
    mu, mv = su / n, sv / n
    xx = max(suu / n - mu * mu, 0.0)
    yy = max(svv / n - mv * mv, 0.0)
    xy = suv / n - mu * mv
    # Eigenvalues of the symmetric 2 x 2, and the unit vector (c, s) of the larger one.
    half = 0.5 * (xx - yy)
    root = np.sqrt(half * half + xy * xy)
    large = 0.5 * (xx + yy) + root
    small = 0.5 * (xx + yy) - root
    angle = 0.5 * np.arctan2(xy, half)
    c, s = np.cos(angle), np.sin(angle)
    # Judged before the floor is laid: else a short piece of wall is a blob, and holds points along the wall.
    flat = max(small, THINNEST) < rule[3] * large
    large = max(large, rule[1])
    small = max(small, rule[1], rule[2] * large)
    if flat:
        # A wall constrains across itself only: its extent inside the cell is where the cell was cut.
        large = large * rule[4]
    il, ism = 1.0 / large, 1.0 / small
    normal[0] = mu
    normal[1] = mv
    normal[2] = c * c * il + s * s * ism
    normal[3] = c * s * (il - ism)
    normal[4] = s * s * il + c * c * ism
    return True


@njit("b1(i8, i8, i4[:,:,::1], f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True)
def fit_block(row, col, slots, sums, rule, normal):
    """Fit the block of the four half cells at and after (row, col); False where its points are too few."""
    n = su = sv = suu = suv = svv = 0.0
    for r in range(row, row + 2):
        for c in range(col, col + 2):
            slot = slots[0, r, c]
            if slot >= 0:
                n += sums[slot, 0]
                su += sums[slot, 1]
                sv += sums[slot, 2]
                suu += sums[slot, 3]
                suv += sums[slot, 4]
                svv += sums[slot, 5]
    return fit(n, su, sv, suu, suv, svv, rule, normal)


@njit(
    "i8[::1](f8[::1], i4[:,:,::1], f8[:,::1], i4[:,::1], f8[:,::1], i4[:,::1], f8[::1], i8[::1])",
    cache=True,
    nogil=True,
)
def fit_blocks(origin, slots, sums, places, normals, blocks, rule, counts):
    """Fit every block that any used half cell touches; `blocks` (K, 2) lists them, `counts[1]` how many."""
    normal = np.empty(5)
    used = counts[1]
    for k in range(counts[0]):
        for row in range(places[k, 0] - 1, places[k, 0] + 1):
            for col in range(places[k, 1] - 1, places[k, 1] + 1):
                if slots[1, row, col] != -1 or used == normals.shape[0]:
                    continue
                blocks[used, 0] = row
                blocks[used, 1] = col
                if fit_block(row, col, slots, sums, rule, normal):
                    for j in range(5):
                        normals[used, j] = normal[j]
                    slots[1, row, col] = used
                else:
                    slots[1, row, col] = -2
                used += 1
    counts[1] = used
    return counts


@njit("f8(f8, f8, i8, i8, i4[:,:,::1], f8[:,::1], f8, f8)", cache=True, nogil=True)
def point_score(u, v, row, col, slots, normals, inv, blur):
    """Score of one point in half cell (row, col): weighted mean of exp(-m/2) over its four blocks."""
    total = 0.0
    weights = 0.0
    for r in range(row - 1, row + 1):
        for c in range(col - 1, col + 1):
            slot = slots[1, r, c]
            if slot < 0:
                continue
            # Weight of a block: one at its centre, nought at its rim, so that the field has no steps.
            w = (1.0 - abs(u * inv - c - 1.0)) * (1.0 - abs(v * inv - r - 1.0))
            du = u - normals[slot, 0]
            dv = v - normals[slot, 1]
            m = du * du * normals[slot, 2] + 2.0 * du * dv * normals[slot, 3] + dv * dv * normals[slot, 4]
            total += w * np.exp(-0.5 * m)
            weights += w
    if weights <= 1e-9:
        return 0.0
    return total / weights


@njit(
    "i8[::1](f8[::1], i4[:,:,::1], f8[:,::1], i4[:,::1], f4[:,::1], i4[:,::1], f8, i8[::1])",
    cache=True,
    nogil=True,
)
def sample_tiles(origin, slots, normals, blocks, tiles, tile_places, blur, counts):
    """Sample the point score at the centres of SIDE x SIDE squares of every half cell under a block.

    `blur` (m^2) is added to the covariances: a sample stands for its whole square.
    """
    inv = origin[2]
    side = 1.0 / inv
    used = counts[2]
    for k in range(counts[1]):
        if slots[1, blocks[k, 0], blocks[k, 1]] < 0:
            continue
        for row in range(blocks[k, 0], blocks[k, 0] + 2):
            for col in range(blocks[k, 1], blocks[k, 1] + 2):
                if slots[2, row, col] != -1 or used == tiles.shape[0] - 1:
                    continue
                slots[2, row, col] = used
                tile_places[used, 0] = row
                tile_places[used, 1] = col
                total = np.zeros(16, np.float32)
                weights = np.zeros(16, np.float32)
                for r in range(row - 1, row + 1):
                    for c in range(col - 1, col + 1):
                        slot = slots[1, r, c]
                        if slot < 0:
                            continue
                        a, b, d = normals[slot, 2], normals[slot, 3], normals[slot, 4]
                        # (S + blur I)^-1 from S^-1: S^-1 (I + blur S^-1)^-1
                        det = a * d - b * b
                        den = 1.0 + blur * (a + d) + blur * blur * det
                        a, b, d = (a + blur * det) / den, b / den, (d + blur * det) / den
                        for j in range(4):
                            y = (row + (j + 0.5) / 4) * side
                            wy = 1.0 - abs(y * inv - r - 1.0)
                            dv = y - normals[slot, 1]
                            for i in range(4):
                                x = (col + (i + 0.5) / 4) * side
                                wx = 1.0 - abs(x * inv - c - 1.0)
                                du = x - normals[slot, 0]
                                m = a * du * du + 2.0 * b * du * dv + d * dv * dv
                                if m < _EXP_END:
                                    total[4 * j + i] += wx * wy * _EXP[int(m * _EXP_STEPS)]
                                weights[4 * j + i] += wx * wy
                for j in range(16):
                    tiles[used, j] = total[j] / weights[j]
                used += 1
    counts[2] = used
    return counts


@njit("void(i4[:,:,::1], i4[:,::1], i4[:,::1], i4[:,::1], i8[::1])", cache=True, nogil=True)
def clear(slots, places, blocks, tile_places, counts):
    """Empty the grid by its lists, so that the cost is that of the map and not of the area."""
    for k in range(counts[0]):
        slots[0, places[k, 0], places[k, 1]] = -1
    for k in range(counts[1]):
        slots[1, blocks[k, 0], blocks[k, 1]] = -1
    for k in range(counts[2]):
        slots[2, tile_places[k, 0], tile_places[k, 1]] = -1
    counts[:] = 0


@njit("f8(f4[:,::1], f8[::1], i4[:,:,::1], f4[:,::1], f8, f8, f8, i4[::1])", cache=True, nogil=True)
def sampled_score(columns, origin, slots, tiles, x, y, yaw, samples):
    """Sum of the sampled point scores of points moved to a pose; 0 for a point off the map.

    `columns` (2, N): x and y of the points; single precision errs by micrometres, a sample is centimetres
    wide. `samples` (N,) is overwritten. That every point's sample is found before the first is looked up
    lets the compiler do the arithmetic of eight points at once.
    """
    scale = origin[2] * 4
    width = np.int32(slots.shape[2])
    right, top = np.int32(4 * width - 1), np.int32(4 * slots.shape[1] - 1)
    c, s = np.float32(np.cos(yaw) * scale), np.float32(np.sin(yaw) * scale)
    tx, ty = np.float32((x - origin[0]) * scale), np.float32((y - origin[1]) * scale)
    px, py = columns[0], columns[1]
    for k in range(columns.shape[1]):
        # The rim of the map is empty: who is past it is there.
        i = min(max(np.int32(c * px[k] - s * py[k] + tx), _0), right)
        j = min(max(np.int32(s * px[k] + c * py[k] + ty), _0), top)
        samples[k] = (((j >> _2) * width + (i >> _2)) << _4) | ((j & _3) << _2) | (i & _3)
    flat = slots[2].ravel()
    total = 0.0
    for k in range(columns.shape[1]):
        sample = np.uint32(samples[k])
        total += tiles[flat[sample >> _FOUR], sample & _FIFTEEN]
    return total


@njit("Tuple((b1, f8, f8, f8))(f8, f8, f8, f8, f8)", cache=True, nogil=True)
def across_wall(nx, ny, a, b, d):
    """Narrow what a cell says to what a point of a wall with the unit normal (nx, ny) can tell of it.

    Along its wall such a point may lie anywhere: wherever the laser is, some ray meets the wall there (as in
    point-to-line matching: Censi, ICRA 2008). So a cell that is no wall counts across the point's own wall
    only; in one of a wall that runs otherwise the point does not belong. With a normal of half the length it
    belongs on no wall at all.

    Returns:
        Whether it tells anything; and xx, xy, yy of the inverse covariance, given as a, b, d.
    """
    trace, det = a + d, a * d - b * b
    if det < FLAT * trace * trace:
        return nx * nx * a + 2.0 * nx * ny * b + ny * ny * d >= 0.5 * trace, a, b, d
    k = det / (d * nx * nx - 2.0 * b * nx * ny + a * ny * ny)
    return True, k * nx * nx, k * nx * ny, k * ny * ny


@njit(
    "f8(f8[:,::1], f8[::1], i4[:,:,::1], f8[:,::1], f8[::1], f8, f8[::1], f8[:,::1], f8[:,::1])",
    cache=True,
    nogil=True,
)
def derivatives(points, origin, slots, normals, pose, blur, gradient, hessian, information):
    """Score points (N, 4) at `pose`; write gradient (3,), Hessian and Gauss-Newton information (3, 3).

    Of each point: place, and unit normal of its wall or 0. A wall that the point does not belong to says
    nothing, and the point fits the less.

    Block weights and the walls' normals are held fixed: the weights' slope compares the noise of
    neighbouring blocks and would pull points along walls. `information` is the sum of w e J^T S^-1 J, never
    negative; `hessian` that of the score itself.
    """
    rows, cols = slots.shape[1], slots.shape[2]
    inv = origin[2]
    cs, sn = np.cos(pose[2]), np.sin(pose[2])
    tx, ty = pose[0] - origin[0], pose[1] - origin[1]
    g0 = g1 = g2 = 0.0
    h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    f00 = f01 = f02 = f11 = f12 = f22 = 0.0
    score = 0.0
    for k in range(points.shape[0]):
        px, py = points[k, 0], points[k, 1]
        rx, ry = cs * px - sn * py, sn * px + cs * py
        nx, ny = cs * points[k, 2] - sn * points[k, 3], sn * points[k, 2] + cs * points[k, 3]
        on_wall = nx != 0.0 or ny != 0.0
        u, v = rx + tx, ry + ty
        col, row = int(np.floor(u * inv)), int(np.floor(v * inv))
        if row < 1 or col < 1 or row >= rows or col >= cols:
            continue
        total = weights = 0.0
        gx = gy = mxx = mxy = myy = fxx = fxy = fyy = 0.0
        for r in range(row - 1, row + 1):
            for c in range(col - 1, col + 1):
                slot = slots[1, r, c]
                if slot < 0:
                    continue
                w = (1.0 - abs(u * inv - c - 1.0)) * (1.0 - abs(v * inv - r - 1.0))
                weights += w
                du, dv = u - normals[slot, 0], v - normals[slot, 1]
                a, b, d = normals[slot, 2], normals[slot, 3], normals[slot, 4]
                if blur > 0.0:
                    det = a * d - b * b
                    den = 1.0 + blur * (a + d) + blur * blur * det
                    a, b, d = (a + blur * det) / den, b / den, (d + blur * det) / den
                if on_wall:
                    tells, a, b, d = across_wall(nx, ny, a, b, d)
                    if not tells:
                        continue
                qx, qy = a * du + b * dv, b * du + d * dv
                m = du * qx + dv * qy
                if m > 50.0:
                    continue
                e = w * np.exp(-0.5 * m)
                total += e
                gx -= e * qx
                gy -= e * qy
                fxx += e * a
                fxy += e * b
                fyy += e * d
                mxx += e * (qx * qx - a)
                mxy += e * (qx * qy - b)
                myy += e * (qy * qy - d)
        if weights <= 1e-9:
            continue
        n = 1.0 / weights
        score += total * n
        gx *= n
        gy *= n
        # Chain rule with d(u, v)/d(yaw) = (-ry, rx) and its own derivative (-rx, -ry).
        g0 += gx
        g1 += gy
        g2 += -ry * gx + rx * gy
        mxx, mxy, myy = mxx * n, mxy * n, myy * n
        h00 += mxx
        h01 += mxy
        h11 += myy
        h02 += -ry * mxx + rx * mxy
        h12 += -ry * mxy + rx * myy
        h22 += ry * ry * mxx - 2.0 * rx * ry * mxy + rx * rx * myy - rx * gx - ry * gy
        fxx, fxy, fyy = fxx * n, fxy * n, fyy * n
        f00 += fxx
        f01 += fxy
        f11 += fyy
        f02 += -ry * fxx + rx * fxy
        f12 += -ry * fxy + rx * fyy
        f22 += ry * ry * fxx - 2.0 * rx * ry * fxy + rx * rx * fyy
    gradient[0], gradient[1], gradient[2] = g0, g1, g2
    hessian[0, 0], hessian[0, 1], hessian[0, 2] = h00, h01, h02
    hessian[1, 0], hessian[1, 1], hessian[1, 2] = h01, h11, h12
    hessian[2, 0], hessian[2, 1], hessian[2, 2] = h02, h12, h22
    information[0, 0], information[0, 1], information[0, 2] = f00, f01, f02
    information[1, 0], information[1, 1], information[1, 2] = f01, f11, f12
    information[2, 0], information[2, 1], information[2, 2] = f02, f12, f22
    return score
