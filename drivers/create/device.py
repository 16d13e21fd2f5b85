"""The robot on its line: start, drive, read, leave; the procedures of the specification, without any policy.

The law of the file: every command goes out in one write, and whatever happens, the first and the last thing
the robot hears is to stand.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from drivers.create import protocol, stream
from drivers.create.limits import SafetyConfig
from drivers.create.stream import StreamDecoder, Telemetry
from drivers.errors import SilentError, TransportError

_BACKLOG_BYTES = 65_536
_TRIES = (1, 3)
_NOT_THERE = (
    "no data from the robot: is it on? Is model {model} right ({baud} baud; tried {tried})? "
    "Is only one of its two connectors used? If its light is on, take the battery out and put it back"
)


@dataclass(frozen=True, slots=True)
class _Model:
    baud: int
    wheel_base_m: float


_MODELS = {"create1": _Model(57600, 0.258), "create2": _Model(115200, 0.235)}


@dataclass(frozen=True, slots=True, kw_only=True)
class CreateConfig:
    """One iRobot Create and the line to it."""

    path: str
    """The port's node, e.g. /dev/ttyUSB0."""
    model: Literal["create1", "create2"] = "create1"
    baud: int | None = None
    """The model's own rate if None."""
    packets: tuple[int, ...] = stream.PACKETS
    """What the robot reports every 15 ms."""
    safety: SafetyConfig = field(default_factory=SafetyConfig)

    def __post_init__(self) -> None:
        if self.model not in _MODELS:
            raise ValueError(f"model = {self.model!r}, must be one of {', '.join(_MODELS)}")
        protocol.baud(self.line_baud)
        stream.check_list(self.packets, self.line_baud)
        if missing := sorted({7, 9, 10, 11, 12, 22, 34, 35}.difference(self.packets)):
            raise ValueError(f"packets lack {missing[0]}, without which the robot is not safe")

    @property
    def line_baud(self) -> int:
        """Rate to begin with."""
        return self.baud or _MODELS[self.model].baud

    @property
    def wheel_base_m(self) -> float:
        """Distance between the wheels."""
        return _MODELS[self.model].wheel_base_m


class Line(Protocol):
    """What is needed of a serial line; `drivers.transport.SerialStream` is one."""

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for a first byte."""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    def fileno(self) -> int:
        """Return the descriptor."""

    def close(self) -> None:
        """Give the port back."""


class Create:
    """A robot that was found and streams; one thread owns it.

    Args:
        config: Which robot, where.
        open_line: Opens a path at a baud rate.
        stopping: Asked while waiting; true ends `connect` with a TransportError within 0.1 s.
    """

    def __init__(
        self,
        config: CreateConfig,
        open_line: Callable[[str, int], Line],
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self._config = config
        self._open_line = open_line
        self._stopping = stopping
        self._line: Line | None = None
        self._decoder = StreamDecoder(config.packets)
        self._stream_list = protocol.stream(config.packets)
        self._totals: dict[str, int] = {}
        self.baud = config.line_baud
        self.superseded_frames = 0
        """Frames that were read together with a newer one; their hazards are kept."""
        self.connections = 0

    @property
    def connected(self) -> bool:
        """Whether the line is open and the robot has been heard on it."""
        return self._line is not None

    @property
    def rule(self) -> stream.Rule | None:
        """Which sum this robot uses, once it is known."""
        return self._decoder.rule

    def fileno(self) -> int:
        """Return the descriptor of the line, to lend it to the watchdog."""
        return self._need().fileno()

    def counters(self) -> dict[str, int]:
        """Return what was received and lost, over all connections."""
        now = self._decoder.counters()
        counted = {name: self._totals.get(name, 0) + n for name, n in now.items()}
        return counted | {"superseded_frames": self.superseded_frames, "connections": self.connections}

    def connect(self) -> Telemetry:
        """Find the robot, stop it, and have it stream; it is in Passive mode then.

        Returns:
            The first telemetry.

        Raises:
            SilentError: Nothing understandable came at any baud rate.
            TransportError: The port is not there, or stopped.
        """
        self.close()
        rates = dict.fromkeys((self._config.line_baud, 19200, 57600, 115200))
        # Once around quickly: a robot that drives on at another rate has to be stopped soon.
        for tries in _TRIES:
            for rate in rates:
                if (first := self._connect_at(rate, tries)) is not None:
                    self.connections += 1
                    return first
                self._abandon()
        tried = ", ".join(map(str, rates))
        raise SilentError(
            f"{self._config.path}: "
            + _NOT_THERE.format(model=self._config.model, baud=self._config.line_baud, tried=tried)
        )

    def receive(self, timeout_s: float) -> Telemetry | None:
        """Return the newest telemetry with the hazards of everything that came; None if nothing did.

        Raises:
            TransportError: The line stopped.
        """
        line = self._need()
        frames = self._decoder.feed(line.read(timeout_s))
        taken = 0
        while chunk := line.read(0.0):  # a backlog is old news: it is read to its end, here and now
            frames += self._decoder.feed(chunk)
            taken += len(chunk)
            if taken > _BACKLOG_BYTES:
                break
        if not frames:
            return None
        self.superseded_frames += len(frames) - 1
        return stream.newest_of(frames)

    def drive(self, left_mmps: int, right_mmps: int) -> None:
        """Set the wheels; to be repeated, because the last command holds for ever."""
        self._need().write(protocol.drive_direct(right_mmps, left_mmps))

    def enter_safe(self) -> None:
        """Ask for Safe mode, standing.  Whether it came is in the telemetry, and nowhere else."""
        self._need().write(protocol.safe() + protocol.STAND)

    def enter_passive(self) -> None:
        """Stand and ask for Passive mode; the list is sent again, because Start may end the stream."""
        self._need().write(protocol.RESYNCHRONISE + self._stream_list)

    def close(self) -> None:
        """Leave the robot standing in Passive mode, so that it can charge, and give the port back."""
        if self._line is None:
            return
        last_words = protocol.STAND * 2 + protocol.pause_stream() + protocol.start()
        if self._config.model == "create2":
            last_words += protocol.stop_interface()
        with contextlib.suppress(TransportError):  # unplugged: nobody can reach it any more
            self._line.write(last_words)
        self._abandon()

    def _need(self) -> Line:
        if self._line is None:
            raise TransportError(f"{self._config.path}: not connected")
        return self._line

    def _abandon(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None
        for name, n in self._decoder.counters().items():
            self._totals[name] = self._totals.get(name, 0) + n
        self._decoder = StreamDecoder(self._decoder.ids)

    def _connect_at(self, rate: int, tries: int) -> Telemetry | None:
        packets = self._config.packets if rate >= self._config.line_baud else stream.SHORT_PACKETS
        first = self._knock(rate, packets, tries)
        if first is None or rate == self._config.line_baud:
            return first
        # The robot was moved to another rate, by three pulses on a line or by a program before us.
        self._need().write(protocol.baud(self._config.line_baud))
        self._wait(0.1)
        self._abandon()
        if (back := self._knock(self._config.line_baud, self._config.packets, tries)) is not None:
            return back
        self._abandon()
        return self._knock(rate, packets, tries)

    def _knock(self, rate: int, packets: tuple[int, ...], tries: int) -> Telemetry | None:
        """Open the port at a rate and ask for the stream; None if no good frame comes."""
        self.baud = rate
        self._decoder = StreamDecoder(packets)
        self._stream_list = protocol.stream(packets)
        line = self._line = self._open_line(self._config.path, rate)
        line.write(protocol.pause_stream())
        self._wait(0.05)
        line.write(protocol.RESYNCHRONISE)
        self._wait(0.1)
        for _ in range(tries):
            line.write(protocol.start() + self._stream_list)
            end = time.monotonic() + 0.5
            while (left_s := end - time.monotonic()) > 0.0:
                self._check_stopping()
                if (telemetry := self.receive(min(left_s, 0.1))) is not None:
                    return telemetry
        return None

    def _wait(self, seconds: float) -> None:
        """Throw away what comes, which answers nothing that we asked."""
        end = time.monotonic() + seconds
        while (left_s := end - time.monotonic()) > 0.0:
            self._check_stopping()
            self._need().read(left_s)

    def _check_stopping(self) -> None:
        if self._stopping():
            raise TransportError(f"{self._config.path}: stopped while connecting")
