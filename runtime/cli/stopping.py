"""A person asks a command to end: it is told, and ends in its own way."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def asked_to_stop(
    then: Callable[[list[int]], None] = lambda asked: None,
    numbers: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM),
) -> Iterator[list[int]]:
    """Collect the signals that ask for the end, and do nothing else about them.

    Args:
        then: Called with those so far after each of them, wherever the program stands; see `insisting`.
        numbers: Which signals.

    Yields:
        The signals that came so far.
    """
    asked: list[int] = []

    def take(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        then(asked)

    before = {number: signal.signal(number, take) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def insisting(times: int) -> Callable[[list[int]], None]:
    """Return what ends a command at once when it was asked for the so many-th time."""

    def end(asked: list[int]) -> None:
        if len(asked) >= times:
            raise KeyboardInterrupt

    return end
