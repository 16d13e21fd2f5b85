"""What is missing from a recording: one answer for those who list it, map it and play it.

Three things tell: holes in the numbers that every publisher gives its messages, what the recorder itself has
counted inside the file, and where the file is cut or damaged.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.formats.mcap_log import McapChannel, McapMessage, McapReader, ReadState
from runtime.messages import BadMessageError, decode
from runtime.recordings.recording import AS_ASKED, END_RECORD, STATUS_TOPIC, STATUS_TYPE
from runtime.topics import TOPICS

_LOST = ".lost"


@dataclass(frozen=True, slots=True)
class Hole:
    """Messages of one publisher that are not there, between two that are."""

    topic: str
    """With the robot's name: `/robot/scan`."""
    at_ns: int
    """Arrival of the message after the hole."""
    first: int
    """Number of the first missing message."""
    count: int


@dataclass(frozen=True, slots=True)
class Outage:
    """A publisher in the place of another one, as a process has that was started again."""

    topic: str
    at_ns: int
    """Arrival of its first message."""
    silent_ns: int
    """Since the last message of the one before."""

    def __str__(self) -> str:
        return f"{self.topic}: a new publisher after {self.silent_ns / 1e9:.1f} s without one"


class Account:
    """Keeps the account of one recording, in one file or in several; show it every message, in order."""

    def __init__(self) -> None:
        self.holes: list[Hole] = []
        self.outages: list[Outage] = []
        self._numbers: dict[McapChannel, int] = {}
        self._publishers: dict[str, set[str]] = {}
        self._heard_ns: dict[str, int] = {}
        self._missing: dict[str, int] = {}
        self._damage: list[str] = []
        self._told: dict[str, str] = {}

    def see(self, message: McapMessage) -> int:
        """Take the next message; return how many of its publisher's are missing right before it."""
        channel = message.channel
        if channel.name == STATUS_TOPIC and channel.msgtype == STATUS_TYPE:
            self._listen(message.payload)
        self._follow(message)
        if message.sequence <= 0:
            return 0  # without a number it tells nothing
        last = self._numbers.get(channel)
        self._numbers[channel] = message.sequence
        if last is None or message.sequence <= last + 1:
            return 0
        count = message.sequence - last - 1
        self._missing[channel.topic] = self._missing.get(channel.topic, 0) + count
        self.holes.append(Hole(channel.topic, message.log_ns, last + 1, count))
        return count

    def end(self, state: ReadState, file: str = "") -> None:
        """Take what a reader found out about a file of which every message was seen.

        Args:
            state: Of the reader.
            file: Its name, where there are several to be told apart.
        """
        self.damaged(state.losses(), file)
        last = state.metadata.get(END_RECORD, {})
        self._told = last or self._told
        ended = last.get("ended", AS_ASKED)
        if ended != AS_ASKED:
            self.damaged([f"everything after its end: {ended}"], file)

    def damaged(self, words: Collection[str], file: str = "") -> None:
        """Take what else is wrong with a file."""
        self._damage += [f"{file}: {one}" if file else one for one in words]

    def missing(self, topic: str) -> int:
        """Return how many messages of a topic are not there between those that are."""
        return self._missing.get(topic, 0)

    def losses(self, names: Collection[str] | None = None, whole: bool = True) -> list[str]:
        """Say what is missing.

        Args:
            names: Of which topics, without the robot's name; of all if None.
            whole: Whether all of the recording was seen. The recorder counts without saying where, and what
                it says of everything is not true of a part.
        """
        told = list(self._damage)
        holes: dict[str, int] = {}
        for topic, count in self._missing.items():
            name = topic.rsplit("/", 1)[-1]
            if names is None or name in names:
                told.append(f"{count} messages of {topic}, by its sequence numbers")
                holes[name] = holes.get(name, 0) + count
        return told + self._by_recorder(names, holes) if whole else told

    def gaps(self, began_ns: int, names: Collection[str] | None = None) -> list[dict[str, Any]]:
        """Return the holes as rows of a table; `at_s` counts from `began_ns`."""
        return [
            {"topic": h.topic, "at_s": (h.at_ns - began_ns) / 1e9, "first": h.first, "count": h.count}
            for h in self.holes
            if names is None or h.topic.rsplit("/", 1)[-1] in names
        ]

    def outages_told(self, began_ns: int, names: Collection[str] | None = None) -> list[str]:
        """Say where publishers were gone; times count from `began_ns`."""
        return [
            f"{(one.at_ns - began_ns) / 1e9:.3f} s: {one}"
            for one in self.outages
            if names is None or one.topic.rsplit("/", 1)[-1] in names
        ]

    def _by_recorder(self, names: Collection[str] | None, holes: dict[str, int]) -> list[str]:
        """Say what the recorder has counted and no hole shows: it was lost at the beginning or the end."""
        told = []
        if self._told.get("damaged"):
            told.append("the recorder's own account is damaged")
        if (unwritten := _number(self._told.get("unwritten"))) > 0:
            told.append(f"{unwritten} messages that the disk did not take")
        for key, value in self._told.items():
            name = key.removesuffix(_LOST)
            if name == key or (names is not None and name not in names):
                continue
            here = holes.get(name, 0)
            if (rest := _number(value) - here) > 0:
                told.append(
                    f"{rest}{' more' if here else ''} messages of {name} that the recorder did not get"
                )
        return told

    def _listen(self, payload: bytes) -> None:
        """Take the recorder's word for what it has lost so far."""
        try:
            (status,) = decode(payload, STATUS_TYPE).status
        except (BadMessageError, ValueError):
            self._told = {"damaged": "yes"}
        else:
            self._told = {one.key: one.value for one in status.values}

    def _follow(self, message: McapMessage) -> None:
        topic, publisher = message.channel.topic, message.channel.publisher
        known = self._publishers.setdefault(topic, set())
        if known and publisher not in known and not _is_shared(message.channel.name):
            silent_ns = max(message.log_ns - self._heard_ns[topic], 0)
            self.outages.append(Outage(topic, message.log_ns, silent_ns))
        known.add(publisher)
        self._heard_ns[topic] = message.log_ns


def account_of(*files: Path) -> Account:
    """Read one recording, in one file or several, for what is missing from it.

    Raises:
        FormatError: One is no MCAP file.
    """
    account = Account()
    for file in files:
        reader = McapReader(file)
        for message in reader.messages():
            account.see(message)
        account.end(reader.state, str(file) if len(files) > 1 else "")
    return account


def _is_shared(name: str) -> bool:
    return name in TOPICS and TOPICS[name].shared


def _number(text: str | None) -> int:
    return int(text) if text is not None and text.isdigit() else 0
