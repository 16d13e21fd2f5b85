"""The bus over zenoh: the only import of it.

What experiments taught (each was a stall, a loss or a process that never ended): callbacks run in zenoh's
own thread and only fill a mailbox; congestion drops, it never blocks a publisher; shared memory is off; a
session is closed explicitly; a latched topic is an advanced publisher with a cache of one.
"""

import json
import re
import time
from collections.abc import Callable
from typing import Any, TypeVar

import zenoh
from zenoh import ext, handlers

from runtime.bus.contract import Arrival, Handle, Publisher
from runtime.errors import HallwayError
from runtime.messages import Attachment
from runtime.topics import Urgency

_PRIORITIES = {
    Urgency.COMMAND: zenoh.Priority.REAL_TIME,
    Urgency.WHERE: zenoh.Priority.DATA_HIGH,
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.DETAIL: zenoh.Priority.DATA_LOW,
    Urgency.BULK: zenoh.Priority.BACKGROUND,
}


_PLACE = re.compile(r" at \S+\.rs:\d+\.?")
"""Where in its own source zenoh found an error: of no use to who reads it."""


class BusError(HallwayError):
    """The bus cannot be opened or has gone."""


class _Declared:
    """Anything that zenoh can undeclare; closing twice, or after the session, is harmless."""

    def __init__(self, entity: Any) -> None:
        self._entity = entity

    def close(self) -> None:
        """See Handle.close."""
        entity, self._entity = self._entity, None
        if entity is not None:
            try:
                entity.undeclare()
            except zenoh.ZError:
                return  # the session went first, and took it along


class _Publisher(_Declared):
    def put(self, payload: bytes, attachment: bytes) -> None:
        """See Publisher.put."""
        if self._entity is not None:
            self._entity.put(payload, attachment=attachment)

    @property
    def matching(self) -> bool:
        """See Publisher.matching."""
        # The status object itself is always true; an advanced publisher has none.
        if self._entity is None:
            return False
        status = getattr(self._entity, "matching_status", None)
        return status is None or bool(status.matching)


_D = TypeVar("_D", bound=_Declared)


class ZenohBus:
    """See `runtime.bus.contract.Bus`.

    Args:
        config: One of the sessions of `runtime.bus.links`.

    Raises:
        BusError: The session cannot be opened: nobody listens, a socket is taken, a key is missing.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        except zenoh.ZError as error:
            where = ", ".join(config.get("connect", {}).get("endpoints", [])) or "the bus"
            why = _PLACE.sub("", str(error).splitlines()[0])
            raise BusError(f"{where}: cannot be reached: {why}") from error
        self._zid = str(self._session.zid())
        # A token that nobody holds is collected, and with it its process seems to be gone.
        self._declared: list[_Declared] = []

    @property
    def zid(self) -> str:
        """See Bus.zid."""
        return self._zid

    def publisher(self, key: str, *, latched: bool = False, urgency: Urgency = Urgency.DATA) -> Publisher:
        """See Bus.publisher."""
        manners: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "priority": _PRIORITIES[urgency],
            "express": urgency is Urgency.COMMAND,
        }
        if not latched:
            return self._kept(_Publisher(self._session.declare_publisher(key, **manners)))
        return self._kept(
            _Publisher(
                ext.declare_advanced_publisher(
                    self._session,
                    key,
                    **manners,
                    cache=ext.CacheConfig(max_samples=1),
                    publisher_detection=True,
                    sample_miss_detection=ext.MissDetectionConfig(heartbeat=1.0, sporadic_heartbeat=None),
                )
            )
        )

    def subscribe(self, key: str, on: Callable[[Arrival], None], *, latched: bool = False) -> Handle:
        """See Bus.subscribe."""

        def arrive(sample: zenoh.Sample) -> None:
            now_ns = time.monotonic_ns()
            if sample.kind == zenoh.SampleKind.PUT:
                attached = sample.attachment
                attachment = Attachment.decode(attached.to_bytes() if attached is not None else None)
                on(Arrival(str(sample.key_expr), sample.payload, attachment, now_ns))

        direct: Any = handlers.Callback(arrive, indirect=False)
        if not latched:
            return self._kept(_Declared(self._session.declare_subscriber(key, direct)))
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        return self._kept(
            _Declared(ext.declare_advanced_subscriber(self._session, key, direct, history=history))
        )

    def token(self, key: str) -> Handle:
        """See Bus.token."""
        return self._kept(_Declared(self._session.liveliness().declare_token(key)))

    def tokens(self, pattern: str, timeout_s: float = 1.0) -> list[str]:
        """See Bus.tokens."""
        replies: Any = self._session.liveliness().get(pattern, timeout=timeout_s)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]

    def watch_tokens(self, pattern: str, on: Callable[[str, bool], None]) -> Handle:
        """See Bus.watch_tokens."""

        def change(sample: zenoh.Sample) -> None:
            on(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        direct: Any = handlers.Callback(change, indirect=False)
        return self._kept(
            _Declared(self._session.liveliness().declare_subscriber(pattern, direct, history=True))
        )

    def answer(self, key: str, reply: Callable[[bytes], bytes]) -> Handle:
        """See Bus.answer."""

        def respond(query: zenoh.Query) -> None:
            # A query that is not dropped keeps its asker waiting for the whole time-out.
            with query:
                asked = query.payload.to_bytes() if query.payload is not None else b""
                query.reply(key, reply(asked))

        direct: Any = handlers.Callback(respond, indirect=False)
        return self._kept(_Declared(self._session.declare_queryable(key, direct)))

    def ask(
        self,
        key: str,
        payload: bytes = b"",
        timeout_s: float = 1.0,
        *,
        urgency: Urgency = Urgency.DATA,
    ) -> list[bytes]:
        """See Bus.ask."""
        try:
            # The answer has the manners of the question: it never waits for a slow asker, who would hold
            # up everybody else's messages.
            replies: Any = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_PRIORITIES[urgency],
            )
        except zenoh.ZError:
            return []  # the session is closed: nobody answers
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok]

    def _kept(self, declared: _D) -> _D:
        self._declared.append(declared)
        return declared

    def links(self) -> list[str]:
        """Return where the links of this session lead; for those who look after the wires."""
        return [str(link.dst) for link in self._session.info.links()]

    def close(self) -> None:
        """See Bus.close."""
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> "ZenohBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
