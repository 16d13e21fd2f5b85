"""What the runtime asks of a bus, and a mailbox that never grows.

Law: nothing here waits for a slow reader. A mailbox that is full drops its oldest message and counts it; a
hole in a publisher's sequence numbers is counted as missed, a number seen twice as a duplicate.
"""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, SupportsBytes

from runtime.messages import Attachment
from runtime.topics import Urgency

_MAX_PUBLISHERS = 64  # remembered by a mailbox; a flood of new publishers must not grow it


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """One message as the bus hands it over: bytes not yet copied, stamp of arrival by CLOCK_MONOTONIC."""

    key: str
    payload: SupportsBytes
    attachment: Attachment | None
    received_monotonic_ns: int


class Mailbox:
    """Holds the newest `keep` arrivals for one reader; filled by the bus's thread, so `put` is tiny."""

    def __init__(self, keep: int) -> None:
        if keep < 1:
            raise ValueError(f"keep = {keep}, must be at least 1")
        self._queue: deque[Arrival] = deque()
        self._keep = keep
        self._filled = threading.Condition()
        self._last: OrderedDict[bytes, int] = OrderedDict()
        self.received = 0
        self.overwritten = 0
        self.missed = 0
        self.duplicates = 0

    def put(self, arrival: Arrival) -> None:
        """Take a message in; drop the oldest if there is no room."""
        with self._filled:
            if (attachment := arrival.attachment) is not None:
                last = self._last.get(attachment.gid)
                if last is not None:
                    if attachment.sequence <= last:
                        self.duplicates += 1
                        return
                    self.missed += attachment.sequence - last - 1
                elif len(self._last) >= _MAX_PUBLISHERS:
                    self._last.popitem(last=False)
                self._last[attachment.gid] = attachment.sequence
            self.received += 1
            if len(self._queue) >= self._keep:
                self._queue.popleft()
                self.overwritten += 1
            self._queue.append(arrival)
            self._filled.notify()

    def take(self, timeout_s: float) -> Arrival | None:
        """Return the oldest held message, waiting for one at most `timeout_s`."""
        with self._filled:
            if not self._queue:
                self._filled.wait(timeout_s)
            return self._queue.popleft() if self._queue else None

    def take_all(self) -> list[Arrival]:
        """Return everything held, oldest first, without waiting."""
        with self._filled:
            taken = list(self._queue)
            self._queue.clear()
            return taken


class Handle(Protocol):
    """Something declared on the bus."""

    def close(self) -> None:
        """Take the declaration back; harmless when done twice."""


class Publisher(Handle, Protocol):
    """A declared writer of one key."""

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send without waiting for any reader."""

    @property
    def matching(self) -> bool:
        """Whether at least one subscriber is there; always true of a latched topic, which loses nothing."""


class Bus(Protocol):
    """One process's connection; all methods may be called from any thread."""

    @property
    def zid(self) -> str:
        """The name of this session, unique on the bus."""

    def publisher(self, key: str, *, latched: bool = False, urgency: Urgency = Urgency.DATA) -> Publisher:
        """Declare a writer; a latched one hands its last message to latched subscribers that come late."""

    def subscribe(self, key: str, on: Callable[[Arrival], None], *, latched: bool = False) -> Handle:
        """Call `on` from the bus's thread for each message on a key expression; `on` must be tiny."""

    def token(self, key: str) -> Handle:
        """Declare a liveliness token; it goes when the handle is closed or the process dies."""

    def tokens(self, pattern: str, timeout_s: float = 1.0) -> list[str]:
        """Return the tokens alive now."""

    def watch_tokens(self, pattern: str, on: Callable[[str, bool], None]) -> Handle:
        """Call `on(token, alive)` for those alive now and for each change."""

    def answer(self, key: str, reply: Callable[[bytes], bytes]) -> Handle:
        """Answer questions on a key."""

    def ask(
        self,
        key: str,
        payload: bytes = b"",
        timeout_s: float = 1.0,
        *,
        urgency: Urgency = Urgency.DATA,
    ) -> list[bytes]:
        """Ask a question; return the answers that came in time."""

    def close(self) -> None:
        """Leave the bus; everything declared goes with it."""


def wait_matching(publisher: Publisher, timeout_s: float) -> bool:
    """Wait until a subscriber is there; what is put earlier is lost to it."""
    end = time.monotonic() + timeout_s
    while not publisher.matching:
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True
