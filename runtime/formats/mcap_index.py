"""What an MCAP file says of itself without being read through: its topics, its time, where each chunk is.

The index stands at the end of a whole file. A cut one has none, and then all of it is read for the answer.
"""

import os
import struct
import zlib
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Statistics

from runtime.formats.mcap_log import CHANNEL_RECORD, MAGIC, Entry, McapChannel, McapReader, channel_of

_FOOTER = struct.Struct("<BQQQI")
"""Opcode, length, where the index begins, where its own index begins, sum over all of that."""
_SUM_BYTES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class McapIndex:
    """What is known of a file before its messages are read."""

    channels: Mapping[int, McapChannel]
    """Those that have messages, by the numbers that they have in the file."""
    began_ns: int
    """Arrival of the earliest message; 0 if there is none."""
    ended_ns: int
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]
    chunks: Sequence[tuple[int, int]] = field(default=())
    """Offset of each chunk, and arrival of the latest message in it or before it; empty without an index."""

    @classmethod
    def of(cls, path: Path) -> "McapIndex":
        """Read the index of a file, or the file where there is none.

        Raises:
            FormatError: It is no MCAP file.
        """
        return _indexed(path) or _read_through(path)

    def entry(self, from_ns: int) -> Entry | None:
        """Return where to begin for everything that arrived at or after a time; None for the beginning."""
        number = bisect_left(self.chunks, from_ns, key=lambda chunk: chunk[1])
        if number == 0:
            return None
        offset, _ = self.chunks[min(number, len(self.chunks) - 1)]
        return Entry(offset, self.channels)


def _indexed(path: Path) -> McapIndex | None:
    """Return what the index tells; None where it is missing, damaged, or does not tell everything."""
    if not McapReader.is_whole(path):
        return None
    with path.open("rb") as file:
        try:
            if not _is_sound(file):
                return None
            file.seek(0)
            reader = make_reader(file)
            summary = reader.get_summary()
            statistics = summary.statistics if summary else None
            if summary is None or statistics is None or not _is_told(statistics, len(summary.chunk_indexes)):
                return None
            counts = statistics.channel_message_counts
            chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
            # Neighbouring chunks overlap by what was on its way when one ended.
            offsets = (chunk.chunk_start_offset for chunk in chunks)
            latest_ns = accumulate((chunk.message_end_time for chunk in chunks), max)
            metadata = {one.name: dict(one.metadata) for one in reader.iter_metadata()}
            return McapIndex(
                channels={
                    number: channel_of(record, summary.schemas[record.schema_id].name)
                    for number, record in summary.channels.items()
                    if counts.get(number)
                },
                began_ns=statistics.message_start_time,
                ended_ns=statistics.message_end_time,
                metadata={name: one for name, one in metadata.items() if name != CHANNEL_RECORD},
                attachments={one.name: one.data for one in reader.iter_attachments()},
                chunks=list(zip(offsets, latest_ns, strict=True)),
            )
        except Exception:  # noqa: BLE001 (damaged bytes raise whatever they provoke)
            return None


def _is_sound(file: BinaryIO) -> bool:
    """Whether the sum over the index is there and right; the library does not ask."""
    size = file.seek(0, os.SEEK_END)
    file.seek(size - _FOOTER.size - len(MAGIC))
    opcode, _, began, _, expected = _FOOTER.unpack(file.read(_FOOTER.size))
    last = size - _SUM_BYTES - len(MAGIC)
    if opcode != Opcode.FOOTER or not expected or not len(MAGIC) < began < last:
        return False
    file.seek(began)
    return zlib.crc32(file.read(last - began)) == int(expected)


def _is_told(statistics: Statistics, chunks: int) -> bool:
    return statistics.chunk_count == chunks and (chunks > 0 or not statistics.message_count)


def _read_through(path: Path) -> McapIndex:
    reader = McapReader(path)
    channels: dict[McapChannel, None] = {}
    began_ns = ended_ns = 0
    for message in reader.messages():
        began_ns = min(began_ns, message.log_ns) if channels else message.log_ns
        ended_ns = max(ended_ns, message.log_ns)
        channels[message.channel] = None
    return McapIndex(
        channels=dict(enumerate(channels, start=1)),
        began_ns=began_ns,
        ended_ns=ended_ns,
        metadata=reader.state.metadata,
        attachments=reader.state.attachments,
    )
