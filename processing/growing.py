"""Arrays that grow: rows are appended, and every row is eight bytes a number, not an object of its own."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

_T = TypeVar("_T", bound=np.generic)


def longer(table: NDArray[_T], size: int) -> NDArray[_T]:
    """Return a copy of a table (N, ...) with room for so many rows, N of them written.

    The room ahead is not written to, and so takes no memory of a large array before its rows come.
    """
    grown = np.zeros((size, *table.shape[1:]), table.dtype)
    grown[: len(table)] = table
    return grown


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
            self._room = longer(self._room, 2 * self._count)
        self._room[self._count] = row
        self._count += 1

    def replace(self, rows: NDArray[Any]) -> None:
        """Become a copy of these rows (N, ...)."""
        self._count = len(rows)
        self._room = longer(np.asarray(rows, self._room.dtype), self._count + 64)
