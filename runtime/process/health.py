"""What the processes of a robot say of themselves: who is there, how each is, since when nothing was heard.

Fed by the bus: liveliness tokens say who is ready, the `diagnostics` topic says the rest once a second.
"""

import threading
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from runtime import messages
from runtime.bus.contract import Arrival, Bus
from runtime.messages import BadMessageError
from runtime.topics import topic

LEVELS = ("ok", "warn", "error", "stale")
LOOP_AGE_S = "loop_age_s"
"""Among the values of a heartbeat, which has a thread of its own: how long ago the node's loop turned."""
LEAVING = "leaving"
"""Among the values of the last word of a process that ends as it should."""
_MAX_NODES = 256  # remembered; a foreign publisher must not grow this without end
_GONE_S = 60.0  # whoever was not heard for so long gives way to a newcomer


@dataclass(frozen=True, slots=True)
class Vital:
    """The last word of one process."""

    name: str
    level: str
    text: str
    values: dict[str, str]
    stamp_ns: int
    heard_monotonic: float

    @property
    def age_s(self) -> float:
        """Since it was heard."""
        return time.monotonic() - self.heard_monotonic

    @property
    def has_left(self) -> bool:
        """Whether this was its last word, by its own account."""
        return LEAVING in self.values

    def number(self, key: str, default: float = 0.0) -> float:
        """Return one of the values as a number; `default` if it is none."""
        return number_of(self.values, key, default)


def number_of(values: Mapping[str, str], key: str, default: float = 0.0) -> float:
    """Return one of the values as a number; `default` if it is none."""
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return default


class Health:
    """Listens to one robot; may be read from any thread."""

    def __init__(self, bus: Bus, robot: str, domain: int = 0) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._tokens: dict[str, str] = {}
        self._vitals: dict[str, Vital] = {}
        self.undecodable = 0
        row = topic("diagnostics")
        bus.subscribe(messages.topic_key(f"{robot}/{row.name}", row.type, domain), self._hear)
        bus.watch_tokens(messages.node_token_pattern(robot, domain), self._change)

    def ready(self) -> set[str]:
        """Return the names of the nodes whose tokens are alive."""
        with self._lock:
            return set(self._tokens.values())

    def vitals(self) -> dict[str, Vital]:
        """Return the last word of every process heard."""
        with self._lock:
            return dict(self._vitals)

    def silent(self, after_s: float, among: Collection[str] | None = None) -> set[str]:
        """Return the names of those that spoke, and have not for `after_s`."""
        vitals = self.vitals()
        return {n for n, vital in vitals.items() if vital.age_s > after_s and (among is None or n in among)}

    def loop_ages_s(self) -> dict[str, float]:
        """Return how long ago the loop of each process had turned when it last spoke."""
        return {name: vital.number(LOOP_AGE_S) for name, vital in self.vitals().items()}

    def forget(self, name: str) -> None:
        """Drop what a process said before it was started again."""
        with self._lock:
            self._tokens = {token: node for token, node in self._tokens.items() if node != name}
            self._vitals.pop(name, None)

    def _change(self, token: str, alive: bool) -> None:
        name = messages.node_of_token(token)
        with self._lock:
            if not alive:
                self._tokens.pop(token, None)
            elif name is not None and len(self._tokens) < _MAX_NODES:
                self._tokens[token] = name

    def _hear(self, arrival: Arrival) -> None:
        try:
            array: Any = messages.decode(bytes(arrival.payload), topic("diagnostics").type)
        except BadMessageError:
            self.undecodable += 1
            return
        stamp_ns = messages.stamp_ns_of(array.header.stamp)
        heard = arrival.received_monotonic_ns / 1e9
        for status in array.status:
            robot, _, name = status.name.partition("/")
            if robot != self._robot or not name:
                continue
            values = {pair.key: pair.value for pair in status.values}
            vital = Vital(name, LEVELS[min(status.level, 3)], status.message, values, stamp_ns, heard)
            with self._lock:
                if name not in self._vitals and len(self._vitals) >= _MAX_NODES:
                    make_room(self._vitals)
                if name in self._vitals or len(self._vitals) < _MAX_NODES:
                    self._vitals[name] = vital


def make_room(vitals: dict[str, Vital]) -> None:
    """Forget the last word of whoever left, or was not heard for long, so that those who come are heard."""
    for name in [n for n, vital in vitals.items() if vital.has_left or vital.age_s > _GONE_S]:
        del vitals[name]
