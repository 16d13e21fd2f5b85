"""What a process must not forget when it is killed: written in one step, read by the one that follows it.

A checkpoint lives in the directory of the run, which only its owner may enter and which every run begins
empty: it never reaches another run, another version or another user. A damaged one counts as none, and
reading takes it away: a state that kills its process at the first step is not met twice.
"""

import os
import pickle
from pathlib import Path
from typing import Any


class Checkpoint:
    """The last state of one process.

    Args:
        path: Of the file; relative where there is no run, and then nothing is kept.
        every_ns: Time between two writings, by the stamps given to `due`.
        identity: What must be equal for a state to be taken back, such as the configuration.
    """

    def __init__(self, path: Path, every_ns: int, identity: Any) -> None:
        self._path, self._every_ns, self._identity = path, every_ns, identity
        self._written_ns: int | None = None

    def due(self, stamp_ns: int) -> bool:
        """Whether it is time to write again; a stamp that went backwards counts as time."""
        if not self._path.is_absolute():
            return False
        last = self._written_ns
        return last is None or not 0 <= stamp_ns - last < self._every_ns

    def write(self, stamp_ns: int, state: Any) -> bool:
        """Replace the state in one step; False where the disk refuses, and then the last one stays."""
        self._written_ns = stamp_ns
        fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            with open(fresh, "wb") as file:
                pickle.dump((self._identity, state), file, protocol=pickle.HIGHEST_PROTOCOL)
            fresh.replace(self._path)
        except OSError:
            fresh.unlink(missing_ok=True)
            return False
        return True

    def read(self) -> Any | None:
        """Take the last state; None if there is none, or it belongs to another configuration."""
        if not self._path.is_absolute() or not self._path.is_file():
            return None
        try:
            with self._path.open("rb") as file:
                identity, state = pickle.load(file)
        except Exception:  # noqa: BLE001 - whatever a cut file provokes, it is no state
            return None
        finally:
            self._path.unlink(missing_ok=True)
        return state if identity == self._identity else None
