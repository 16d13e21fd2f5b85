"""What a command has written: the folder, and the files in it, in lines that no terminal cuts in a word."""

import textwrap
from collections.abc import Iterable

_WIDTH = 80


def print_written(folder: str, names: Iterable[str]) -> None:
    """Print a folder and the names of files in it."""
    print(f"{folder}/:")
    print(
        textwrap.fill(
            ", ".join(names),
            _WIDTH,
            initial_indent="  ",
            subsequent_indent="  ",
            break_on_hyphens=False,
            break_long_words=False,
        )
    )
