"""A device and an emulator on one line and one clock: for tests, benchmarks, and for trying things out."""

from collections.abc import Callable
from types import TracebackType
from typing import Any

from drivers.transport import SerialStream
from drivers.urg04lx.device import Urg
from drivers.urg04lx.emulator import Emulator
from drivers.urg04lx.events import Connected, Notice, UrgScan
from drivers.urg04lx.link import POLL_S
from drivers.urg04lx.reader import UrgReader
from drivers.urg04lx.settings import UrgConfig


def attach(emulator: Emulator, *, speed: float = 1.0, patience_s: float = 3.0, **wanted: Any) -> Urg:
    """Build a device that reads this emulator through its port, by its clock.

    Args:
        emulator: Running, or about to.
        speed: How fast the emulator runs; waits for bytes are as much shorter.
        patience_s: See `Urg`.
        wanted: What of `UrgConfig` differs from its defaults.
    """
    return Urg(
        UrgConfig(**{"port": emulator.port or "auto", **wanted}),
        now_ns=emulator.now_ns,
        sleep=emulator.sleep,
        find=lambda: [emulator.port] if emulator.port else [],
        open_stream=lambda path, baud: SerialStream(path, baud, POLL_S / speed),
        patience_s=patience_s,
    )


class Session:
    """Runs a device and keeps everything it says; use it as a context.

    Args:
        device: What to run.
        emulator: Whose clock it runs by.
        keep: See `UrgReader`; by default no scan is lost for want of somebody to take it.
    """

    def __init__(self, device: Urg, emulator: Emulator, *, keep: int = 10_000) -> None:
        self.device = device
        self.reader = UrgReader(device, keep)
        self.scans: list[UrgScan] = []
        self.notices: list[Notice] = []
        self.connections: list[Connected] = []
        self._emulator = emulator

    def __enter__(self) -> "Session":
        self.reader.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.reader.close()

    def until(self, done: Callable[[], bool], within_s: float) -> bool:
        """Collect events until `done`; False if it is not within `within_s` of the emulator's time."""
        began_ns = self._emulator.now_ns()
        while not done():
            if self._emulator.now_ns() - began_ns > within_s * 1e9:
                return False
            self._take(self.reader.read(0.02))
        return True

    def more_scans(self, count: int, within_s: float = 10.0) -> bool:
        """Collect `count` further scans; False if there are not so many in time."""
        target = len(self.scans) + count
        return self.until(lambda: len(self.scans) >= target, within_s)

    def said(self, text: str) -> bool:
        """Whether a notice contains this text."""
        return any(text in notice.text for notice in self.notices)

    def _take(self, event: object) -> None:
        if isinstance(event, UrgScan):
            self.scans.append(event)
        elif isinstance(event, Notice):
            self.notices.append(event)
        elif isinstance(event, Connected):
            self.connections.append(event)
