"""iRobot Create Open Interface, host to robot: commands to bytes and bytes to commands.  No I/O, no clock.

Packets 0, 2, 6, 19, 20 (and 100 of Create 2) are refused here: they carry distance and angle since the last
reading, which are wrong on many robots, and no odometry of the base enters this system.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


class Op(IntEnum):
    """First byte of a command."""

    RESET = 7
    START = 128
    BAUD = 129
    CONTROL = 130
    SAFE = 131
    FULL = 132
    POWER = 133
    SPOT = 134
    COVER = 135
    DEMO = 136
    DRIVE = 137
    LOW_SIDE_DRIVERS = 138
    LEDS = 139
    SONG = 140
    PLAY_SONG = 141
    SENSORS = 142
    COVER_AND_DOCK = 143
    PWM_LOW_SIDE_DRIVERS = 144
    DRIVE_DIRECT = 145
    DIGITAL_OUTPUTS = 147
    STREAM = 148
    QUERY_LIST = 149
    PAUSE_STREAM = 150
    SEND_IR = 151
    SCRIPT = 152
    PLAY_SCRIPT = 153
    SHOW_SCRIPT = 154
    WAIT_TIME = 155
    WAIT_DISTANCE = 156
    WAIT_ANGLE = 157
    WAIT_EVENT = 158
    STOP = 173


class Mode(IntEnum):
    """Packet 35: what the robot obeys."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


BAUD_CODES = {
    300: 0, 600: 1, 1200: 2, 2400: 3, 4800: 4, 9600: 5, 14400: 6, 19200: 7, 28800: 8, 38400: 9,
    57600: 10, 115200: 11,
}  # fmt: skip
MAX_WHEEL_MMPS = 500
STRAIGHT = 0x8000
SPIN_CLOCKWISE = -1
SPIN_COUNTER_CLOCKWISE = 1
FORBIDDEN_PACKETS = frozenset((0, 2, 6, 19, 20, 100))
"""Distance and angle, and the groups that hold them."""

_DATA_BYTES = {
    Op.RESET: 0, Op.START: 0, Op.BAUD: 1, Op.CONTROL: 0, Op.SAFE: 0, Op.FULL: 0, Op.POWER: 0, Op.SPOT: 0,
    Op.COVER: 0, Op.DEMO: 1, Op.DRIVE: 4, Op.LOW_SIDE_DRIVERS: 1, Op.LEDS: 3, Op.PLAY_SONG: 1, Op.SENSORS: 1,
    Op.COVER_AND_DOCK: 0, Op.PWM_LOW_SIDE_DRIVERS: 3, Op.DRIVE_DIRECT: 4, Op.DIGITAL_OUTPUTS: 1,
    Op.PAUSE_STREAM: 1, Op.SEND_IR: 1, Op.PLAY_SCRIPT: 0, Op.SHOW_SCRIPT: 0, Op.WAIT_TIME: 1,
    Op.WAIT_DISTANCE: 2, Op.WAIT_ANGLE: 2, Op.WAIT_EVENT: 1, Op.STOP: 0,
}  # fmt: skip


def start() -> bytes:
    """Ask for Passive mode; wakes the interface up."""
    return bytes((Op.START,))


def safe() -> bytes:
    """Ask for Safe mode: the robot obeys, and stops by itself at cliffs, dropped wheels and the charger."""
    return bytes((Op.SAFE,))


def full() -> bytes:
    """Ask for Full mode: nothing protects the robot any more."""
    return bytes((Op.FULL,))


def stop_interface() -> bytes:
    """Ask a Create 2 to end the interface; a Create 1 does not know this."""
    return bytes((Op.STOP,))


def baud(rate: int) -> bytes:
    """Ask for another baud rate; wait 100 ms before using it.

    Raises:
        ValueError: The robot has no such rate.
    """
    if rate not in BAUD_CODES:
        raise ValueError(f"baud = {rate}, must be one of {', '.join(map(str, BAUD_CODES))}")
    return bytes((Op.BAUD, BAUD_CODES[rate]))


def drive_direct(right_mmps: int, left_mmps: int) -> bytes:
    """Set the speed of each wheel; the right one comes first on the wire.

    Raises:
        ValueError: A speed is over 500 mm/s.
    """
    for name, speed in (("right_mmps", right_mmps), ("left_mmps", left_mmps)):
        if not -MAX_WHEEL_MMPS <= speed <= MAX_WHEEL_MMPS:
            raise ValueError(f"{name} = {speed}, must be within +-{MAX_WHEEL_MMPS}")
    return struct.pack(">Bhh", Op.DRIVE_DIRECT, right_mmps, left_mmps)


def drive(velocity_mmps: int, radius_mm: int) -> bytes:
    """Set speed and turning radius; STRAIGHT, SPIN_CLOCKWISE and SPIN_COUNTER_CLOCKWISE are special radii.

    Raises:
        ValueError: Out of +-500 mm/s, or of +-2000 mm and not special.
    """
    if not -MAX_WHEEL_MMPS <= velocity_mmps <= MAX_WHEEL_MMPS:
        raise ValueError(f"velocity_mmps = {velocity_mmps}, must be within +-{MAX_WHEEL_MMPS}")
    if radius_mm in (STRAIGHT, STRAIGHT - 1):
        return struct.pack(">BhH", Op.DRIVE, velocity_mmps, radius_mm)
    if not -2000 <= radius_mm <= 2000 or radius_mm == 0:
        raise ValueError(f"radius_mm = {radius_mm}, must be within +-2000 and not 0, or STRAIGHT")
    return struct.pack(">Bhh", Op.DRIVE, velocity_mmps, radius_mm)


def leds(*, play: bool, advance: bool, colour: int, intensity: int) -> bytes:
    """Set the lights; colour 0 is green, 255 red."""
    return bytes((Op.LEDS, (advance << 3) | (play << 1), colour & 0xFF, intensity & 0xFF))


def stream(ids: Sequence[int]) -> bytes:
    """Ask for a frame of these packets every 15 ms.

    Raises:
        ValueError: The list holds a packet that is never to be asked for.
    """
    _check_ids(ids)
    return bytes((Op.STREAM, len(ids), *ids))


def query(ids: Sequence[int]) -> bytes:
    """Ask once for these packets; the answer has neither header nor sum.  Raises as `stream` does."""
    _check_ids(ids)
    return bytes((Op.QUERY_LIST, len(ids), *ids))


def pause_stream() -> bytes:
    """Ask for silence; the list is kept."""
    return bytes((Op.PAUSE_STREAM, 0))


def resume_stream() -> bytes:
    """Ask for the frames again."""
    return bytes((Op.PAUSE_STREAM, 1))


STAND = drive_direct(0, 0)
"""Both wheels at zero."""

RESYNCHRONISE = bytes(40) + STAND + start()
"""Ends a command that was cut, stops the wheels, asks for Passive; right in any state of the robot.

A robot waits for ever for the missing bytes of a command.  Forty zeros are longer than the data of any
command we send; zeros and not 128s, because a cut Drive Direct would take four 128s for full speed.
"""


def _check_ids(ids: Sequence[int]) -> None:
    if bad := sorted(FORBIDDEN_PACKETS.intersection(ids)):
        raise ValueError(f"packet {bad[0]} carries distance or angle, which are never asked for")
    if not 1 <= len(ids) <= 43:
        raise ValueError(f"{len(ids)} packets, must be 1 to 43")


def wheel_speeds(
    speed_mps: float, turn_rate_radps: float, wheel_base_m: float, limit_mps: float = 0.5
) -> tuple[int, int]:
    """Return left and right wheel speed in mm/s for a motion of the robot.

    Over the limit both wheels are slowed by the same factor: the robot stays on its curve.
    """
    half = turn_rate_radps * wheel_base_m / 2.0
    left, right = speed_mps - half, speed_mps + half
    factor = min(1.0, limit_mps / max(abs(left), abs(right), 1e-9))
    return round(1000.0 * left * factor), round(1000.0 * right * factor)


@dataclass(frozen=True, slots=True)
class Command:
    """One command as the robot understands it."""

    op: int
    data: bytes = b""

    def wheels(self) -> tuple[int, int]:
        """Return right and left wheel speed (mm/s) of a Drive Direct."""
        right, left = struct.unpack(">hh", self.data)
        return right, left


class CommandDecoder:
    """Turns any chunking of the host's bytes into commands, as the robot does.

    A cut command waits for its missing bytes for ever and takes them from the next one; opcodes that the
    robot does not know are skipped one byte at a time, and counted.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()  # always shorter than one command between calls
        self.unknown_bytes = 0

    @property
    def waiting(self) -> bool:
        """Whether a command has begun whose last byte has not come."""
        return bool(self._buffer)

    def feed(self, chunk: bytes) -> list[Command]:
        """Take the next bytes, in any amount; return the commands they complete."""
        self._buffer += chunk
        commands, at = [], 0
        while at < len(self._buffer):
            op = self._buffer[at]
            size = self._size(op, at)
            if size is None:
                self.unknown_bytes += 1
                at += 1
                continue
            if len(self._buffer) - at < size:
                break
            commands.append(Command(op, bytes(self._buffer[at + 1 : at + size])))
            at += size
        del self._buffer[:at]
        return commands

    def _size(self, op: int, at: int) -> int | None:
        """Return the bytes of the command that begins at `at`; None for an unknown opcode."""
        if op in (Op.STREAM, Op.QUERY_LIST, Op.SCRIPT):
            return 2 + self._buffer[at + 1] if at + 1 < len(self._buffer) else 2
        if op == Op.SONG:
            return 3 + 2 * self._buffer[at + 2] if at + 2 < len(self._buffer) else 3
        data = _DATA_BYTES.get(op)  # type: ignore[call-overload]
        return None if data is None else 1 + data
