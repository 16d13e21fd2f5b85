"""The live status of a robot: one calm table on a terminal, a plain line now and then elsewhere."""

import sys
import time
from dataclasses import replace
from types import TracebackType
from typing import Any

from runtime.latency import HOPS
from runtime.process.status import Status

_PLAIN_EVERY_S = 5.0
_PAINT_EVERY_S = 0.5
_COLOURS = {"ok": "green", "warn": "yellow", "error": "red", "stale": "red"}
_STATE_COLOURS = {"TRACKING": "green", "DEGENERATE": "yellow", "LOST": "red"}


class Screen:
    """Shows one status after another; `say` prints a line that stays.

    Args:
        quiet: Show nothing at all.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._live: Any = None
        self._shown = 0.0
        self._hops_ms: dict[str, dict[str, float]] = {}

    def __enter__(self) -> "Screen":
        if not self._quiet and sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(auto_refresh=False, transient=False)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def say(self, line: str) -> None:
        """Print a line that stays."""
        if self._quiet:
            return
        if self._live is not None:
            self._live.console.print(line, highlight=False, markup=False)
        else:
            print(line, flush=True)

    def show(self, status: Status, elapsed_s: float) -> None:
        """Show the present status, if it is time to; the hops stay when whoever measured them has left."""
        every_s = _PAINT_EVERY_S if self._live is not None else _PLAIN_EVERY_S
        if self._quiet or time.monotonic() - self._shown < every_s:
            return
        self._shown = time.monotonic()
        self._hops_ms = status.hops_ms or self._hops_ms
        status = replace(status, hops_ms=self._hops_ms)
        if self._live is not None:
            self._live.update(table(status, elapsed_s), refresh=True)
        else:
            print(f"{elapsed_s:6.0f} s  {status.line()}", flush=True)


def table(status: Status, elapsed_s: float | None) -> Any:
    """Return the status as something `rich` paints."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    head = Text.assemble(
        (f"{status.robot}  ", "bold"),
        (status.tracking or "starting", _STATE_COLOURS.get(status.tracking.split(" ")[0], "white")),
        "" if elapsed_s is None else f"   {elapsed_s:.0f} s",
        f"   map {status.map_size or '-'}   {status.mapped} of {status.scans} scans",
        "" if status.clock is None else f"   clock {status.clock}",
    )
    rates = "   ".join(f"{name} {rate:.1f}/s" for name, rate in status.rates_hz.items())
    hops = Table("last minute", "p50 ms", "p99 ms", "max ms", "", box=None, pad_edge=False)
    for column in (1, 2, 3):
        hops.columns[column].justify = "right"
    for hop, ms in status.hops_ms.items():
        values = [f"{ms[name]:.1f}" for name in ("p50", "p99", "max")]
        hops.add_row(hop, *values, Text(HOPS[hop], style="dim"))
    titles = ("process", "state", "cpu %", "MB", "lost", "twice", "queue ms", "late", "restarts", "")
    processes = Table(*titles, box=None, pad_edge=False)
    for column in range(2, 9):
        processes.columns[column].justify = "right"
    for line in status.processes:
        colour = _COLOURS.get(line.level, "white")
        processes.add_row(
            line.name,
            Text(f"{line.state} on {line.host}" if line.host else line.state, style=colour),
            f"{line.cpu_percent:.0f}",
            f"{line.rss_mb:.0f}",
            str(line.lost),
            str(line.duplicates),
            f"{line.queue_ms:.0f}",
            str(line.deadline_misses),
            str(line.restarts),
            Text(line.text, style="" if line.level == "ok" else colour, overflow="ellipsis"),
        )
    return Group(head, rates, hops, processes)
