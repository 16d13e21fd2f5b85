"""The sensor's end of the line: a pseudo-terminal that takes its time, knows rates, and can be unplugged.

Law: bytes leave when they are due.  What nobody reads stays queued, and the owner sees that the line is busy.
"""

import contextlib
import os
import termios
import tty
from collections import deque
from pathlib import Path

import numpy as np

_USB_BYTES_PER_S = 370_000
_RETRY_NS = 2_000_000
# What the far end of a pseudo-terminal shows of the rates that termios has no constant for.
_OTHER_BAUD = 4096


class Wire:
    """A line that can be plugged, unplugged, and plugged again under another name.

    Args:
        rs232: Whether rates matter and a byte takes ten bits; else USB.
        link: A name for the port; without it the port has the terminal's own.
        chunk_bytes: Most bytes that leave together.
        rng: For what a wrong rate makes of bytes.
    """

    def __init__(self, *, rs232: bool, link: Path | None, chunk_bytes: int, rng: np.random.Generator) -> None:
        self.path = ""
        self.master = self._slave = -1
        self._rs232, self._link, self._chunk, self._rng = rs232, link, chunk_bytes, rng
        self._queue: deque[tuple[int, bytes]] = deque()

    @property
    def plugged(self) -> bool:
        """Whether there is a port at all."""
        return self.master >= 0

    @property
    def busy(self) -> bool:
        """Whether bytes wait to leave."""
        return bool(self._queue)

    @property
    def terminal(self) -> str:
        """The terminal's own name, whatever the port is called."""
        return os.ttyname(self._slave)

    def plug(self, link: Path | None = None) -> None:
        """Appear, under another name if one is given."""
        self._link = link or self._link
        self.master, self._slave = os.openpty()
        # The slave stays open here: without any, the host's closing would end the line for good.
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = self.terminal
        if self._link:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.path)
            self.path = str(self._link)

    def unplug(self) -> None:
        """Vanish; what has not left is lost."""
        if not self.plugged:
            return
        os.close(self.master)
        os.close(self._slave)
        self.master = self._slave = -1
        self.path = ""
        self._queue.clear()
        if self._link:
            self._link.unlink(missing_ok=True)

    def receive(self, baud: int) -> bytes:
        """Return what the host sent; garbage comes back at a wrong rate, and nothing is understood."""
        chunk = b""
        with contextlib.suppress(OSError):
            chunk = os.read(self.master, 4096)
        if chunk and not self._rates_agree(baud):
            self._queue.append((0, self._garbage(len(chunk))))
            return b""
        return chunk

    def send(self, data: bytes, at_ns: int, baud: int) -> None:
        """Queue bytes, in pieces, at the pace of the line, behind what is already there."""
        if self._queue:
            at_ns = max(at_ns, self._queue[-1][0])
        per_byte_ns = 1e10 / baud if self._rs232 else 1e9 / _USB_BYTES_PER_S
        for begin in range(0, len(data), self._chunk):
            self._queue.append((at_ns + round(begin * per_byte_ns), data[begin : begin + self._chunk]))

    def clear(self) -> None:
        """Drop what has not left yet."""
        self._queue.clear()

    def transmit(self, now_ns: int, baud: int) -> int | None:
        """Let go what is due; return when the next piece is, None if there is none."""
        while self._queue and self._queue[0][0] <= now_ns:
            due_ns, piece = self._queue.popleft()
            if not self.plugged:
                continue
            if not self._rates_agree(baud):
                piece = self._garbage(len(piece))
            written = 0
            with contextlib.suppress(OSError):
                written = os.write(self.master, piece)
            if written < len(piece):
                self._queue.appendleft((due_ns, piece[written:]))
                return now_ns + _RETRY_NS
        return self._queue[0][0] if self._queue else None

    def _rates_agree(self, baud: int) -> bool:
        if not self._rs232:
            return True
        return bool(termios.tcgetattr(self.master)[4] == getattr(termios, f"B{baud}", _OTHER_BAUD))

    def _garbage(self, count: int) -> bytes:
        return self._rng.integers(0x80, 0x100, count, dtype=np.uint8).tobytes()
