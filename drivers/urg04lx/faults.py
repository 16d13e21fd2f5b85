"""What can happen to the bytes of a scan on their way: one function for each kind of damage.

They are given to `Emulator.spoil`; faults that are no damage to bytes (silence, unplugging, jumping clocks
and the like) are methods and arguments of the emulator.
"""

from collections.abc import Callable

from drivers.urg04lx.protocol import END, LF, encode_reply

Damage = Callable[[bytes], bytes]
"""A scan reply as the sensor means it, to what really leaves."""


def flip(position: int, bits: int = 0x01) -> Damage:
    """Change bits of one byte."""
    return lambda reply: reply[:position] + bytes((reply[position] ^ bits,)) + reply[position + 1 :]


def delete(position: int, count: int = 1) -> Damage:
    """Lose some bytes."""
    return lambda reply: reply[:position] + reply[position + count :]


def delete_line_end(line: int) -> Damage:
    """Lose the LF of one line."""

    def damage(reply: bytes) -> bytes:
        lines = reply.split(LF)
        return LF.join([*lines[:line], lines[line] + lines[line + 1], *lines[line + 2 :]])

    return damage


def delete_end(reply: bytes) -> bytes:
    """Lose the LF LF."""
    return reply.removesuffix(END)


def insert(position: int, garbage: bytes) -> Damage:
    """Gain some bytes."""
    return lambda reply: reply[:position] + garbage + reply[position:]


def truncate(position: int) -> Damage:
    """Stop in the middle; the next reply follows at once."""
    return lambda reply: reply[:position]


def status(code: bytes) -> Damage:
    """Send a status in place of the scan."""
    return lambda reply: encode_reply(reply[:15], code)


def duplicate(reply: bytes) -> bytes:
    """Send it twice."""
    return reply * 2


def skip(_reply: bytes) -> bytes:
    """Do not send it."""
    return b""
