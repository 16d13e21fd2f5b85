"""A bus within one process, for tests: the same contract as the real one, without a network.

Messages are handed over in the publisher's own thread; every session made by `join` hears the others.
"""

import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

from runtime.bus.contract import Arrival, Handle, Publisher
from runtime.messages import Attachment
from runtime.topics import Urgency


def key_matches(pattern: str, key: str) -> bool:
    """Whether a key expression covers a key; `*` is one chunk, `**` any number, neither a chunk in `@`."""
    return _chunks_match(pattern.split("/"), key.split("/"))


def _chunks_match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        if _chunks_match(pattern[1:], key):
            return True
        return bool(key) and not key[0].startswith("@") and _chunks_match(pattern, key[1:])
    if not key or (pattern[0] != key[0] and (pattern[0] != "*" or key[0].startswith("@"))):
        return False
    return _chunks_match(pattern[1:], key[1:])


class _Declared:
    """A declaration on the memory bus: closing runs `undo` once."""

    def __init__(self, undo: Callable[[], None]) -> None:
        self._undo: Callable[[], None] | None = undo

    def close(self) -> None:
        undo, self._undo = self._undo, None
        if undo is not None:
            undo()


class _MemoryPublisher(_Declared):
    def __init__(self, network: "_Network", key: str, latched: bool) -> None:
        super().__init__(lambda: network.publishers.discard(self))
        self.key = key
        self._network = network
        self._latched = latched
        self.last: Arrival | None = None
        with network.lock:
            network.publishers.add(self)

    def put(self, payload: bytes, attachment: bytes) -> None:
        arrival = Arrival(self.key, bytes(payload), Attachment.decode(attachment), time.monotonic_ns())
        with self._network.lock:
            self.last = arrival if self._latched else None
            readers = [on for pattern, on in self._network.readers.values() if key_matches(pattern, self.key)]
        for on in readers:
            on(arrival)

    @property
    def matching(self) -> bool:
        if self._latched:
            return True
        with self._network.lock:
            return any(key_matches(pattern, self.key) for pattern, _ in self._network.readers.values())


class _Network:
    """What all sessions of one memory bus share."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.ids = itertools.count(1)
        self.publishers: set[_MemoryPublisher] = set()
        self.readers: dict[int, tuple[str, Callable[[Arrival], None]]] = {}
        self.tokens: dict[int, str] = {}
        self.watchers: dict[int, tuple[str, Callable[[str, bool], None]]] = {}
        self.answerers: dict[int, tuple[str, Callable[[bytes], bytes]]] = {}

    def tell(self, token: str, alive: bool) -> None:
        with self.lock:
            watchers = [on for pattern, on in self.watchers.values() if key_matches(pattern, token)]
        for on in watchers:
            on(token, alive)


class MemoryBus:
    """The bus within one process; `join()` gives another session on the same network."""

    def __init__(self, network: "_Network | None" = None) -> None:
        self._network = network or _Network()
        self._zid = f"{next(self._network.ids):032x}"
        self._declared: list[_Declared] = []

    def join(self) -> "MemoryBus":
        """Open another session that talks with this one."""
        return MemoryBus(self._network)

    @property
    def zid(self) -> str:
        """See Bus.zid."""
        return self._zid

    def publisher(self, key: str, *, latched: bool = False, urgency: Urgency = Urgency.DATA) -> Publisher:
        """See Bus.publisher."""
        declared = _MemoryPublisher(self._network, key, latched)
        self._declared.append(declared)
        return declared

    def subscribe(self, key: str, on: Callable[[Arrival], None], *, latched: bool = False) -> Handle:
        """See Bus.subscribe."""
        handle = self._enter(self._network.readers, (key, on))
        if latched:
            with self._network.lock:
                held = [p.last for p in self._network.publishers if p.last and key_matches(key, p.key)]
            for arrival in held:
                on(arrival)
        return handle

    def token(self, key: str) -> Handle:
        """See Bus.token."""
        network, number = self._network, next(self._network.ids)
        network.tokens[number] = key
        network.tell(key, True)

        def undo() -> None:
            del network.tokens[number]
            network.tell(key, False)

        declared = _Declared(undo)
        self._declared.append(declared)
        return declared

    def tokens(self, pattern: str, timeout_s: float = 1.0) -> list[str]:
        """See Bus.tokens."""
        with self._network.lock:
            return [token for token in self._network.tokens.values() if key_matches(pattern, token)]

    def watch_tokens(self, pattern: str, on: Callable[[str, bool], None]) -> Handle:
        """See Bus.watch_tokens."""
        handle = self._enter(self._network.watchers, (pattern, on))
        for token in self.tokens(pattern):
            on(token, True)
        return handle

    def answer(self, key: str, reply: Callable[[bytes], bytes]) -> Handle:
        """See Bus.answer."""
        return self._enter(self._network.answerers, (key, reply))

    def ask(
        self,
        key: str,
        payload: bytes = b"",
        timeout_s: float = 1.0,
        *,
        urgency: Urgency = Urgency.DATA,
    ) -> list[bytes]:
        """See Bus.ask."""
        with self._network.lock:
            answerers = list(self._network.answerers.values())
            replies = [reply for pattern, reply in answerers if key_matches(pattern, key)]
        return [reply(payload) for reply in replies]

    def close(self) -> None:
        """See Bus.close."""
        for declared in self._declared:
            declared.close()

    def __enter__(self) -> "MemoryBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _enter(self, table: dict[int, Any], row: tuple[str, Callable[..., object]]) -> Handle:
        number = next(self._network.ids)
        with self._network.lock:
            table[number] = row

        def undo() -> None:
            table.pop(number, None)

        declared = _Declared(undo)
        self._declared.append(declared)
        return declared
