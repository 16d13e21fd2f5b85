"""How far the clock of a robot is from ours: measured over the bus, shown, never written into a recording."""

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass

from runtime.bus.contract import Bus, Handle
from runtime.clock import Clock

_QUESTIONS = 20
AGAIN_S = 60.0  # two quartzes part by some milliseconds in that time at most
_SOON_S = 0.5  # while nobody answers; the robot may come later than we
_STAMP = struct.Struct("<q")


@dataclass(frozen=True, slots=True)
class Offset:
    """The robot's clock minus ours."""

    offset_ns: int
    round_trip_ns: int
    """Of the quickest answer; the offset is right to half of it."""

    def __str__(self) -> str:
        return f"{self.offset_ns / 1e6:+.3f} ms ± {self.round_trip_ns / 2e6:.3f} ms"


def question_key(robot: str, name: str) -> str:
    """Return where a robot answers questions of a name."""
    return f"hallway/{robot}/{name}"


def key(robot: str) -> str:
    """Return where a robot tells its time."""
    return question_key(robot, "clock")


def tell_time(bus: Bus, robot: str, clock: Clock) -> Handle:
    """Answer everybody who asks for the time of this run."""
    return bus.answer(key(robot), lambda asked: _STAMP.pack(clock.now_ns()))


def measure(ask: Callable[[], list[bytes]], clock: Clock) -> Offset | None:
    """Ask for the time some twenty times and believe the quickest answer.

    Args:
        ask: Puts the question; returns the answers.
        clock: Ours.

    Returns:
        None if nobody answers, or in another language.
    """
    best: Offset | None = None
    for _ in range(_QUESTIONS):
        asked_ns = clock.now_ns()
        answers = ask()
        answered_ns = clock.now_ns()
        if len(answers) != 1 or len(answers[0]) != _STAMP.size:
            return best  # silence is asked once, not twenty times
        (theirs_ns,) = _STAMP.unpack(answers[0])
        took_ns = answered_ns - asked_ns
        if best is None or took_ns < best.round_trip_ns:
            best = Offset(theirs_ns - (asked_ns + answered_ns) // 2, took_ns)
    return best


def measured(bus: Bus, robot: str, clock: Clock) -> Offset | None:
    """Return how far the clock of a robot on the bus is from ours."""
    return measure(lambda: bus.ask(key(robot), timeout_s=1.0), clock)


class Follower:
    """Sets a clock by the robot's, and keeps it so in a thread; what is shown has the robot's time."""

    def __init__(self, bus: Bus, robot: str, clock: Clock) -> None:
        self._bus, self._robot, self._clock = bus, robot, clock
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="robot's clock", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End, after the bus was closed: a thread within it at the end of the process would crash that."""
        self._closing.set()
        self._thread.join()

    def _work(self) -> None:
        while True:
            if (offset := measured(self._bus, self._robot, self._clock)) is not None:
                self._clock.offset_ns += offset.offset_ns
            if self._closing.wait(AGAIN_S if offset else _SOON_S):
                return
