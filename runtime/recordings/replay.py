"""Play a recording back at its own pace, faster, slower, by steps, or again and again.

The order is that of the file, and so are the bytes and the holes; only the times of publication are new. What
moves a robot is never played unless it is asked for by name.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from runtime.errors import ConfigError
from runtime.formats.mcap_index import McapIndex
from runtime.formats.mcap_log import McapMessage, McapReader
from runtime.formats.missing import Account
from runtime.messages import BadMessageError, decode, encode, peek_stamp_ns
from runtime.recordings.pace import Control, Pace
from runtime.recordings.unnumbered import Counted, with_holes
from runtime.topics import TOPICS

REFUSED = ("cmd_vel",)
"""Topics that move a robot: played only when named."""
UNPLAYED = ("recording", "clock", "diagnostics")
"""What a player says itself, or what would speak for processes that do not run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayConfig:
    """Which part of a recording is played, and how fast."""

    rate: float = 1.0
    """Times the original speed, 0.01 .. 100; 0 for as fast as it goes."""
    start_s: float = 0.0
    """Recorded time to leave out at the beginning, s."""
    duration_s: float = 0.0
    """Recorded time to play, s; 0 for all."""
    loop: bool = False
    topics: tuple[str, ...] = ()
    """Which topics, without the robot's name; all but `cmd_vel` if empty."""

    def __post_init__(self) -> None:
        if self.rate and not 0.01 <= self.rate <= 100:
            raise ValueError(f"rate = {self.rate}, must be 0 or in [0.01, 100]")
        for name in ("start_s", "duration_s"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} = {getattr(self, name)}, must be at least 0")


@dataclass(slots=True)
class Played:
    """What was sent."""

    messages: dict[str, int] = field(default_factory=dict)
    scan_stamps_ns: list[int] = field(default_factory=list)
    """Header stamps of the scans, in order, to compare a result with."""
    worst_late_ns: int = 0
    complete: bool = False
    """Whether the end was reached."""


class Publish(Protocol):
    """Sends a message; see `runtime.port.Port.publish_raw`."""

    def __call__(self, topic: str, payload: bytes, publisher: str, skipped: int) -> None:
        """Send under the next number of one publisher but `skipped`."""


class Recorded:
    """The messages to be played out of one or more files of one recording.

    Raises:
        ConfigError: A topic was asked for that the files do not hold, or nothing is left to play.
    """

    def __init__(self, files: Sequence[Path], config: ReplayConfig) -> None:
        self._files, self._config = files, config
        self.topics: dict[str, str] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self._indexes = [McapIndex.of(file) for file in files]
        for index in self._indexes:
            self.topics |= {channel.name: channel.msgtype for channel in index.channels.values()}
            self.metadata |= {name: dict(values) for name, values in index.metadata.items()}
            self.attachments |= index.attachments
        spoken = [index for index in self._indexes if index.channels]
        self.began_ns = spoken[0].began_ns if spoken else 0
        ended_ns = max((index.ended_ns for index in spoken), default=0)
        self.duration_s = max(ended_ns - self.began_ns, 0) / 1e9
        self.played = self._choose()
        self._account = Account()

    @property
    def seed(self) -> int | None:
        """Of the recorded run, if it is known."""
        text = self.metadata.get("hallway", {}).get("seed", "")
        return int(text) if text.isdigit() else None

    def messages(self) -> Iterator[Counted]:
        """Yield the messages of the chosen topics and time, in the order of the files.

        Each comes with the number of those of its publisher that are missing right before it, by its own
        numbers, or by the stamps where scans have none.
        """
        return with_holes(self._numbered())

    def _numbered(self) -> Iterator[Counted]:
        self._account = account = Account()
        from_ns = self.began_ns + round(self._config.start_s * 1e9)
        until_ns = from_ns + round(self._config.duration_s * 1e9) if self._config.duration_s else None
        for file, index in zip(self._files, self._indexes, strict=True):
            reader = McapReader(file)
            for message in reader.messages(index.entry(from_ns)):
                if message.log_ns < from_ns:
                    continue
                played = message.channel.name in self.played
                if played and until_ns is not None and message.log_ns >= until_ns:
                    account.damaged(reader.state.damage(), str(file))
                    return
                skipped = account.see(message)
                if played:
                    yield message, skipped
            account.end(reader.state, str(file))

    def losses(self) -> list[str]:
        """Say what is missing from what was played so far, in the present turn."""
        return self._account.losses(self.played, whole=not (self._config.start_s or self._config.duration_s))

    def gaps(self) -> list[dict[str, Any]]:
        """Return the holes in what was played so far, in the present turn; see `Account.gaps`."""
        return self._account.gaps(self.began_ns, self.played)

    def outages(self) -> list[str]:
        """Say where publishers were gone in what was played so far, in the present turn."""
        return self._account.outages_told(self.began_ns, self.played)

    def _choose(self) -> tuple[str, ...]:
        here = [name for name in self.topics if name in TOPICS and TOPICS[name].type == self.topics[name]]
        if not self._config.topics:
            chosen = [name for name in here if name not in (*REFUSED, *UNPLAYED)]
        else:
            for name in self._config.topics:
                if name not in here:
                    raise ConfigError(f"topic {name!r}: not recorded; there are {', '.join(sorted(here))}")
            chosen = list(self._config.topics)
        if not chosen:
            raise ConfigError(
                f"{self._files[0]}: nothing to play; it holds {', '.join(self.topics) or 'nothing'}"
            )
        if self._config.start_s > self.duration_s:
            raise ConfigError(
                f"start_s = {self._config.start_s}, the recording lasts {self.duration_s:.3f} s"
            )
        return tuple(chosen)


def play(
    recorded: Recorded,
    config: ReplayConfig,
    control: Control,
    publish: Publish,
    publish_clock: Callable[[int], None],
    now_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> Played:
    """Publish the messages of a recording, each when it is due.

    Args:
        recorded: What is played.
        config: How.
        control: What a person changes meanwhile.
        publish: Sends a message; where some are missing, the numbers that listeners see have the same hole.
        publish_clock: Says the recorded time, in ns, some twenty times a second.
        now_ns: The present.
        sleep: Waits, in seconds.
    """
    played = Played()
    control.rate = config.rate
    while True:
        played.complete = False
        pace = Pace(control, publish_clock, now_ns, sleep)
        for message, skipped in recorded.messages():
            if not pace.wait_for(message.log_ns):
                return played
            played.worst_late_ns = max(played.worst_late_ns, pace.late_ns)
            publish(message.channel.name, message.payload, message.channel.publisher, skipped)
            _count(played, message)
        played.complete = True
        if not config.loop:
            return played


def in_name_of(robot: str, payload: bytes) -> bytes:
    """Return a message of the topic `diagnostics` as another robot would have said it.

    Its processes are named after their robot, and whoever listens to one robot passes over the others.
    """
    kind = TOPICS["diagnostics"].type
    try:
        told = decode(payload, kind)
    except BadMessageError:
        return payload
    renamed = [replace(one, name=f"{robot}/{one.name.rpartition('/')[2]}") for one in told.status]
    return encode(replace(told, status=renamed))


def _count(played: Played, message: McapMessage) -> None:
    name = message.channel.name
    played.messages[name] = played.messages.get(name, 0) + 1
    if name == "scan":
        stamp_ns = peek_stamp_ns(message.payload)
        if stamp_ns is not None:
            played.scan_stamps_ns.append(stamp_ns)
