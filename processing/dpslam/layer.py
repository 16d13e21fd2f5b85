"""What people have painted on a map: erased, walled, kept out. It stands over what the laser has seen.

Each painted cell is tied to the key scan nearest to it and moves with it: when a later drive closes a loop
and the path bends, the paint bends with the map.
"""

import enum
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.grid import (
    CELL_M,
    METRES,
    NONE,
    PLACES,
    STOPS,
    TILE,
    TILE_M,
    TileStore,
    own_tile,
)
from processing.dpslam.writing import renew_blocks
from processing.occupancy import OccupancyGrid
from processing.se2 import Pose

ERASED_M = 2.0
"""Metres of travel that an erased cell is given: rays are sure to pass."""
WALL_STOPS = 10.0
"""Stops that a painted wall is given."""
CHUNK = 1000
"""Cells whose nearest key scan is sought at once."""


class Paint(enum.IntEnum):
    """What a painted cell is."""

    ERASED = 1
    """Free, whatever the laser has seen there."""
    WALL = 2
    """Occupied, whatever the laser has seen there."""
    KEEP_OUT = 3
    """A robot shall not go there; for the laser it is what it was."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Layer:
    """N painted cells."""

    paints: NDArray[np.uint8]
    """(N,) each a `Paint`."""
    keys: NDArray[np.int64]
    """(N,) the key scan that each is tied to."""
    spots: NDArray[np.float64]
    """(N, 2) middle of the cell as seen from that key scan, m."""

    def __post_init__(self) -> None:
        n = len(self.paints)
        if self.keys.shape != (n,) or self.spots.shape != (n, 2):
            raise ValueError(f"{n} paints, {self.keys.shape} keys, {self.spots.shape} spots: must be as many")
        if not np.isin(self.paints, list(Paint)).all() or self.keys.min(initial=0) < 0:
            raise ValueError("a painted cell is of no known kind or tied to no key scan")

    @classmethod
    def none(cls) -> "Layer":
        """Return a layer on which nothing is painted."""
        return cls(paints=np.zeros(0, np.uint8), keys=np.zeros(0, np.int64), spots=np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self.paints)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything under its name; `Layer(**arrays)` takes it back."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def count(self, paint: Paint) -> int:
        """Return how many cells are painted so."""
        return int((self.paints == paint).sum())

    def cells(self, path: Pose) -> NDArray[np.int64]:
        """Return the cells (N, 2), row and column from the map's origin; `path` (K, 3) of the key scans."""
        at = path[self.keys]
        c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
        x = c * self.spots[:, 0] - s * self.spots[:, 1] + at[:, 0]
        y = s * self.spots[:, 0] + c * self.spots[:, 1] + at[:, 1]
        return np.floor(np.column_stack((y, x)) / CELL_M).astype(np.int64)

    def painted(self, cells: NDArray[np.int64], paint: Paint, path: Pose) -> "Layer":
        """Return the layer with more cells (M, 2) painted; what was painted there before gives way.

        Erasing and walls are of one kind: the newer one stands. Keep-out stands beside both.
        """
        if len(cells) == 0:
            return self
        kind = self.paints == Paint.KEEP_OUT if paint == Paint.KEEP_OUT else self.paints != Paint.KEEP_OUT
        hidden = kind & np.isin(_numbers(self.cells(path)), _numbers(cells))
        middles = (cells[:, ::-1] + 0.5) * CELL_M
        parts = np.array_split(middles, len(middles) // CHUNK + 1)
        nearest = np.concatenate([_nearest(part, path) for part in parts])
        at = path[nearest]
        off, c, s = middles - at[:, :2], np.cos(at[:, 2]), np.sin(at[:, 2])
        spots = np.column_stack((c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]))
        return Layer(
            paints=np.concatenate((self.paints[~hidden], np.full(len(cells), paint, dtype=np.uint8))),
            keys=np.concatenate((self.keys[~hidden], nearest)),
            spots=np.vstack((self.spots[~hidden], spots)),
        )

    def without(self, *paints: Paint) -> "Layer":
        """Return the layer without what is painted so."""
        kept = ~np.isin(self.paints, paints)
        return Layer(paints=self.paints[kept], keys=self.keys[kept], spots=self.spots[kept])

    def over(self, grid: OccupancyGrid, path: Pose) -> OccupancyGrid:
        """Return the map as it is with the erased cells and the walls; cells outside it are left out."""
        probability = grid.probability.copy()
        for paint, value in ((Paint.ERASED, 0.0), (Paint.WALL, 1.0)):
            probability[self._inside(grid, path, paint)] = value
        return replace(grid, probability=probability)

    def keep_out(self, grid: OccupancyGrid, path: Pose) -> NDArray[np.bool_]:
        """Return which cells (rows, cols) of a map a robot shall keep out of."""
        mask = np.zeros(grid.probability.shape, dtype=np.bool_)
        mask[self._inside(grid, path, Paint.KEEP_OUT)] = True
        return mask

    def write_on(self, store: TileStore, path: Pose) -> None:
        """Write erased cells and walls into the one map that all particles of a store share."""
        cells = self.cells(path)
        for paint, stops, metres in ((Paint.ERASED, 0.0, ERASED_M), (Paint.WALL, WALL_STOPS, CELL_M)):
            chosen = cells[self.paints == paint]
            if len(chosen):
                _write(store, chosen, stops, metres)

    def _inside(
        self, grid: OccupancyGrid, path: Pose, paint: Paint
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns, in the grid, of what is painted so."""
        corner = np.round(np.array(grid.origin_m)[::-1] / CELL_M).astype(np.int64)
        at = self.cells(path)[self.paints == paint] - corner
        at = at[((at >= 0) & (at < grid.probability.shape)).all(axis=1)]
        return at[:, 0], at[:, 1]


def _nearest(points: NDArray[np.float64], path: Pose) -> NDArray[np.int64]:
    """Return the key scan nearest to each point (N, 2)."""
    off = points[:, None] - path[None, :, :2]
    return np.asarray((off**2).sum(axis=2).argmin(axis=1))


def _write(store: TileStore, cells: NDArray[np.int64], stops: float, metres: float) -> None:
    store.cover(cells.min(axis=0)[::-1] * CELL_M - TILE_M, cells.max(axis=0)[::-1] * CELL_M + TILE_M)
    for tile_row, tile_col in np.unique(cells // TILE, axis=0).tolist():
        store.reserve(1)
        arrays, table, first_row, first_col = store.maps
        at = tile_row - first_row, tile_col - first_col
        if table[0, *at] == NONE:
            table[:, *at] = own_tile(arrays, table, 0, *at)
            arrays[4][table[0, *at]] = len(table)
        tile = int(table[0, *at])
        inside = cells[(cells // TILE == (tile_row, tile_col)).all(axis=1)] % TILE
        number = inside[:, 0] * TILE + inside[:, 1]
        for place, value, middle in ((0, stops * STOPS, 0.5), (1, metres * METRES, 0.5)):
            arrays[0][tile, 2 * number + place] = round(value)
            arrays[1][tile, 2 * number + place] = round(middle * PLACES)
        arrays[3][tile] = 1
        renew_blocks(*arrays[:4], tile)


def _numbers(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for each cell (N, 2)."""
    return cells[:, 0] * 4_000_037 + cells[:, 1]
