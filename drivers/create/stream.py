"""iRobot Create Open Interface, robot to host: the 15 ms stream of sensor packets.  No I/O, no clock.

Bytes from the wire never raise: what does not fit is dropped one byte at a time, and counted by reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from drivers.create.protocol import FORBIDDEN_PACKETS

HEADER = 19
PERIOD_S = 0.015
LATCH_FRAMES = 5

SIZES = {
    **dict.fromkeys((*range(7, 19), 21, 24, 32, 34, 35, 36, 37, 38), 1),
    **dict.fromkeys((19, 20, 22, 23, 25, 26, *range(27, 32), 33, 39, 40, 41, 42), 2),
}
"""Data bytes of each packet."""
_SIGNED = frozenset((19, 20, 23, 24, 39, 40, 41, 42))

PACKETS = (7, 8, 9, 10, 11, 12, 13, 14, 18, 21, 22, 23, 24, 25, 26, 34, 35, 41, 42)
"""What we ask for: 47 bytes, 8.2 ms of the 15 at 57600 baud; 41, 42 are what the wheels were last told."""
SHORT_PACKETS = (7, 9, 10, 11, 12, 22, 34, 35)
"""What fits at 19200 baud: 20 bytes, 10.4 ms."""


class Rule(Enum):
    """What the last byte of a frame makes zero; documents differ, and so may robots."""

    WITH_HEADER = "sum of all bytes"
    WITHOUT_HEADER = "sum of all bytes after the header"


@dataclass(frozen=True, slots=True, kw_only=True)
class Telemetry:
    """One frame.  Fields of packets that were not asked for keep their defaults."""

    bumps_and_drops: int = 0
    """Packet 7: bit 4 caster dropped, 3 left, 2 right wheel dropped, 1 left, 0 right bumper pressed."""
    wall: bool = False
    cliffs: int = 0
    """Packets 9 to 12: bit 3 left, 2 front left, 1 front right, 0 right."""
    virtual_wall: bool = False
    overcurrents: int = 0
    buttons: int = 0
    charging_state: int = 0
    """0 not charging, 1 reconditioning, 2 full, 3 trickle, 4 waiting, 5 fault."""
    voltage_mv: int = 0
    current_ma: int = 0
    """Negative while discharging."""
    temperature_c: int = 0
    charge_mah: int | None = None
    capacity_mah: int | None = None
    charging_sources: int = 0
    """Bit 1 home base, bit 0 internal charger."""
    mode: int = 0
    right_mmps: int | None = None
    """What the right wheel was last told; not a measurement."""
    left_mmps: int | None = None

    @property
    def bumps(self) -> int:
        """Bit 1 left, bit 0 right."""
        return self.bumps_and_drops & 0b11

    @property
    def wheel_drops(self) -> int:
        """Bit 2 caster, 1 left, 0 right."""
        return self.bumps_and_drops >> 2

    @property
    def on_charger(self) -> bool:
        """Whether a charger is connected or current flows into the battery."""
        return self.charging_sources != 0 or self.charging_state in (1, 2, 3)

    @property
    def plausible(self) -> bool:
        """Whether every value is one that a robot can have."""
        return (
            5000 <= self.voltage_mv <= 25000
            and -20 <= self.temperature_c <= 80
            and self.mode <= 4  # 4: firmware that reports one too much
            and self.charging_state <= 5
            and self.charging_sources <= 3
            and self.bumps_and_drops <= 0b11111
        )


def newest_of(frames: Sequence[Telemetry]) -> Telemetry:
    """Return the last frame, with every hazard that any of the frames saw.

    A bump that lasted for one frame of a burst must not be lost because a newer frame is without it.
    """
    bumps = cliffs = overcurrents = 0
    for frame in frames:
        bumps |= frame.bumps_and_drops
        cliffs |= frame.cliffs
        overcurrents |= frame.overcurrents
    return replace(frames[-1], bumps_and_drops=bumps, cliffs=cliffs, overcurrents=overcurrents)


def frame_bytes(ids: Sequence[int]) -> int:
    """Return the length of a frame: header, count, packets, sum."""
    return 3 + sum(1 + SIZES[i] for i in ids)


def check_list(ids: Sequence[int], baud: int) -> None:
    """Check that a list of packets may be asked for and fits into 15 ms.

    Raises:
        ValueError: It does not; a list too long gives a corrupted stream.
    """
    for i in ids:
        if i in FORBIDDEN_PACKETS:
            raise ValueError(f"packet {i} carries distance or angle, which are never asked for")
        if i not in SIZES:
            raise ValueError(f"packet {i} is unknown")
    room = int(baud / 10 * PERIOD_S)
    if (size := frame_bytes(ids)) > room:
        raise ValueError(f"a frame of {size} bytes, must be at most {room} at {baud} baud")


def encode_frame(ids: Sequence[int], values: dict[int, int], rule: Rule = Rule.WITH_HEADER) -> bytes:
    """Return the frame in which a robot reports these packet values; missing ones are 0."""
    body = b"".join(
        bytes((i,)) + values.get(i, 0).to_bytes(SIZES[i], "big", signed=i in _SIGNED) for i in ids
    )
    frame = bytes((HEADER, len(body))) + body
    total = sum(frame) - (HEADER if rule is Rule.WITHOUT_HEADER else 0)
    return frame + bytes((-total & 0xFF,))


def encode_packets(ids: Sequence[int], values: dict[int, int]) -> bytes:
    """Return the bare answer to a query: data only, in the order asked for."""
    return b"".join(values.get(i, 0).to_bytes(SIZES[i], "big", signed=i in _SIGNED) for i in ids)


class StreamDecoder:
    """Turns any chunking of the robot's bytes into frames; bad bytes are counted, not raised."""

    def __init__(self, ids: Sequence[int] = PACKETS) -> None:
        self.ids = tuple(ids)
        self._size = frame_bytes(self.ids)
        self._places: list[tuple[int, int]] = []  # where each packet's id stands, and the id
        at = 2
        for i in self.ids:
            self._places.append((at, i))
            at += 1 + SIZES[i]
        self._buffer = bytearray()  # always shorter than one frame between calls
        self._run: tuple[Rule | None, int] = (None, 0)
        self.rule: Rule | None = None
        """Which sum this robot uses, once it has shown the same one five times in a row."""
        self.frames = 0
        self.skipped_bytes = 0
        self.misplaced_packets = 0
        self.checksum_errors = 0
        self.implausible_frames = 0

    def counters(self) -> dict[str, int]:
        """Return what was lost, by reason."""
        return {
            "frames": self.frames,
            "skipped_bytes": self.skipped_bytes,
            "misplaced_packets": self.misplaced_packets,
            "checksum_errors": self.checksum_errors,
            "implausible_frames": self.implausible_frames,
        }

    def feed(self, chunk: bytes) -> list[Telemetry]:
        """Take the next bytes, in any amount; return the frames they complete, oldest first."""
        buffer = self._buffer
        buffer += chunk
        frames: list[Telemetry] = []
        at = 0
        while True:
            # Advance one byte, not one frame: a header look-alike must not cost the frame behind it.
            found = buffer.find(HEADER, at)
            if found < 0:
                found = len(buffer)
            self.skipped_bytes += found - at
            at = found
            if len(buffer) - at >= 2 and buffer[at + 1] != self._size - 3:
                self.skipped_bytes += 1
                at += 1
                continue
            if len(buffer) - at < self._size:
                break
            telemetry = self._frame(bytes(buffer[at : at + self._size]))
            if telemetry is None:
                self.skipped_bytes += 1
                at += 1
                continue
            frames.append(telemetry)
            at += self._size
        del buffer[:at]
        return frames

    def _frame(self, frame: bytes) -> Telemetry | None:
        if any(frame[at] != i for at, i in self._places):
            self.misplaced_packets += 1
            return None
        rule = {0: Rule.WITH_HEADER, HEADER: Rule.WITHOUT_HEADER}.get(sum(frame) & 0xFF)
        if rule is None or (self.rule is not None and rule is not self.rule):
            self.checksum_errors += 1
            return None
        telemetry = self._telemetry(frame)
        if not telemetry.plausible:
            self.implausible_frames += 1
            return None
        self.frames += 1
        if self.rule is None:
            seen, count = self._run
            self._run = (rule, count + 1 if seen is rule else 1)
            if self._run[1] >= LATCH_FRAMES:
                self.rule = rule
        return telemetry

    def _telemetry(self, frame: bytes) -> Telemetry:
        value = {
            i: int.from_bytes(frame[at + 1 : at + 1 + SIZES[i]], "big", signed=i in _SIGNED)
            for at, i in self._places
        }
        get = value.get
        return Telemetry(
            bumps_and_drops=get(7, 0),
            wall=bool(get(8, 0)),
            cliffs=sum(bool(get(i, 0)) << (12 - i) for i in (9, 10, 11, 12)),
            virtual_wall=bool(get(13, 0)),
            overcurrents=get(14, 0),
            buttons=get(18, 0),
            charging_state=get(21, 0),
            voltage_mv=get(22, 0),
            current_ma=get(23, 0),
            temperature_c=get(24, 0),
            charge_mah=get(25),
            capacity_mah=get(26),
            charging_sources=get(34, 0),
            mode=get(35, 0),
            right_mmps=get(41),
            left_mmps=get(42),
        )
