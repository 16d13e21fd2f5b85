"""Steering with the keys of a terminal: hold to drive, let go to stop.

A terminal tells of keys that go down and repeat, never of keys that go up.  A key counts as held as long as
its repetitions come; the first one comes late (a quarter to two thirds of a second), so that a key that has
just been pressed moves the robot a little, and one that is held moves it on.
"""

import contextlib
import os
import select
import termios
import tty
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.create.operators import Intent
from runtime.clock import Clock

_MILLISECOND = 1_000_000
FIRST_HOLD_NS = 200 * _MILLISECOND
"""How long a key counts that was pressed once; shorter than the base believes in an input."""
_GAP_MAX_NS = 180 * _MILLISECOND
_GAP_MIN_NS = 90 * _MILLISECOND
_GAPS = 3.0
_LONGEST = 16

_ESCAPES = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left",
    b"\x1bOA": "up", b"\x1bOB": "down", b"\x1bOC": "right", b"\x1bOD": "left",
}  # fmt: skip
_MOTIONS = {
    "up": (1.0, 0.0), "w": (1.0, 0.0), "down": (-1.0, 0.0), "s": (-1.0, 0.0), "left": (0.0, 1.0),
    "a": (0.0, 1.0), "right": (0.0, -1.0), "d": (0.0, -1.0), "q": (1.0, 0.5), "e": (1.0, -0.5),
}  # fmt: skip
_WISHES = {" ": Intent.STOP, "r": Intent.RESET, "\r": Intent.ARM, "\n": Intent.ARM}
_QUIT = ("\x03", "\x04")
_KEEP = "k"
_FASTER = {"+": 0.1, "=": 0.1, "-": -0.1}

HELP = (
    "Enter arms the robot   hold arrows or W A S D to drive, Q E for curves\n"
    "+ - speed   space: emergency stop, R resets it   K keeps the last minutes\n"
    "Ctrl-C ends"
)


@dataclass(frozen=True, slots=True)
class Wish:
    """What the operator wants now."""

    made_ns: int
    """When the operator said so."""
    speed: float = 0.0
    """-1 .. 1 of the highest speed; forward positive."""
    turn: float = 0.0
    """-1 .. 1 of the highest turn rate; left positive."""
    intent: Intent = Intent.DRIVE
    keep: bool = False
    """That the last minutes are kept; says nothing of how to drive."""
    leave: bool = False


class Keys:
    """From the bytes of a terminal to wishes; time is an argument."""

    def __init__(self) -> None:
        self.scale = 0.7
        """Share of the highest speed that a key asks for."""
        self._escape = b""
        self._key = ""
        self._last_ns = 0
        self._hold_ns = FIRST_HOLD_NS

    def feed(self, data: bytes, now_ns: int) -> list[Wish]:
        """Take what the terminal sent; return a wish for each key that means something."""
        wishes = []
        for key in self._split(data):
            if key in _QUIT:
                wishes.append(Wish(now_ns, leave=True))
            elif key == _KEEP:
                self._key = ""
                wishes.append(Wish(now_ns, keep=True))
            elif key in _WISHES:
                self._key = ""
                wishes.append(Wish(now_ns, intent=_WISHES[key]))
            elif key in _FASTER:
                self.scale = min(1.0, max(0.1, round(self.scale + _FASTER[key], 1)))
            elif key in _MOTIONS:
                self._press(key, now_ns)
                wishes.append(self._motion(key, now_ns))
            else:
                self._key = ""  # whatever it was, it was not the key that drives
        return wishes

    def rest(self, now_ns: int) -> Wish | None:
        """Return the wish to stand, made now, unless a key is held."""
        if self._key and now_ns - self._last_ns <= self._hold_ns:
            return None
        self._key = ""
        return Wish(now_ns)

    def _motion(self, key: str, now_ns: int) -> Wish:
        speed, turn = _MOTIONS[key]
        return Wish(now_ns, speed * self.scale, turn * self.scale)

    def _press(self, key: str, now_ns: int) -> None:
        gap_ns = now_ns - self._last_ns
        if key != self._key:
            self._hold_ns = FIRST_HOLD_NS
        elif gap_ns <= _GAP_MAX_NS:
            # Three repetitions missing in a row are a key that was let go.
            self._hold_ns = round(min(max(_GAPS * gap_ns, _GAP_MIN_NS), _GAP_MAX_NS))
        self._key, self._last_ns = key, now_ns

    def _split(self, data: bytes) -> list[str]:
        """Return the keys of these bytes; a sequence that is none of ours counts as one unknown key."""
        keys = []
        for byte in data:
            if not self._escape and byte != 0x1B:
                keys.append(chr(byte).lower())
                continue
            self._escape += bytes((byte,))
            if _ended(self._escape):
                keys.append(_ESCAPES.get(self._escape, "unknown"))
                self._escape = b""
        return keys


def _ended(sequence: bytes) -> bool:
    """Whether an escape sequence is complete: its letters must not be taken for keys."""
    if len(sequence) < 3:
        return len(sequence) == 2 and sequence[1:] not in (b"[", b"O")
    return 0x40 <= sequence[-1] <= 0x7E or len(sequence) > _LONGEST


class Keyboard:
    """Keys of the terminal at a descriptor."""

    def __init__(self, terminal: int, clock: Clock) -> None:
        self._terminal, self._clock = terminal, clock
        self.keys = Keys()

    @property
    def name(self) -> str:
        """What the operator steers with."""
        return f"keyboard, {self.keys.scale:.0%}"

    def poll(self, timeout_s: float) -> list[Wish]:
        """Return new wishes, waiting at most `timeout_s` for one; the wish to stand comes by itself."""
        ready, _, _ = select.select([self._terminal], [], [], timeout_s)
        wishes: list[Wish] = []
        if ready:
            try:
                data = os.read(self._terminal, 256)
            except OSError:
                data = b""  # the terminal was closed
            now_ns = self._clock.now_ns()
            wishes = self.keys.feed(data, now_ns) if data else [Wish(now_ns, leave=True)]
        if not wishes and (rest := self.keys.rest(self._clock.now_ns())) is not None:
            wishes = [rest]
        return wishes

    def close(self) -> None:
        """Nothing to give back; the terminal belongs to `raw`."""


@contextlib.contextmanager
def raw(terminal: int) -> Iterator[None]:
    """Have each key at once and unseen, Ctrl-C too; put the terminal back as it was."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        modes = termios.tcgetattr(terminal)
        modes[3] &= ~termios.ISIG
        termios.tcsetattr(terminal, termios.TCSANOW, modes)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
