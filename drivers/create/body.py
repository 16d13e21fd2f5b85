"""The emulated robot itself: commands in, telemetry out, wheels that move a robot in a world.  No I/O.

The law of the file: time is an argument; nothing happens between two calls.  As the real one, it drives on
until it is told otherwise: nothing here times out.
"""

import struct
from collections import deque

from drivers.create import protocol, stream
from drivers.create.protocol import BAUD_CODES, Command, CommandDecoder, Mode, Op
from drivers.create.stream import Rule
from drivers.world.robot import WheeledRobot

MILLISECOND = 1_000_000
STREAM_PERIOD_NS = 15 * MILLISECOND
BOOT_NS = 3_000 * MILLISECOND
_QUERY_DELAY_NS = 15 * MILLISECOND
_MAX_CATCH_UP = 10
_OWN_RADIUS_MM = 165
_DEFAULT_BAUD = {"create1": 57600, "create2": 115200}
_TO_PASSIVE = frozenset((Op.START, Op.SPOT, Op.COVER, Op.COVER_AND_DOCK, Op.DEMO))


class Body:
    """State of one robot; its owner brings bytes and time."""

    def __init__(self, robot: WheeledRobot | None = None, model: str = "create1", now_ns: int = 0) -> None:
        if model not in _DEFAULT_BAUD:
            raise ValueError(f"model = {model!r}, must be one of {', '.join(_DEFAULT_BAUD)}")
        self.model = model
        self.robot = robot
        self.mode = Mode.OFF
        self.baud = _DEFAULT_BAUD[model]
        self.powered = True
        self.cliffs = 0
        """Bit 3 left, 2 front left, 1 front right, 0 right."""
        self.wheel_drops = 0
        """Bit 2 caster, 1 left, 0 right."""
        self.bumps = 0
        """Pressed by hand, besides what the robot touches in its world."""
        self.overcurrents = 0
        self.charger = False
        self.voltage_mv = 15_200
        self.charge_mah = 2_500
        self.capacity_mah = 2_700
        self.obeys_safe = True
        self.mode_offset = 0
        """What is added to the mode in packet 35, as some firmware does."""
        self.start_ends_stream = False
        self.rule = Rule.WITH_HEADER
        self.commands: deque[tuple[int, Command]] = deque(maxlen=50_000)
        """Every command that arrived whole, and when."""
        self._deaf_until_ns = now_ns
        self._decoder = CommandDecoder()
        self._wheels = (0, 0)  # right, left, mm/s
        self._drive = (0, 0)
        self._stream_ids: tuple[int, ...] = ()
        self._paused = False
        self._next_frame_ns = now_ns
        self._answers: deque[tuple[int, bytes]] = deque()

    @property
    def wheels_mmps(self) -> tuple[int, int]:
        """Right and left wheel as they turn now."""
        return self._wheels

    @property
    def unknown_bytes(self) -> int:
        """Bytes that were no command."""
        return self._decoder.unknown_bytes

    @property
    def waiting_for_data(self) -> bool:
        """Whether a cut command waits for its missing bytes."""
        return self._decoder.waiting

    def receive(self, chunk: bytes, now_ns: int) -> None:
        """Obey what the host sends."""
        if not self.powered or now_ns < self._deaf_until_ns:
            return
        for command in self._decoder.feed(chunk):
            self.commands.append((now_ns, command))
            if self.mode != Mode.OFF or command.op == Op.START:
                self._obey(command, now_ns)

    def reset(self, now_ns: int) -> None:
        """Lose everything, as after a brown-out: off, deaf for the three seconds of the boot loader."""
        self.mode, self._stream_ids, self._paused = Mode.OFF, (), False
        self.baud = _DEFAULT_BAUD[self.model]
        self._decoder = CommandDecoder()
        self._answers.clear()
        self._deaf_until_ns = now_ns + BOOT_NS
        self._turn_wheels(0, 0)

    def transmit(self, now_ns: int) -> list[bytes]:
        """Move on to `now_ns` and return the frames and answers that are due, in order."""
        if self.robot is not None:
            self.robot.advance(now_ns)
        self._watch_hazards()
        due = []
        while self._answers and self._answers[0][0] <= now_ns:
            due.append(self._answers.popleft()[1])
        if not self._stream_ids or self._paused or self.mode == Mode.OFF or not self.powered:
            self._next_frame_ns = now_ns
            return due
        for _ in range(_MAX_CATCH_UP):
            if self._next_frame_ns > now_ns:
                break
            self._next_frame_ns += STREAM_PERIOD_NS
            frame = stream.encode_frame(self._stream_ids, self.packets(), self.rule)
            # More than the line carries in 15 ms comes out cut.
            due.append(frame[: int(self.baud / 10 * stream.PERIOD_S)])
        else:
            self._next_frame_ns = now_ns + STREAM_PERIOD_NS
        return due

    def packets(self) -> dict[int, int]:
        """Return the value of every packet now."""
        bumps = self.bumps | (self.robot.bumps if self.robot is not None else 0)
        moving = self._wheels != (0, 0)
        values = {9 + i: (self.cliffs >> (3 - i)) & 1 for i in range(4)}
        values |= {
            7: (self.wheel_drops << 2) | bumps,
            14: self.overcurrents,
            17: 0 if self.model == "create2" else 255,
            21: 2 if self._charging else 0,
            22: self.voltage_mv,
            23: 1200 if self._charging else (-900 if moving else -210),
            24: 26,
            25: self.charge_mah,
            26: self.capacity_mah,
            34: 1 if self.charger else 0,
            35: min(int(self.mode) + self.mode_offset, 4),
            38: len(self._stream_ids),
            39: self._drive[0],
            40: self._drive[1],
            41: self._wheels[0],
            42: self._wheels[1],
        }
        return values

    @property
    def _charging(self) -> bool:
        return self.charger and self.mode in (Mode.OFF, Mode.PASSIVE)

    def _obey(self, command: Command, now_ns: int) -> None:
        op, data = command.op, command.data
        if op in _TO_PASSIVE:
            self._go_passive()
            if op == Op.START and self.start_ends_stream:
                self._stream_ids = ()
        elif op in (Op.SAFE, Op.CONTROL):
            if self.obeys_safe:
                self.mode = Mode.SAFE
        elif op == Op.FULL:
            self.mode = Mode.FULL
        elif op == Op.STOP and self.model == "create2":
            self.mode, self._stream_ids = Mode.OFF, ()
            self._turn_wheels(0, 0)
        elif op == Op.RESET:
            self.reset(now_ns)
        elif op == Op.BAUD:
            self.baud = next((rate for rate, code in BAUD_CODES.items() if code == data[0]), self.baud)
        elif op == Op.STREAM:
            # Of a list that was cut and filled with something else, what is no packet is left out.
            self._stream_ids, self._paused = tuple(i for i in data[1:] if i in stream.SIZES), False
            self._next_frame_ns = now_ns
        elif op == Op.PAUSE_STREAM:
            self._paused = data[0] == 0
            self._next_frame_ns = now_ns
        elif op in (Op.SENSORS, Op.QUERY_LIST):
            ids = data[1:] if op == Op.QUERY_LIST else data
            known = [i for i in ids if i in stream.SIZES]
            self._answers.append((now_ns + _QUERY_DELAY_NS, stream.encode_packets(known, self.packets())))
        elif op in (Op.DRIVE, Op.DRIVE_DIRECT) and self.mode in (Mode.SAFE, Mode.FULL):
            self._move(command)

    def _move(self, command: Command) -> None:
        if command.op == Op.DRIVE_DIRECT:
            right, left = command.wheels()
        else:
            velocity, radius = struct.unpack(">hh", command.data)
            self._drive = (velocity, radius)
            half_base = 129.0 if self.model == "create1" else 117.5
            if radius in (-0x8000, 0x7FFF):
                right = left = velocity
            elif radius in (protocol.SPIN_CLOCKWISE, protocol.SPIN_COUNTER_CLOCKWISE):
                right, left = velocity * radius, -velocity * radius
            else:
                curvature = half_base / radius if radius else 0.0
                right, left = round(velocity * (1 + curvature)), round(velocity * (1 - curvature))
        limit = protocol.MAX_WHEEL_MMPS
        self._turn_wheels(min(max(right, -limit), limit), min(max(left, -limit), limit))

    def _turn_wheels(self, right_mmps: int, left_mmps: int) -> None:
        self._wheels = (right_mmps, left_mmps)
        if self.robot is not None:
            self.robot.drive(left_mmps / 1000.0, right_mmps / 1000.0)

    def _go_passive(self) -> None:
        self.mode = Mode.PASSIVE
        self._turn_wheels(0, 0)

    def _watch_hazards(self) -> None:
        """Do what Safe mode does: fall to Passive, wheels off, without a word."""
        if self.mode != Mode.SAFE:
            return
        right, left = self._wheels
        forward = right + left
        # Radius of the curve = half the axle times sum over difference of the speeds.
        tight = abs(forward) * 129 < _OWN_RADIUS_MM * abs(right - left)
        over_cliff = self.cliffs and (forward > 0 or (forward < 0 and tight))
        if over_cliff or self.wheel_drops or self.charger:
            self._go_passive()
