"""When the next message of a recording is due, through pauses and changes of rate."""

from collections.abc import Callable
from dataclasses import dataclass

CLOCK_NS = 50_000_000
"""Recorded time after which it is told again."""
_SLICE_S = 0.05


@dataclass(slots=True)
class Control:
    """What a person changes while a recording plays."""

    paused: bool = False
    steps: int = 0
    """Messages to play although paused."""
    rate: float = 1.0
    stopping: Callable[[], bool] = lambda: False


class Pace:
    """Waits for one message after the other."""

    def __init__(
        self,
        control: Control,
        publish_clock: Callable[[int], None],
        now_ns: Callable[[], int],
        sleep: Callable[[float], None],
    ) -> None:
        self._control, self._publish_clock, self._now_ns, self._sleep = control, publish_clock, now_ns, sleep
        self._anchor: tuple[int, int, float] | None = None  # present, recorded time there, rate
        self._recorded_ns = 0
        self._clock_ns: int | None = None
        self.late_ns = 0

    def wait_for(self, recorded_ns: int) -> bool:
        """Wait until a recorded moment is due; False when asked to stop."""
        c = self._control
        while not c.stopping():
            if c.paused:
                self._anchor = None
                if c.steps > 0:
                    c.steps -= 1
                    return self._reach(recorded_ns, late_ns=0)
                self._sleep(_SLICE_S)
                continue
            if c.rate == 0:
                return self._reach(recorded_ns, late_ns=0)
            now = self._now_ns()
            if self._anchor is None or self._anchor[2] != c.rate:
                self._anchor = (now, self._recorded_ns or recorded_ns, c.rate)
            began, recorded_began, rate = self._anchor
            left_ns = began + round((recorded_ns - recorded_began) / rate) - now
            if left_ns <= 0:
                return self._reach(recorded_ns, late_ns=-left_ns)
            self._recorded_ns = max(recorded_ns - round(left_ns * rate), self._recorded_ns)
            self._tick()
            self._sleep(min(left_ns / 1e9, _SLICE_S))
        return False

    def _reach(self, recorded_ns: int, late_ns: int) -> bool:
        self._recorded_ns, self.late_ns = max(self._recorded_ns, recorded_ns), late_ns
        self._tick()
        return True

    def _tick(self) -> None:
        if self._clock_ns is None or self._recorded_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = self._recorded_ns
            self._publish_clock(self._recorded_ns)
