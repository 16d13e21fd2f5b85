"""A word to whoever waits: something that is usually quick takes long this time."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LONG_S = 3.0


@contextmanager
def told(say: Callable[[str], None], line: str) -> Iterator[None]:
    """Do what is inside, and say one line if it is not done after a while.

    Args:
        say: Takes the line, from another thread.
        line: What takes so long.
    """
    timer = threading.Timer(LONG_S, say, (line,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
