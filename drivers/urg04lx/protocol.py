"""SCIP 2.0 as the URG-04LX speaks it: requests and replies, written and read by both ends of the line.

Law: no I/O, no clock.  A reply is an exact echo of the request, a two-character status, lines that each end
in their own sum, and an empty line; so every reply ends LF LF, and LF LF occurs nowhere else.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

LF = b"\n"
END = b"\n\n"
LINE_CHARS = 64
"""Data characters in a full line, before its sum."""
STAMP_MODULUS_MS = 1 << 24
ERROR_LIMIT = 20
"""Values below it are error codes, not distances."""
OUT_OF_RANGE_CODE = 19
MS_LIMIT_MM = 4095
"""The largest two-character value: "this, or more"."""

SWITCH_TO_SCIP2 = b"SCIP2.0"
ECHO = re.compile(
    rb"(?:VV|PP|II|BM|QT|RS|RT|TM\d|SS\d{6}|CR\d\d|HS\d|G[DS]\d{10}|M[DS]\d{13}|SCIP2\.0|V)"
    rb"(?:;[A-Za-z0-9 ._+@]{0,16})?"
)
"""What the first line of a reply to one of our requests looks like."""


def checksum(text: bytes) -> int:
    """Return the sum character of a line (as a byte value, 0x30..0x6F), over every byte of `text`."""
    return (sum(text) & 0x3F) + 0x30


def with_sum(text: bytes) -> bytes:
    """Return the line with its sum behind it."""
    return text + bytes((checksum(text),))


def encode_value(value: int, width: int) -> bytes:
    """Write a number in `width` characters of six bits, most significant first.

    Raises:
        ValueError: It does not fit.
    """
    if not 0 <= value < 1 << 6 * width:
        raise ValueError(f"value = {value}, must be in 0 .. {(1 << 6 * width) - 1} for {width} characters")
    return bytes((value >> shift & 0x3F) + 0x30 for shift in range(6 * (width - 1), -1, -6))


def encode_values(values: ArrayLike, width: int) -> bytes:
    """Write many numbers, each in `width` characters; see `encode_value`."""
    numbers = np.asarray(values, dtype=np.int64)
    if numbers.size and not (numbers.min() >= 0 and numbers.max() < 1 << 6 * width):
        raise ValueError(f"values {numbers.min()} .. {numbers.max()} do not fit {width} characters")
    shifts = np.arange(6 * (width - 1), -1, -6)
    return ((numbers[:, None] >> shifts & 0x3F) + 0x30).astype(np.uint8).tobytes()


def decode_values(text: bytes, width: int) -> NDArray[np.int32]:
    """Read numbers of `width` characters each; `text` must hold whole numbers of characters 0x30..0x6F."""
    digits = np.frombuffer(text, dtype=np.uint8).astype(np.int32).reshape(-1, width) - 0x30
    return digits @ (1 << np.arange(6 * (width - 1), -1, -6, dtype=np.int32))


def decode_value(text: bytes) -> int:
    """Read one number of as many characters as there are."""
    value = 0
    for character in text:
        value = value << 6 | (character - 0x30)
    return value


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamRequest:
    """What MD and MS ask for: which steps, how many together, how often."""

    first_step: int = 44
    last_step: int = 725
    cluster: int = 1
    """Steps that share one value, the smallest distance among them."""
    skip: int = 0
    """Scans left out between two reported ones."""
    scans: int = 0
    """How many scans, 0 = until stopped."""
    wide: bool = True
    """MD, three characters a value; otherwise MS, two characters and 4095 mm at most."""

    def __post_init__(self) -> None:
        if not 0 <= self.first_step <= self.last_step <= 768:
            raise ValueError(
                f"steps = {self.first_step} .. {self.last_step}, must be 0 <= first <= last <= 768"
            )
        if not 1 <= self.cluster <= 99 or self.cluster > self.last_step - self.first_step + 1:
            raise ValueError(f"cluster = {self.cluster}, must be 1 .. 99 and at most the number of steps")
        if not 0 <= self.skip <= 9:
            raise ValueError(f"skip = {self.skip}, must be 0 .. 9")
        if not 0 <= self.scans <= 99:
            raise ValueError(f"scans = {self.scans}, must be 0 .. 99")

    @property
    def width(self) -> int:
        """Characters of one value."""
        return 3 if self.wide else 2

    @property
    def count(self) -> int:
        """Values in one scan; a last group that is not full is left out."""
        return (self.last_step - self.first_step + 1) // self.cluster

    @property
    def steps(self) -> bytes:
        """The 13 characters that every reply to this request begins with."""
        name = b"MD" if self.wide else b"MS"
        return name + b"%04d%04d%02d%d" % (self.first_step, self.last_step, self.cluster, self.skip)

    def encode(self) -> bytes:
        """Return the request line without its LF."""
        return self.echo(self.scans)

    def echo(self, remaining: int) -> bytes:
        """Return the first line of a reply when `remaining` scans are still to come."""
        return self.steps + b"%02d" % remaining

    @classmethod
    def parse(cls, line: bytes) -> "StreamRequest":
        """Read a request line.

        Raises:
            ValueError: It is not one.
        """
        if not re.fullmatch(rb"M[DS]\d{13}", line):
            raise ValueError(f"request {line!r}, must be MD or MS and 13 digits")
        first, last, cluster = int(line[2:6]), int(line[6:10]), int(line[10:12])
        return cls(
            first_step=first, last_step=last, cluster=max(1, cluster), skip=int(line[12:13]),
            scans=int(line[13:15]), wide=line[:2] == b"MD",
        )  # fmt: skip


def data_lines(text: bytes) -> bytes:
    """Cut data into lines of 64 characters, each with its own sum and LF."""
    return b"".join(with_sum(text[at : at + LINE_CHARS]) + LF for at in range(0, len(text), LINE_CHARS))


def encode_reply(echo: bytes, status: bytes, lines: Iterable[bytes] = ()) -> bytes:
    """Return a whole reply; `status` without its sum, `lines` with theirs."""
    return LF.join((echo, with_sum(status), *lines)) + END


def encode_scan(echo: bytes, status: bytes, stamp_ms: int, values: ArrayLike, width: int) -> bytes:
    """Return a whole scan reply (MD, MS with status 99; GD, GS with 00).

    Args:
        echo: First line.
        status: Two characters.
        stamp_ms: Sensor time of step 0; only its lowest 24 bits are sent.
        values: (N,) mm or error codes; in two characters they end at 4095.
        width: 3 or 2.
    """
    numbers = np.asarray(values, dtype=np.int64)
    if width == 2:
        numbers = np.minimum(numbers, MS_LIMIT_MM)
    stamp = with_sum(encode_value(stamp_ms % STAMP_MODULUS_MS, 4))
    head = LF.join((echo, with_sum(status), stamp)) + LF
    return head + data_lines(encode_values(numbers, width)) + LF


def encode_information(tag: str, value: str) -> bytes:
    """Return one line of VV, PP or II; the `;` before the sum is not part of it."""
    text = f"{tag}:{value}".encode("ascii")
    return text + b";" + bytes((checksum(text),))


def status_of(line: bytes) -> bytes | None:
    """Return the status in a reply's second line: two characters, or one of SCIP 1.1; None if damaged."""
    if len(line) == 3 and checksum(line[:2]) == line[2]:
        return line[:2]
    # SCIP 1.1 has no sums. The switch itself is answered in either fashion.
    return line if len(line) == 1 and line.isalnum() else None


def decode_single(lines: tuple[bytes, ...], width: int) -> tuple[int, NDArray[np.int32]] | None:
    """Read the lines of a GD or GS reply behind its status; None if any is damaged.

    Returns:
        Sensor time of step 0 in ms, and the values.
    """
    if any(not line or checksum(line[:-1]) != line[-1] for line in lines):
        return None
    stamp, *data = [line[:-1] for line in lines] or [b""]
    text = b"".join(data)
    if len(stamp) != 4 or len(text) % width or any(len(part) != LINE_CHARS for part in data[:-1]):
        return None
    if any(not 0x30 <= character <= 0x6F for character in stamp + text):
        return None
    return decode_value(stamp), decode_values(text, width)
