"""What a process must not forget when it is killed: written in one step, read by the one that follows it.

A checkpoint lives in the directory of the run, which only its owner may enter and which every run begins
empty: it never reaches another run, another version or another user. A damaged one counts as none, and
reading takes it away: a state that kills its process at the first step is not met twice.
"""

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LONGEST_NS = 10_000_000_000
"""Between two writings, however slow the disk."""
_SHARE = 20


class Checkpoint:
    """The last state of one process.

    Args:
        path: Of the file; relative where there is no run, and then nothing is kept.
        every_ns: Time between two writings at least, by the stamps given to `due`; longer where writing
            takes long, so that a slow disk never takes more than a twentieth of the time, up to LONGEST_NS.
            The quicker one of the last two counts: one stall of the machine does not make a disk slow.
        identity: What must be equal for a state to be taken back, such as the configuration.
        now_ns: The present; given by tests.
    """

    def __init__(
        self, path: Path, every_ns: int, identity: Any, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._now_ns = now_ns
        self._path, self._every_ns, self._identity = path, every_ns, identity
        self._written_ns: int | None = None
        self._took_ns = self._took_before_ns = 0

    def due(self, stamp_ns: int) -> bool:
        """Whether it is time to write again; a stamp that went backwards counts as time."""
        if not self._path.is_absolute():
            return False
        last = self._written_ns
        took_ns = min(self._took_ns, self._took_before_ns)
        pause_ns = max(self._every_ns, min(_SHARE * took_ns, LONGEST_NS))
        return last is None or not 0 <= stamp_ns - last < pause_ns

    def write(self, stamp_ns: int, state: Any) -> bool:
        """Replace the state in one step; False where the disk refuses, and then the last one stays."""
        self._written_ns = stamp_ns
        began_ns = self._now_ns()
        fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            with open(fresh, "wb") as file:
                pickle.dump((self._identity, state), file, protocol=pickle.HIGHEST_PROTOCOL)
            fresh.replace(self._path)
        except OSError:
            fresh.unlink(missing_ok=True)
            return False
        finally:
            self._took_before_ns, self._took_ns = self._took_ns, self._now_ns() - began_ns
        return True

    def read(self) -> Any | None:
        """Take the last state; None if there is none, or it belongs to another configuration."""
        if not self._path.is_absolute():
            return None
        for cut in self._path.parent.glob(f".{self._path.name}.*"):  # of one that was killed as it wrote
            cut.unlink(missing_ok=True)
        if not self._path.is_file():
            return None
        try:
            with self._path.open("rb") as file:
                identity, state = pickle.load(file)
        except Exception:  # noqa: BLE001 - whatever a cut file provokes, it is no state
            return None
        finally:
            self._path.unlink(missing_ok=True)
        return state if identity == self._identity else None
