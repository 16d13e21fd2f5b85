"""The sensor's clock asked directly (TM), as a check of the latency that the stamps assume.

Each answer bounds the offset between the clocks: the stamp was made after the question left and before the
answer came.  The sensor answers once a revolution, so the middle of such an interval is biased; the
intersection of many, asked at different phases of the revolution, is not.  It switches the laser off, so only
the doctor uses it.
"""

from collections.abc import Generator
from dataclasses import dataclass
from itertools import pairwise

from drivers.urg04lx.connect import ANSWER_S
from drivers.urg04lx.link import Link
from drivers.urg04lx.protocol import checksum, decode_value

_GOLDEN = 0.618
_TURN_S = 0.1


@dataclass(frozen=True, slots=True)
class Bounds:
    """Host time minus sensor time, ms: somewhere between."""

    low_ms: float
    high_ms: float
    agreeing: int
    """How many answers agree with this."""
    asked: int


def clock_bounds(link: Link, exchanges: int = 12) -> Generator[None, None, Bounds | None]:
    """Bound the offset of the clocks; None if the sensor answers nothing that can be used.

    The sensor has to be idle, and is idle afterwards.
    """
    intervals = []
    yield from link.ask(b"TM0", ANSWER_S)
    for number in range(exchanges):
        pause_s = (number * _GOLDEN) % 1.0 * _TURN_S
        yield from link.drain(pause_s, pause_s)
        asked_ns = link.now_ns()
        reply = yield from link.ask(b"TM1", ANSWER_S)
        if reply is None or reply.status != b"00" or len(reply.lines) != 1:
            continue
        stamp = reply.lines[0]
        if len(stamp) == 5 and checksum(stamp[:4]) == stamp[4]:
            sensor_ms = decode_value(stamp[:4])
            intervals.append((asked_ns / 1e6 - sensor_ms - 1.0, reply.at_ns / 1e6 - sensor_ms))
    yield from link.ask(b"TM2", ANSWER_S)
    return agreement(intervals, exchanges)


def agreement(intervals: list[tuple[float, float]], asked: int) -> Bounds | None:
    """Return where most of the intervals overlap; a wrong one costs itself only."""
    edges = sorted([(low, 1) for low, _ in intervals] + [(high, -1) for _, high in intervals])
    best, depth, found = 0, 0, None
    for (at, change), (until, _) in pairwise(edges):
        depth += change
        if depth > best:
            best, found = depth, (at, until)
    return Bounds(*found, best, asked) if found else None
