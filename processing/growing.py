"""Arrays that grow: rows are appended, and every row is eight bytes a number, not an object of its own."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Growing:
    """An array whose first axis grows; its room doubles, so that a row costs the same at any length.

    The room ahead is not written to, and so takes no memory of a large array before its rows come.

    Args:
        shape: Of a row.
        dtype: Of its numbers.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: DTypeLike = np.float64) -> None:
        self._room: NDArray[Any] = np.zeros((64, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Any]:
        """The rows (N, ...) so far: a view, which the next `append` may leave behind."""
        return self._room[: self._count]

    def append(self, row: object) -> None:
        """Add a row."""
        if self._count == len(self._room):
            self._make_room(2 * self._count)
        self._room[self._count] = row
        self._count += 1

    def replace(self, rows: NDArray[Any]) -> None:
        """Become a copy of these rows (N, ...)."""
        self._count = len(rows)
        self._room = np.asarray(rows, self._room.dtype)
        self._make_room(self._count + 64)

    def _make_room(self, size: int) -> None:
        room = np.zeros((size, *self._room.shape[1:]), self._room.dtype)
        room[: self._count] = self._room[: self._count]
        self._room = room
