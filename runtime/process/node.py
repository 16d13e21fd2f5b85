"""The frame around a node: one process, its port on the bus, its heartbeat, its signals, its exit code.

The frame opens the bus when the node first subscribes, publishes or is ready, so that a node compiles and
warms up its core before any other process counts on its answers: compiling holds the interpreter longer
than a link may be silent.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime import messages
from runtime.bus.contract import Bus, Handle, Publisher, wait_matching
from runtime.bus.inbox import Inbox
from runtime.bus.offset import question_key
from runtime.bus.pulling import Puller
from runtime.clock import Clock
from runtime.messages import DiagnosticArray, DiagnosticStatus, KeyValue
from runtime.port import Level, Subscription
from runtime.process import realtime
from runtime.process.health import LEAVING, LOOP_AGE_S
from runtime.process.usage import Usage
from runtime.topics import Topic
from runtime.topics import topic as topic_named

HEARTBEAT_S = 1.0
_MATCHING_S = 0.3
_LEVELS: dict[Level, int] = {"ok": 0, "warn": 1, "error": 2}


@dataclass(slots=True)
class _Voice:
    """Who a message is from."""

    gid: bytes
    number: int = 0
    """Of the last message."""


class _Outlet:
    """One topic's publisher: numbers, stamps and sends under one lock, so that numbers leave in order."""

    def __init__(self, bus: Bus, key: str, topic: Topic, clock: Clock) -> None:
        self.topic = topic
        self.publisher: Publisher = bus.publisher(key, latched=topic.latched, urgency=topic.urgency)
        self.published = 0
        self._voices: dict[str, _Voice] = {}
        self._clock = clock
        self._lock = threading.Lock()

    def put(self, payload: bytes, publisher: str = "", skipped: int = 0) -> None:
        with self._lock:
            self.published += 1
            voice = self._voices.get(publisher)
            if voice is None:
                voice = self._voices[publisher] = _Voice(os.urandom(16))
            voice.number += 1 + skipped
            stamp_ns = self._clock.now_ns()
            self.publisher.put(payload, messages.Attachment(voice.number, stamp_ns, voice.gid).encode())


class BusPort:
    """See `runtime.port.Port`; built on any bus."""

    def __init__(
        self,
        name: str,
        open_bus: Callable[[], Bus],
        *,
        subscribes: Sequence[str] = (),
        publishes: Sequence[str] = (),
        robot: str = "robot",
        domain: int = 0,
        seed: int = 0,
        clock: Clock | None = None,
        run_dir: Path = Path(),
        results_dir: Path | None = None,
        guest: bool = False,
    ) -> None:
        self.name, self.robot, self.domain, self.seed = name, robot, domain, seed
        self.clock = clock or Clock.from_environment()
        self.log = logging.getLogger(name)
        self.run_dir, self.results_dir = run_dir, results_dir
        self._subscribes = {topic_named(topic).name for topic in subscribes}
        self._publishes = list(
            dict.fromkeys([*(topic_named(topic).name for topic in publishes), "diagnostics"])
        )
        self._open_bus = open_bus
        self._bus: Bus | None = None
        self._guest = guest
        self._puller: Puller | None = None
        self._opening = threading.RLock()
        self._outlets: dict[str, _Outlet] = {}
        self._inboxes: list[Inbox] = []
        self._tokens: list[Handle] = []
        self._entities = 0
        self._asked_to_stop = False
        self._closing = threading.Event()
        self._beating: threading.Thread | None = None
        self._counters: dict[str, int] = {}
        self._state: tuple[Level, str, dict[str, object]] = ("ok", "starting", {})
        self._is_ready = False
        self._usage = Usage()
        self._turned_monotonic = time.monotonic()

    # ---- what a node sees ----

    @property
    def stopping(self) -> bool:
        """See Port.stopping."""
        self.turn()
        return self._asked_to_stop

    def subscribe(self, topic: str, *, keep: int | None = None, raw: bool = False) -> Subscription:
        """See Port.subscribe."""
        row = topic_named(topic)
        if row.name not in self._subscribes:
            raise ValueError(f"{self.name}: subscribes {row.name!r}, which is not in its SUBSCRIBES")
        if not raw:
            messages.prepare(row.type)
        inbox = Inbox(row, self.clock, lambda: self.stopping, keep=keep, raw=raw)
        bus = self._connected()
        self._inboxes.append(inbox)
        if self._guest and row.name in ("map", "map_updates"):
            # Over a network the map comes as tiles, at the pace of the link, and never in one piece.
            if row.name == "map":
                self._puller = Puller(bus, self.robot, self._key(row), inbox.mailbox.put)
            return inbox
        bus.subscribe(self._key(row), inbox.mailbox.put, latched=row.latched)
        self._declare_endpoint(bus, "MS", row)
        return inbox

    def publish(self, topic: str, message: Any) -> None:
        """See Port.publish."""
        self.publish_raw(topic, messages.encode(message))

    def publish_raw(self, topic: str, payload: bytes, publisher: str = "", skipped: int = 0) -> None:
        """See Port.publish_raw."""
        self._connected()
        outlet = self._outlets.get(topic)
        if outlet is None:
            raise ValueError(f"{self.name}: publishes {topic!r}, which is not in its PUBLISHES")
        outlet.put(payload, publisher, skipped)

    def answer(self, name: str, reply: Callable[[bytes], bytes]) -> None:
        """See Port.answer."""
        self._connected().answer(question_key(self.robot, name), reply)

    def report(self, level: Level, text: str, **values: object) -> None:
        """See Port.report."""
        before, _, values_before = self._state
        self._state = (level, text, values)
        if level != before:
            self.log.log((logging.INFO, logging.WARNING, logging.ERROR)[_LEVELS[level]], "%s", text)
        if (level != before or _state_in(values) != _state_in(values_before)) and self._bus is not None:
            self.beat()

    def ready(self) -> None:
        """See Port.ready."""
        if self._is_ready:
            return
        self.turn()  # whatever came before was no turn of the loop, however long it took
        bus = self._connected()
        realtime.settle()
        # Whoever is there already shall not miss the first message.
        end = time.monotonic() + _MATCHING_S
        for outlet in self._outlets.values():
            wait_matching(outlet.publisher, max(0.0, end - time.monotonic()))
        self._is_ready = True
        self._tokens.append(bus.token(messages.node_token(bus.zid, self.robot, self.name, self.domain)))
        if self._state[1] == "starting":
            self._state = ("ok", "running", {})
        self.beat()

    def count(self, name: str, n: int = 1) -> None:
        """See Port.count."""
        self._counters[name] = self._counters.get(name, 0) + n

    # ---- what the frame does ----

    def turn(self) -> None:
        """Take note that the node's loop turns; asking whether to stop does so, too."""
        self._turned_monotonic = time.monotonic()

    def stop(self) -> None:
        """Ask the node to stop; a signal handler may call it, for it takes no lock.

        Setting an Event would: a second signal that arrives in the middle of it waits for ever.
        """
        self._asked_to_stop = True

    def beat(self, *, leaving: bool = False) -> None:
        """Publish how the node is, now; the last word says that it is the last."""
        level, text, values = self._state
        entries = {**self.counters(), **{key: str(value) for key, value in values.items()}}
        if leaving:
            entries[LEAVING] = 1
        status = DiagnosticStatus(
            level=_LEVELS[level],
            name=f"{self.robot}/{self.name}",
            message=text,
            hardware_id=os.uname().nodename,
            values=[KeyValue(key=key, value=str(value)) for key, value in entries.items()],
        )
        stamp = messages.header(self.clock.now_ns(), "")
        self._outlets["diagnostics"].put(messages.encode(DiagnosticArray(header=stamp, status=[status])))

    def counters(self) -> dict[str, object]:
        """Return everything counted in this process, as the heartbeat publishes it."""
        values: dict[str, object] = {"pid": os.getpid(), "ready": int(self._is_ready)}
        for inbox in self._inboxes:
            values |= inbox.counters()
            values[f"{inbox.topic.name}.worst_work_ms"] = f"{inbox.worst_work_ns / 1e6:.1f}"
            values[f"{inbox.topic.name}.queue_ms"] = f"{inbox.queue_ms():.1f}"
        for outlet in self._outlets.values():
            values[f"{outlet.topic.name}.published"] = outlet.published
        if self._puller is not None:
            values["map.pulled_bytes"] = self._puller.bytes_received
            values["map.damaged_answers"] = self._puller.answers_damaged
        values |= self._counters
        values[LOOP_AGE_S] = f"{time.monotonic() - self._turned_monotonic:.1f}"
        values |= self._usage.values()
        return values

    def close(self) -> None:
        """Say the last word and leave the bus."""
        self._asked_to_stop = True
        self._closing.set()
        if self._beating is not None:
            self._beating.join()
        if self._bus is not None:
            self.beat(leaving=True)
            self._bus.close()
            self._bus = None
        if self._puller is not None:
            self._puller.close()

    def __enter__(self) -> "BusPort":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _key(self, topic: Topic) -> str:
        return messages.topic_key(f"{self.robot}/{topic.name}", topic.type, self.domain)

    def _connected(self) -> Bus:
        with self._opening:
            if self._bus is None:
                bus = self._bus = self._open_bus()
                for name in self._publishes:
                    row = topic_named(name)
                    messages.prepare(row.type)
                    self._outlets[name] = _Outlet(bus, self._key(row), row, self.clock)
                    self._declare_endpoint(bus, "MP", row)
                self._beating = threading.Thread(target=self._heartbeat, name="heartbeat", daemon=True)
                self._beating.start()
            return self._bus

    def _declare_endpoint(self, bus: Bus, kind: str, row: Topic) -> None:
        self._entities += 1
        qos = messages.qos_text(latched=row.latched, depth=row.keep)
        name = f"{self.robot}/{row.name}"
        token = messages.endpoint_token(
            bus.zid, self._entities, kind, self.robot, self.name, name, row.type, qos, self.domain
        )
        self._tokens.append(bus.token(token))

    def _heartbeat(self) -> None:
        while not self._closing.wait(HEARTBEAT_S):
            self.beat()


def _state_in(values: dict[str, object]) -> str:
    """Return the word for the state that a node is in; what follows it, such as an angle, always changes."""
    return str(values.get("state", "")).partition(" ")[0]
