"""The parser of verbs and actions: takes whole names alone, and says what a mistyped one is near to."""

import argparse
import math
from collections.abc import Callable
from typing import Any, NoReturn

from runtime.guess import meant


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` that guesses nothing and suggests; the parsers made under it are of its kind."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{**kwargs, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        """End with the line of usage and what is wrong; and where to read of a word that is missing."""
        missing = message.startswith("the following arguments are required")
        super().error(f"{message}; `{self.prog} --help` lists what it may be" if missing else message)

    def refuse(self, unknown: list[str]) -> NoReturn:
        """End with the words that nobody took, and what the first option among them is near to."""
        option = next((word.partition("=")[0] for word in unknown if word.startswith("--")), "")
        known = self._options()
        hint = "; write it at the end of the line" if option in known else meant(option, known)
        self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")

    def _options(self) -> list[str]:
        """Return the options of this parser and of those under it."""
        options = []
        for action in self._actions:
            options += [option for option in action.option_strings if option.startswith("--")]
            if isinstance(action, argparse._SubParsersAction):
                options += [option for child in action.choices.values() for option in child._options()]
        return options

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse what is no choice, with the nearest one where there is one, else with all of them."""
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        said = meant(value, choices) or f"; choose from {', '.join(choices)}"
        raise argparse.ArgumentError(action, f"invalid choice: {value!r}{said}")


def number(*, least: float = -math.inf) -> Callable[[str], float]:
    """Return what reads a finite number that is not below `least`, as the `type` of an option."""

    def read(text: str) -> float:
        value: float = _read(float, "a number", text)
        if not (math.isfinite(value) and value >= least):
            rule = "be finite" if least == -math.inf else f"be at least {least:g} and finite"
            raise argparse.ArgumentTypeError(f"{text}, must {rule}")
        return value

    return read


def whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return what reads a whole number from `least` to `most`, as the `type` of an option."""

    def read(text: str) -> int:
        value: int = _read(int, "a whole number", text)
        if value < least or (most is not None and value > most):
            rule = f"at least {least}" if most is None else f"in [{least}, {most}]"
            raise argparse.ArgumentTypeError(f"{text}, must be {rule}")
        return value

    return read


def read_address(text: str) -> str:
    """Read HOST or HOST:PORT, or nothing, as the `type` of an option."""
    host, colon, port = text.rpartition(":")
    if colon and not (host and port.isdecimal() and 1 <= int(port) <= 65535):
        raise argparse.ArgumentTypeError(f"{text}, must be HOST or HOST:PORT, the port in [1, 65535]")
    return text


def _read(kind: type, what: str, text: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}, must be {what}") from None
