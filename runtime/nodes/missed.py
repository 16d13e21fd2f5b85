"""How many scans never came before each one: the live matcher and whoever reads a recording count alike."""

import numpy as np
from numpy.typing import NDArray

HOLE_S = 5.0
"""Longer holes count as so long: the last velocity tells nothing more."""
BESIDE = 20
"""So many stamps on both sides tell a hole from scans that were only written down late, in a burst."""


class Missed:
    """Goes by the numbers of the laser; by the stamps where another one goes on, whose numbers begin anew."""

    def __init__(self) -> None:
        self._publisher: object = None
        self._sequence, self._stamp_ns = -1, 0

    def before(self, publisher: object, sequence: int, stamp_ns: int, period_s: float) -> int:
        """Take the next scan; return how many are missing before it, those of five seconds at most.

        Args:
            publisher: Whatever names it.
            sequence: Its number; negative if it has none.
            stamp_ns: Of the scan.
            period_s: From scan to scan, by the sensor's own rate.
        """
        if self._stamp_ns == 0:
            missed = 0
        elif publisher == self._publisher and sequence > self._sequence >= 0:
            missed = sequence - self._sequence - 1
        else:
            missed = round((stamp_ns - self._stamp_ns) / (period_s * 1e9)) - 1
        self._publisher, self._sequence, self._stamp_ns = publisher, sequence, stamp_ns
        return min(max(missed, 0), round(HOLE_S / period_s))


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
