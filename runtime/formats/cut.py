"""Texts whose last line is cut off, as a power cut or a kill leaves them: everything before it is read.

Only the last line may be unreadable, and only where it has no end: a broken line in the middle, or a whole
one at the end, is no cut and stays an error. A line that is cut within its last number cannot be told from a
whole one whose end is missing; it is taken.
"""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from runtime.formats.errors import FormatError
from runtime.formats.text import MAX_LINE_BYTES, Lines, lines_of, open_bytes

_Read = TypeVar("_Read")


def up_to_the_cut(path: Path, read: Callable[[Lines], _Read]) -> tuple[_Read, tuple[str, ...]]:
    """Read a text, up to its last line where that is cut off.

    Args:
        path: Of the text, plain or compressed.
        read: Makes something of its lines; FormatError names the line that breaks a rule.

    Returns:
        What was made of them, and what is missing from it, in words.

    Raises:
        FormatError: Another line breaks a rule, or nothing is left before the cut.
    """
    try:
        return read(lines_of(path)), ()
    except FormatError as error:
        if error.line is None or error.line != _cut_line(path):
            raise
        try:
            left = read(lines_of(path, until=error.line))
        except FormatError:
            raise error from None  # where nothing is left, the cut is what is wrong
        return left, (f"{path}:{error.line}: the last line is cut off, and left out",)


def _cut_line(path: Path) -> int | None:
    """Return the number of the last line if that has no end; None if it has one."""
    number = 0
    try:
        with open_bytes(path) as file:
            for number, raw in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES), b""), start=1):
                if not raw.endswith(b"\n"):
                    # Of a file that had grown just before a power cut the disk may hold zeros, at any length.
                    rest = iter(lambda: file.read(MAX_LINE_BYTES), b"")
                    return None if any(part.strip(b"\0") for part in rest) else number
    except EOFError:  # compressed data that ends too early
        return number + 1
    except (OSError, zlib.error):  # damaged further on
        return None
    return None
