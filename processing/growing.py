"""Arrays that grow: rows are appended, and every row is eight bytes a number, not an object of its own."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Growing:
    """An array whose first axis grows; its room doubles, so that a row costs the same at any length.

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
            self._room = np.concatenate((self._room, np.zeros_like(self._room)))
        self._room[self._count] = row
        self._count += 1

    def replace(self, rows: NDArray[Any]) -> None:
        """Become a copy of these rows (N, ...)."""
        self._count = len(rows)
        self._room = np.concatenate(
            (rows, np.zeros((64, *rows.shape[1:]), rows.dtype)), dtype=self._room.dtype
        )
