"""What the log of a process looks like: a line with wall time, level and name, on stderr."""

import logging
import sys
import time


class LogFormat(logging.Formatter):
    """Log lines with wall time (UTC), level and node."""

    converter = staticmethod(time.gmtime)

    def __init__(self) -> None:
        line = "%(asctime)s.%(msecs)03d %(levelname)-7s %(name)s: %(message)s"
        super().__init__(line, datefmt="%Y-%m-%dT%H:%M:%S")


def log_to_stderr() -> None:
    """Write log lines to stderr, which the supervisor keeps in a file."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LogFormat())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
