"""Compiled inner loops that tell which way walls face, and which of them a laser would see from behind."""

import numpy as np
from numba import njit

NEAR_M, THIN = 0.15, 0.1
"""Neighbours up to so far away say how a wall runs; greatest ratio of their variances across it and along."""
STRAIGHT_M, STRAIGHT = 0.25, 0.01
"""The same where the wall must be straight: as long as a cell of the map, and a tenth as thick."""
ENOUGH = 6
"""So many on each side count even if they are farther, as far away as"""
REACH = 0.15
"""this share of the range."""
LEAST = 4
"""Points that it takes."""
GRAZING = 6.0
"""A hit whose neighbours are so many times as far away as on a wall square to its ray is of one along it,"""
LONE_M = 0.1
"""where neighbouring rays are farther apart than this; nearer, it may be a thin thing: a leg of a chair."""
SHORT = 0.5
"""Length of its normal, which belongs on no wall: far away a wall is a few hits in the map, and stands aslant
by their noise; matched on it the hit would tell the way along."""


@njit("f8(f8[::1], f8[::1])", cache=True, nogil=True)
def across(sums, normal):
    """Write the short axis (2,) of points; return the ratio of their variances, infinity if they are too few.

    `sums` (6,): their number, sums of u, v, u^2, u v, v^2.
    """
    n = sums[0]
    if n < LEAST:
        return np.inf
    mu, mv = sums[1] / n, sums[2] / n
    xx, xy, yy = sums[3] / n - mu * mu, sums[4] / n - mu * mv, sums[5] / n - mv * mv
    half, mean = 0.5 * (xx - yy), 0.5 * (xx + yy)
    root = np.sqrt(half * half + xy * xy)
    angle = 0.5 * np.arctan2(xy, half)
    normal[0], normal[1] = -np.sin(angle), np.cos(angle)
    return (mean - root) / max(mean + root, 1e-12)


@njit("void(f8[:,::1], i8, i8[::1], f8, f8, f8[:,::1])", cache=True, nogil=True)
def face(points, count, which, near_m, thin, normals):
    """Write the unit normals of points' walls, towards the laser at the origin; 0 where there is no wall.

    The wall is that of the neighbours on both sides; at a corner, of those on the straighter side.

    Args:
        points: (N, 2) m, laser frame, in the order of their rays.
        count: How many of them there are.
        which: (K,) numbers of those that are asked about.
        near_m: How far away neighbours may be.
        thin: Greatest ratio of the variances of points on one wall.
        normals: (M, 2), M >= K; the answer.
    """
    sums, normal = np.empty((3, 6)), np.empty(2)
    for k in range(which.shape[0]):
        i = which[k]
        x, y = points[i, 0], points[i, 1]
        near_2 = near_m * near_m
        reach_2 = max(near_2, REACH * REACH * (x * x + y * y))
        for part in range(3):
            sums[part, 0] = 1.0
            for m in range(1, 6):
                sums[part, m] = 0.0
        for side in range(1, 3):
            step = 2 * side - 3
            j = i + step
            while 0 <= j < count:
                u, v = points[j, 0] - x, points[j, 1] - y
                away_2 = u * u + v * v
                if away_2 > reach_2 or (away_2 > near_2 and abs(j - i) > ENOUGH):
                    break
                sums[side, 0] += 1.0
                sums[side, 1] += u
                sums[side, 2] += v
                sums[side, 3] += u * u
                sums[side, 4] += u * v
                sums[side, 5] += v * v
                j += step
        for m in range(6):
            sums[0, m] = sums[1, m] + sums[2, m]
        sums[0, 0] -= 1.0
        normals[k, 0] = normals[k, 1] = 0.0
        thinnest = thin
        for part in range(3):
            if part == 1 and thinnest < thin:
                break
            ratio = across(sums[part], normal)
            if ratio < thinnest:
                thinnest = ratio
                away = 1.0 if normal[0] * x + normal[1] * y > 0.0 else -1.0
                normals[k, 0], normals[k, 1] = -away * normal[0], -away * normal[1]


@njit("void(f8[:,::1], i8[::1], i8, i8[::1], f8, f8[:,::1])", cache=True, nogil=True)
def lean(points, rays, count, which, increment_rad, normals):
    """Give lone far hits that have no wall a short normal across their ray.

    With it they tell across their ray only, and nothing where the map has a wall (`ndt_kernels.across_wall`).

    Of a laser of a degree between its rays, the last one along a corridor meets its side tens of metres
    beyond the one before, and always equally far ahead: taken for a thing that stands there, it holds the
    laser.

    Args:
        points: (N, 2) m, laser frame, in the order of their rays.
        rays: (N,) numbers of these.
        count: How many points there are.
        which: (K,) numbers of those that are asked about.
        increment_rad: Between neighbouring rays, > 0.
        normals: (M, 2), M >= K, as `face` wrote them; filled in.
    """
    for k in range(which.shape[0]):
        if normals[k, 0] != 0.0 or normals[k, 1] != 0.0:
            continue
        i = which[k]
        x, y = points[i, 0], points[i, 1]
        range_m = np.sqrt(x * x + y * y)
        square_m = range_m * increment_rad
        is_lone = square_m > LONE_M
        for j in range(max(i - 1, 0), min(i + 2, count)):
            if j != i:
                u, v = points[j, 0] - x, points[j, 1] - y
                is_near = u * u + v * v < (GRAZING * square_m) ** 2
                # Both sides of a corridor are hit equally far ahead, and nothing between them: no wall.
                is_lone = is_lone and not (is_near and abs(rays[j] - rays[i]) == 1)
        if is_lone:
            normals[k, 0], normals[k, 1] = -SHORT * y / range_m, SHORT * x / range_m


@njit("i8(f8[:,::1], f8[:,::1], f8, f8, f8, f8, b1[::1])", cache=True, nogil=True)
def look_behind(points, normals, x, y, least_m, least_slant, behind):
    """Mark the points whose wall a laser would see from behind; return how many they are.

    Args:
        points: (N, 2) m.
        normals: (N, 2) unit normals of their walls, 0 for none.
        x: Of the laser, same frame.
        y: Of the laser.
        least_m: How far the laser must be behind the line of the wall, and
        least_slant: by which sine of an angle more, seen from the point.
        behind: (N,) the answer.
    """
    count = 0
    for i in range(points.shape[0]):
        u, v = x - points[i, 0], y - points[i, 1]
        beyond = -(u * normals[i, 0] + v * normals[i, 1]) - least_m
        behind[i] = beyond > 0.0 and beyond > least_slant * np.sqrt(u * u + v * v)
        if behind[i]:
            count += 1
    return count
