"""A subscription on a real bus: decodes what arrives, counts what does not, and times its reader.

The time from taking one message to asking for the next is the reader's work; more than the topic's period
is a missed deadline, because the next message was there already. The time from the arrival of a message to
the moment it is taken is its age in the queue.
"""

import time
from collections.abc import Callable
from typing import Any

from runtime.bus.contract import Arrival, Mailbox
from runtime.clock import Clock
from runtime.latency import Recent
from runtime.messages import BadMessageError, decode
from runtime.port import Received
from runtime.topics import Topic

_SLICE_S = 0.1  # a signal ends a wait within this time


class Inbox:
    """See `runtime.port.Subscription`."""

    def __init__(
        self,
        topic: Topic,
        clock: Clock,
        stopping: Callable[[], bool],
        *,
        keep: int | None = None,
        raw: bool = False,
    ) -> None:
        self.topic = topic
        self.mailbox = Mailbox(topic.keep if keep is None else keep)
        self.undecodable = 0
        self.deadline_misses = 0
        self.worst_work_ns = 0
        self._clock, self._stopping, self._raw = clock, stopping, raw
        self._taken_monotonic_ns = 0
        self._ages = Recent()

    @property
    def received(self) -> int:
        """See Subscription.received."""
        return self.mailbox.received

    @property
    def overwritten(self) -> int:
        """See Subscription.overwritten."""
        return self.mailbox.overwritten

    @property
    def missed(self) -> int:
        """See Subscription.missed."""
        return self.mailbox.missed

    @property
    def duplicates(self) -> int:
        """See Subscription.duplicates."""
        return self.mailbox.duplicates

    def wait(self, timeout_s: float) -> Received | None:
        """See Subscription.wait."""
        self._time_reader()
        end = time.monotonic() + timeout_s
        while not self._stopping():
            left_s = end - time.monotonic()
            arrival = self.mailbox.take(max(0.0, min(left_s, _SLICE_S)))
            if arrival is not None:
                if (received := self._read(arrival)) is not None:
                    self._taken_monotonic_ns = time.monotonic_ns()
                    return received
            elif left_s <= 0:
                break
        return None

    def drain(self) -> list[Received]:
        """See Subscription.drain."""
        return [got for arrival in self.mailbox.take_all() if (got := self._read(arrival)) is not None]

    def queue_ms(self) -> float:
        """Return the age that 99 of 100 messages of the last minute had at most when they were taken, ms."""
        return self._ages.summary(time.monotonic_ns()).get("p99", 0.0)

    def counters(self) -> dict[str, int]:
        """Return what is published about this subscription, under the topic's name."""
        values = {
            "received": self.received,
            "overwritten": self.overwritten,
            "missed": self.missed,
            "duplicates": self.duplicates,
            "undecodable": self.undecodable,
            "deadline_misses": self.deadline_misses,
        }
        return {f"{self.topic.name}.{name}": value for name, value in values.items()}

    def _time_reader(self) -> None:
        if self._taken_monotonic_ns:
            work_ns = time.monotonic_ns() - self._taken_monotonic_ns
            self._taken_monotonic_ns = 0
            self.worst_work_ns = max(self.worst_work_ns, work_ns)
            if self.topic.period_ns and work_ns > self.topic.period_ns:
                self.deadline_misses += 1

    def _read(self, arrival: Arrival) -> Received | None:
        now_ns = time.monotonic_ns()
        self._ages.add((now_ns - arrival.received_monotonic_ns) / 1e6, now_ns)
        payload = bytes(arrival.payload)
        message: Any = None
        if not self._raw:
            try:
                message = decode(payload, self.topic.type)
            except BadMessageError:
                self.undecodable += 1
                return None
        attachment = arrival.attachment
        return Received(
            self.topic.name,
            message,
            attachment.sequence if attachment else -1,
            attachment.published_ns if attachment else 0,
            self._clock.from_monotonic_ns(arrival.received_monotonic_ns),
            payload,
            attachment.gid if attachment else b"",
        )
