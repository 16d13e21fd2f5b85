"""What a run is: left in its directory for this machine, and told to guests who ask.

A recorder that somebody else than the run started reads it here; what nobody tells is unknown, and never
made up.
"""

import dataclasses
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from runtime.bus.contract import Bus, Handle
from runtime.bus.offset import question_key

FILE = "run.json"
CONFIG_FILE = "config.yaml"
"""Beside it: the resolved configuration of every node."""
_QUESTION = "run"


@dataclass(frozen=True, slots=True)
class Identity:
    """What is needed to make a run again, and to understand its stamps."""

    seed: int | None = None
    domain: int = 0
    clock_offset_ns: int | None = None
    """Of the stamps, over CLOCK_MONOTONIC of the robot's machine."""
    version: str = ""
    """Of this package, on the robot."""
    host: str = ""
    config: str = ""
    """YAML of the resolved configuration; empty if unknown."""

    @classmethod
    def of_run(cls, seed: int, domain: int, clock_offset_ns: int) -> "Identity":
        """Return the identity of a run on this machine."""
        return cls(seed, domain, clock_offset_ns, installed("hallway"), os.uname().nodename)

    def leave(self, run_dir: Path) -> None:
        """Write it into the directory of the run."""
        (run_dir / FILE).write_bytes(self.encode())

    def encode(self) -> bytes:
        """Return it as JSON."""
        return json.dumps(dataclasses.asdict(self)).encode()

    @classmethod
    def decode(cls, data: bytes) -> "Identity":
        """Return what `encode` was given; unknown what was not understood."""
        try:
            values = json.loads(data)
        except ValueError:
            return cls()
        return cls(**_known(values)) if isinstance(values, dict) else cls()


def _known(values: dict[str, Any]) -> dict[str, Any]:
    """Keep the entries that are ours, and of the right kind."""
    fields = {field.name: field.default for field in dataclasses.fields(Identity)}
    return {
        name: value
        for name, value in values.items()
        if name in fields and type(value) is (str if isinstance(fields[name], str) else int)
    }


def left_in(run_dir: Path) -> Identity:
    """Return what a run has left in its directory; all unknown where there is nothing."""
    run, config = run_dir / FILE, run_dir / CONFIG_FILE
    identity = Identity.decode(run.read_bytes()) if run.is_file() else Identity()
    text = config.read_text(encoding="utf-8") if config.is_file() else ""
    return dataclasses.replace(identity, config=text)


def tell(bus: Bus, robot: str, identity: Identity) -> Handle:
    """Answer everybody who asks what this run is."""
    answer = identity.encode()
    return bus.answer(question_key(robot, _QUESTION), lambda asked: answer)


def told(ask: Callable[[str], list[bytes]], robot: str) -> Identity:
    """Ask a robot what it runs; all unknown if it does not answer.

    Args:
        ask: Puts a question at a key; returns the answers.
        robot: Its name.
    """
    answers = ask(question_key(robot, _QUESTION))
    return Identity.decode(answers[0]) if len(answers) == 1 else Identity()


def installed(package: str) -> str:
    """Return the version of a package that is installed here, or that it is not."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
