"""How many scans never came, by the stamps alone: for logs whose scans have no numbers."""

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

HOLE_S = 5.0
"""Longer holes count as so long: the last velocity tells nothing more."""
BESIDE = 20
"""So many stamps on both sides tell a hole from scans that were only written down late, in a burst."""


def missing_before(stamps_ns: NDArray[np.int64], period_s: float) -> NDArray[np.int64]:
    """Count the scans that never came into a log without numbers: before each, of five seconds at most.

    A scan that never came moves the stamps of all that follow it; one that was held up moves its own, and
    those that wait behind it are stamped in a burst. So a hole is what all later stamps agree on, and no
    earlier one forestalls.

    Args:
        stamps_ns: (N,) in the order of the file, not always rising.
        period_s: From scan to scan.
    """
    count = len(stamps_ns)
    missing = np.zeros(count, np.int64)
    if count < 2:
        return missing
    late = (stamps_ns - stamps_ns[0]) / (period_s * 1e9) - np.arange(count)
    beside = np.full(BESIDE, np.inf)
    windows = np.lib.stride_tricks.sliding_window_view
    later = windows(np.concatenate((late[1:], beside)), BESIDE + 1).min(axis=1)
    earlier = windows(np.concatenate((-beside, late[:-1])), BESIDE + 1).max(axis=1)
    missing[1:] = np.clip(np.rint(later - earlier), 0, round(HOLE_S / period_s))
    return missing


class StampHoles:
    """Counts as `missing_before` does, while the scans come.

    Args:
        period_s: From scan to scan.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._before: deque[int] = deque(maxlen=BESIDE + 1)
        self._waiting: deque[int] = deque()

    def take(self, stamp_ns: int) -> int | None:
        """Take the next stamp; return what is missing before the one BESIDE stamps earlier, if any."""
        self._waiting.append(stamp_ns)
        return self._first() if len(self._waiting) > BESIDE else None

    def end(self) -> Iterator[int]:
        """Yield what is missing before each of those that are left."""
        while self._waiting:
            yield self._first()

    def _first(self) -> int:
        stamps_ns = np.array((*self._before, *self._waiting), dtype=np.int64)
        missing = int(missing_before(stamps_ns, self._period_s)[len(self._before)])
        self._before.append(self._waiting.popleft())
        return missing
