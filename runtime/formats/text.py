"""Lines and numbers of text logs, plain or compressed, with the place of whatever cannot be read."""

import bz2
import gzip
import io
import math
import zlib
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import IO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import (
    LaserGeometry,
    LaserLog,
    clean_ranges,
    reading_notices,
    robust_period_s,
    stamp_notices,
)

MAX_LINE_BYTES = 1 << 20
_MAX_STAMP_NS = 2**62

Lines: TypeAlias = Iterable[tuple[int, str]]
"""Number, from 1, and text of each line that is not blank."""


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file for reading, through gzip or bzip2 when its first bytes say so, whatever its name says."""
    with path.open("rb") as file:
        magic = file.read(3)
    if magic[:2] == b"\x1f\x8b":
        return io.BufferedReader(gzip.open(path, "rb"))
    if magic == b"BZh":
        return bz2.open(path, "rb")
    return path.open("rb")


def lines_of(path: Path, until: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text; FormatError where it is cut or no text.

    Args:
        path: Of the text, plain or compressed.
        until: Number of the first line that is left out, with all after it.
    """
    number = 0
    try:
        with open_bytes(path) as file:
            # A limit, so that a huge file without line ends is refused and not swallowed.
            for number, raw in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES), b""), start=1):
                if number == until:
                    return
                if len(raw) >= MAX_LINE_BYTES:
                    raise FormatError(path, f"a line of more than {MAX_LINE_BYTES} bytes", number)
                if b"\x00" in raw:
                    raise FormatError(path, "not text: binary bytes in it", number)
                line = raw.decode("ascii", errors="strict").strip()
                if line:
                    yield number, line
    except UnicodeDecodeError as error:
        raise FormatError(path, f"not text: byte {error.object[error.start]:#04x} found", number) from error
    except EOFError as error:
        if number + 1 != until:
            why = f"compressed data is cut off after line {number}"
            raise FormatError(path, why, number + 1) from error
    except (OSError, zlib.error) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # the disk, not the format
        raise FormatError(path, f"compressed data is damaged after line {number} ({error})") from error


def stamp_ns(path: Path, line: int, text: str, unit_exponent: int = 9) -> int:
    """Read a stamp by its digits, without the rounding of a float; `unit_exponent` 9 for s, 3 for us."""
    try:
        value = int(Decimal(text).scaleb(unit_exponent))
    except (InvalidOperation, ValueError, OverflowError):
        raise FormatError(path, f"stamp = {text!r}, must be a number", line) from None
    if not 0 <= value < _MAX_STAMP_NS:
        raise FormatError(path, f"stamp = {text}, must be at least 0 and fit 64 bits of ns", line)
    return value


def numbers(path: Path, line: int, tokens: list[str], what: str) -> list[float]:
    """Read many numbers; the error names which one is none."""
    try:
        return list(map(float, tokens))
    except ValueError:
        pass
    for index, token in enumerate(tokens):
        try:
            float(token)
        except ValueError:
            raise FormatError(path, f"{what} {index} = {token!r}, must be a number", line) from None
    raise AssertionError("one token was no number")


def whole_number(path: Path, line: int, text: str, what: str) -> int:
    """Read a count of at least 1."""
    if not text.isdigit() or int(text) < 1:
        raise FormatError(path, f"{what} = {text!r}, must be a whole number of at least 1", line)
    return int(text)


SICK_S_PER_RAD = 1.0 / 75.0 / math.tau
"""The mirror of a SICK LMS, the scanner of a half circle of its time, turns 75 times a second; the logs do
not say. At half a degree every second ray is of the turn before, which delays all stretches alike."""


class ScanTable:
    """Collects the scans of a text log and makes the log of them."""

    def __init__(self, path: Path, kind: str, zero_is_a_code: bool = False) -> None:
        self._path, self._kind, self._zero_is_a_code = path, kind, zero_is_a_code
        self._stamps: list[int] = []
        self._rows: list[NDArray[np.float32]] = []
        self._first_line = 0
        self._odd, self._first_odd = 0, ""

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, line: int, stamp: int, ranges_m: list[float]) -> None:
        """Take one scan; a beam count other than the first scan's is an error."""
        row = np.array(ranges_m, dtype=np.float64)
        if self._rows and len(row) != len(self._rows[0]):
            raise FormatError(
                self._path,
                f"scan of {len(row)} beams, must be {len(self._rows[0])} as in line {self._first_line}",
                line,
            )
        if not self._rows:
            self._first_line = line
        odd = np.flatnonzero(~((row >= 0.0) if self._zero_is_a_code else (row > 0.0)))
        if len(odd) and not self._odd:
            self._first_odd = f"line {line}, beam {odd[0]}: {row[odd[0]]:g}"
        self._odd += len(odd)
        self._stamps.append(stamp)
        self._rows.append(row.astype(np.float32))

    def finish(
        self,
        *,
        angle_min_rad: float,
        angle_increment_rad: float,
        range_max_m: float,
        time_increment_s: float = 0.0,
        range_min_m: float = 0.02,
    ) -> LaserLog:
        """Return the log; FormatError if it holds no scan.

        Args:
            angle_min_rad: Bearing of the first ray.
            angle_increment_rad: From ray to ray.
            range_max_m: Readings of so much mean that nothing came back.
            time_increment_s: From ray to ray.
            range_min_m: Least reading.
        """
        if not self._rows:
            raise FormatError(self._path, f"0 scans found, a {self._kind} log must hold at least 1")
        stamps_ns = np.array(self._stamps, dtype=np.int64)
        ranges_m = clean_ranges(np.stack(self._rows), range_min_m, range_max_m)
        ranges_m.setflags(write=False)
        geometry = LaserGeometry(
            count=ranges_m.shape[1],
            angle_min_rad=angle_min_rad,
            angle_increment_rad=angle_increment_rad,
            time_increment_s=time_increment_s,
            period_s=robust_period_s(stamps_ns),
            range_min_m=range_min_m,
            range_max_m=range_max_m,
        )
        return LaserLog(
            path=self._path,
            kind=self._kind,
            topic=None,
            geometry=geometry,
            stamps_ns=stamps_ns,
            notices=stamp_notices(self._path, stamps_ns)
            + reading_notices(self._path, self._odd, self._first_odd),
            read=lambda: iter(ranges_m),
        )
