"""Errors that a user can act on: each is one line of place, rule and value, and knows its exit code.

`HallwayError` 1, failed; `ConfigError` 2, a graph, a configuration or an argument is wrong; `DataLostError`
4, scans or messages are missing from the result; `PositionLostError` 5, the matcher could not say where the
laser is.
"""


class HallwayError(Exception):
    """Anything expected; the command line prints it as one line and leaves with `exit_code`."""

    exit_code = 1


class ConfigError(HallwayError, ValueError):
    """A wrong value that a person wrote; the text names place, rule and value."""

    exit_code = 2


class DataLostError(HallwayError):
    """The result is there, and something that belongs into it is not."""

    exit_code = 4


class PositionLostError(HallwayError):
    """The track broke and was not found again."""

    exit_code = 5


def exit_code_of(error: BaseException) -> int | None:
    """Return the exit code of an expected error; None for a bug, which keeps its traceback.

    Any class with an integer `exit_code` counts, and a device error of the drivers, which know nothing of us.
    """
    code = getattr(error, "exit_code", None)
    if isinstance(code, int):
        return code
    if any(cls.__name__ == "DeviceError" for cls in type(error).__mro__):
        return 3
    return None
