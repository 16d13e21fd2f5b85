"""An iRobot Create on a pseudo-terminal: the bytes of the real one, and its failures when asked for.

The law of the file: the host side must not be able to tell it from a robot on a serial line.  What the host
wrote is kept with the time of its arrival, so that a test can say when the wheels were told to stop.
"""

import contextlib
import errno
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path
from types import TracebackType

import numpy as np

from drivers.create import stream
from drivers.create.body import MILLISECOND, Body
from drivers.create.protocol import Command, Mode, Op
from drivers.create.stream import Rule
from drivers.world.robot import WheeledRobot

_SPEEDS = {
    getattr(termios, f"B{rate}"): rate
    for rate in (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
}
_POLL_MS = 5


class CreateEmulator:
    """A robot with a serial port; runs in its own thread from `with` to the end of it.

    Args:
        robot: What its wheels move; None for a robot in empty space that senses nothing.
        model: "create1" or "create2".
        link: A symbolic link to keep pointing at the port, through hang-ups too.
        seed: Of the damage done to frames.
    """

    def __init__(
        self,
        robot: WheeledRobot | None = None,
        *,
        model: str = "create1",
        link: Path | None = None,
        seed: int = 0,
    ) -> None:
        self.body = Body(robot, model, time.monotonic_ns())
        self.lock = threading.RLock()
        """Hold it to change `body` from outside."""
        self.received = bytearray()
        """Every byte from the host, as far as a robot could read it."""
        self._link = link
        self._rng = np.random.default_rng(seed)
        self._master = self._slave = -1
        self.port = ""
        self._flip_share = self._drop_share = 0.0
        self._silent_until_ns = 0
        self._held: list[bytes] | None = None
        self._garbage = b""
        self._reads = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="create-emulator", daemon=True)
        self._open()

    def __enter__(self) -> "CreateEmulator":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self) -> None:
        """Run, without `with`."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and give the pseudo-terminal back."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._close()

    # ---- what tests read ----

    def commands(self, since_ns: int = 0) -> list[tuple[int, Command]]:
        """Return what arrived since a time of `time.monotonic_ns()`, with the time of each."""
        with self.lock:
            return [entry for entry in self.body.commands if entry[0] >= since_ns]

    def drives(self, since_ns: int = 0) -> list[tuple[int, tuple[int, int]]]:
        """Return the Drive Direct commands since then: time, and right and left speed in mm/s."""
        return [(ns, c.wheels()) for ns, c in self.commands(since_ns) if c.op == Op.DRIVE_DIRECT]

    @property
    def mode(self) -> Mode:
        """What the robot obeys now."""
        with self.lock:
            return self.body.mode

    @property
    def wheels_mmps(self) -> tuple[int, int]:
        """Right and left wheel as they turn now."""
        with self.lock:
            return self.body.wheels_mmps

    # ---- the failures, by the numbers of the specification ----

    def flip_bytes(self, share: float) -> None:
        """1: change one byte in this share of the frames."""
        self._flip_share = share

    def drop_bytes(self, share: float) -> None:
        """2: lose one byte in this share of the frames."""
        self._drop_share = share

    def disguise(self, ids: tuple[int, ...] = stream.PACKETS) -> None:
        """3: let voltage, charge and capacity hold the two bytes with which a frame begins."""
        with self.lock:
            look_alike = (stream.HEADER << 8) | (stream.frame_bytes(ids) - 3)
            self.body.voltage_mv = self.body.charge_mah = self.body.capacity_mah = look_alike

    def use_rule(self, rule: Rule) -> None:
        """4: sum as the other document says."""
        with self.lock:
            self.body.rule = rule

    def silence(self, seconds: float = float("inf")) -> None:
        """5 and 6: send nothing for a while, or for ever; commands are still obeyed."""
        end = time.monotonic_ns() + seconds * 1e9 if np.isfinite(seconds) else 2**62
        self._silent_until_ns = int(end)

    def hazard(self, *, cliffs: int = 0, wheel_drops: int = 0, charger: bool = False) -> None:
        """7: what makes Safe mode fall to Passive; without arguments the hazard is gone."""
        with self.lock:
            self.body.cliffs, self.body.wheel_drops, self.body.charger = cliffs, wheel_drops, charger

    def misreport_mode(self, offset: int) -> None:
        """8: report a mode that is too high by this much."""
        with self.lock:
            self.body.mode_offset = offset

    def reset(self) -> None:
        """9: brown-out in mid-drive."""
        with self.lock:
            self.body.reset(time.monotonic_ns())

    def change_baud(self, rate: int) -> None:
        """10: three pulses on the baud rate line."""
        with self.lock:
            self.body.baud = rate

    def ignore_safe(self, ignored: bool = True) -> None:
        """11: the freeze after a long time on the charger."""
        with self.lock:
            self.body.obeys_safe = not ignored

    def alkaline(self) -> None:
        """12: a pack of alkaline cells: charge and capacity mean nothing."""
        with self.lock:
            self.body.charge_mah, self.body.capacity_mah, self.body.voltage_mv = 0, 0, 16_500

    def hold_back(self) -> None:
        """13: keep every frame from now on ..."""
        self._held = []

    def let_go(self) -> None:
        """13: ... and send all of them at once."""
        with self.lock:
            held, self._held = self._held or [], None
            self._write(b"".join(held))

    def hang_up(self) -> None:
        """14: the cable is pulled."""
        with self.lock:
            self._close()

    def come_back(self) -> None:
        """14: the cable is plugged in again, under another name."""
        with self.lock:
            self._open()

    def block_writes(self) -> None:
        """15: take no byte from the host any more, until its writes block."""
        self._reads = False
        with self.lock, contextlib.suppress(BlockingIOError):
            os.set_blocking(self._slave, False)
            while True:
                os.write(self._slave, bytes(256))

    def take_writes(self) -> None:
        """15: take them again; what clogged the line were zeros, which mean nothing."""
        self._reads = True

    def begin_with_garbage(self, garbage: bytes) -> None:
        """16: send this before the next frame."""
        self._garbage = garbage

    def cut_command(self, begun: bytes) -> None:
        """17: have received the beginning of a command, and nothing after it."""
        with self.lock:
            self.body.receive(begun, time.monotonic_ns())

    # ---- the line ----

    def _open(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        if self._link is not None:
            fresh = self._link.with_name(self._link.name + ".new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self.port)
            fresh.replace(self._link)

    def _close(self) -> None:
        # One end stays open here as long as the robot is plugged in: without any reader a
        # pseudo-terminal reports an error that no serial line has.
        for fd in (self._slave, self._master):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1

    def _run(self) -> None:
        while not self._stop.is_set():
            with self.lock:
                master = self._master if self._reads else -1
            if master < 0:
                self._stop.wait(_POLL_MS / 1000)
            else:
                with contextlib.suppress(OSError):
                    select.select([master], [], [], _POLL_MS / 1000)
            with self.lock:
                self._turn(time.monotonic_ns())

    def _turn(self, now_ns: int) -> None:
        matched = self._master >= 0 and self._host_baud() == self.body.baud
        if self._master >= 0 and self._reads:
            with contextlib.suppress(BlockingIOError):
                chunk = os.read(self._master, 4096)
                if matched:
                    self.received += chunk
                    del self.received[:-1_000_000]
                    self.body.receive(chunk, now_ns)
        for frame in self.body.transmit(now_ns):
            if now_ns < self._silent_until_ns or self._master < 0:
                continue
            data = self._garbage + self._mangle(frame)
            self._garbage = b""
            if self._held is not None:
                self._held.append(data)
            else:
                self._write(data if matched else self._rng.bytes(len(data)))

    def _host_baud(self) -> int:
        return _SPEEDS.get(termios.tcgetattr(self._master)[5], 0)

    def _write(self, data: bytes) -> None:
        """Send; what the host does not read in time is lost, as on a line without flow control."""
        if self._master < 0:
            return
        try:
            os.write(self._master, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    def _mangle(self, frame: bytes) -> bytes:
        damaged = bytearray(frame)
        if self._flip_share and self._rng.random() < self._flip_share:
            damaged[self._rng.integers(len(damaged))] ^= int(self._rng.integers(1, 256))
        if self._drop_share and self._rng.random() < self._drop_share:
            del damaged[self._rng.integers(len(damaged))]
        return bytes(damaged)


def stopped_after_ms(emulator: CreateEmulator, fault_ns: int) -> float | None:
    """Return the time from a fault to the first zeros on the wire after which no motion was commanded."""
    drives = emulator.drives(fault_ns)
    moving = [i for i, (_, wheels) in enumerate(drives) if wheels != (0, 0)]
    after = drives[moving[-1] + 1 :] if moving else drives
    return (after[0][0] - fault_ns) / MILLISECOND if after else None
