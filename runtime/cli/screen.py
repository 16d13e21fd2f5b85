"""The live status of a robot: one calm table on a terminal, a plain line now and then elsewhere."""

import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Any

from runtime.latency import HOPS
from runtime.process.status import ProcessLine, Status

_FIGURE = re.compile(r"\d+(\.\d+)?")
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
        self.unread = False
        """Whether nobody reads any more: the window was closed, or the program behind the pipe has ended."""
        self._live: Any = None
        self._shown = 0.0
        self._hops_ms: dict[str, dict[str, float]] = {}
        self._map_size = ""
        self._times: dict[str, tuple[str, int]] = {}

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

    def say(self, line: str, *, ordinary: bool = False) -> None:
        """Print a line that stays; an ordinary one only where no table shows the same."""
        if self._quiet or (ordinary and self._live is not None):
            return
        with self._while_read():
            if self._live is not None:
                self._live.console.print(line, highlight=False, markup=False)
            else:
                print(line, flush=True)

    def check_read(self) -> None:
        """Raise BrokenPipeError if nobody reads any more: it ends a command without a word."""
        if self.unread:
            raise BrokenPipeError

    def show(self, status: Status, elapsed_s: float) -> None:
        """Show the present status, if it is time to; hops and map stay when who measured them has left."""
        every_s = _PAINT_EVERY_S if self._live is not None else _PLAIN_EVERY_S
        if self._quiet or time.monotonic() - self._shown < every_s:
            return
        self._shown = time.monotonic()
        self._hops_ms = status.hops_ms or self._hops_ms
        self._map_size = status.map_size or self._map_size
        status = replace(status, hops_ms=self._hops_ms, map_size=self._map_size)
        with self._while_read():
            if self._live is not None:
                self._live.update(table(status, elapsed_s), refresh=True)
            else:
                line = " | ".join((status.line(), *self._news(status.troubles())))
                print(f"{elapsed_s:6.0f} s  {line}", flush=True)

    @contextmanager
    def _while_read(self) -> Iterator[None]:
        try:
            yield
        except OSError:  # no reason to lose what a robot has not saved yet
            self._quiet = self.unread = True

    def _news(self, troubles: dict[str, str]) -> list[str]:
        """Return what is wrong: in words when it is new, later how often it was so, whatever its figures."""
        before, self._times = self._times, {}
        told = []
        for name, text in troubles.items():
            kind = _FIGURE.sub("#", text)
            last, times = before.get(name, (kind, 0))
            times = times + 1 if last == kind else 1
            self._times[name] = kind, times
            told.append(f"{name}: {text}" if times == 1 else f"{name}: the same, {times} times")
        return told


def table(status: Status, elapsed_s: float | None) -> Any:
    """Return the status as something `rich` paints: a line a process, and below in whole what is wrong.

    On a narrow terminal the words at the right end are cut, never the figures; no line becomes two.
    """
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    def quiet(words: str) -> Text:
        return Text(words, style="dim", no_wrap=True, overflow="ellipsis")

    head = Text.assemble(
        (f"{status.robot}  ", "bold"),
        (status.tracking or "starting", _STATE_COLOURS.get(status.tracking.split(" ")[0], "white")),
        "" if elapsed_s is None else f"   {elapsed_s:.0f} s",
        f"   map {status.map_size or '-'}   {status.mapped} of {status.scans} scans",
    )
    rates = "   ".join(f"{name} {rate:.1f}/s" for name, rate in status.rates_hz.items())
    hops = _columns(Table, "last minute", "p50 ms", "p99 ms", "max ms")
    for hop, ms in status.hops_ms.items():
        figures = (f"{ms[name]:.1f}" for name in ("p50", "p99", "max"))
        hops.add_row(hop, *figures, quiet(HOPS[hop].partition(":")[0]))
    processes = _columns(Table, "process", "cpu %", "MB", "queue ms")
    troubles = Text()
    for line in status.processes:
        colour = _COLOURS.get(line.level, "white")
        processes.add_row(
            Text(line.name, style=colour),
            f"{line.cpu_percent:.0f}",
            f"{line.rss_mb:.0f}",
            f"{line.queue_ms:.0f}",
            Text(_words(line), no_wrap=True, overflow="ellipsis"),
        )
        if line.level != "ok" and line.text:
            troubles.append(f"{line.name}: {line.text}\n", style=colour)
    if status.clock is not None:
        troubles.append(f"clock of the robot minus ours: {status.clock}")
    troubles.rstrip()
    return Group(head, rates, hops, processes, *([troubles] if troubles else []))


def _columns(table: Any, first: str, *figures: str) -> Any:
    """Return an empty table of a name, figures that are never cut, and words that may be."""
    made = table(box=None, pad_edge=False)
    made.add_column(first, no_wrap=True)
    for title in figures:
        made.add_column(title, justify="right", no_wrap=True)
    made.add_column("")
    return made


def _words(line: ProcessLine) -> str:
    """Return a process's state if it is news, what it counted, and what it says where nothing is wrong."""
    counts = {
        "lost": line.lost,
        "twice": line.duplicates,
        "late": line.deadline_misses,
        "restarts": line.restarts,
    }
    said = line.text if line.level == "ok" and line.text != "running" else ""
    state = f"{line.state} on {line.host}" if line.host else line.state
    parts = [] if state == "running" and said else [state]
    parts += [f"{name} {count}" for name, count in counts.items() if count]
    return ", ".join(filter(None, (*parts, said)))
