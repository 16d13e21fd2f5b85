"""The holes of a recording whose scans have no numbers, as one has that was made of a text log.

Their stamps tell: those behind a hole, too. So a scan without a number is held back, with all that follows,
until the next ones are read.
"""

from collections import deque
from collections.abc import Iterable, Iterator

from runtime.formats.laser_log import MAX_PERIOD_S
from runtime.formats.mcap_log import McapMessage
from runtime.formats.stamp_holes import StampHoles
from runtime.messages import BadMessageError, decode, peek_stamp_ns
from runtime.topics import topic

Counted = tuple[McapMessage, int]
"""A message, and how many of its publisher's are missing right before it."""


def with_holes(messages: Iterable[Counted]) -> Iterator[Counted]:
    """Yield messages in their order; before a scan without a number is missing what the stamps tell."""
    holes: StampHoles | None = None
    held: deque[tuple[McapMessage, int | None]] = deque()
    found: deque[int] = deque()

    def known() -> Iterator[Counted]:
        while held and (held[0][1] is not None or found):
            message, missing = held.popleft()
            yield message, found.popleft() if missing is None else missing

    for message, missing in messages:
        stamp_ns = peek_stamp_ns(message.payload) if _is_unnumbered(message) else None
        if stamp_ns is not None:
            holes = holes or _holes_of(message.payload)
        if stamp_ns is None or holes is None:
            held.append((message, missing))
        else:
            held.append((message, None))
            if (count := holes.take(stamp_ns)) is not None:
                found.append(count)
        yield from known()
    if holes is not None:
        found.extend(holes.end())
    yield from known()


def _is_unnumbered(message: McapMessage) -> bool:
    return message.sequence <= 0 and message.channel.name == "scan"


def _holes_of(payload: bytes) -> StampHoles | None:
    """Return what counts holes at the rate of the sensor; None where the scan does not tell it."""
    try:
        period_s = float(decode(payload, topic("scan").type).scan_time)
    except BadMessageError:
        return None
    return StampHoles(period_s) if 0.0 < period_s <= MAX_PERIOD_S else None
