"""Compiled inner loops of what a scan could have seen from a place: see `processing.sightlines`."""

import numpy as np
from numba import njit

SLACK_M = 0.2
SLACK = 0.1
"""A ray ends behind a wall only when it is longer by so much and by this share: poses and walls are rough."""


@njit("i8(f8, f8, i8)", cache=True, nogil=True)
def sector(x, y, sectors):
    """Return in which of so many sectors a point lies, counted from straight behind."""
    return min(int((np.arctan2(y, x) + np.pi) * (sectors / (2.0 * np.pi))), sectors - 1)


@njit("void(f8[:,::1], i8, i8, f8[::1], f8, f8[::1])", cache=True, nogil=True)
def nearest(points, first, last, frame_t_laser, most_m, distance_m):
    """Write how far the nearest of points[first:last] (N, 2) is in each sector (S,) around a pose (3,).

    Infinity where there is none nearer than `most_m`.
    """
    sectors = distance_m.shape[0]
    for k in range(sectors):
        distance_m[k] = np.inf
    c, s = np.cos(frame_t_laser[2]), np.sin(frame_t_laser[2])
    for i in range(first, last):
        dx, dy = points[i, 0] - frame_t_laser[0], points[i, 1] - frame_t_laser[1]
        away_m = np.hypot(dx, dy)
        if away_m < most_m:
            k = sector(c * dx + s * dy, c * dy - s * dx, sectors)
            distance_m[k] = min(distance_m[k], away_m)


@njit("void(f8[:,::1], f8[:,::1], i8[::1], f8[:,::1], f8, f8[::1], u1[::1], i8[::1])", cache=True, nogil=True)
def look_back(placed, points, ends, poses, most_m, distance_m, known, counts):
    """Ask each earlier scan what it saw where the points of a scan (N, 2) lie now; all in one frame.

    `points` (M, 2): of the earlier scans, one after the other up to `ends` (K,); `poses` (K, 3): where they
    were taken. `distance_m` (S,): room to work in, a sector each. `known` (N,): set where an earlier scan has
    looked. `counts` (2,): how often one has looked through the place of a point, and how often in its
    direction.
    """
    counts[0] = counts[1] = 0
    for i in range(placed.shape[0]):
        known[i] = 0
    first = 0
    for j in range(poses.shape[0]):
        nearest(points, first, ends[j], poses[j], most_m, distance_m)
        first = ends[j]
        c, s = np.cos(poses[j, 2]), np.sin(poses[j, 2])
        for i in range(placed.shape[0]):
            dx, dy = placed[i, 0] - poses[j, 0], placed[i, 1] - poses[j, 1]
            end_m = distance_m[sector(c * dx + s * dy, c * dy - s * dx, distance_m.shape[0])]
            if end_m == np.inf:
                continue
            away_m = np.hypot(dx, dy)
            counts[1] += 1
            if away_m + (SLACK_M + SLACK * away_m) < end_m:
                counts[0] += 1
            if away_m <= end_m + (SLACK_M + SLACK * end_m):
                known[i] = 1
