"""A URG-04LX on a pseudo-terminal: the same bytes, the same pace, and every fault on demand.

It runs in a thread of the caller's process.  The mirror turns whether anybody listens or not: a reply leaves
at the end of a revolution, one command is answered in each, and every ray has its own time, so that a moving
robot can be asked where it was at that very moment.
"""

import contextlib
import os
import select
import threading
from collections import deque
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from drivers.urg04lx.faults import Damage
from drivers.urg04lx.model import URG_04LX, Mode, Model
from drivers.urg04lx.pace import Pace
from drivers.urg04lx.protocol import LF, STAMP_MODULUS_MS, StreamRequest, encode_reply
from drivers.urg04lx.scene import Scene, still_room
from drivers.urg04lx.sensor import Sensor
from drivers.urg04lx.wire import Wire

PERIOD_NS = 99_889_000
"""Mean revolution of a real unit: 600.67 rpm."""
_SWEEP_NS = 80_000_000
"""After it the last ray is in, and the reply is made."""
_LATENCY_NS = 99_000_000
_JITTER_NS = 2_000_000
_FOREVER_NS = 1 << 62


class Emulator:
    """One sensor on one line; use it as a context.

    Args:
        scene: What the rays see; a still room without it.
        model: Which unit.
        mode: What it is doing when the line is opened; as after power-on without it.
        stream: What it is streaming, if `mode` is STREAMING.
        rs232: Whether it hangs on RS-232, where rates matter and bytes take their time; else on USB.
        link: A name for the port that stays; without it the port has the terminal's own name.
        start_ms: The sensor's counter at the start.
        drift: By how much the sensor's clock is faster than the host's.
        speed: How many times faster than real everything runs; `now_ns` and `sleep` run with it. Unless it is
            1, the clock is its own and waits for the sensor where the machine is busy.
        fast: Answer commands at once and not with the revolution.
        chunk_bytes: Most bytes that leave together.
        seed: Of jitter and garbage.
    """

    def __init__(
        self,
        scene: Scene | None = None,
        *,
        model: Model = URG_04LX,
        mode: Mode | None = None,
        stream: StreamRequest | None = None,
        rs232: bool = False,
        link: Path | None = None,
        start_ms: int = 0,
        drift: float = 0.0,
        speed: float = 1.0,
        fast: bool = False,
        chunk_bytes: int = 64,
        seed: int = 0,
    ) -> None:
        self.sensor = Sensor(model, mode)
        if self.sensor.mode is Mode.STREAMING:
            self.sensor.stream = stream or StreamRequest()
        self.requests: deque[bytes] = deque(maxlen=10_000)
        """Every line the host sent."""
        self.sweeps: deque[tuple[int, int]] = deque(maxlen=100_000)
        """Of every scan sent: its stamp (ms), and the true time of its step 0 (ns, `now_ns`)."""
        self.drops: deque[int] = deque(maxlen=100_000)
        """Stamps (ms) of the scans the line had no room for: none of `sweeps`."""
        self._scene = scene or still_room(seed)
        self._rng = np.random.default_rng(seed)
        self._wire = Wire(rs232=rs232, link=link, chunk_bytes=chunk_bytes, rng=self._rng)
        self._fast, self._drift, self._start_ms = fast, drift, start_ms
        self._pace = Pace(speed)
        self._host_step_ns = 0
        self._timer_zero_ns = self._turn_ns = self._true_ns()
        self._ready_ns = self._turn_ns
        self._swept_ns = self._turn_ns + _SWEEP_NS
        self._due_ns = self._turn_ns + _LATENCY_NS
        self._prepared: tuple[int, int, bytes] | None = None
        self._sweep: NDArray[np.int32] | None = None
        self._skipped = 0
        self._pending: deque[bytes] = deque()
        self._input = b""
        self._spoils: deque[tuple[Damage, int, int]] = deque()
        self._silent_until_ns = 0
        self._wake_on: tuple[bytes, int] | None = None
        self._delay_ns = 0
        self._lock = threading.RLock()
        self._wake_r, self._wake_w = os.pipe()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="urg-emulator", daemon=True)

    # ---- the line

    @property
    def port(self) -> str:
        """The path to open; "" while unplugged."""
        return self._wire.path

    @property
    def terminal(self) -> str:
        """The terminal's own name behind `port`."""
        return self._wire.terminal

    @property
    def dropped(self) -> int:
        """How many scans the line had no room for."""
        return len(self.drops)

    def __enter__(self) -> "Emulator":
        self._wire.plug()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing = True
        self._nudge()
        self._thread.join()
        self._wire.unplug()
        os.close(self._wake_r)
        os.close(self._wake_w)

    def plug(self, link: Path | None = None) -> None:
        """Appear on the line again, under another name if one is given; the sensor has been without power."""
        with self._lock:
            self._power_on(None)
            self._wire.plug(link)
        self._nudge()

    def unplug(self) -> None:
        """Vanish from the line."""
        with self._lock:
            self._wire.unplug()
        self._nudge()

    def power_cycle(self, mode: Mode | None = None) -> None:
        """Lose power and get it back: everything as after power-on, the line stays."""
        with self._lock:
            self._power_on(mode)

    # ---- time

    def now_ns(self) -> int:
        """The clock of the host this sensor is attached to."""
        return self._true_ns() + self._host_step_ns

    def sleep(self, duration_s: float) -> None:
        """Sleep as long as takes `duration_s` on this clock."""
        self._pace.sleep(duration_s)

    def step_host_clock(self, step_s: float) -> None:
        """Make the host's clock jump."""
        with self._lock:
            self._host_step_ns += round(step_s * 1e9)

    def reset_timer(self) -> None:
        """Put the sensor's counter back to zero, as a brown-out does."""
        with self._lock:
            self._restart_timer()

    # ---- faults

    def spoil(self, damage: Damage, scans: int = 1, *, every: int = 1) -> None:
        """Damage the next `scans` scans before they leave, or only each `every`-th one."""
        with self._lock:
            self._spoils.append((damage, scans * every, every))

    def silence(self, duration_s: float | None = None, *, wake_on: bytes = b"", times: int = 1) -> None:
        """Send nothing and hear nothing: for a time, until a request has come so often, or for ever."""
        with self._lock:
            self._wire.clear()
            self._wake_on = (wake_on, times) if wake_on else None
            self._silent_until_ns = (
                _FOREVER_NS if duration_s is None else self._true_ns() + round(duration_s * 1e9)
            )

    def delay_answers(self, delay_s: float) -> None:
        """Answer commands later by this much."""
        self._delay_ns = round(delay_s * 1e9)

    def send(self, noise: bytes) -> None:
        """Put bytes on the line that no sensor meant."""
        with self._lock:
            self._wire.send(noise, self._true_ns(), self.sensor.baud)
        self._nudge()

    def fault(self, code: bytes) -> None:
        """Report a status in the stream and act on it: 21-49 pause, 50-97 stop, 98 goes on."""
        with self._lock:
            stream = self.sensor.stream
            if stream is None:
                return
            self._emit(encode_reply(stream.echo(0), code), self._true_ns())
            if b"50" <= code <= b"97":
                self.sensor.stop()
            else:
                self._ready_ns = self._true_ns() if code == b"98" else _FOREVER_NS
        self._nudge()

    # ---- the thread

    def _run(self) -> None:
        try:
            while not self._closing:
                self._wait_until(self._do_what_is_due())
        finally:
            self._pace.release()

    def _do_what_is_due(self) -> int:
        """Catch up with the clock; return when (ns) there will be something to do again."""
        with self._lock:
            now_ns = self._true_ns()
            while now_ns >= min(self._swept_ns, self._due_ns):
                if self._swept_ns < self._due_ns:
                    self._end_sweep()
                else:
                    self._end_turn()
            while self._fast and self._pending:
                self._answer(self._pending.popleft(), now_ns)
            piece_ns = self._wire.transmit(now_ns, self.sensor.baud)
            if not self._wire.busy:
                self.sensor.baud = self.sensor.next_baud
            due_ns = min(self._swept_ns, self._due_ns, piece_ns or self._due_ns)
            self._pace.done_until(due_ns)
            return due_ns

    def _wait_until(self, due_ns: int) -> None:
        """Wait for a time, or for something on the line before."""
        with self._lock:
            fds = [self._wake_r, *([self._wire.master] if self._wire.plugged else [])]
        wait_s = max(0.0, (due_ns - self._true_ns()) / 1e9 / self._pace.speed)
        # Unplugging closes descriptors under the waiting thread; the next round knows better.
        with contextlib.suppress(OSError, ValueError):
            ready, _, _ = select.select(fds, [], [], wait_s)
            if self._wake_r in ready:
                os.read(self._wake_r, 1024)
            with self._lock:
                if self._wire.master in ready:
                    self._receive(self._wire.receive(self.sensor.baud))

    def _receive(self, chunk: bytes) -> None:
        *lines, rest = (self._input + chunk.replace(b"\r", LF)).split(LF)
        self._input = rest[-256:]
        for line in filter(None, lines):
            self.requests.append(line)
            if self._wake_on and line.startswith(self._wake_on[0]):
                text, times = self._wake_on
                self._wake_on = (text, times - 1) if times > 1 else None
                self._silent_until_ns = self._silent_until_ns if times > 1 else 0
            if self._true_ns() >= self._silent_until_ns:
                self._pending.append(line)

    def _end_sweep(self) -> None:
        """Make a reply of the sweep that has just ended, if one is wanted; it leaves a little later."""
        step_0_ns, self._swept_ns = self._turn_ns, self._swept_ns + PERIOD_NS
        stream = self.sensor.stream
        if stream is None or step_0_ns < self._ready_ns:
            return
        self._skipped = (self._skipped + 1) % (stream.skip + 1)
        if self._skipped:
            return
        stamp_ms = self._sensor_ms(step_0_ns)
        self._prepared = stamp_ms, step_0_ns, self.sensor.scan(stamp_ms, self._look(step_0_ns))

    def _end_turn(self) -> None:
        """Send the sweep that is ready, and answer one command."""
        at_ns = self._due_ns
        # What was due before has left by then, however late this thread may be.
        self._wire.transmit(at_ns, self.sensor.baud)
        self._turn_ns += PERIOD_NS
        self._due_ns = self._turn_ns + _LATENCY_NS + int(self._rng.integers(_JITTER_NS))
        request = self._pending.popleft() if self._pending else b""
        sweep, self._prepared = self._prepared, None
        # These end what is running; a sweep that has not begun to leave never does.
        if sweep and not request.startswith((b"QT", b"RS", b"M")):
            self._send_sweep(*sweep, at_ns)
        if request:
            self._answer(request, at_ns + self._delay_ns)

    def _send_sweep(self, stamp_ms: int, step_0_ns: int, reply: bytes, at_ns: int) -> None:
        if at_ns < self._silent_until_ns:
            return
        if self._wire.busy:
            self.drops.append(stamp_ms)
            return
        self.sweeps.append((stamp_ms, step_0_ns + self._host_step_ns))
        if self._spoils:
            damage, left, every = self._spoils.popleft()
            if (left - 1) % every == 0:
                reply = damage(reply)
            if left > 1:
                self._spoils.appendleft((damage, left - 1, every))
        self._emit(reply, at_ns)

    def _look(self, step_0_ns: int) -> NDArray[np.int32]:
        sensor = self.sensor.model.parameters
        steps = np.arange(sensor.first_step, sensor.last_step + 1)
        self._sweep = self._scene(step_0_ns + self._host_step_ns + steps * PERIOD_NS // sensor.steps_per_turn)
        return self._sweep

    def _answer(self, line: bytes, at_ns: int) -> None:
        was_on = self.sensor.mode in (Mode.MEASURING, Mode.STREAMING)
        if line[:1] == b"G" and was_on:
            self._look(self._turn_ns - PERIOD_NS)
        reply = self.sensor.answer(line, self._sensor_ms(at_ns), self._sweep)
        if self.sensor.timer_reset:
            self.sensor.timer_reset = False
            self._restart_timer()
        if self.sensor.mode is Mode.STREAMING and line[:1] == b"M":
            self._skipped = -1
            # A laser that was off needs a revolution more until its first sweep.
            self._ready_ns = self._turn_ns if was_on or self._fast else self._turn_ns + PERIOD_NS
        self._emit(reply, at_ns)

    def _emit(self, reply: bytes, at_ns: int) -> None:
        if at_ns >= self._silent_until_ns:
            self._wire.send(reply, at_ns, self.sensor.baud)

    def _power_on(self, mode: Mode | None) -> None:
        self.sensor = Sensor(self.sensor.model, mode)
        self._pending.clear()
        self._input = b""
        self._prepared = None
        self._wire.clear()
        self._restart_timer()

    def _restart_timer(self) -> None:
        self._start_ms = 0
        self._timer_zero_ns = self._true_ns()

    def _sensor_ms(self, true_ns: int) -> int:
        ticks_ms = (true_ns - self._timer_zero_ns) / 1e6 * (1.0 + self._drift)
        return (self._start_ms + int(ticks_ms // 1)) % STAMP_MODULUS_MS

    def _true_ns(self) -> int:
        return self._pace.now_ns()

    def _nudge(self) -> None:
        os.write(self._wake_w, b"x")
