"""Loops over particles: refine, weigh, write; each is independent of the others until the selection."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.dpslam.alignment import align
from processing.dpslam.grid import _STORE, TILE_M, Arrays, Table
from processing.dpslam.laser_model import place_rays, score_rays
from processing.dpslam.writing import write_rays

_MAP = f"{_STORE}, i4[:,:,::1], i8, i8"


@njit(
    f"void({_MAP}, f8[:,::1], f8[:,::1], f8[:,:,::1], f8, f8[:,::1], f8[:,:,::1], f8[:,::1])",
    cache=True,
    nogil=True,
)
def refine_all(
    store: Arrays,
    table: Table,
    first_row: int,
    first_col: int,
    points: NDArray[np.float64],
    predicted: NDArray[np.float64],
    priors: NDArray[np.float64],
    gain: float,
    poses: NDArray[np.float64],
    information: NDArray[np.float64],
    results: NDArray[np.float64],
) -> None:
    """Align the points with the map of each particle; see `alignment.align`."""
    for p in range(poses.shape[0]):
        align(
            store,
            table,
            p,
            first_row,
            first_col,
            points,
            predicted[p],
            priors[p],
            gain,
            poses[p],
            information[p],
            results[p],
        )


@njit(f"void({_MAP}, f8[:,::1], f8[:,::1], i8, b1, f8, u1[::1], f8[::1])", cache=True, nogil=True)
def weigh_all(
    store: Arrays,
    table: Table,
    first_row: int,
    first_col: int,
    rays: NDArray[np.float64],
    poses: NDArray[np.float64],
    every: int,
    whole: bool,
    unseen: float,
    chosen: NDArray[np.uint8],
    scores: NDArray[np.float64],
) -> None:
    """Write the log-likelihood of every `every`-th ray in the map of each chosen particle."""
    placed = np.empty_like(rays)
    for p in range(poses.shape[0]):
        if chosen[p]:
            place_rays(poses[p], rays, placed)
            scores[p] = score_rays(store, table, p, first_row, first_col, placed, 0, every, whole, unseen)


@njit("i8(f8[:,::1])", cache=True, nogil=True)
def tiles_under(rays_map: NDArray[np.float64]) -> int:
    """Return how many tiles the rays (N, 4) may touch: those of their bounding box, one more on each side."""
    if rays_map.shape[0] == 0:
        return 0
    x0 = x1 = rays_map[0, 0]
    y0 = y1 = rays_map[0, 1]
    for i in range(rays_map.shape[0]):
        x0 = min(x0, rays_map[i, 0], rays_map[i, 2])
        x1 = max(x1, rays_map[i, 0], rays_map[i, 2])
        y0 = min(y0, rays_map[i, 1], rays_map[i, 3])
        y1 = max(y1, rays_map[i, 1], rays_map[i, 3])
    cols = int(np.floor(x1 / TILE_M)) - int(np.floor(x0 / TILE_M)) + 3
    rows = int(np.floor(y1 / TILE_M)) - int(np.floor(y0 / TILE_M)) + 3
    return cols * rows


@njit(f"i8({_MAP}, f8[:,::1], f8[:,::1], f8, i8)", cache=True, nogil=True)
def write_all(
    store: Arrays,
    table: Table,
    first_row: int,
    first_col: int,
    rays: NDArray[np.float64],
    poses: NDArray[np.float64],
    memory: float,
    begin: int,
) -> int:
    """Write the rays into the maps of the particles from `begin` on.

    Returns:
        The particle at which free tiles ran short, before anything of it was written; P when all are done.
    """
    placed = np.empty_like(rays)
    touched = np.empty(table.shape[1] * table.shape[2] + 1, dtype=np.int32)
    for p in range(begin, poses.shape[0]):
        place_rays(poses[p], rays, placed)
        if store[6][0] < tiles_under(placed):
            return p
        write_rays(store, table, p, first_row, first_col, placed, memory, touched)
    return int(poses.shape[0])


@njit(f"i8({_MAP}, f8[:,::1], i8[::1], f8[:,::1], f8, i8)", cache=True, nogil=True)
def write_path(
    store: Arrays,
    table: Table,
    first_row: int,
    first_col: int,
    rays: NDArray[np.float64],
    ends: NDArray[np.int64],
    path: NDArray[np.float64],
    memory: float,
    begin: int,
) -> int:
    """Write key scans from `begin` on into the map of particle 0, each from its pose on the path (K, 3).

    Returns:
        The key scan at which free tiles ran short, before anything of it was written; K when all are done.
    """
    longest = 0
    for k in range(path.shape[0]):
        longest = max(longest, ends[k + 1] - ends[k])
    placed = np.empty((longest, 4))
    touched = np.empty(table.shape[1] * table.shape[2] + 1, dtype=np.int32)
    for k in range(begin, path.shape[0]):
        count = ends[k + 1] - ends[k]
        place_rays(path[k], rays[ends[k] : ends[k + 1]], placed[:count])
        if store[6][0] < tiles_under(placed[:count]):
            return k
        write_rays(store, table, 0, first_row, first_col, placed[:count], memory, touched)
    return int(path.shape[0])


@njit("Tuple((f8[::1], f8[::1], i8))(f8[:,::1], i8[::1], f8[:,::1])", cache=True, nogil=True)
def bounds(
    rays: NDArray[np.float64], ends: NDArray[np.int64], path: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Return the corners of a box around all key scans, and the most tiles that one of them may touch."""
    # The start counts too: an empty path must not give an empty box.
    low, high = np.zeros(2), np.zeros(2)
    tiles = 1
    for k in range(path.shape[0]):
        count = ends[k + 1] - ends[k]
        reach = 0.0
        for i in range(ends[k], ends[k + 1]):
            reach = max(reach, np.hypot(rays[i, 2], rays[i, 3]))
        placed = np.empty((count, 4))
        place_rays(path[k], rays[ends[k] : ends[k + 1]], placed)
        tiles = max(tiles, tiles_under(placed))
        for axis in range(2):
            low[axis] = min(low[axis], path[k, axis] - reach)
            high[axis] = max(high[axis], path[k, axis] + reach)
    return low, high, tiles
