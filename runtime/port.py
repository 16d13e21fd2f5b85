"""The world as a node sees it: subscribe, publish, report, count, and know when to stop.

A node is written against `Port` alone. `runtime.process.node.BusPort` is the real one; `ListPort` plays a
list of messages to a node and keeps what it said, without threads or waiting.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from runtime.clock import Clock, ManualClock
from runtime.topics import topic as topic_named

Level = Literal["ok", "warn", "error"]


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """One message, with who sent it when."""

    topic: str
    message: Any
    """Decoded; None on a raw subscription."""
    sequence: int = -1
    """Of its publisher, from 1 without gaps; -1 where the publisher gave none."""
    published_ns: int = 0
    received_ns: int = 0
    payload: bytes = b""
    """The CDR bytes as they came."""
    gid: bytes = b""
    """16 bytes that name the publisher."""


class Subscription(Protocol):
    """One topic's messages, kept as the topic table says."""

    @property
    def received(self) -> int:
        """Messages that arrived, whether or not they were taken."""

    @property
    def overwritten(self) -> int:
        """Messages that arrived and gave way to newer ones before they were taken."""

    @property
    def missed(self) -> int:
        """Messages that were published and never arrived, by the gaps in the sequence numbers."""

    @property
    def duplicates(self) -> int:
        """Messages that arrived again."""

    @property
    def undecodable(self) -> int:
        """Messages that were not what the topic carries."""

    def wait(self, timeout_s: float) -> Received | None:
        """Return the next message held, waiting at most `timeout_s`; None on time-out or when stopping."""

    def drain(self) -> list[Received]:
        """Return every message held, oldest first, without waiting."""


class Port(Protocol):
    """Everything a node may touch outside its core."""

    robot: str
    seed: int
    clock: Clock
    log: logging.Logger
    run_dir: Path
    """Directory of this run for sockets and device links; 0700, gone afterwards."""
    results_dir: Path | None
    """Where this run's results are written; None where nobody wants them."""

    @property
    def stopping(self) -> bool:
        """Whether the node shall save what it has and return; turns true within 0.1 s of a signal.

        Asking, here or by `Subscription.wait`, shows that the loop turns: a node that does not for half a
        minute (`turn_s` of the graph) hangs, and is started again.
        """

    def subscribe(self, topic: str, *, keep: int | None = None, raw: bool = False) -> Subscription:
        """Listen from now on.

        Args:
            topic: Name in the topic table, declared in the node's SUBSCRIBES.
            keep: How many messages are held until taken; the topic table's own number if None.
            raw: Leave messages as bytes: `Received.message` is None.
        """

    def publish(self, topic: str, message: Any) -> None:
        """Send a message on a topic declared in the node's PUBLISHES; never waits for a reader."""

    def publish_raw(self, topic: str, payload: bytes, publisher: str = "", skipped: int = 0) -> None:
        """Send a message that is CDR already.

        Args:
            topic: As for `publish`.
            payload: The message.
            publisher: Whose it is, where a process repeats what several have said; each has numbers of its
                own.
            skipped: How many of those numbers are left out before this one.
        """

    def answer(self, name: str, reply: Callable[[bytes], bytes]) -> None:
        """Answer questions on `hallway/<robot>/<name>`, from another thread; bulk, that nothing waits for."""

    def report(self, level: Level, text: str, **values: object) -> None:
        """Say how the node is; published at 1 Hz, and at once when the level or its `state` changes."""

    def ready(self) -> None:
        """Say that the node is warm and takes its first message in time."""

    def count(self, name: str, n: int = 1) -> None:
        """Add to a published counter; names are plural nouns that say what was lost or done."""


class _ListSubscription:
    """Plays the inputs of one topic, one by one."""

    def __init__(self, port: "ListPort", topic: str, raw: bool) -> None:
        self._port = port
        self.topic = topic
        self._raw = raw
        self.received = self.overwritten = self.missed = self.duplicates = self.undecodable = 0

    def wait(self, timeout_s: float) -> Received | None:
        """See Subscription.wait."""
        if not self._port.inputs.get(self.topic):
            self._port.idle_waits += 1
            return None
        self._port.idle_waits = 0
        self.received += 1
        self._port.sequences[self.topic] = self._port.sequences.get(self.topic, 0) + 1
        message = self._port.inputs[self.topic].pop(0)
        payload = b""
        if self._raw:
            from runtime.messages import encode

            payload, message = encode(message), None
        now_ns = self._port.clock.now_ns()
        return Received(self.topic, message, self._port.sequences[self.topic], now_ns, now_ns, payload)

    def drain(self) -> list[Received]:
        """See Subscription.drain."""
        return [got for _ in range(len(self._port.inputs.get(self.topic, ()))) if (got := self.wait(0.0))]


class ListPort:
    """A port for tests: plays (topic, message) pairs, asks the node to stop, keeps what it said."""

    MAX_IDLE_WAITS = 1000  # a node that waits for what never comes is stopped, so that its test ends

    def __init__(
        self,
        *inputs: tuple[str, Any],
        robot: str = "robot",
        seed: int = 0,
        clock: Clock | None = None,
        run_dir: Path = Path(),
        results_dir: Path | None = None,
        stop_after: int | None = None,
        sequences: dict[str, int] | None = None,
    ) -> None:
        self._stop_after = stop_after
        self.robot, self.seed = robot, seed
        self.clock = clock or ManualClock()
        self.log = logging.getLogger("test")
        self.run_dir, self.results_dir = run_dir, results_dir
        self.inputs: dict[str, list[Any]] = {}
        for name, message in inputs:
            self.inputs.setdefault(topic_named(name).name, []).append(message)
        self.subscribed: list[str] = []
        self.published: list[tuple[str, Any]] = []
        self.reports: list[tuple[Level, str, dict[str, object]]] = []
        self.counters: dict[str, int] = {}
        self.answers: dict[str, Callable[[bytes], bytes]] = {}
        self.is_ready = False
        self.idle_waits = 0
        self.sequences = dict(sequences or {})
        """Number of the last message of each topic; given, the next one follows it."""

    @property
    def stopping(self) -> bool:
        """True when all inputs of the subscribed topics are played, or `stop_after` messages are out."""
        if self._stop_after is not None:
            return len(self.published) >= self._stop_after or self.idle_waits > self.MAX_IDLE_WAITS
        left = any(self.inputs.get(name) for name in self.subscribed)
        return self.idle_waits > self.MAX_IDLE_WAITS or not left

    def subscribe(self, topic: str, *, keep: int | None = None, raw: bool = False) -> Subscription:
        """See Port.subscribe."""
        self.subscribed.append(topic_named(topic).name)
        return _ListSubscription(self, topic, raw)

    def publish(self, topic: str, message: Any) -> None:
        """See Port.publish."""
        self.published.append((topic_named(topic).name, message))

    def publish_raw(self, topic: str, payload: bytes, publisher: str = "", skipped: int = 0) -> None:
        """See Port.publish_raw."""
        self.published.append((topic_named(topic).name, payload))

    def answer(self, name: str, reply: Callable[[bytes], bytes]) -> None:
        """See Port.answer."""
        self.answers[name] = reply

    def report(self, level: Level, text: str, **values: object) -> None:
        """See Port.report."""
        self.reports.append((level, text, values))

    def ready(self) -> None:
        """See Port.ready."""
        self.is_ready = True

    def count(self, name: str, n: int = 1) -> None:
        """See Port.count."""
        self.counters[name] = self.counters.get(name, 0) + n

    def said(self, topic: str) -> list[Any]:
        """Return the messages published on one topic."""
        return [message for name, message in self.published if name == topic]
