"""Keys that steer a recording while it plays."""

import os
import select
import sys
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runtime.recordings.pace import Control

HELP = "space pause or go, s one message, + faster, - slower, q end"


class Keys:
    """Single keys from the terminal, where there is one; waiting for a key is the pause between messages."""

    def __init__(self) -> None:
        self._terminal = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._before: Any = None

    def __enter__(self) -> "Keys":
        if self._terminal is not None:
            import termios
            import tty

            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal is not None:
            import termios

            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    def poll(self, control: "Control", seconds: float) -> bool:
        """Wait so long at most, obey the keys that came; False for the key that ends."""
        if self._terminal is None:
            time.sleep(seconds)
            return True
        if not select.select([self._terminal], [], [], seconds)[0]:
            return True
        return all(obey(key, control) for key in os.read(self._terminal, 64).decode(errors="ignore"))


def obey(key: str, control: "Control") -> bool:
    """Do what a key means; False for the key that ends."""
    if key == " ":
        control.paused = not control.paused
    elif key == "s":
        control.paused = True
        control.steps += 1
    elif key in "+=":
        control.rate = min(control.rate * 2, 100.0)
    elif key == "-":
        control.rate = max(control.rate / 2, 0.01) if control.rate else 0.0
    return key != "q"
