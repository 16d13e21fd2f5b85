"""The laser scans of an MCAP file of any writer, finished or cut; its messages must be CDR."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import Numbers
from runtime.formats.mcap_log import LIBRARY, McapReader
from runtime.formats.missing import Account
from runtime.messages import BadMessageError, decode

LASER_TYPE = "sensor_msgs/msg/LaserScan"


class McapScans:
    """Reads a file once for what it holds and lacks, and again for the scans themselves."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._account = Account()
        self._began_ns: int | None = None
        self._topics: dict[str, str] = {}
        self._numbers: dict[str, list[tuple[int, int]]] = {}
        publishers: dict[str, int] = {}
        reader = McapReader(path)
        for message in reader.messages():
            channel = message.channel
            self._began_ns = message.log_ns if self._began_ns is None else self._began_ns
            self._topics[channel.topic] = channel.msgtype
            self._account.see(message)
            if channel.msgtype == LASER_TYPE:
                publisher = publishers.setdefault(channel.publisher, len(publishers))
                self._numbers.setdefault(channel.topic, []).append((message.sequence, publisher))
        self.state = reader.state
        self._account.end(self.state)
        self.clean = reader.state.library == LIBRARY
        """Whether its ranges follow REP-117 already, because this program wrote them."""

    def topics(self) -> dict[str, str]:
        """Return name and type of each topic."""
        return self._topics

    def scans(self, topic: str) -> Iterator[Any]:
        """Yield the LaserScan messages of a topic, in the order of the file; raises FormatError."""
        index = 0
        for message in McapReader(self._path).messages():
            if message.channel.topic == topic and message.channel.msgtype == LASER_TYPE:
                index += 1
                try:
                    yield decode(message.payload, LASER_TYPE)
                except BadMessageError as error:
                    raise FormatError(self._path, f"{topic} scan {index}: {error}") from error

    def losses(self, topic: str) -> tuple[str, ...]:
        """Say what belongs into the file and is not there."""
        return tuple(f"{self._path}: {one}" for one in self._account.losses([_name(topic)]))

    def gaps(self, topic: str) -> tuple[Mapping[str, Any], ...]:
        """Return where scans of a topic are missing, as rows of a table."""
        return tuple(self._account.gaps(self._began_ns or 0, [_name(topic)]))

    def notices(self, topic: str) -> tuple[str, ...]:
        """Say where the laser's process was gone."""
        told = self._account.outages_told(self._began_ns or 0, [_name(topic)])
        return tuple(f"{self._path}: {one}" for one in told)

    def numbers(self, topic: str) -> Numbers:
        """Return the numbers of the scans of a topic."""
        sequences, publishers = np.array(self._numbers[topic], dtype=np.int64).T
        return Numbers(sequences=sequences, publishers=publishers)


def _name(topic: str) -> str:
    return topic.rsplit("/", 1)[-1]
