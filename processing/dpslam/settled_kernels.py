"""Compiled inner loops of the settled map: normals kept up to date point by point, and how a scan fits them.

Same arrays as `processing.ndt_kernels`, but the map grows instead of being built anew. Arrays and scalars in
and out; nothing is checked here (`processing.dpslam.settled` does that).
"""

import numpy as np
from numba import njit

from processing.ndt_kernels import fit_block, point_score

FLAT_RATIO = 0.1
"""Greatest ratio of the variances of a block that has sides."""
ONE_SIDED = 0.1
"""Least mean of the cosines between its normal and where it was seen from: of what was seen from both sides,
and of an edge that was looked along, nothing is told."""


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


@njit("void(f8[:,::1], f8[::1], f8[::1], i4[:,:,::1], f8[:,::1])", cache=True, nogil=True)
def note_views(points, laser, origin, slots, views):
    """Add to the half cell of each point (N, 2) the unit vector to the laser (2,) that saw it."""
    rows, cols = slots.shape[1], slots.shape[2]
    for k in range(points.shape[0]):
        col = int(np.floor((points[k, 0] - origin[0]) * origin[2]))
        row = int(np.floor((points[k, 1] - origin[1]) * origin[2]))
        if 1 <= row < rows - 1 and 1 <= col < cols - 1 and slots[0, row, col] >= 0:
            dx, dy = laser[0] - points[k, 0], laser[1] - points[k, 1]
            away = max(np.hypot(dx, dy), 1e-9)
            slot = slots[0, row, col]
            views[slot, 0] += dx / away
            views[slot, 1] += dy / away


@njit("b1(i8, i8, f8, f8, i4[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8)", cache=True, nogil=True)
def block_is_away(row, col, x, y, slots, sums, normals, views, least_m, least_slant):
    """Whether a block is a wall that was seen from one side only, and a laser at (x, y) is on the other."""
    slot = slots[1, row, col]
    xx, xy, yy = normals[slot, 2], normals[slot, 3], normals[slot, 4]
    half = 0.5 * (xx - yy)
    root = np.sqrt(half * half + xy * xy)
    mean = 0.5 * (xx + yy)
    if mean - root > FLAT_RATIO * (mean + root):
        return False
    # Of the inverse covariance: its long axis is the wall's short one.
    angle = 0.5 * np.arctan2(xy, half)
    nx, ny = np.cos(angle), np.sin(angle)
    count = seen_x = seen_y = 0.0
    for r in range(row, row + 2):
        for c in range(col, col + 2):
            cell = slots[0, r, c]
            if cell >= 0:
                count += sums[cell, 0]
                seen_x += views[cell, 0]
                seen_y += views[cell, 1]
    side = nx * seen_x + ny * seen_y
    if abs(side) < ONE_SIDED * count:
        return False
    dx, dy = x - normals[slot, 0], y - normals[slot, 1]
    beyond = -np.sign(side) * (nx * dx + ny * dy) - least_m
    return bool(beyond > 0.0 and beyond > least_slant * np.hypot(dx, dy))


@njit(
    "void(f8[:,::1], f8[::1], f8[::1], i4[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, b1[::1])",
    cache=True,
    nogil=True,
)
def look_away(points, pose, origin, slots, sums, normals, views, least_m, least_slant, away):
    """Mark the points (N, 2), laser frame, that lie on nothing but walls that face away from the laser.

    Args:
        points: (N, 2) m, laser frame.
        pose: (3,) of the laser.
        origin: Of the map.
        slots: Of the map.
        sums: Of its half cells.
        normals: Of its blocks.
        views: (K, 2) of its half cells: sums of unit vectors to the lasers that saw them.
        least_m: How far the laser must be behind the line of a wall, and
        least_slant: by which sine of an angle more, seen from the wall.
        away: (N,) the answer.
    """
    cs, sn, inverse = np.cos(pose[2]), np.sin(pose[2]), origin[2]
    rows, cols = slots.shape[1], slots.shape[2]
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    for k in range(points.shape[0]):
        u = cs * points[k, 0] - sn * points[k, 1] + x
        v = sn * points[k, 0] + cs * points[k, 1] + y
        col, row = int(np.floor(u * inverse)), int(np.floor(v * inverse))
        away[k] = False
        if row < 1 or col < 1 or row >= rows - 1 or col >= cols - 1:
            continue
        known = facing = 0
        for r in range(row - 1, row + 1):
            for c in range(col - 1, col + 1):
                if slots[1, r, c] >= 0:
                    known += 1
                    if not block_is_away(r, c, x, y, slots, sums, normals, views, least_m, least_slant):
                        facing += 1
        away[k] = known > 0 and facing == 0


@njit("void(f8[::1], f8[:,::1], f8[::1], f8, f8, f8, u1[:,::1])", cache=True, nogil=True)
def look_through(laser, ends, origin, cell_m, short_m, most_m, passed):
    """Count up to 255 how often rays from `laser` (2,) to `ends` (N, 2) pass each cell (rows, cols), all m.

    A ray counts up to `short_m` before its end, a beam being wider than its axis, and no farther than
    `most_m`. It is looked at once each `cell_m` of its length.
    """
    rows, cols = passed.shape
    for i in range(ends.shape[0]):
        dx, dy = ends[i, 0] - laser[0], ends[i, 1] - laser[1]
        length_m = np.hypot(dx, dy)
        for k in range(int((min(length_m, most_m) - short_m) / cell_m)):
            along = k * cell_m / length_m
            col = int(np.floor((laser[0] + along * dx - origin[0]) / cell_m))
            row = int(np.floor((laser[1] + along * dy - origin[1]) / cell_m))
            if 0 <= row < rows and 0 <= col < cols and passed[row, col] < 255:
                passed[row, col] += 1
