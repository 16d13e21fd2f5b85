"""The key scans themselves, kept small, so that the maps can be drawn anew along a moved path.

Where the laser has looked often from one place in one direction, only the newest scans are kept: memory grows
with the ground, not with time.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.sweep import NOTHING_SEEN, Sweep, cast_rays
from processing.growing import Growing
from processing.scan import Beams
from processing.se2 import Pose

PLACE_M = 1.0
HEADINGS = 8
"""A place is a square of this side and a heading in as many parts of the circle."""
MOST_SCANS = 8
"""Key scans kept of one place: two passes."""
CHUNK = 500
"""Key scans whose rays are cast at once."""


class KeyScans:
    """Ranges of every key scan that is kept; empty where newer ones stand for it."""

    def __init__(self) -> None:
        self._ranges_m: list[NDArray[np.float32]] = []
        self._numbers: list[NDArray[np.uint16]] = []
        self._twists = Growing((3,))
        self._rays = 0  # of all that are kept
        self._places: dict[tuple[int, int, int], list[int]] = {}

    def __len__(self) -> int:
        return len(self._ranges_m)

    @property
    def bytes_used(self) -> int:
        """Memory of the ranges kept."""
        return self._rays * 6

    def add(self, sweep: Sweep, map_t_laser: Pose) -> int | None:
        """Append one key scan; return the number of the older one that it replaces, if any."""
        x, y, yaw = (float(v) for v in map_t_laser)
        heading = int(np.floor(yaw / (2.0 * np.pi) * HEADINGS)) % HEADINGS
        place = (int(np.floor(x / PLACE_M)), int(np.floor(y / PLACE_M)), heading)
        kept = self._places.setdefault(place, [])
        kept.append(len(self))
        self._ranges_m.append(sweep.ranges_m)
        self._numbers.append(sweep.numbers)
        self._twists.append(sweep.twist)
        self._rays += len(sweep.numbers)
        if len(kept) <= MOST_SCANS:
            return None
        old = kept.pop(0)
        self._rays -= len(self._numbers[old])
        self._ranges_m[old], self._numbers[old] = NOTHING_SEEN.ranges_m, NOTHING_SEEN.numbers
        return old

    def rays(self, beams: Beams) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
        """Yield the rays (N, 4) of some hundred key scans at a time, and where each one's begin and end."""
        for first in range(0, len(self), CHUNK):
            part = slice(first, first + CHUNK)
            lengths = [len(numbers) for numbers in self._numbers[part]]
            twists = np.repeat(self._twists.rows[part], lengths, axis=0)
            ranges_m, numbers = np.concatenate(self._ranges_m[part]), np.concatenate(self._numbers[part])
            ends = np.concatenate(((0,), np.cumsum(lengths, dtype=np.int64)))
            yield cast_rays(beams, ranges_m, numbers, twists), ends

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was added; `restore` takes it back."""
        places = [(*place, key) for place, kept in self._places.items() for key in kept]
        return {
            "ranges_m": np.concatenate((NOTHING_SEEN.ranges_m, *self._ranges_m)),
            "numbers": np.concatenate((NOTHING_SEEN.numbers, *self._numbers)),
            "counts": np.array([len(numbers) for numbers in self._numbers], dtype=np.int64),
            "twists": self._twists.rows.copy(),
            "places": np.array(places, dtype=np.int64).reshape(-1, 4),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the memory whose `state` was taken."""
        ends = np.cumsum(state["counts"])
        self._ranges_m = [part.copy() for part in np.split(state["ranges_m"], ends)[:-1]]
        self._numbers = [part.copy() for part in np.split(state["numbers"], ends)[:-1]]
        self._twists.replace(state["twists"])
        self._rays = len(state["numbers"])
        self._places = {}
        for x, y, heading, key in state["places"].tolist():
            self._places.setdefault((x, y, heading), []).append(key)
