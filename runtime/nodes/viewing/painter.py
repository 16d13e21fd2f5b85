"""Draws in a thread of its own, so that a viewer that is slow or gone delays nothing but its own picture."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

Draw = Callable[[Any], None]

WAITING_MAX = 64


class Painter:
    """Keeps the newest drawing of each kind until the canvas takes it; drops the others, and counts them."""

    def __init__(self, canvas: Any) -> None:
        self._canvas = canvas
        self._waiting: OrderedDict[str, Draw] = OrderedDict()
        self._change = threading.Condition()
        self._closing = False
        self._busy_since: float | None = None
        self.dropped = 0
        """Drawings that gave way to newer ones of their kind, or found too many others waiting."""
        self.drawn = 0
        self._thread = threading.Thread(target=self._work, name="painter", daemon=True)
        self._thread.start()

    def paint(self, kind: str, draw: Draw) -> None:
        """Draw as soon as the canvas is free; never waits."""
        with self._change:
            self.dropped += kind in self._waiting
            self._waiting[kind] = draw
            if len(self._waiting) > WAITING_MAX:
                self._waiting.popitem(last=False)
                self.dropped += 1
            self._change.notify()

    @property
    def stuck_s(self) -> float:
        """How long the present drawing has been under way."""
        since = self._busy_since
        return 0.0 if since is None else time.monotonic() - since

    @property
    def failed(self) -> bool:
        """Whether drawing ended with an error."""
        return not self._thread.is_alive() and not self._closing

    def close(self, timeout_s: float) -> bool:
        """Draw what waits and end; False if the canvas did not let go in time."""
        with self._change:
            self._closing = True
            self._change.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            with self._change:
                while not self._waiting and not self._closing:
                    self._change.wait()
                if not self._waiting:
                    return
                _, draw = self._waiting.popitem(last=False)
            self._busy_since = time.monotonic()
            draw(self._canvas)
            self._busy_since = None
            self.drawn += 1
