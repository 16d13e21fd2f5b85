"""Play a recording back at its own pace, faster, slower, by steps, or again and again.

The order is that of the file, and so are the bytes; only the times of publication are new. What moves a robot
is never played unless it is asked for by name.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from runtime.errors import ConfigError
from runtime.formats.mcap_log import McapMessage, McapReader
from runtime.topics import TOPICS

REFUSED = ("cmd_vel",)
"""Topics that move a robot: played only when named."""
UNPLAYED = ("recording", "clock", "diagnostics")
"""What a player says itself, or what would speak for processes that do not run."""
_SLICE_S = 0.05
CLOCK_NS = 50_000_000


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
            if getattr(self, name) < 0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be at least 0")


@dataclass(slots=True)
class Control:
    """What a person changes while a recording plays."""

    paused: bool = False
    steps: int = 0
    """Messages to play although paused."""
    rate: float = 1.0
    stopping: Callable[[], bool] = lambda: False


@dataclass(slots=True)
class Played:
    """What was sent."""

    messages: dict[str, int] = field(default_factory=dict)
    scan_stamps_ns: list[int] = field(default_factory=list)
    """Header stamps of the scans, in order, to compare a result with."""
    worst_late_ns: int = 0
    complete: bool = False
    """Whether the end was reached."""


class Recorded:
    """The messages to be played out of one or more files of one recording.

    Raises:
        ConfigError: A topic was asked for that the files do not hold, or nothing is left to play.
    """

    def __init__(self, files: Sequence[Path], config: ReplayConfig) -> None:
        self._files, self._config = files, config
        self.topics: dict[str, str] = {}
        self.losses: list[str] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        began: list[int] = []
        ended_ns = 0
        for file in files:
            reader = McapReader(file)
            for message in reader.messages():
                self.topics[message.channel.name] = message.channel.msgtype
                if not began:
                    began.append(message.log_ns)
                ended_ns = max(ended_ns, message.log_ns)
            self.losses += [f"{file}: {one}" for one in reader.state.losses()]
            self.metadata |= reader.state.metadata
            self.attachments |= reader.state.attachments
        self.began_ns = began[0] if began else 0
        self.duration_s = max(ended_ns - self.began_ns, 0) / 1e9
        self.played = self._choose()

    def messages(self) -> Iterator[McapMessage]:
        """Yield the messages of the chosen topics and time, in the order of the files."""
        from_ns = self.began_ns + round(self._config.start_s * 1e9)
        until_ns = from_ns + round(self._config.duration_s * 1e9) if self._config.duration_s else None
        for file in self._files:
            for message in McapReader(file).messages():
                if message.channel.name not in self.played or message.log_ns < from_ns:
                    continue
                if until_ns is not None and message.log_ns >= until_ns:
                    return
                yield message

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
    publish: Callable[[str, bytes], None],
    publish_clock: Callable[[int], None],
    now_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> Played:
    """Publish the messages of a recording, each when it is due.

    Args:
        recorded: What is played.
        config: How.
        control: What a person changes meanwhile.
        publish: Sends a payload on a topic.
        publish_clock: Says the recorded time, in ns, some twenty times a second.
        now_ns: The present.
        sleep: Waits, in seconds.
    """
    played = Played()
    control.rate = config.rate
    while True:
        played.complete = False
        pace = _Pace(control, publish_clock, now_ns, sleep)
        for message in recorded.messages():
            if not pace.wait_for(message.log_ns):
                return played
            played.worst_late_ns = max(played.worst_late_ns, pace.late_ns)
            publish(message.channel.name, message.payload)
            _count(played, message)
        played.complete = True
        if not config.loop:
            return played


def _count(played: Played, message: McapMessage) -> None:
    name = message.channel.name
    played.messages[name] = played.messages.get(name, 0) + 1
    if name == "scan":
        from runtime.messages import peek_stamp_ns

        stamp_ns = peek_stamp_ns(message.payload)
        if stamp_ns is not None:
            played.scan_stamps_ns.append(stamp_ns)


class _Pace:
    """Turns recorded time into the present, through pauses and changes of rate."""

    def __init__(
        self,
        control: Control,
        publish_clock: Callable[[int], None],
        now_ns: Callable[[], int],
        sleep: Callable[[float], None],
    ) -> None:
        self._control, self._publish_clock, self._now_ns, self._sleep = control, publish_clock, now_ns, sleep
        self._anchor: tuple[int, int, float] | None = None  # present, recorded time there, rate
        self._recorded_ns = 0
        self._clock_ns: int | None = None
        self.late_ns = 0

    def wait_for(self, recorded_ns: int) -> bool:
        """Wait until a recorded moment is due; False when asked to stop."""
        c = self._control
        while not c.stopping():
            if c.paused:
                self._anchor = None
                if c.steps > 0:
                    c.steps -= 1
                    return self._reach(recorded_ns, late_ns=0)
                self._sleep(_SLICE_S)
                continue
            if c.rate == 0:
                return self._reach(recorded_ns, late_ns=0)
            now = self._now_ns()
            if self._anchor is None or self._anchor[2] != c.rate:
                self._anchor = (now, self._recorded_ns or recorded_ns, c.rate)
            began, recorded_began, rate = self._anchor
            left_ns = began + round((recorded_ns - recorded_began) / rate) - now
            if left_ns <= 0:
                return self._reach(recorded_ns, late_ns=-left_ns)
            self._recorded_ns = max(recorded_ns - round(left_ns * rate), self._recorded_ns)
            self._tick()
            self._sleep(min(left_ns / 1e9, _SLICE_S))
        return False

    def _reach(self, recorded_ns: int, late_ns: int) -> bool:
        self._recorded_ns, self.late_ns = max(self._recorded_ns, recorded_ns), late_ns
        self._tick()
        return True

    def _tick(self) -> None:
        if self._clock_ns is None or self._recorded_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = self._recorded_ns
            self._publish_clock(self._recorded_ns)
