"""Lines that a terminal shows without cutting a word; a file or another program gets them whole."""

import shutil
import sys
import textwrap
from collections.abc import Iterable
from typing import TextIO


def fitted(line: str, indent: int = 0, stream: TextIO | None = None) -> str:
    """Return a line as it is, or where it goes to a narrower terminal, broken between words.

    Args:
        line: Words longer than the terminal, such as paths, stay whole.
        indent: Columns by which what follows the first break is moved to the right.
        stream: Where it goes; standard output if None.
    """
    if not (sys.stdout if stream is None else stream).isatty():
        return line
    columns = shutil.get_terminal_size().columns
    return textwrap.fill(
        line,
        columns,
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
        break_long_words=False,
    )


def print_written(folder: str, names: Iterable[str]) -> None:
    """Print a folder, and the names of files in it."""
    print(f"{folder}/:")
    print(fitted("  " + ", ".join(names), 2))
