"""MCAP files: a kill costs at most what was not flushed, and reading goes as far as the bytes are good.

Profile `ros2`: CDR payloads under standard schemas, so that ROS 2 tools and Foxglove open a whole file. One
channel is one publisher of one topic, and a message carries its publisher's own number; a hole is a loss.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from runtime.formats.errors import FormatError

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "hallway"
ACTIVE_SUFFIX = ".active"
"""What is added to the name of a file that is being written, or that was cut."""
CHANNEL_RECORD = "hallway.channel"
QOS_KEY = "offered_qos_profiles"
"""Metadata of a channel that `ros2 bag play` reads; empty for its defaults."""
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
LATCHED_QOS = f"""\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: automatic
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""
"""What a latched topic offers, so that it is latched again when the recording is played by ROS."""
_MAX_RECORD_BYTES = 1 << 30


def is_mcap(path: Path) -> bool:
    """Whether something is a file that begins as MCAP files do; raises OSError if it cannot be read."""
    if path.is_dir():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


@dataclass(frozen=True, slots=True)
class McapChannel:
    """One publisher of one topic."""

    topic: str
    """With the robot's name: `/robot/scan`."""
    msgtype: str
    metadata: Mapping[str, str] = field(default_factory=dict, hash=False)

    @property
    def name(self) -> str:
        """The last part of the topic."""
        return self.topic.rsplit("/", 1)[-1]

    @property
    def publisher(self) -> str:
        """Name of the publisher; empty where the file does not tell."""
        return self.metadata.get("gid", "")


@dataclass(frozen=True, slots=True, eq=False)
class McapMessage:
    """One message as it was recorded."""

    channel: McapChannel
    sequence: int
    """Of its publisher; 0 where there is none."""
    log_ns: int
    """When it arrived."""
    publish_ns: int
    payload: bytes


@dataclass(slots=True)
class ReadState:
    """What a reader found out about the file besides its messages."""

    library: str = ""
    complete: bool = False
    """Whether the end of the messages was reached."""
    indexed: bool = False
    """Whether the index behind it is there too; without it other programs refuse the file."""
    damaged_chunks: int = 0
    nameless: int = 0
    """Messages of channels of which nothing is known any more."""
    ended: str = ""
    """Why reading ended before the end, in words."""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)

    @property
    def run_seed(self) -> int | None:
        """Seed of the recorded run."""
        seed = self.metadata.get("hallway", {}).get("seed", "")
        return int(seed) if seed.isdigit() else None

    @property
    def run_config(self) -> str:
        """YAML of the resolved configuration of the recorded run; empty if there is none."""
        return self.attachments.get("config.yaml", b"").decode("utf-8", errors="replace")

    def troubles(self) -> list[str]:
        """Say what is wrong with the file; nothing for a whole one."""
        if self.complete and not self.indexed:
            return ["the index at the end of the file was cut; every message is there", *self.losses()]
        return self.losses()

    def losses(self) -> list[str]:
        """Say why messages that were in the file cannot be read."""
        cut = f"the file was cut{f' ({self.ended})' if self.ended else ''}"
        return self.damage() if self.complete else [cut, *self.damage()]

    def damage(self) -> list[str]:
        """Say what could not be read so far; that reading went on to the end is not asked for."""
        told = []
        if self.damaged_chunks:
            told.append(f"{self.damaged_chunks} damaged chunks were left out")
        if self.nameless:
            told.append(f"{self.nameless} messages of unknown channels were left out")
        return told


@dataclass(frozen=True, slots=True)
class Entry:
    """Where reading may begin in the middle of a file; its index tells."""

    offset: int
    channels: Mapping[int, McapChannel]
    """Of the whole file: those that begin further ahead are not met any more."""


class McapReader:
    """Reads a file in the order in which it was written, finished or cut, good chunk by good chunk."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.state = ReadState()

    @staticmethod
    def is_whole(path: Path) -> bool:
        """Whether a file has the end that only a finished one has."""
        with path.open("rb") as file:
            file.seek(0, os.SEEK_END)
            if file.tell() < 2 * len(MAGIC):
                return False
            file.seek(-len(MAGIC), os.SEEK_END)
            return file.read() == MAGIC

    def messages(self, entry: Entry | None = None) -> Iterator[McapMessage]:
        """Yield every readable message; `state` is complete afterwards.

        Args:
            entry: Where to begin; at the beginning if None.

        Raises:
            FormatError: The file does not begin as an MCAP file.
        """
        self.state = state = ReadState()
        channels = {} if entry is None else dict(entry.channels)
        types: dict[int, str] = {}
        for record in self._records(state, None if entry is None else entry.offset):
            if isinstance(record, Schema):
                types[record.id] = record.name
            elif isinstance(record, Channel):
                if entry is None or record.id not in channels:
                    channels[record.id] = channel_of(record, types.get(record.schema_id, ""))
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    state.nameless += 1
                    continue
                yield McapMessage(channel, record.sequence, record.log_time, record.publish_time, record.data)
            elif isinstance(record, Metadata):
                if record.name == CHANNEL_RECORD:
                    _remember(record.metadata, channels)
                else:
                    state.metadata[record.name] = dict(record.metadata)
            elif isinstance(record, Attachment):
                state.attachments[record.name] = record.data
            elif isinstance(record, Header):
                state.library = record.library

    def _records(self, state: ReadState, offset: int | None) -> Iterator[Any]:
        with self.path.open("rb") as file:
            if (begin := file.read(len(MAGIC))) != MAGIC:
                foreign = "not an MCAP file; `hallway convert` makes one of a log"
                raise FormatError(self.path, foreign if begin else "the file is empty")
            if offset is not None:
                file.seek(offset)
            reader = StreamReader(
                file, skip_magic=True, emit_chunks=True, record_size_limit=_MAX_RECORD_BYTES
            ).records
            while True:
                try:
                    record = next(reader)
                except StopIteration:
                    return
                except Exception as error:  # noqa: BLE001 (damaged bytes raise whatever they provoke)
                    state.ended = state.ended or _words(error)
                    return
                if isinstance(record, DataEnd):
                    state.complete = True  # what follows only repeats what was read
                    file.seek(-len(MAGIC), os.SEEK_END)
                    state.indexed = file.read() == MAGIC
                    return
                if isinstance(record, Chunk):
                    try:
                        if record.uncompressed_size > _MAX_RECORD_BYTES:
                            raise ValueError("the size of the chunk is damaged")
                        parts = breakup_chunk(record, validate_crc=True)
                    except Exception:  # noqa: BLE001 (as above; the next chunk may be good)
                        state.damaged_chunks += 1
                        continue
                    yield from parts
                else:
                    yield record


def channel_of(record: Channel, msgtype: str) -> McapChannel:
    """Return the channel that a record of a file describes."""
    metadata = {key: value for key, value in record.metadata.items() if key != QOS_KEY}
    return McapChannel(record.topic, msgtype, metadata)


def _remember(metadata: Mapping[str, str], channels: dict[int, McapChannel]) -> None:
    """Take a channel's name from the record that repeats it, if it is not damaged and tells something new."""
    named = dict(metadata)
    number, topic, msgtype = (named.pop(key, "") for key in ("id", "topic", "type"))
    if number.isdigit() and topic and msgtype:
        channels.setdefault(int(number), McapChannel(topic, msgtype, named))


def _words(error: Exception) -> str:
    name = type(error).__name__
    return "its last record ends too early" if name in ("EndOfFile", "error") else f"{name}: {error}"
