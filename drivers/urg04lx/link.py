"""One open line to the sensor: ask and wait, listen, drain.

Every procedure that waits is a generator: it yields None at least every 50 ms, so that whoever runs it can do
other things or stop.  Closing the generator ends the procedure there.
"""

from collections.abc import Callable, Generator
from typing import Any, Protocol

from drivers.urg04lx.decoder import Decoder, Reply, ScanReply
from drivers.urg04lx.protocol import LF

POLL_S = 0.05
Waiting = Generator[Any, None, None]
"""A procedure without a result; what it yields besides None are events of the device."""


class Stream(Protocol):
    """Bytes in, bytes out: `drivers.transport.SerialStream`, or a twin in a test."""

    path: str

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, b"" if nothing does within the time-out."""

    def write(self, data: bytes) -> None:
        """Send all of it."""

    def set_baud(self, baud: int) -> None:
        """Change the rate of this side."""

    def close(self) -> None:
        """Give the port back."""


class Link:
    """A stream, its decoder, and the clock that says when bytes came.

    Args:
        stream: Open.
        decoder: Lives as long as the device, so that its counters do.
        now_ns: The host's steady clock.
    """

    def __init__(self, stream: Stream, decoder: Decoder, now_ns: Callable[[], int]) -> None:
        self.stream = stream
        self.decoder = decoder
        self.now_ns = now_ns
        self.last_byte_ns = now_ns()
        self.heard_bytes = 0
        self._unprintable = 0

    def elapsed_s(self, since_ns: int) -> float:
        """Return the time since `since_ns`."""
        return (self.now_ns() - since_ns) / 1e9

    def listen(self) -> list[ScanReply | Reply]:
        """Wait a moment for bytes; return the replies they complete."""
        chunk = self.stream.read()
        if not chunk:
            return []
        self.last_byte_ns = at_ns = self.now_ns()
        self.heard_bytes += len(chunk)
        self._unprintable += sum(1 for byte in chunk if not (0x20 <= byte <= 0x7E or byte in b"\r\n"))
        return self.decoder.feed(chunk, at_ns)

    def forget(self) -> None:
        """Begin to count anew what is heard."""
        self.heard_bytes = self._unprintable = 0

    @property
    def garbled(self) -> bool:
        """Whether what was heard since `forget` is no text: the rate is wrong."""
        return self._unprintable * 10 > self.heard_bytes

    def ask(self, request: bytes, within_s: float) -> Generator[None, None, Reply | None]:
        """Send a request; return the reply with its echo, None if none comes in time; drop all others."""
        self.stream.write(request + LF)
        sent_ns = self.now_ns()
        while self.elapsed_s(sent_ns) < within_s:
            for reply in self.listen():
                if isinstance(reply, Reply) and reply.echo == request:
                    return reply
            yield None
        return None

    def drain(self, silence_s: float, at_most_s: float) -> Waiting:
        """Drop what comes until it has been silent for a while; an endless stream is never silent."""
        began_ns = self.last_byte_ns = self.now_ns()
        while self.elapsed_s(self.last_byte_ns) < silence_s and self.elapsed_s(began_ns) < at_most_s:
            self.listen()
            yield None
        self.decoder.reset()
