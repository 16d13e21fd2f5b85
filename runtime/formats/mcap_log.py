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
from mcap.writer import CompressionType, Writer

from runtime.formats.errors import FormatError
from runtime.messages import TYPES

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "hallway"
CHUNK_BYTES = 256 * 1024
"""Compressing a chunk stalls its thread for about 10 ms at this size, and 180 ms at 4 MB."""
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
        self._file = self.active_path.open("xb")
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=LIBRARY)
        for name, values in (about or {}).items():
            self._writer.add_metadata(name, dict(values))
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, 0, name, "text/plain", data)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}
        self.flush()

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

    def finish(self, about: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write the last metadata and the index, and give the file its own name."""
        self._writer.flush()
        for name, values in (about or {}).items():
            self._writer.add_metadata(name, dict(values))
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.active_path.rename(self.path)
        folder = os.open(self.path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)

    def abandon(self) -> None:
        """Close without an index, as after a full disk; what was flushed can be read."""
        self._file.close()

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
        told = []
        if not self.complete:
            told.append(f"the file was cut{f' ({self.ended})' if self.ended else ''}")
        if self.damaged_chunks:
            told.append(f"{self.damaged_chunks} damaged chunks were left out")
        if self.nameless:
            told.append(f"{self.nameless} messages of unknown channels were left out")
        return told


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

    def messages(self) -> Iterator[McapMessage]:
        """Yield every readable message; `state` is complete afterwards.

        Raises:
            FormatError: The file does not begin as an MCAP file.
        """
        self.state = state = ReadState()
        channels: dict[int, McapChannel] = {}
        types: dict[int, str] = {}
        for record in self._records(state):
            if isinstance(record, Schema):
                types[record.id] = record.name
            elif isinstance(record, Channel):
                msgtype = types.get(record.schema_id, "")
                metadata = {k: v for k, v in record.metadata.items() if k != QOS_KEY}
                channels[record.id] = McapChannel(record.topic, msgtype, metadata)
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    state.nameless += 1
                    continue
                yield McapMessage(channel, record.sequence, record.log_time, record.publish_time, record.data)
            elif isinstance(record, Metadata):
                if record.name == CHANNEL_RECORD:
                    named = dict(record.metadata)
                    number, topic, msgtype = int(named.pop("id")), named.pop("topic"), named.pop("type")
                    channels.setdefault(number, McapChannel(topic, msgtype, named))
                else:
                    state.metadata[record.name] = dict(record.metadata)
            elif isinstance(record, Attachment):
                state.attachments[record.name] = record.data
            elif isinstance(record, Header):
                state.library = record.library

    def _records(self, state: ReadState) -> Iterator[Any]:
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FormatError(self.path, "not an MCAP file; `hallway convert` makes one of a log")
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


class Gaps:
    """Finds holes in the sequence numbers of every publisher."""

    def __init__(self) -> None:
        self._last: dict[McapChannel, int] = {}
        self.missing: dict[str, int] = {}
        """For each topic, how many messages are not there between those that are."""
        self.where: list[tuple[str, int, int, int]] = []
        """Topic, arrival of the message after the hole, first missing number, how many."""

    def see(self, message: McapMessage) -> None:
        """Take the next message of the file; messages without a number tell nothing."""
        if message.sequence <= 0:
            return
        last = self._last.get(message.channel)
        self._last[message.channel] = message.sequence
        if last is not None and message.sequence > last + 1:
            count = message.sequence - last - 1
            topic = message.channel.topic
            self.missing[topic] = self.missing.get(topic, 0) + count
            self.where.append((topic, message.log_ns, last + 1, count))


def _words(error: Exception) -> str:
    name = type(error).__name__
    return "its last record ends too early" if name in ("EndOfFile", "error") else f"{name}: {error}"
