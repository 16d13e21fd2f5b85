"""One store for the maps of all particles: tiles of 32 x 32 cells, shared until somebody writes.

A particle is a table of tile numbers. Descendants share their ancestors' tiles; a write to a tile with more
than one owner copies it first (copy on write), and a tile without owner goes back to the pool. This is the
ancestry of DP-SLAM at the grain of a tile: a look-up costs one table read instead of a walk through the
lineage, and memory grows with what the particles see differently, not with particles times area.

A cell holds its stops and the metres travelled through it, and apart from them, because rays that pass do not
read it, the mean of its end points; all in 16 bit fixed point, for the time of an update is the time to reach
memory. A block of 4 x 4 cells holds the moments (n, x, y, xx, xy, yy) of its occupied cells, kept beside the
tile so that particles who share a tile share the matcher's reference too.
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

CELL_M = 0.05
TILE = 32
TILE_M = TILE * CELL_M
BLOCK = 4
BLOCKS = TILE // BLOCK
BLOCK_M = BLOCK * CELL_M
NONE = -1

Cells: TypeAlias = NDArray[np.uint16]
Blocks: TypeAlias = NDArray[np.float32]
Table: TypeAlias = NDArray[np.int32]

MOMENTS = 6
CELL_VALUES = TILE * TILE * 2
BLOCK_VALUES = BLOCKS * BLOCKS * MOMENTS
STOPS = 256.0
"""Units of one stop."""
METRES = 8192.0
"""Units of one metre of travel."""
PLACES = 65536.0
"""Units of the side of a cell, for end points."""

_STORE = "Tuple((u2[:,::1], u2[:,::1], f4[:,::1], u1[:,::1], i4[::1], i4[::1], i8[::1]))"
"""Type of `TileStore.arrays`, one row a tile: stops and metres (row, column, two), mean end points (row,
column, x, y), blocks (row, column, moment), which blocks are stale, owners, free tiles, number of free tiles.
Rows are flat: compiled loops copy them as one stretch."""

Arrays: TypeAlias = tuple[
    Cells,
    Cells,
    Blocks,
    NDArray[np.uint8],
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.int64],
]
Maps: TypeAlias = tuple[Arrays, Table, int, int]
"""What compiled loops read maps by: store, tables, and the tile (row, column) of the tables' corner."""


@njit(f"i4({_STORE}, i4[:,:,::1], i8, i8, i8)", cache=True, nogil=True)
def own_tile(store: Arrays, table: Table, particle: int, row: int, col: int) -> int:
    """Return the number of a tile that this particle alone owns: fresh, copied, or already its own."""
    cells, ends, blocks, stale, owners, free, count = store
    tile = table[particle, row, col]
    if tile != NONE and owners[tile] == 1:
        return int(tile)
    count[0] -= 1
    mine = free[count[0]]
    if tile == NONE:
        for k in range(CELL_VALUES):
            cells[mine, k] = 0
            ends[mine, k] = 0
        for k in range(BLOCK_VALUES):
            blocks[mine, k] = 0.0
        for k in range(BLOCKS * BLOCKS):
            stale[mine, k] = 0
    else:
        for k in range(CELL_VALUES):
            cells[mine, k] = cells[tile, k]
            ends[mine, k] = ends[tile, k]
        for k in range(BLOCK_VALUES):
            blocks[mine, k] = blocks[tile, k]
        for k in range(BLOCKS * BLOCKS):
            stale[mine, k] = stale[tile, k]
        owners[tile] -= 1
    owners[mine] = 1
    table[particle, row, col] = mine
    return int(mine)


@njit(f"void({_STORE}, i4[:,:,::1], i4[::1])", cache=True, nogil=True)
def _resample(store: Arrays, table: Table, parents: NDArray[np.int32]) -> None:
    """Give particle i the map of particle `parents[i]`; a surviving particle keeps its own place."""
    owners, free, count = store[4], store[5], store[6]
    particles, rows, cols = table.shape
    for i in range(particles):
        parent = parents[i]
        if parent == i:
            continue
        for row in range(rows):
            for col in range(cols):
                tile = table[parent, row, col]
                if tile != NONE:
                    owners[tile] += 1
                gone = table[i, row, col]
                table[i, row, col] = tile
                if gone != NONE:
                    owners[gone] -= 1
                    if owners[gone] == 0:
                        free[count[0]] = gone
                        count[0] += 1


@dataclass(slots=True)
class Extent:
    """Which tiles the tables cover: (row, col) lies at (first_row + row, first_col + col) of the plane."""

    first_row: int
    first_col: int
    rows: int
    cols: int


class TileStore:
    """The maps of `particles` particles, all empty at first."""

    def __init__(self, particles: int, tiles: int = 256) -> None:
        self.table: Table = np.full((particles, 8, 8), NONE, dtype=np.int32)
        self.extent = Extent(-4, -4, 8, 8)
        self.arrays: Arrays = _empty(tiles)
        self._touched = 0

    @property
    def tiles_used(self) -> int:
        """Number of tiles with at least one owner."""
        return int(self.arrays[4].shape[0] - self.arrays[6][0])

    @property
    def bytes_used(self) -> int:
        """Memory of the used tiles and of all tables."""
        return int(self.tiles_used * self._tile_bytes + self.table.nbytes)

    @property
    def bytes_held(self) -> int:
        """Memory of all tiles that were in use at one time, and of all tables: what was taken stays taken."""
        return int(max(self._touched, self.tiles_used) * self._tile_bytes + self.table.nbytes)

    @property
    def _tile_bytes(self) -> int:
        return int(sum(array.nbytes for array in self.arrays[:4]) // self.arrays[0].shape[0])

    def note_use(self) -> None:
        """Take note of how many tiles are in use; called when they are most."""
        self._touched = max(self._touched, self.tiles_used)

    @property
    def maps(self) -> Maps:
        """The arrays as compiled loops take them; valid until `cover`, `reserve` or `restore`."""
        return self.arrays, self.table, self.extent.first_row, self.extent.first_col

    def resample(self, parents: NDArray[np.int32]) -> None:
        """Give particle i the map of particle `parents[i]`; survivors must keep their own place.

        Raises:
            ValueError: if a surviving particle does not stand in its own place.
        """
        stayed = parents[parents]
        if not np.array_equal(stayed, parents):
            moved = int(np.flatnonzero(stayed != parents)[0])
            raise ValueError(f"parents[{moved}] = {parents[moved]}, a survivor must be its own parent")
        _resample(self.arrays, self.table, parents)

    def clear(self) -> None:
        """Empty the maps of all particles."""
        owners, free, count = self.arrays[4:]
        self.table[:] = NONE
        owners[:] = 0
        # Old numbers on top: memory that was used already is taken again before untouched memory is.
        free[:] = np.arange(free.shape[0] - 1, -1, -1)
        count[0] = free.shape[0]

    def share(self, particle: int) -> None:
        """Give the map of one particle to all others, whose maps must be empty."""
        self.table[:] = self.table[particle]
        self.arrays[4][self.table[particle][self.table[particle] != NONE]] = self.table.shape[0]

    def cover(self, low_m: NDArray[np.float64], high_m: NDArray[np.float64]) -> None:
        """Make the tables cover the rectangle from `low_m` to `high_m` (x, y), map frame."""
        first = np.floor(np.asarray(low_m) / TILE_M).astype(int) - 1
        last = np.floor(np.asarray(high_m) / TILE_M).astype(int) + 1
        e = self.extent
        first_col, first_row = min(e.first_col, int(first[0])), min(e.first_row, int(first[1]))
        end_col = max(e.first_col + e.cols, int(last[0]) + 1)
        end_row = max(e.first_row + e.rows, int(last[1]) + 1)
        if (first_row, first_col, end_row, end_col) == (
            e.first_row,
            e.first_col,
            e.first_row + e.rows,
            e.first_col + e.cols,
        ):
            return
        wider = np.full((self.table.shape[0], end_row - first_row, end_col - first_col), NONE, dtype=np.int32)
        at_row, at_col = e.first_row - first_row, e.first_col - first_col
        wider[:, at_row : at_row + e.rows, at_col : at_col + e.cols] = self.table
        self.table = wider
        self.extent = Extent(first_row, first_col, end_row - first_row, end_col - first_col)

    def reserve(self, tiles: int) -> None:
        """Make sure that at least `tiles` tiles are free."""
        owners, count = self.arrays[4], self.arrays[6]
        lacking = tiles - int(count[0])
        if lacking <= 0:
            return
        size = owners.shape[0]
        grown = _empty(size + max(lacking, size // 2))
        # What lies behind the last tile in use is of no worth, and would only become memory in use here.
        last = int(np.flatnonzero(owners).max(initial=-1)) + 1
        for number in range(5):
            grown[number][:last] = self.arrays[number][:last]
        self._touched = last
        free = grown[5]
        fresh = grown[4].shape[0] - size
        # Old numbers on top: a tile that was used already is taken again before untouched memory is.
        free[:fresh] = np.arange(grown[4].shape[0] - 1, size - 1, -1)
        free[fresh : fresh + int(count[0])] = self.arrays[5][: int(count[0])]
        grown[6][0] = fresh + int(count[0])
        self.arrays = grown

    def dense(self, particle: int) -> tuple[Cells, tuple[int, int]]:
        """Return one particle's whole map and the cell (row, col) of its lower left corner.

        The map is (rows, cols, 4): stops, metres, mean end point x and y, in the units of this module.
        """
        cells, ends = self.arrays[:2]
        table, e = self.table[particle], self.extent
        out = np.zeros((e.rows * TILE, e.cols * TILE, 4), dtype=np.uint16)
        for row, col in zip(*np.nonzero(table != NONE), strict=True):
            part = out[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE]
            part[..., :2] = cells[table[row, col]].reshape(TILE, TILE, 2)
            part[..., 2:] = ends[table[row, col]].reshape(TILE, TILE, 2)
        return out, (e.first_row * TILE, e.first_col * TILE)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays, used tiles only; `restore` takes them back."""
        used = np.flatnonzero(self.arrays[4] > 0).astype(np.int32)
        e = self.extent
        cells, ends, blocks, stale, owners, free, count = self.arrays
        return {
            "table": self.table.copy(),
            "extent": np.array((e.first_row, e.first_col, e.rows, e.cols)),
            "used": used,
            "cells": cells[used],
            "ends": ends[used],
            "blocks": blocks[used],
            "stale": stale[used],
            "owners": owners.copy(),
            "free": free[: int(count[0])].copy(),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the store whose `state` was taken."""
        self.table = state["table"].copy()
        self.extent = Extent(*(int(v) for v in state["extent"]))
        self.arrays = _empty(state["owners"].shape[0])
        cells, ends, blocks, stale, owners, free, count = self.arrays
        for array, name in ((cells, "cells"), (ends, "ends"), (blocks, "blocks"), (stale, "stale")):
            array[state["used"]] = state[name]
        owners[:] = state["owners"]
        free[: state["free"].shape[0]] = state["free"]
        count[0] = state["free"].shape[0]


def _empty(tiles: int) -> Arrays:
    return (
        # Untouched pages of a fresh array cost nothing, so the pool may be larger than what is in use.
        np.empty((tiles, CELL_VALUES), dtype=np.uint16),
        np.empty((tiles, CELL_VALUES), dtype=np.uint16),
        np.empty((tiles, BLOCK_VALUES), dtype=np.float32),
        np.zeros((tiles, BLOCKS * BLOCKS), dtype=np.uint8),
        np.zeros(tiles, dtype=np.int32),
        np.arange(tiles - 1, -1, -1, dtype=np.int32),
        np.array([tiles], dtype=np.int64),
    )
