"""How far a long run is: one live bar on a terminal, a plain line now and then elsewhere; on stderr."""

import sys
import time
from types import TracebackType
from typing import Any

PLAIN_EVERY_S = 5.0
PAINT_EVERY_S = 0.1


class Progress:
    """Counts scans and says how fast they go, against the time that the log took to record.

    Args:
        total: Number of scans.
        period_s: Time from scan to scan, for "times real time".
        quiet: Say nothing at all.
    """

    def __init__(self, total: int, period_s: float, quiet: bool = False) -> None:
        self._total, self._period_s, self._quiet = total, period_s, quiet
        self._bar: Any = None
        self.done = 0
        self.began_s = self._said_s = time.monotonic()
        self._ended_s: float | None = None

    @property
    def elapsed_s(self) -> float:
        """Seconds since the first scan began, until the last one ended."""
        return (time.monotonic() if self._ended_s is None else self._ended_s) - self.began_s

    @property
    def scans_per_s(self) -> float:
        """Mean speed so far."""
        return self.done / max(self.elapsed_s, 1e-9)

    @property
    def times_real_time(self) -> float:
        """How many seconds of the log pass in one second."""
        return self.scans_per_s * self._period_s

    def __enter__(self) -> "Progress":
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("mapping"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[figures]}"),
                console=Console(stderr=True),
                auto_refresh=False,
                transient=True,
            )
            self._bar.start()
            self._bar.add_task("", total=self._total, figures="")
        self.began_s = self._said_s = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended_s = time.monotonic()
        if self._bar is not None:
            self._bar.stop()

    def advance(self, note: str = "") -> None:
        """Count one scan; `note` is shown beside the figures, such as the state of the track."""
        self.done += 1
        now_s = time.monotonic()
        if self._quiet or now_s - self._said_s < (PAINT_EVERY_S if self._bar else PLAIN_EVERY_S):
            return
        self._said_s = now_s
        figures = self.figures() + (f"  {note}" if note else "")
        if self._bar is not None:
            self._bar.update(0, completed=self.done, figures=figures)
            self._bar.refresh()
        else:
            print(f"{self.done} of {self._total} scans, {figures}", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """Print a line of its own, beside the bar if there is one."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
        else:
            print(text, file=sys.stderr, flush=True)

    def figures(self) -> str:
        """Return speed and time left in words."""
        left_s = (self._total - self.done) / max(self.scans_per_s, 1e-9)
        minutes, seconds = divmod(round(left_s), 60)
        speed = f"{self.scans_per_s:.0f} scans/s, {self.times_real_time:.1f} x real time"
        return f"{speed}, {minutes}:{seconds:02d} left"
