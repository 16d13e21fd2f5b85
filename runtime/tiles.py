"""A map that grows and changes, in tiles: which changed since somebody last asked, and the answer to that.

Tiles lie fixed in the map's frame, each with the number of its last change. Whoever asks names the number up
to which he knows the map and how many bytes he takes; the answer holds the tiles that changed after it, the
longest changed first. So a slow reader gets fewer answers and never an older picture, one who was away or
comes late catches up with the same question, and one who asks no more costs nothing.
"""

import os
import struct
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TILE = 64
"""Cells along a side."""
MAX_ANSWER = 60_000
"""More would be cut into pieces on the wire, of which a slow link loses one."""
UNKNOWN = -1
_QUESTION = struct.Struct("<16sqI")
_ANSWER = struct.Struct("<16sqqqdIH")  # run, number, stamp, published, resolution, tiles left, tiles here
_TILE = struct.Struct("<iiH")  # column, row, bytes
_MOST_TILES = 1 << 15  # within the borders of a picture: what a damaged answer may make us reserve

Cells = NDArray[np.int8]


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Part of a picture, in its cells."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A map as a grid; row 0 has the lowest y."""

    cells: Cells
    """(rows, cols): -1 unknown, 0 .. 100."""
    resolution_m: float
    origin_m: tuple[float, float]
    """Lower left corner, map frame."""
    stamp_ns: int
    """Of the last scan in it."""
    published_ns: int
    """When the mapper said so."""


class Tiles:
    """The map's last state, its tiles' numbers, and answers from another thread.

    Args:
        bytes_per_s: What all askers together get at most.
        now_s: The present; given by tests.
    """

    def __init__(self, bytes_per_s: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._run = os.urandom(16)
        self._lock = threading.Lock()
        self._picture = Picture(np.zeros((0, 0), np.int8), 1.0, (0.0, 0.0), 0, 0)
        self._corner = (0, 0)  # tile column and row of the picture's first tile
        self._numbers = np.zeros((0, 0), np.int64)
        self._newest = 0
        self._packed: dict[tuple[int, int], tuple[int, bytes]] = {}
        self._now_s, self._rate = now_s, bytes_per_s
        self._purse, self._filled_s = float(bytes_per_s), now_s()

    @property
    def picture(self) -> Picture:
        """The whole map, padded to whole tiles; do not write into it."""
        return self._picture

    def take(
        self,
        cells: Cells,
        resolution_m: float,
        origin_m: tuple[float, float],
        stamp_ns: int,
        published_ns: int,
    ) -> tuple[bool, list[Rectangle]]:
        """Take the map in.

        Args:
            cells: (rows, cols) as in a Picture.
            resolution_m: Side of a cell; the same each time.
            origin_m: Lower left corner, a whole number of cells from the origin of the frame.
            stamp_ns: Of the last scan in it.
            published_ns: The present.

        Returns:
            Whether the picture has grown, and the parts of it that have changed, each under MAX_ANSWER cells.
        """
        first = (round(origin_m[0] / resolution_m), round(origin_m[1] / resolution_m))  # x, y in cells
        before, old = self._corner, self._numbers
        low = [first[k] // TILE for k in (0, 1)]
        high = [-(-(first[k] + cells.shape[1 - k]) // TILE) for k in (0, 1)]
        if old.size:  # what was shown once stays in the picture
            low = [min(low[k], before[k]) for k in (0, 1)]
            high = [max(high[k], before[k] + old.shape[1 - k]) for k in (0, 1)]
        shape = (high[1] - low[1], high[0] - low[0])
        fresh = np.full((shape[0] * TILE, shape[1] * TILE), UNKNOWN, np.int8)
        last = fresh.copy()
        x, y = first[0] - low[0] * TILE, first[1] - low[1] * TILE
        fresh[y : y + cells.shape[0], x : x + cells.shape[1]] = cells
        numbers = np.zeros(shape, np.int64)
        if old.size:
            right, up = before[0] - low[0], before[1] - low[1]
            rows, cols = self._picture.cells.shape
            last[up * TILE : up * TILE + rows, right * TILE : right * TILE + cols] = self._picture.cells
            numbers[up : up + old.shape[0], right : right + old.shape[1]] = old
        changed = (fresh != last).reshape(shape[0], TILE, shape[1], TILE).any(axis=(1, 3))
        resized = shape != old.shape
        with self._lock:
            numbers[changed] = self._newest + 1 + np.arange(np.count_nonzero(changed))
            self._newest += int(np.count_nonzero(changed))
            self._numbers, self._corner = numbers, (low[0], low[1])
            corner_m = (low[0] * TILE * resolution_m, low[1] * TILE * resolution_m)
            self._picture = Picture(fresh, resolution_m, corner_m, stamp_ns, published_ns)
        return resized, _rectangles(changed)

    def answer(self, question: bytes) -> bytes:
        """Answer `question(...)`; empty for anything else."""
        if len(question) != _QUESTION.size:
            return b""
        run, known, room = _QUESTION.unpack(question)
        with self._lock:
            known = known if run == self._run else 0
            room = min(room, MAX_ANSWER, self._allowance()) - _ANSWER.size
            rows, cols = np.nonzero(self._numbers > known)
            order = np.argsort(self._numbers[rows, cols])
            body: list[bytes] = []
            for index in order:
                row, col = int(rows[index]), int(cols[index])
                packed = self._pack(row, col)
                room -= len(packed)
                if room < 0:
                    break
                body.append(packed)
                known = int(self._numbers[row, col])
            left = len(order) - len(body)
            now = self._picture
            head = _ANSWER.pack(
                self._run, known, now.stamp_ns, now.published_ns, now.resolution_m, left, len(body)
            )
            reply = head + b"".join(body)
            self._purse -= len(reply)
        return reply

    def _allowance(self) -> int:
        now = self._now_s()
        self._purse = min(self._rate, self._purse + (now - self._filled_s) * self._rate)
        self._filled_s = now
        return int(self._purse)

    def _pack(self, row: int, col: int) -> bytes:
        key, number = (self._corner[0] + col, self._corner[1] + row), int(self._numbers[row, col])
        kept = self._packed.get(key)
        if kept is None or kept[0] != number:
            cells = self._picture.cells[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE]
            squeezed = zlib.compress(cells.tobytes(), 6)
            kept = self._packed[key] = (number, _TILE.pack(*key, len(squeezed)) + squeezed)
        return kept[1]


def _rectangles(changed: NDArray[np.bool_]) -> list[Rectangle]:
    """Return the changed tiles, those beside each other joined, in cells."""
    most = MAX_ANSWER // (TILE * TILE)
    found: list[Rectangle] = []
    for row in np.flatnonzero(changed.any(axis=1)):
        cols = np.flatnonzero(changed[row])
        for run in np.split(cols, np.flatnonzero(np.diff(cols) > 1) + 1):
            for part in range(0, len(run), most):
                width = len(run[part : part + most])
                found.append(Rectangle(int(run[part]) * TILE, int(row) * TILE, width * TILE, TILE))
    return found


class Mosaic:
    """The asker's side: puts the answers together again."""

    def __init__(self) -> None:
        self._run = bytes(16)
        self._known = 0
        self._tiles: dict[tuple[int, int], Cells] = {}
        self._stamps_ns, self._resolution_m = (0, 0), 0.0
        self.left = 0
        """Tiles that have changed and are not here yet."""

    def question(self, room: int) -> bytes:
        """Return what to ask for, in at most `room` bytes."""
        return _QUESTION.pack(self._run, self._known, room)

    def take(self, answer: bytes) -> bool:
        """Take an answer in; return whether anything has changed.

        Raises:
            ValueError: It is none, or is damaged; nothing of it was taken.
        """
        tiles: dict[tuple[int, int], Cells] = {}
        try:
            run, known, *stamps_ns, resolution_m, left, count = _ANSWER.unpack_from(answer)
            at = _ANSWER.size
            for _ in range(count):
                col, row, size = _TILE.unpack_from(answer, at)
                at += _TILE.size
                unpacking = zlib.decompressobj()
                cells = unpacking.decompress(answer[at : at + size], TILE * TILE)
                at += size
                if not unpacking.eof:
                    raise ValueError(f"a damaged answer of {len(answer)} bytes: a tile of another size")
                tiles[col, row] = np.frombuffer(cells, np.int8).reshape(TILE, TILE)
        except (struct.error, zlib.error) as error:
            raise ValueError(f"a damaged answer of {len(answer)} bytes: {error}") from error
        if run == self._run:  # of another mapper, what it does not say is unknown
            tiles = self._tiles | tiles
        if tiles and np.prod(np.ptp(list(tiles), axis=0) + 1) > _MOST_TILES:
            raise ValueError(f"a map of more than {_MOST_TILES} tiles")
        self._run, self._known, self.left, self._tiles = run, known, left, tiles
        self._stamps_ns, self._resolution_m = (stamps_ns[0], stamps_ns[1]), resolution_m
        return bool(count)

    def picture(self) -> Picture | None:
        """Return the map so far; None before the first tile."""
        if not self._tiles:
            return None
        places = np.array(list(self._tiles))
        low, high = places.min(axis=0), places.max(axis=0) + 1
        cols, rows = (high - low) * TILE
        cells = np.full((rows, cols), UNKNOWN, np.int8)
        for (col, row), tile in self._tiles.items():
            x, y = (col - low[0]) * TILE, (row - low[1]) * TILE
            cells[y : y + TILE, x : x + TILE] = tile
        corner_m = (float(low[0] * TILE * self._resolution_m), float(low[1] * TILE * self._resolution_m))
        return Picture(cells, self._resolution_m, corner_m, *self._stamps_ns)
