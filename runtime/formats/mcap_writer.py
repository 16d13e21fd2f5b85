"""Writes MCAP files: what was flushed survives a kill, and a file has its own name only when it is whole.

A file is locked as long as it is written, so that whoever recovers cut files knows which ones nobody writes.
"""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import CompressionType, Writer

from runtime.formats.mcap_log import ACTIVE_SUFFIX, CHANNEL_RECORD, LIBRARY, QOS_KEY, McapChannel
from runtime.messages import TYPES

CHUNK_BYTES = 256 * 1024
"""Compressing a chunk stalls its thread for about 10 ms at this size, and 180 ms at 4 MB."""
_MEDIA_TYPES = {"npz": "application/zip", "pgm": "image/x-portable-graymap", "png": "image/png"}


class McapWriter:
    """Writes one file; `X.mcap.active` until `finish` has renamed it to `X.mcap`."""

    def __init__(
        self,
        path: Path,
        about: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self.path = path
        self.active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        self._file = _locked(self.active_path)
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}
        try:
            self._writer.start(profile="ros2", library=LIBRARY)
            for name, values in (about or {}).items():
                self._writer.add_metadata(name, dict(values))
            self._attach(attachments)
            self.flush()
        except OSError:
            self.abandon()
            self.active_path.unlink(missing_ok=True)  # there is nothing in it
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file so far, without the chunk in memory."""
        return self._file.tell()

    def add(self, channel: McapChannel, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Put one message into the chunk in memory."""
        key = (channel.topic, channel.msgtype, channel.publisher)
        number = self._channels.get(key)
        if number is None:
            number = self._channels[key] = self._register(channel)
        self._writer.add_message(number, log_ns, payload, publish_ns, max(sequence, 0) & 0xFFFFFFFF)

    def flush(self, to_disk: bool = False) -> None:
        """Hand everything to the system, which survives a kill; `to_disk` also survives a power cut."""
        self._writer.flush()
        if to_disk:
            os.fdatasync(self._file.fileno())

    def finish(
        self,
        about: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        """Write the last metadata and attachments and the index, and give the file its own name."""
        self._writer.flush()
        self._attach(attachments)
        for name, values in (about or {}).items():
            self._writer.add_metadata(name, dict(values))
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        # Closed after it has its name: with its lock gone before, it would look like a file that was cut.
        self.active_path.rename(self.path)
        self._file.close()
        folder = os.open(self.path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)

    def abandon(self) -> None:
        """Close without an index, as after a full disk; what was flushed can be read."""
        with contextlib.suppress(OSError):  # what it still held goes nowhere either
            self._file.close()

    def _attach(self, attachments: Mapping[str, bytes] | None) -> None:
        for name, data in (attachments or {}).items():
            kind = _MEDIA_TYPES.get(name.rpartition(".")[2], "text/plain")
            self._writer.add_attachment(0, 0, name, kind, data)

    def _register(self, channel: McapChannel) -> int:
        schema = self._schemas.get(channel.msgtype)
        if schema is None:
            text = TYPES.generate_msgdef(channel.msgtype, ros_version=2)[0]
            schema = self._writer.register_schema(channel.msgtype, "ros2msg", text.encode())
            self._schemas[channel.msgtype] = schema
        metadata = {QOS_KEY: "", **channel.metadata}
        number = self._writer.register_channel(channel.topic, "cdr", schema, metadata)
        # MCAP names a channel only in the chunk where it first appears; should that chunk be damaged,
        # this says again what the later ones hold.
        named = {"id": str(number), "topic": channel.topic, "type": channel.msgtype}
        named |= {key: value for key, value in channel.metadata.items() if key != QOS_KEY}
        self._writer.add_metadata(CHANNEL_RECORD, named)
        return int(number)


def is_written(file: BinaryIO) -> bool:
    """Whether somebody writes this file; if nobody does, it is ours until it is closed."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked; or a disk without locks, of which nothing is known
        return True
    return False


def _locked(path: Path) -> BinaryIO:
    """Make a file of this name, which nobody has yet, and lock it."""
    while True:
        file = path.open("xb")
        with contextlib.suppress(OSError):  # a disk without locks is written all the same
            fcntl.flock(file, fcntl.LOCK_EX)
        # Somebody who takes empty files away may have been quicker than the lock.
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            return file
        file.close()
