"""What a process takes of the machine, as the kernel counts it; of this process, or of another one here."""

import os
import time
from pathlib import Path

_SPAN_S = 0.5
_TICKS_S = os.sysconf("SC_CLK_TCK")
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


class Usage:
    """Resident memory and CPU time of one process.

    Args:
        pid: Whose; this process if None.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._proc = Path("/proc") / ("self" if pid is None else str(pid))
        self._mark_s: float | None = None
        self._before_s = 0.0
        self._cpu_percent = 0.0
        self.values()

    def values(self) -> dict[str, str]:
        """Return MB, s, and the percentage of one core since about a second ago; nothing if it has ended."""
        try:
            pages = int((self._proc / "statm").read_text(encoding="ascii").split()[1])
            stat = (self._proc / "stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return {}
        # Counted from behind the name, which may hold anything: user and system time are fields 14 and 15.
        fields = stat.rpartition(")")[2].split()
        cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_S
        now_s = time.monotonic()
        if self._mark_s is None:
            self._mark_s, self._before_s = now_s, cpu_s
        elif now_s - self._mark_s > _SPAN_S:
            self._cpu_percent = 100.0 * (cpu_s - self._before_s) / (now_s - self._mark_s)
            self._mark_s, self._before_s = now_s, cpu_s
        return {
            "rss_mb": f"{pages * _PAGE_MB:.1f}",
            "cpu_s": f"{cpu_s:.2f}",
            "cpu_percent": f"{self._cpu_percent:.1f}",
        }
