"""The scans of the drive that goes on, on disk from the first one: what the session of a live run is made of.

Each process of a mapper that was killed leaves a file of its own beside the results; the last one puts them
together, of each as many scans as its successor knew of.
"""

import logging
from pathlib import Path

from processing.scan import Scan
from runtime.formats.mcap_log import ACTIVE_SUFFIX
from runtime.formats.session import Parts, Session, SessionWriter
from runtime.messages import encode
from runtime.nodes.convert import scan_to_message

Kept = tuple[tuple[Path, int], ...]
"""Files, and how many scans of each count."""


class ScanKeeper:
    """Keeps scans until the session is written.

    Args:
        home: Where files are made; None to keep nothing.
        head: Of the session: version, seed.
        earlier: What the processes before this one have kept.
        log: Told once when the disk refuses.
    """

    def __init__(
        self, home: Path | None, head: dict[str, str], log: logging.Logger, earlier: Kept = ()
    ) -> None:
        self._home, self._head, self._log, self._earlier = home, head, log, earlier
        self._writer: SessionWriter | None = None
        self._count = 0

    def add(self, scan: Scan) -> None:
        """Keep one scan; where the disk refuses, nothing more is kept and there will be no session."""
        if self._home is None:
            return
        try:
            if self._writer is None:
                path = self._home / f"scans_{len(self._earlier) + 1}.mcap"
                self._writer = SessionWriter(path, self._head)
            self._writer.add(1, scan.stamp_ns, encode(scan_to_message(scan)))
            self._count += 1
        except OSError as error:
            self._give_up(error)

    def kept(self) -> Kept:
        """Hand everything to the system and say what there is, for whoever goes on after a kill."""
        if self._writer is None:
            return self._earlier
        try:
            self._writer.flush()
        except OSError as error:
            self._give_up(error)
            return ()
        active = self._writer.path.with_name(self._writer.path.name + ACTIVE_SUFFIX)
        return (*self._earlier, (active, self._count))

    @property
    def whole(self) -> bool:
        """Whether every scan was kept."""
        return self._home is not None and (self._count > 0 or bool(self._earlier))

    def write(self, path: Path, parts: Parts, before: Session | None) -> None:
        """Write the session, after the scans of another one, and take the own files away."""
        pieces = self.kept()
        writer = SessionWriter(path, self._head)
        if before is not None:
            writer.copy(before.path)
        for piece, count in pieces:
            writer.copy(piece, count, drive=1 if before is None else before.drives + 1)
        writer.finish(parts)
        self.clear()

    def clear(self) -> None:
        """Take the own files away."""
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None
        for piece, _ in self._earlier:
            piece.unlink(missing_ok=True)
        self._earlier, self._count = (), 0

    def _give_up(self, error: OSError) -> None:
        self._log.error("no session will be written: %s", error)
        self._home = None
        self.clear()
