"""Compiled inner loops that tell which way walls face, and which of them a laser would see from behind."""

import numpy as np
from numba import njit

NEAR_M = 0.15
"""Neighbours up to so far away say how a wall runs,"""
ENOUGH = 6
"""and so many on each side even if they are farther, as far away as"""
REACH = 0.15
"""this share of the range."""
LEAST = 4
"""Points that it takes."""
THIN = 0.1
"""Greatest ratio of the variances of points on one wall."""


@njit("void(f8[:,::1], i8, f8[:,::1])", cache=True, nogil=True)
def face(points, count, normals):
    """Write the unit normal of each point's wall, towards the laser at the origin; 0 where there is no wall.

    Args:
        points: (N, 2) m, laser frame, in the order of their rays.
        count: How many of them there are.
        normals: (M, 2), M >= count; the answer.
    """
    for i in range(count):
        x, y = points[i, 0], points[i, 1]
        near_2 = NEAR_M * NEAR_M
        reach_2 = max(near_2, REACH * REACH * (x * x + y * y))
        n = 1.0
        su = sv = suu = suv = svv = 0.0
        for step in (-1, 1):
            j = i + step
            while 0 <= j < count:
                u, v = points[j, 0] - x, points[j, 1] - y
                away_2 = u * u + v * v
                if away_2 > reach_2 or (away_2 > near_2 and abs(j - i) > ENOUGH):
                    break
                n += 1.0
                su += u
                sv += v
                suu += u * u
                suv += u * v
                svv += v * v
                j += step
        normals[i, 0] = normals[i, 1] = 0.0
        if n < LEAST:
            continue
        mu, mv = su / n, sv / n
        xx, xy, yy = suu / n - mu * mu, suv / n - mu * mv, svv / n - mv * mv
        half = 0.5 * (xx - yy)
        root = np.sqrt(half * half + xy * xy)
        if 0.5 * (xx + yy) - root > THIN * (0.5 * (xx + yy) + root):
            continue
        angle = 0.5 * np.arctan2(xy, half)
        nx, ny = -np.sin(angle), np.cos(angle)
        if nx * x + ny * y > 0.0:
            nx, ny = -nx, -ny
        normals[i, 0], normals[i, 1] = nx, ny


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
