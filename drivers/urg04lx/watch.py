"""When is a stream ill, and what is to be done about it?  Decisions only: no I/O, times come in as arguments.

Only a good scan is a sign of health: neither bytes, nor an acknowledgement, nor an open port.
"""

from collections import deque
from enum import IntEnum

STALE_S = 0.3
RESTART_S = 1.0
RESET_S = 3.0
REOPEN_S = 5.0
_FIRST_SCAN_S = 2.0
_PROOF_S = 0.6
"""A remedy that seems to have worked has this long to be proved by a scan."""
_VERIFY_S = 5.0
_BAD_IN_A_ROW = 10
_BAD_SHARE = 0.2
_BAD_WINDOW_S = 5.0
_BAD_AT_LEAST = 20
"""Fewer scans than this are no statistics."""


class Remedy(IntEnum):
    """What to do about missing scans; each is tried once, in this order."""

    REPORT = 1
    RESTART = 2
    RESET = 3
    REOPEN = 4


_LADDER = (
    (Remedy.REOPEN, REOPEN_S),
    (Remedy.RESET, RESET_S),
    (Remedy.RESTART, RESTART_S),
    (Remedy.REPORT, STALE_S),
)


class Watch:
    """Watches one stream.

    Args:
        now_ns: When it was started; the first scan has two seconds.
        period_s: Time between two scans.
    """

    def __init__(self, now_ns: int, period_s: float) -> None:
        self._allowance_ns = round(max(0.0, period_s - 0.1) * 1e9)
        self._well_ns = self._proof_ns = 0
        self._tried: Remedy | None = Remedy.REPORT
        self._recent: deque[tuple[int, bool]] = deque()
        self._bad_in_a_row = 0
        self.wait(now_ns, _FIRST_SCAN_S)

    def wait(self, now_ns: int, grace_s: float = _VERIFY_S) -> None:
        """Do not restart before `grace_s` from now: the sensor said that it needs time."""
        self._well_ns = now_ns + round((grace_s - RESTART_S) * 1e9)

    def restarted(self, now_ns: int) -> None:
        """Give the stream time for a scan before the next remedy: it has been acknowledged again."""
        self._proof_ns = now_ns + round(_PROOF_S * 1e9) + self._allowance_ns

    def good(self, at_ns: int) -> bool:
        """Take note of a good scan; True if it ends an illness."""
        recovered = self._tried is not None
        self._well_ns, self._tried, self._bad_in_a_row = at_ns, None, 0
        self._recent.append((at_ns, True))
        return recovered

    def damaged(self, count: int, at_ns: int) -> bool:
        """Take note of damaged scans; True if they are so many that the stream should be started again."""
        self._bad_in_a_row += count
        self._recent.extend([(at_ns, False)] * min(count, 100))
        while self._recent and at_ns - self._recent[0][0] > _BAD_WINDOW_S * 1e9:
            self._recent.popleft()
        bad = sum(not good for _, good in self._recent)
        share_is_bad = len(self._recent) >= _BAD_AT_LEAST and bad > _BAD_SHARE * len(self._recent)
        if count and (self._bad_in_a_row >= _BAD_IN_A_ROW or share_is_bad):
            self._recent.clear()
            self._bad_in_a_row = 0
            return True
        return False

    def quiet_s(self, now_ns: int) -> float:
        """Return how much longer than usual no good scan came."""
        return (now_ns - self._well_ns - self._allowance_ns) / 1e9

    def due(self, now_ns: int) -> Remedy | None:
        """Return what to do now, each remedy once."""
        if now_ns < self._proof_ns:
            return None
        quiet_s = self.quiet_s(now_ns)
        for remedy, after_s in _LADDER:
            if quiet_s >= after_s:
                if self._tried is not None and self._tried >= remedy:
                    return None
                self._tried = remedy
                return remedy
        return None
