"""Time of a run: steady, comparable between the processes of one machine, and usable as a ROS stamp.

CLOCK_MONOTONIC is one clock for all processes of a machine; one offset, fixed once per run by the
supervisor and handed to every process, turns it into wall time. A step of the wall clock in mid-run moves
no stamp.
"""

import os
import time

OFFSET_VARIABLE = "HALLWAY_CLOCK_OFFSET_NS"
"""Environment variable by which a process hands the offset of its run to its children."""


class Clock:
    """Nanoseconds since 1970, by CLOCK_MONOTONIC plus the run's offset."""

    __slots__ = ("offset_ns",)

    def __init__(self, offset_ns: int | None = None) -> None:
        self.offset_ns = time.time_ns() - time.monotonic_ns() if offset_ns is None else offset_ns

    @classmethod
    def from_environment(cls) -> "Clock":
        """Return the clock of the run this process belongs to, or start a new one."""
        text = os.environ.get(OFFSET_VARIABLE)
        return cls(int(text) if text else None)

    def now_ns(self) -> int:
        """Return the present stamp; never goes backwards."""
        return time.monotonic_ns() + self.offset_ns

    def from_monotonic_ns(self, monotonic_ns: int) -> int:
        """Return the stamp of an instant read from `time.monotonic_ns()`."""
        return monotonic_ns + self.offset_ns

    def wall_step_ns(self) -> int:
        """Return how far the wall clock has moved away from this run's clock since it was fixed."""
        return time.time_ns() - self.now_ns()


class ManualClock(Clock):
    """A clock for tests: it moves when told to."""

    __slots__ = ("_now_ns",)

    def __init__(self, now_ns: int = 0) -> None:
        super().__init__(0)
        self._now_ns = now_ns

    def now_ns(self) -> int:
        """See Clock.now_ns."""
        return self._now_ns

    def advance(self, step_ns: int) -> None:
        """Move the present forward by `step_ns` >= 0."""
        if step_ns < 0:
            raise ValueError(f"step_ns = {step_ns}, must be >= 0")
        self._now_ns += step_ns
