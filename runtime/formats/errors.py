"""What is said about a file that cannot be read: place, rule and value, in one line."""

from pathlib import Path

from runtime.errors import HallwayError


class FormatError(HallwayError, ValueError):
    """A file, or a line of it, that breaks the rules of its format.

    Args:
        path: The file.
        rule: What is wrong, with the value that was found.
        line: Line number counted from 1, or None when the whole file is meant.
    """

    exit_code = 2

    def __init__(self, path: Path, rule: str, line: int | None = None) -> None:
        self.line = line
        place = str(path) if line is None else f"{path}:{line}"
        super().__init__(f"{place}: {rule}")
