"""The key scans themselves, kept small, so that the maps can be drawn anew along a moved path."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class KeyScans:
    """The rays of every key scan, single precision, in one growing pool."""

    def __init__(self) -> None:
        self._rays = np.zeros((4096, 4), dtype=np.float32)
        self._ends = np.zeros(1024, dtype=np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rays(self) -> NDArray[np.float32]:
        """All rays (N, 4): start x, y and end x, y, m, each in the frame of its own key scan."""
        return self._rays

    @property
    def ends(self) -> NDArray[np.int64]:
        """(K + 1,) key scan k has the rays from `ends[k]` to `ends[k + 1]`."""
        return self._ends[: self._count + 1]

    @property
    def bytes_used(self) -> int:
        """Memory of what is kept."""
        return int(self._ends[self._count]) * self._rays.itemsize * 4

    def add(self, rays: NDArray[np.float64]) -> None:
        """Append the rays (N, 4) of one key scan."""
        begin = int(self._ends[self._count])
        end = begin + len(rays)
        if end > len(self._rays):
            room = max(end, 2 * len(self._rays)) - len(self._rays)
            self._rays = np.concatenate((self._rays, np.zeros((room, 4), dtype=np.float32)))
        if self._count + 1 == len(self._ends):
            self._ends = np.concatenate((self._ends, np.zeros_like(self._ends)))
        self._rays[begin:end] = rays
        self._count += 1
        self._ends[self._count] = end

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was added; `restore` takes it back."""
        return {"rays": self._rays[: int(self._ends[self._count])].copy(), "ends": self.ends.copy()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the memory whose `state` was taken."""
        self._count = len(state["ends"]) - 1
        self._rays = state["rays"].copy()
        self._ends = np.concatenate((state["ends"], np.zeros(1, dtype=np.int64)))
