"""Compiled inner loops of the wide search: blurring, window maxima, branch and bound.

Arrays and scalars in, results into given arrays; nothing is checked here: `wide_match` does that once.
"""

import numpy as np
from numba import njit

SLACK = 1e-6
"""Of sums of floats: nothing is given up that rounding alone puts below."""


@njit("void(f8[:,::1], f8, f8, f8, f8, f4[:,::1])", cache=True, nogil=True)
def blur(points, x0, y0, resolution, sigma, field):
    """Raise `field` (rows, cols) to a Gaussian around every point; the highest at each cell stays."""
    rows, cols = field.shape
    reach = int(np.ceil(3.0 * sigma / resolution))
    for i in range(points.shape[0]):
        px, py = (points[i, 0] - x0) / resolution - 0.5, (points[i, 1] - y0) / resolution - 0.5
        col0, row0 = int(np.round(px)), int(np.round(py))
        for row in range(max(row0 - reach, 0), min(row0 + reach + 1, rows)):
            for col in range(max(col0 - reach, 0), min(col0 + reach + 1, cols)):
                d2 = ((col - px) ** 2 + (row - py) ** 2) * resolution * resolution
                value = np.float32(np.exp(-0.5 * d2 / (sigma * sigma)))
                if value > field[row, col]:
                    field[row, col] = value


@njit("void(f8[:,::1], f8, f8, f8, f8, f4, f4[:,::1])", cache=True, nogil=True)
def lower(squares, x0, y0, resolution, edge, most, field):
    """Write -1 into the cells of `field` (rows, cols) under squares of an edge, but where it exceeds `most`.

    `squares` (N, 2): their middles. The border is left as it is: what begins outside reaches over it.
    """
    rows, cols = field.shape
    side = int(np.round(edge / resolution))
    for i in range(squares.shape[0]):
        col0 = int(np.round((squares[i, 0] - 0.5 * edge - x0) / resolution))
        row0 = int(np.round((squares[i, 1] - 0.5 * edge - y0) / resolution))
        for row in range(max(row0, 1), min(row0 + side, rows - 1)):
            for col in range(max(col0, 1), min(col0 + side, cols - 1)):
                if field[row, col] <= most:
                    field[row, col] = -1.0


@njit("void(f4[:,:,::1])", cache=True, nogil=True)
def raise_pyramid(levels):
    """Fill levels 1.. from level 0: each the maximum of four shifted copies of the one below."""
    count, rows, cols = levels.shape
    for level in range(1, count):
        step = 1 << (level - 1)
        below, here = levels[level - 1], levels[level]
        for row in range(rows):
            up = min(row + step, rows - 1)
            for col in range(cols):
                right = min(col + step, cols - 1)
                a = max(below[row, col], below[row, right])
                b = max(below[up, col], below[up, right])
                here[row, col] = max(a, b)


@njit("f8(f4[:,::1], i8[:,::1], i8, i8)", cache=True, nogil=True)
def mean_at(field, cells, shift_col, shift_row):
    """Mean of a level of the field under the cells (N, 2) moved by whole cells; 0 outside."""
    rows, cols = field.shape
    total = 0.0
    for i in range(cells.shape[0]):
        col, row = cells[i, 0] + shift_col, cells[i, 1] + shift_row
        if 0 <= row < rows and 0 <= col < cols:
            total += field[row, col]
    return total / cells.shape[0]


@njit("f8(f4[:,:,::1], i8, i8[:,::1], i8, i8, f8)", cache=True, nogil=True)
def bound_at(levels, level, cells, shift_col, shift_row, least):
    """Mean of window maxima; windows that begin outside the field but reach into it count by their border.

    -1 as soon as it is sure not to be above `least`.
    """
    field = levels[level]
    rows, cols = field.shape
    reach = (1 << level) - 1
    count = cells.shape[0]
    total, spare = 0.0, (1.0 - least) * count + SLACK
    for i in range(count):
        col, row = cells[i, 0] + shift_col, cells[i, 1] + shift_row
        if -reach <= row < rows and -reach <= col < cols:
            value = field[max(row, 0), max(col, 0)]
            total += value
            spare -= 1.0 - value
        else:
            spare -= 1.0
        if spare < 0.0:
            return -1.0
    return total / count


@njit("f8(f8[:,::1], f8, f8, f8, i8, f8)", cache=True, nogil=True)
def least_cost(costs, col, row, turn, level, resolution):
    """Least of what an offset takes off, over a square of 2^level cells from the offset (col, row) on.

    `costs` (3, 3): a quadratic form of the offset in x, y (m) and rotation (rad). Its root is a norm, so from
    the middle of the square it falls by no more than its steepest slope allows.
    """
    wide = 0.5 * ((1 << level) - 1)
    x, y = (col + wide) * resolution, (row + wide) * resolution
    cost = costs[0, 0] * x * x + costs[1, 1] * y * y + costs[2, 2] * turn * turn
    cost += 2.0 * (costs[0, 1] * x * y + (costs[0, 2] * x + costs[1, 2] * y) * turn)
    mean, apart = 0.5 * (costs[0, 0] + costs[1, 1]), 0.5 * (costs[0, 0] - costs[1, 1])
    steepest = mean + np.sqrt(apart * apart + costs[0, 1] * costs[0, 1])
    root = np.sqrt(max(cost, 0.0)) - wide * resolution * np.sqrt(2.0 * steepest)
    return root * root if root > 0.0 else 0.0


@njit("b1(f8, f8, f8, f8[:,::1], f8, f8)", cache=True, nogil=True)
def neighbours(x, y, yaw, places, apart_m, apart_rad):
    """Whether a pose belongs to the same place as one of others (M, 3)."""
    for i in range(places.shape[0]):
        turn = (yaw - places[i, 2] + np.pi) % (2.0 * np.pi) - np.pi
        off2 = (x - places[i, 0]) ** 2 + (y - places[i, 1]) ** 2
        if off2 < apart_m * apart_m and abs(turn) < apart_rad:
            return True
    return False


@njit("i8(i8, i8)", cache=True, nogil=True)
def top_of(levels, reach):
    """Return the level from which a window of 2 `reach` + 1 cells is searched.

    Its squares of 2^level cells, counted row by row from the lowest corner, are those that may be closed.
    """
    top = levels - 1
    while top > 0 and (1 << top) > 2 * reach + 1:
        top -= 1
    return top


@njit(
    "b1(f4[:,:,::1], f8, f8, f8, f8[:,::1], f8[::1], f8, i8, i8,"
    " f8[:,::1], f8[:,::1], f8, f8, u1[::1], f8[::1], i8[::1])",
    cache=True,
    nogil=True,
)
def branch_and_bound(
    levels,
    x0,
    y0,
    resolution,
    points,
    guess,
    turn,
    turns,
    reach,
    costs,
    shunned,
    apart_m,
    apart_rad,
    open_nodes,
    found,
    progress,
):
    """Go on with a search and return whether it is at its end.

    Rotations are walked from the guess outwards; for each, the translations are a tree of squares whose
    bound is the pyramid, less what their offsets cost, see `least_cost`. Places that neighbour one of
    `shunned` (M, 3) are passed over, and squares of the coarsest step that are not open, see `top_of`.

    `found` (x, y, yaw, score) begins with the score that must be passed and ends with the best of the window.
    `progress`: the rotation to go on with, the squares that may still be looked at, counted down; the search
    stops at the end of the rotation in which they are used up.
    """
    count = points.shape[0]
    top = top_of(levels.shape[0], reach)
    cells = np.empty((count, 2), dtype=np.int64)
    stack = np.empty((4 * (top + 1) + 4, 3), dtype=np.int64)
    side = 1 << top
    across = (2 * reach + side) // side
    bounds = np.empty(across * across)
    best = found[3]
    while progress[0] < 2 * turns + 1 and progress[1] > 0:
        k = progress[0]
        progress[0] += 1
        yaw = guess[2] + turn * ((k + 1) // 2) * (1.0 if k % 2 else -1.0)
        c, s = np.cos(yaw), np.sin(yaw)
        for i in range(count):
            px, py = points[i, 0], points[i, 1]
            cells[i, 0] = int(np.floor((c * px - s * py + guess[0] - x0) / resolution))
            cells[i, 1] = int(np.floor((s * px + c * py + guess[1] - y0) / resolution))
        for node in range(across * across):
            col, row = -reach + side * (node % across), -reach + side * (node // across)
            bounds[node] = -1.0
            if open_nodes[node]:
                cost = least_cost(costs, col, row, yaw - guess[2], top, resolution)
                bounds[node] = bound_at(levels, top, cells, col, row, best + cost) - cost
        progress[1] -= across * across
        while True:
            # The most promising first; few are looked at, so that they need not all be sorted.
            node = 0
            for other in range(1, across * across):
                if bounds[other] > bounds[node]:
                    node = other
            if bounds[node] <= best:
                break
            bounds[node] = -1.0
            stack[0, 0], stack[0, 1] = -reach + side * (node % across), -reach + side * (node // across)
            stack[0, 2] = top
            depth = 1
            while depth > 0:
                depth -= 1
                col, row, level = stack[depth, 0], stack[depth, 1], stack[depth, 2]
                cost = least_cost(costs, col, row, yaw - guess[2], level, resolution)
                score = bound_at(levels, level, cells, col, row, best + cost) - cost
                progress[1] -= 1
                if score <= best:
                    continue
                if level == 0:
                    x, y = guess[0] + col * resolution, guess[1] + row * resolution
                    inside = abs(col) <= reach and abs(row) <= reach
                    if inside and not neighbours(x, y, yaw, shunned, apart_m, apart_rad):
                        best = score
                        found[0], found[1], found[2], found[3] = x, y, yaw, score
                    continue
                half = 1 << (level - 1)
                for child in range(4):
                    stack[depth, 0] = col + half * (child % 2)
                    stack[depth, 1] = row + half * (child // 2)
                    stack[depth, 2] = level - 1
                    depth += 1
    return progress[0] == 2 * turns + 1
