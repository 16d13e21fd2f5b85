"""The sensor's side of SCIP as a state machine: one request line in, one reply out.

Law: no I/O and no clock; the emulator brings the time and decides when a reply leaves.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.urg04lx.geometry import RS232_BAUDS
from drivers.urg04lx.model import Mode, Model
from drivers.urg04lx.protocol import (
    END,
    ERROR_LIMIT,
    LF,
    OUT_OF_RANGE_CODE,
    SWITCH_TO_SCIP2,
    StreamRequest,
    encode_information,
    encode_reply,
    encode_scan,
    encode_value,
    with_sum,
)

DEFAULT_BAUD = 19_200
SLOTS = 769
"""Steps that can be asked for, 0 .. 768."""


class Sensor:
    """One unit: mode, laser, rate, what is being streamed."""

    def __init__(self, model: Model, mode: Mode | None = None) -> None:
        self.model = model
        self.mode = mode or (Mode.SCIP1 if model.boots_in_scip1 else Mode.IDLE)
        self.baud = DEFAULT_BAUD
        self.next_baud = DEFAULT_BAUD
        """Rate after the reply to SS or RS has left."""
        self.stream: StreamRequest | None = None
        self.remaining = 0
        self.mute = False
        self.timer_reset = False
        """Set by RS; whoever keeps the time clears it."""
        self.sensitive = False
        self._versions_told = 0

    def answer(self, line: bytes, now_ms: int, latest: NDArray[np.int32] | None = None) -> bytes:
        """Return the reply to one request line, "" if there is none.

        Args:
            line: Without its terminator.
            now_ms: The sensor's own time.
            latest: The newest sweep, (682,), for single scans.
        """
        if self.mute or not line:
            return b""
        if self.mode is Mode.SCIP1:
            return self._answer_scip1(line)
        command, semicolon, text = line.partition(b";")
        if semicolon and len(text) > 16:
            return encode_reply(line, b"0G")
        if semicolon and not all(chr(c).isalnum() or c in b" ._+@" for c in text):
            return encode_reply(line, b"0H")
        name = command[:2]
        if self.mode is Mode.UPDATE and name not in (b"VV", b"II", b"RS") and command != SWITCH_TO_SCIP2:
            return encode_reply(line, b"0I")
        if self.mode is Mode.TIME and name not in (b"TM", b"RS"):
            return encode_reply(line, b"0E")
        if name in (b"ME", b"GE", b"HD"):
            self.mute = True  # asking this sensor for intensities hangs it until the power is cut
            return b""
        if name in (b"MD", b"MS", b"GD", b"GS"):
            return self._measure(line, command, now_ms, latest)
        handler = _HANDLERS.get(name)
        return handler(self, line, command, now_ms) if handler else encode_reply(line, b"0E")

    def scan(self, stamp_ms: int, sweep: NDArray[np.int32]) -> bytes:
        """Return the next reply of the stream.

        Args:
            stamp_ms: Sensor time of step 0.
            sweep: (682,) mm or error codes, first to last step of the detection range.
        """
        request = self.stream
        assert request is not None
        if request.scans:
            self.remaining -= 1
        reply = encode_scan(
            request.echo(self.remaining), b"99", stamp_ms, self._select(sweep, request), request.width
        )
        if request.scans and self.remaining == 0:
            self.stop()
        return reply

    def stop(self) -> None:
        """Switch the laser off and end the stream."""
        self.stream = None
        if self.mode in (Mode.STREAMING, Mode.MEASURING):
            self.mode = Mode.IDLE

    def _select(self, sweep: NDArray[np.int32], request: StreamRequest) -> NDArray[np.int32]:
        """Cut and group a sweep as asked: the smallest distance of each group, an error if there is none."""
        steps = np.full(SLOTS, OUT_OF_RANGE_CODE, dtype=np.int32)
        sensor = self.model.parameters
        steps[sensor.first_step : sensor.last_step + 1] = sweep
        asked = steps[request.first_step :][: request.count * request.cluster].reshape(-1, request.cluster)
        smallest = np.where(asked < ERROR_LIMIT, np.iinfo(np.int32).max, asked).min(axis=1)
        return np.where((asked < ERROR_LIMIT).all(axis=1), asked[:, 0], smallest).astype(np.int32)

    def _answer_scip1(self, line: bytes) -> bytes:
        if line == SWITCH_TO_SCIP2 and self.model.has_scip2:
            self.mode = Mode.IDLE
            return line + b"\n0" + END
        if line == b"V":
            sensor = self.model.parameters
            firmware = self.model.firmware.partition("(")[0]
            return LF.join((
                b"V", b"0", b"VEND:Hokuyo Automatic Co.,Ltd.", f"PROD:{self.model.product}".encode(),
                f"FIRM:{firmware},07/08/02(20-4095[mm],240[deg],{sensor.first_step}-{sensor.last_step}[step]"
                f",{sensor.turns_per_minute}[rpm])".encode(),
                b"PROT:00003,(SCIP 1.0)", f"SERI:{self.model.serial}".encode(),
                b"STAT:FW Normal[FinalDist with shadow  ]",
            )) + END  # fmt: skip
        return line + b"\nE" + END

    def _measure(self, line: bytes, command: bytes, now_ms: int, latest: NDArray[np.int32] | None) -> bytes:
        streaming = command[:1] == b"M"
        if len(command) != (15 if streaming else 12):
            return encode_reply(line, b"0C")
        fields = (
            command[2:6],
            command[6:10],
            command[10:12],
            *((command[12:13], command[13:15]) * streaming),
        )
        for text, status in zip(fields, (b"01", b"02", b"03", b"06", b"07"), strict=False):
            if not text.isdigit():
                return encode_reply(line, status)
        first, last = int(fields[0]), int(fields[1])
        if last >= SLOTS:
            return encode_reply(line, b"04")
        if last < first:
            return encode_reply(line, b"05")
        if streaming:
            self.stream = StreamRequest.parse(command)
            self.remaining = self.stream.scans
            self.mode = Mode.STREAMING
            return encode_reply(line, b"00")
        if self.mode is Mode.IDLE or latest is None:
            return encode_reply(line, b"10")
        single = StreamRequest.parse(b"M" + command[1:] + b"000")
        return encode_scan(line, b"00", now_ms, self._select(latest, single), single.width)

    def _version(self, line: bytes, _command: bytes, _now_ms: int) -> bytes:
        self._versions_told += 1
        model = self.model
        lines = [
            encode_information("VEND", "Hokuyo Automatic Co.,Ltd."),
            encode_information("PROD", model.product),
            encode_information("FIRM", model.firmware),
            encode_information("PROT", "SCIP 2.0"),
            encode_information("SERI", model.serial),
        ]
        if model.odd_version:
            lines[4] = lines[4][:-1] + bytes((lines[4][-1] ^ 1,))
            lines.append(b"OPTN without a colon")
        self.mute = self._versions_told == model.mute_after_versions
        return encode_reply(line, b"00", lines)

    def _parameters(self, line: bytes, _command: bytes, _now_ms: int) -> bytes:
        sensor = self.model.parameters
        texts = (
            ("MODL", sensor.model), ("DMIN", sensor.range_min_mm), ("DMAX", sensor.range_max_mm),
            ("ARES", sensor.steps_per_turn), ("AMIN", sensor.first_step), ("AMAX", sensor.last_step),
            ("AFRT", sensor.front_step), ("SCAN", sensor.turns_per_minute),
        )  # fmt: skip
        return encode_reply(line, b"00", [encode_information(tag, str(value)) for tag, value in texts])

    def _state(self, line: bytes, _command: bytes, now_ms: int) -> bytes:
        on = self.mode in (Mode.MEASURING, Mode.STREAMING)
        texts = (
            ("MODL", self.model.parameters.model), ("LASR", "ON" if on else "OFF"),
            ("SCSP", "Initial(600[rpm])<-Default setting by user"), ("MESM", "CLASSIC" if on else "IDLE"),
            ("SBPS", f"{self.baud}[bps]<-Default setting by user"), ("TIME", f"{now_ms:06X}"),
            ("STAT", "Sensor works well."),
        )  # fmt: skip
        return encode_reply(line, b"00", [encode_information(tag, value) for tag, value in texts])

    def _laser_on(self, line: bytes, _command: bytes, _now_ms: int) -> bytes:
        if self.mode is not Mode.IDLE:
            return encode_reply(line, b"02")
        self.mode = Mode.MEASURING
        return encode_reply(line, b"00")

    def _quit(self, line: bytes, _command: bytes, _now_ms: int) -> bytes:
        self.stop()
        return encode_reply(line, b"00")

    def _reset(self, line: bytes, _command: bytes, _now_ms: int) -> bytes:
        self.stream = None
        if self.mode is not Mode.UPDATE:
            self.mode = Mode.IDLE
        self.next_baud = DEFAULT_BAUD
        self.timer_reset = True
        return encode_reply(line, b"00")

    def _time(self, line: bytes, command: bytes, now_ms: int) -> bytes:
        code, inside = command[2:3], self.mode is Mode.TIME
        if code == b"0":
            self.stop()
            self.mode = Mode.TIME
            return encode_reply(line, b"02" if inside else b"00")
        if code == b"1":
            if not inside:
                return encode_reply(line, b"04")
            return encode_reply(line, b"00", [with_sum(encode_value(now_ms, 4))])
        if code == b"2":
            self.mode = Mode.IDLE if inside else self.mode
            return encode_reply(line, b"00" if inside else b"03")
        return encode_reply(line, b"01")

    def _rate(self, line: bytes, command: bytes, _now_ms: int) -> bytes:
        if not command[2:].isdigit():
            return encode_reply(line, b"01")
        baud = int(command[2:])
        if baud not in RS232_BAUDS:
            return encode_reply(line, b"02")
        if baud == self.baud:
            return encode_reply(line, b"03")
        self.next_baud = baud
        return encode_reply(line, b"00")

    def _motor(self, line: bytes, command: bytes, _now_ms: int) -> bytes:
        return encode_reply(line, b"03" if command[2:] in (b"00", b"99") else b"04")

    def _sensitivity(self, line: bytes, command: bytes, _now_ms: int) -> bytes:
        if not self.model.knows_sensitivity:
            return encode_reply(line, b"0C")
        if command[2:] not in (b"0", b"1"):
            return encode_reply(line, b"01")
        before, self.sensitive = self.sensitive, command[2:] == b"1"
        return encode_reply(line, b"02" if before == self.sensitive else b"00")


_HANDLERS = {
    b"VV": Sensor._version,
    b"PP": Sensor._parameters,
    b"II": Sensor._state,
    b"BM": Sensor._laser_on,
    b"QT": Sensor._quit,
    b"RS": Sensor._reset,
    b"TM": Sensor._time,
    b"SS": Sensor._rate,
    b"CR": Sensor._motor,
    b"HS": Sensor._sensitivity,
}
