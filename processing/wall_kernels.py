"""Compiled inner loop that fills in a wall between two rays that both met it.

A laser of a degree between its rays meets the far wall of a corridor metres apart. Between the hits the map
would know nothing, every point that lands there would count as a misfit, and the scan be drawn to where its
own pattern of rays was before: a robot in a corridor would stand still.
"""

import numpy as np
from numba import njit

SPACING_M = 0.1
"""Distance of the points put in, and least gap that is filled."""
STRAIGHT_M = 0.03
STRAIGHT = 0.02
"""How far the next hit may lie off the line of two, and how much more a metre that it is away."""
LEAST_SLANT = 0.026
"""Least sine of the angle between ray and wall: what lies along a ray is the edge of something."""


@njit("b1(f8[:,::1], i8, f8, f8)", cache=True, nogil=True)
def slanted(points, i, ux, uy):
    """Whether a wall along the unit vector (ux, uy) is met by the ray of point i, and not merely grazed."""
    x, y = points[i, 0], points[i, 1]
    return bool(abs(x * uy - y * ux) >= LEAST_SLANT * np.hypot(x, y))


@njit("b1(f8[:,::1], i8[::1], i8, i8, i8, f8, f8)", cache=True, nogil=True)
def goes_on(points, rays, count, end, beyond, ux, uy):
    """Whether the ray beyond the end of a stretch of wall along the unit vector (ux, uy) met it, too."""
    if beyond < 0 or beyond >= count or abs(rays[beyond] - rays[end]) != 1:
        return False
    x, y = points[beyond, 0] - points[end, 0], points[beyond, 1] - points[end, 1]
    return bool(abs(x * uy - y * ux) <= STRAIGHT_M + STRAIGHT * np.hypot(x, y))


@njit("i8(f8[:,::1], i8[::1], i8, f8, f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def fill_walls(points, rays, count, most_m, out, normals):
    """Write the first `count` points (N, 2) of a sweep, laser frame, and more between them; return how many.

    Neighbours up to `most_m` apart are joined where they and the rays on both sides of them met one straight
    wall. `rays` (N,): number of each point's ray. `out` (M, 2), M >= count, takes as much as it can hold;
    `normals` (M, 2): unit normals of the walls, towards the laser, of the points put in.
    """
    written = 0
    for i in range(count):
        out[written, 0], out[written, 1] = points[i, 0], points[i, 1]
        written += 1
    for i in range(count):
        if i + 1 == count or rays[i + 1] - rays[i] != 1:
            continue
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        gap = np.hypot(dx, dy)
        if not SPACING_M < gap <= most_m:
            continue
        ux, uy = dx / gap, dy / gap
        if not (
            slanted(points, i, ux, uy)
            and goes_on(points, rays, count, i, i - 1, ux, uy)
            and goes_on(points, rays, count, i + 1, i + 2, ux, uy)
        ):
            continue
        pieces = int(np.ceil(gap / SPACING_M))
        for k in range(1, pieces):
            if written < out.shape[0]:
                out[written, 0], out[written, 1] = (
                    points[i, 0] + dx * k / pieces,
                    points[i, 1] + dy * k / pieces,
                )
                side = 1.0 if ux * points[i, 1] > uy * points[i, 0] else -1.0
                normals[written, 0], normals[written, 1] = side * uy, -side * ux
                written += 1
    return written
