"""The driver's side of the watchdog: starts it, lends it the line, beats, and knows whether it listens."""

import contextlib
import os
import select
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from drivers.create import watchdog
from drivers.errors import DeviceError

_START_S = 5.0
_ASLEEP_S = 0.5
"""A watchdog that owes an answer for longer is not watching; a busy machine alone takes less."""


class Guard:
    """A running watchdog process.

    Args:
        silence_s: After so long without a beat of a moving robot the watchdog stops it.
        deaf_s: After so long without any beat it kills the driver, which holds the port for nothing.

    Raises:
        DeviceError: It does not start.
    """

    def __init__(self, silence_s: float = 0.2, deaf_s: float = 10.0) -> None:
        if not 0.05 <= silence_s <= 0.25:
            raise ValueError(f"silence_s = {silence_s}, must be in [0.05, 0.25]")
        self._silence_s, self._deaf_s = silence_s, deaf_s
        self._owes_since: float | None = None
        self._start()

    def renew(self) -> None:
        """Start a watchdog in place of one that is dead or asleep."""
        self._link.close()
        self._process.kill()
        self._process.wait()
        self._start()

    @property
    def pid(self) -> int:
        """Of the watchdog."""
        return self._process.pid

    @property
    def awake(self) -> bool:
        """Whether the watchdog lives and answers."""
        self._read_answers()
        asleep = self._owes_since is not None and time.monotonic() - self._owes_since > _ASLEEP_S
        return self._process.poll() is None and not asleep

    def lend(self, line: int) -> None:
        """Give the watchdog a copy of a line's descriptor; it replaces the one before."""
        self._send(b"L", line)

    def take_back(self) -> None:
        """Have the watchdog close its copy: the robot has been told to stand, or is unplugged."""
        self._send(b"R")

    def beat(self, moving: bool) -> None:
        """Say that the driver is alive, and whether the robot may be moving."""
        self._read_answers()
        if self._owes_since is None:
            self._owes_since = time.monotonic()
        self._send(b"M" if moving else b"S")

    def close(self) -> None:
        """End the watchdog.  A line that it still has is stopped."""
        self._link.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> "Guard":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read_answers(self) -> None:
        # Any answer pays all debts: some get lost when nobody reads them for a while.
        with contextlib.suppress(OSError):
            while self._link.recv(16):
                self._owes_since = None

    def _send(self, message: bytes, line: int | None = None) -> None:
        # A watchdog that does not take its mail shows itself in `awake`.
        with contextlib.suppress(OSError):
            socket.send_fds(self._link, [message], [] if line is None else [line])

    def _start(self) -> None:
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link.setblocking(False)
        # Isolated and without site: it must start on its own, and in no time.
        command = [sys.executable, "-I", "-S", str(Path(watchdog.__file__))]
        silences_ms = [str(round(seconds * 1000)) for seconds in (self._silence_s, self._deaf_s)]
        with theirs:
            self._process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(os.getpid()), *silences_ms],
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                stdin=subprocess.DEVNULL,
            )
        ready, _, _ = select.select([self._link], [], [], _START_S)
        if not ready or not self._link.recv(16):
            raise DeviceError(f"the watchdog did not start within {_START_S:g} s")
        self._owes_since = None
