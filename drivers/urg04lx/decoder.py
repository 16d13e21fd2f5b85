"""Bytes from a URG to replies and scans, in any chunking.

Law: nothing that comes over the wire raises, and nothing piles up: what cannot be read is counted, and costs
only the replies it touches.  The sums have six bits only and miss a flip of the two others, so a scan has to
pass all of: echo, status, length of every line, range of every character, every sum.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.urg04lx.protocol import (
    ECHO,
    END,
    LF,
    LINE_CHARS,
    StreamRequest,
    checksum,
    decode_value,
    status_of,
)

BUFFER_BYTES = 8192
_LONGEST_REPLY = 2408  # MD over all 769 steps
_HEAD = 26  # echo 15, LF, status 3, LF, stamp 5, LF


@dataclass(frozen=True, slots=True, eq=False)
class ScanReply:
    """One scan, all checks passed."""

    at_ns: int
    """When its first byte arrived, by the clock of whoever fed it."""
    stamp_ms: int
    """Sensor time of step 0, 24 bits."""
    values: NDArray[np.int32]
    """(count,) mm, or error codes below 20."""
    remaining: int
    """Scans still to come; 0 also when the stream is endless."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Any other reply: echo and status passed their checks, the lines are as they came."""

    at_ns: int
    echo: bytes
    status: bytes
    """Two characters, or one in SCIP 1.1."""
    lines: tuple[bytes, ...] = ()


class Decoder:
    """Takes bytes as they come, gives the replies they complete.

    Args:
        stream: The request whose scans are wanted; others' scans are counted as `foreign`.
    """

    def __init__(self, stream: StreamRequest | None = None) -> None:
        self._buffer = bytearray()
        self._searched = 0  # no LF LF begins before this position
        self._arrivals: list[tuple[int, int]] = []  # (position in the buffer, when the chunk from there came)
        self._layout: _Layout | None = None
        self.damaged: Counter[str] = Counter()
        """Blocks that could not be read, by what was wrong with them."""
        self.skipped_bytes = 0
        """Bytes that belong to no accepted reply."""
        self.foreign = 0
        """Good replies to a request that is not ours: left over from an earlier run."""
        self.expect(stream)

    def expect(self, stream: StreamRequest | None) -> None:
        """From now on take the scans of this request."""
        self._layout = _Layout(stream) if stream else None

    def reset(self) -> None:
        """Forget the bytes of an unfinished reply, as after discarding input; the counters go on."""
        self.skipped_bytes += len(self._buffer)
        self._drop(len(self._buffer))

    @property
    def pending_bytes(self) -> int:
        """Bytes of a reply that has not ended yet; never more than `BUFFER_BYTES`."""
        return len(self._buffer)

    def feed(self, chunk: bytes, at_ns: int = 0) -> list[ScanReply | Reply]:
        """Take the next bytes, in any amount, with the time of their arrival; return what they complete."""
        if chunk:
            self._arrivals.append((len(self._buffer), at_ns))
            self._buffer += chunk
        found: list[ScanReply | Reply] = []
        while (end := self._buffer.find(END, self._searched)) >= 0:
            block = bytes(self._buffer[: end + 1])
            if reply := self._read_block(block):
                found.append(reply)
            self._drop(end + 2)
        if len(self._buffer) > BUFFER_BYTES:
            # No reply is this long: its end was lost. What may still become one is at the tail.
            lost = len(self._buffer) - _LONGEST_REPLY
            self.damaged["endless"] += 1
            self.skipped_bytes += lost
            self._drop(lost)
        self._searched = max(0, len(self._buffer) - 1)
        return found

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._searched = 0
        kept = [(max(0, at - count), when) for at, when in self._arrivals]
        # Of the chunks that began before the cut only the last one still has bytes here.
        first = max((i for i, (at, _) in enumerate(kept) if at == 0), default=0)
        self._arrivals = kept[first:] if self._buffer else []

    def _arrival_ns(self, position: int) -> int:
        when = 0
        for at, at_ns in self._arrivals:
            if at > position:
                break
            when = at_ns
        return when

    def _read_block(self, block: bytes) -> ScanReply | Reply | None:
        """Read one block (it ends in one LF); on damage look for a reply that begins inside it."""
        if len(block) > BUFFER_BYTES:  # only a very long chunk makes one
            self.skipped_bytes += len(block) - BUFFER_BYTES
            block = block[-BUFFER_BYTES:]
        start = len(block) - len(block.lstrip(LF))
        if start == len(block):
            return None  # an empty line more or less means nothing
        reply = self._read_scan(block, start) or self._read_reply(block, start)
        if isinstance(reply, str):
            # Perhaps the end of one reply was lost and the next one is whole.
            for at in self._later_starts(block, start):
                later = self._read_scan(block, at) or self._read_reply(block, at)
                if not isinstance(later, str):
                    self.damaged["no end"] += 1
                    self.skipped_bytes += at
                    return self._own(later, len(block) + 1 - at)
            self.damaged[reply] += 1
            self.skipped_bytes += len(block) + 1
            return None
        return self._own(reply, len(block) + 1 - start)

    def _own(self, reply: ScanReply | Reply, size: int) -> ScanReply | Reply | None:
        """Count what answers somebody else's request."""
        if isinstance(reply, Reply) and reply.status == b"99":
            self.foreign += 1
            self.skipped_bytes += size
            return None
        return reply

    def _later_starts(self, block: bytes, start: int) -> list[int]:
        """Where a reply may begin in a damaged block: our echo anywhere, others on a line of their own."""
        starts = []
        if self._layout:
            at = block.find(self._layout.echo, start + 1)
            while at >= 0:
                starts.append(at)
                at = block.find(self._layout.echo, at + 1)
        at = block.find(LF, start)
        while at >= 0:
            if ECHO.match(block, at + 1):
                starts.append(at + 1)
            at = block.find(LF, at + 1)
        return sorted(set(starts))

    def _read_scan(self, block: bytes, start: int) -> ScanReply | str | None:
        """Read the scan that starts here; a word if it is damaged, None if it is no scan of ours."""
        layout = self._layout
        if layout is None or not block.startswith(layout.echo, start):
            return None
        if block[start + 15 : start + 20] != b"\n99b\n":
            return None if block[start + 15 : start + 16] == LF else "echo"
        if len(block) - start != layout.size:
            return "length"
        read = layout.read(block[start:])
        if isinstance(read, str):
            return read
        stamp_ms, values, remaining = read
        return ScanReply(self._arrival_ns(start), stamp_ms, values, remaining)

    def _read_reply(self, block: bytes, start: int) -> Reply | str:
        """Read a reply other than a scan of ours; a word if it is damaged."""
        echo_end = block.index(LF, start)
        if not ECHO.fullmatch(block, start, echo_end):
            return "echo"
        status_end = block.find(LF, echo_end + 1)
        status = status_of(block[echo_end + 1 : status_end]) if status_end > 0 else None
        if status is None:
            return "status"
        lines = block[status_end + 1 : -1].split(LF) if status_end + 1 < len(block) else []
        return Reply(self._arrival_ns(start), block[start:echo_end], status, tuple(lines))


class _Layout:
    """Where each byte of a scan reply to one request has to be, so that reading it is a few array steps."""

    def __init__(self, request: StreamRequest) -> None:
        self.echo = request.steps
        self._width = request.width
        chars = request.count * request.width
        self._full, rest = divmod(chars, LINE_CHARS)
        lengths = [LINE_CHARS] * self._full + [rest] * (rest > 0)
        ends = np.cumsum([length + 2 for length in lengths]) + _HEAD
        self.size = int(ends[-1])
        self._breaks = ends - 1
        self._sums = ends - 2
        begins = ends - 2 - np.array(lengths)
        self._chars = np.concatenate([np.arange(b, b + n) for b, n in zip(begins, lengths, strict=True)])
        self._line_starts = np.arange(len(lengths)) * LINE_CHARS
        self._powers = 1 << np.arange(6 * (self._width - 1), -1, -6, dtype=np.int32)

    def read(self, block: bytes) -> tuple[int, NDArray[np.int32], int] | str:
        """Return stamp, values and remaining scans of a block of the right size, or what is wrong with it."""
        remaining, stamp = block[13:15], block[20:24]
        if not remaining.isdigit():
            return "echo"
        if block[25:26] != LF or checksum(stamp) != block[24]:
            return "stamp"
        if not all(0x30 <= character <= 0x6F for character in stamp):
            return "stamp"
        view = np.frombuffer(block, dtype=np.uint8)
        if (view[self._breaks] != 0x0A).any():
            return "line"
        digits = view[self._chars] - np.uint8(0x30)  # wraps, so that one comparison sees both limits
        if (digits > 0x3F).any():
            return "character"
        # The sum of the characters is the sum of their digits plus 0x30 for each; both modulo 64.
        lengths = np.diff(self._line_starts, append=len(digits))
        sums = np.add.reduceat(digits, self._line_starts, dtype=np.int64) + 0x30 * lengths
        if ((sums & 0x3F) + 0x30 != view[self._sums]).any():
            return "sum"
        values = digits.reshape(-1, self._width).astype(np.int32) @ self._powers
        return decode_value(stamp), values, int(remaining)
