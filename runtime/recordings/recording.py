"""A recording of the bus: MCAP files that survive a kill, a full disk and a power cut up to the last second.

Nothing here waits for the bus or is waited for by it: whoever feeds a recording holds bounded mailboxes, and
what did not fit in them is counted into the file, once a second, as a message of its own.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from runtime.formats.mcap_log import ACTIVE_SUFFIX, McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.messages import DiagnosticArray, DiagnosticStatus, KeyValue, encode, header
from runtime.recordings.names import RING_DIGITS, SPLIT_DIGITS, earlier_in_ring, number_of, numbered

STATUS_TOPIC = "recording"
"""Under the robot's name, in files only: what the recorder could not keep."""
STATUS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
END_RECORD = "hallway.end"
"""Metadata at the end of a file: the counts, and why it ended."""
DISK_FULL = "the disk was full"
AS_ASKED = "as asked"
FLUSH_NS = 1_000_000_000
RING_FILES = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingConfig:
    """When a file ends and the next begins, and when the disk is full."""

    split_mb: float = 0.0
    """Size after which a new file begins, MB; 0 for one file, else 1 .. 1e6."""
    split_s: float = 0.0
    """Time after which a new file begins, s; 0 for one file, else 1 .. 1e6."""
    ring_s: float = 0.0
    """Only the last so many seconds are kept, in about ten files; 0 to keep everything, else 10 .. 1e6."""
    ring_mb: float = 1000.0
    """Size that such a ring never exceeds by more than one file, MB, 1 .. 1e6."""
    min_free_mb: float = 500.0
    """Free space that is never used up, MB, 0 .. 1e6."""

    def __post_init__(self) -> None:
        for name in ("split_mb", "split_s"):
            if getattr(self, name) and not 1 <= getattr(self, name) <= 1e6:
                raise ValueError(f"{name} = {getattr(self, name)}, must be 0 or in [1, 1e6]")
        if self.ring_s and not 10 <= self.ring_s <= 1e6:
            raise ValueError(f"ring_s = {self.ring_s}, must be 0 or in [10, 1e6]")
        if not 1 <= self.ring_mb <= 1e6:
            raise ValueError(f"ring_mb = {self.ring_mb}, must be in [1, 1e6]")
        if not 0 <= self.min_free_mb <= 1e6:
            raise ValueError(f"min_free_mb = {self.min_free_mb}, must be in [0, 1e6]")

    @property
    def file_s(self) -> float:
        """Time after which a new file begins; 0 for never."""
        return self.split_s or self.ring_s / RING_FILES

    @property
    def file_mb(self) -> float:
        """Size after which a new file begins; 0 for never."""
        return self.split_mb or (self.ring_mb / RING_FILES if self.ring_s else 0.0)


@dataclass(slots=True)
class Counts:
    """What became of the messages of a recording."""

    written: int = 0
    unwritten: int = 0
    """Messages that came when nothing more could be written, or that did not get to the disk before."""
    lost: dict[str, int] = field(default_factory=dict)
    """For each topic, messages that never came here or gave way in the mailbox."""

    @property
    def total_lost(self) -> int:
        """Everything that should be in the file and is not."""
        return self.unwritten + sum(self.lost.values())


class Recording:
    """Takes messages and writes them into one file, or into several one after the other.

    Args:
        path: `X.mcap`; with a split the files are `X_000.mcap`, `X_001.mcap`, ...
        robot: Name under which the recorder's own status is written.
        config: See RecordingConfig.
        now_ns: The present, by the clock of the stamps; steady.
        about: Metadata for the head of each file: versions, host, clock offset.
        attachments: Files for the head of each file, such as the resolved configuration.
        free_bytes: Space left on the disk of a folder; given by tests.
    """

    def __init__(
        self,
        path: Path,
        robot: str,
        config: RecordingConfig,
        now_ns: int,
        about: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        self._base, self._robot, self._config = path, robot, config
        self._about, self._attachments = dict(about or {}), dict(attachments or {})
        self._free_bytes = free_bytes
        self._splitting = bool(config.file_mb or config.file_s)
        self._status = McapChannel(f"/{robot}/{STATUS_TOPIC}", STATUS_TYPE)
        self.counts = Counts()
        self.stopped = ""
        """Why nothing more is written, in words; empty while all is well."""
        self.topics: set[str] = set()
        """Topics of which something came, without the robot's name."""
        path.parent.mkdir(parents=True, exist_ok=True)
        # A ring also bounds what an earlier recorder of this run has left.
        self.files: list[Path] = earlier_in_ring(path) if config.ring_s else []
        self._opened = number_of(self.files[-1]) + 1 if self.files else 0
        self._flushed_ns = now_ns
        self._flushed_count = 0
        self._writer: McapWriter | None = None
        try:
            if not self._no_space():
                self._open(now_ns)
        except OSError as error:
            self._give_up(error)

    def add(self, channel: McapChannel, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Write one message; when nothing more can be written it is only counted."""
        self.topics.add(channel.name)
        if self._writer is None:
            self.counts.unwritten += 1
            return
        try:
            self._writer.add(channel, sequence, log_ns, publish_ns, payload)
            self.counts.written += 1
        except OSError as error:
            self.counts.unwritten += 1
            self._give_up(error)

    def tick(self, now_ns: int, lost: Mapping[str, int]) -> None:
        """Do what is due; call it some times a second.

        Args:
            now_ns: The present.
            lost: For each topic, how many messages never came here or gave way in the mailbox, so far.
        """
        self.counts.lost = dict(lost)
        if now_ns - self._flushed_ns < FLUSH_NS or self._writer is None:
            return
        self._flushed_ns = now_ns
        try:
            self._write_status(self._writer, now_ns)
            self._writer.flush(to_disk=True)
            self._flushed_count = self.counts.written
            if self._no_space():
                self._finish(now_ns)
            elif self._split_due(now_ns):
                self._finish(now_ns)
                self._open(now_ns)
        except OSError as error:
            self._give_up(error)

    def close(self, now_ns: int) -> None:
        """End the recording; the last file gets its name."""
        if self._writer is None:
            return
        try:
            self._finish(now_ns)
        except OSError as error:
            self._give_up(error)

    def _open(self, now_ns: int) -> None:
        path = self._free_path()
        about = {**self._about, "robot": self._robot, "file": str(self._opened), "began_ns": str(now_ns)}
        self._writer = McapWriter(path, {"hallway": about}, self._attachments)
        self._began_ns = now_ns
        self._opened += 1
        self.files.append(path)
        if self._config.ring_s:
            self._trim()

    def _trim(self) -> None:
        """Take the oldest files of a ring away; those that are whole, for the newest is being written."""
        while len(self.files) > 1:
            whole = self.files[:-1]
            size = sum(path.stat().st_size for path in whole if path.exists())
            too_many = len(whole) * self._config.file_s > self._config.ring_s
            if not too_many and size <= self._config.ring_mb * 1e6:
                return
            oldest = self.files.pop(0)
            for path in (oldest, oldest.with_name(oldest.name + ACTIVE_SUFFIX)):
                path.unlink(missing_ok=True)

    def _free_path(self) -> Path:
        """Return the next name; a file of an earlier recording, whole or cut, is never touched."""
        base = self._base
        number = self._opened
        digits = RING_DIGITS if self._config.ring_s else SPLIT_DIGITS
        path = numbered(base, number, digits) if self._splitting else base
        while path.exists() or path.with_name(path.name + ACTIVE_SUFFIX).exists():
            number += 1
            path = numbered(base, number, digits)
        return path

    def _split_due(self, now_ns: int) -> bool:
        assert self._writer is not None
        c = self._config
        by_size = bool(c.file_mb) and self._writer.bytes_written >= c.file_mb * 1e6
        return by_size or (bool(c.file_s) and now_ns - self._began_ns >= c.file_s * 1e9)

    def _no_space(self) -> bool:
        if self._free_bytes(self._base.parent) < self._config.min_free_mb * 1e6:
            self.stopped = DISK_FULL
        return bool(self.stopped)

    def _finish(self, now_ns: int) -> None:
        assert self._writer is not None
        why = {"ended_ns": str(now_ns), "ended": self.stopped or AS_ASKED}
        self._write_status(self._writer, now_ns)
        self._writer.finish({END_RECORD: {**self._summary(), **why}})
        self._writer = None
        self._flushed_count = self.counts.written

    def _give_up(self, error: OSError) -> None:
        """Stop after an error of the disk; what was flushed stays readable under its unfinished name."""
        self.stopped = error.strerror or str(error)
        # Nobody knows how much of the last second still got through: all of it counts as lost.
        self.counts.unwritten += self.counts.written - self._flushed_count
        self.counts.written = self._flushed_count
        if self._writer is not None:
            self._writer.abandon()
            if self._writer.active_path.exists():
                self.files[-1] = self._writer.active_path
            self._writer = None

    def _summary(self) -> dict[str, str]:
        counts = {"written": str(self.counts.written), "unwritten": str(self.counts.unwritten)}
        return counts | {f"{topic}.lost": str(n) for topic, n in self.counts.lost.items()}

    def _write_status(self, writer: McapWriter, now_ns: int) -> None:
        values = [KeyValue(key=key, value=value) for key, value in self._summary().items()]
        level = 1 if self.counts.total_lost else 0
        text = f"{self.counts.total_lost} messages lost" if level else "recording"
        status = DiagnosticStatus(
            level=level, name=f"{self._robot}/{STATUS_TOPIC}", message=text, hardware_id="", values=values
        )
        payload = encode(DiagnosticArray(header=header(now_ns, ""), status=[status]))
        writer.add(self._status, 0, now_ns, now_ns, payload)
