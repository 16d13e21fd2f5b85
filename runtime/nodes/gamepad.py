"""Steering with a gamepad through the joystick interface of Linux: a button held down, and a stick.

The button is the dead man's: without it the stick means nothing.  The kernel tells of changes only, so a held
button counts as long as the device is there.
"""

import os
import select
import struct
from pathlib import Path

from drivers.create.operators import Intent
from runtime.clock import Clock
from runtime.nodes.keyboard import Wish

_EVENT = struct.Struct("<IhBB")  # time in ms, value, kind, number
_BUTTON, _AXIS, _INITIAL = 0x01, 0x02, 0x80
_FULL = 32767
DEAD_ZONE = 0.12
SPEED_AXIS, TURN_AXIS = 1, 0
_DEAD_MAN = (4, 5)  # the shoulder buttons
_WISHES = {0: Intent.ARM, 7: Intent.ARM, 1: Intent.STOP, 3: Intent.RESET}  # A and start, B, Y

_KEEP = 2  # X

HELP = (
    "hold a shoulder button and use the left stick; A arms, B is the emergency stop,\n"
    "Y resets it, X keeps the last minutes"
)


class Pad:
    """From joystick events to wishes; time is an argument."""

    def __init__(self) -> None:
        self._axes: dict[int, float] = {}
        self._held: set[int] = set()
        self._rest = b""

    def feed(self, data: bytes, now_ns: int) -> list[Wish]:
        """Take what the device sent; return the wishes of buttons that were pressed."""
        self._rest += data
        wishes = []
        while len(self._rest) >= _EVENT.size:
            _, value, kind, number = _EVENT.unpack_from(self._rest)
            self._rest = self._rest[_EVENT.size :]
            if kind & ~_INITIAL == _AXIS:
                self._axes[number] = max(-1.0, value / _FULL)
            elif kind & ~_INITIAL == _BUTTON:
                (self._held.add if value else self._held.discard)(number)
                # What was pressed before we listened is no wish.
                pressed = value and not kind & _INITIAL
                if pressed and number in _WISHES:
                    wishes.append(Wish(now_ns, intent=_WISHES[number]))
                elif pressed and number == _KEEP:
                    wishes.append(Wish(now_ns, keep=True))
        return wishes

    def motion(self, now_ns: int) -> Wish:
        """Return where the stick is, or the wish to stand without the dead man's button."""
        if self._held.isdisjoint(_DEAD_MAN):
            return Wish(now_ns)
        return Wish(now_ns, -self._axis(SPEED_AXIS), -self._axis(TURN_AXIS))

    def _axis(self, number: int) -> float:
        value = self._axes.get(number, 0.0)
        if abs(value) < DEAD_ZONE:
            return 0.0
        return (abs(value) - DEAD_ZONE) / (1.0 - DEAD_ZONE) * (1.0 if value > 0.0 else -1.0)


class Gamepad:
    """The joystick device at a path."""

    def __init__(self, path: Path, clock: Clock) -> None:
        self.name = f"gamepad {path.name}"
        self._clock = clock
        self._device = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        self.pad = Pad()

    def poll(self, timeout_s: float) -> list[Wish]:
        """Return new wishes, after `timeout_s` at the latest where the stick is.

        A device that is gone wishes to stand, and to leave.
        """
        ready, _, _ = select.select([self._device], [], [], timeout_s)
        now_ns = self._clock.now_ns()
        if not ready:
            return [self.pad.motion(now_ns)]
        try:
            data = os.read(self._device, 64 * _EVENT.size)
        except OSError:
            data = b""
        if not data:
            return [Wish(now_ns, leave=True)]
        return self.pad.feed(data, now_ns) or [self.pad.motion(now_ns)]

    def close(self) -> None:
        """Give the device back."""
        os.close(self._device)


def attached(directory: Path = Path("/dev/input")) -> list[Path]:
    """Return the joystick devices of this machine."""
    return sorted(directory.glob("js*"))
