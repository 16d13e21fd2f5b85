"""The directory of a running robot: its sockets and device links, for its owner's eyes only.

One directory for each robot's name, locked while its supervisor lives; whoever wants to look at a running
robot finds it by that name.
"""

import contextlib
import fcntl
import os
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from runtime.errors import ConfigError, HallwayError

_VARIABLE = "HALLWAY_RUN"
GONE_S = 2.0


class NotRunningError(HallwayError):
    """No robot of that name runs here."""


def base_dir() -> Path:
    """Return where the directories of all robots are."""
    if named := os.environ.get(_VARIABLE):
        return Path(named)
    if home := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(home) / "hallway"
    return Path(f"/tmp/hallway-{os.getuid()}")


def run_dir(robot: str) -> Path:
    """Return the directory of one robot, whether or not it runs."""
    return base_dir() / robot


def is_running(robot: str) -> bool:
    """Whether a robot of that name runs here."""
    return (run_dir(robot) / "hub.sock").exists()


class Presence:
    """Whether a robot of this machine is still there, to somebody who looks again and again.

    Its hub may begin anew, and has no socket meanwhile; a robot that was never here is never gone.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._here = is_running(robot)
        self._seen = time.monotonic()

    @property
    def gone(self) -> bool:
        """Whether it was here, and has not been for some seconds."""
        now = time.monotonic()
        if not self._here or is_running(self._robot):
            self._seen = now
        return now - self._seen > GONE_S


def running(robot: str) -> Path:
    """Return the directory of a robot that runs.

    Raises:
        NotRunningError: It does not; the text names those that do, or how to come to one.
    """
    path = run_dir(robot)
    if not is_running(robot):
        others = sorted(p.parent.name for p in base_dir().glob("*/hub.sock")) if base_dir().is_dir() else []
        way_out = (
            f"running: {', '.join(others)}; say which with --robot"
            if others
            else "nor does any other; start one with `hallway up demo`, "
            "or pair with one elsewhere with `hallway keys pair FILE`"
        )
        raise NotRunningError(f"robot {robot!r} does not run here, {way_out}")
    return path


def private(robot: str) -> Path:
    """Make the directory of a robot, for its owner's eyes only, if it is not there.

    Raises:
        ConfigError: It belongs to somebody else.
    """
    path = run_dir(robot)
    for part in (base_dir(), path):
        part.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = part.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
            raise ConfigError(f"{part}: must be a directory of user {os.getuid()}, and is not")
        part.chmod(0o700)
    return path


@contextlib.contextmanager
def claimed(robot: str) -> Iterator[Path]:
    """Make the directory of a robot, empty and locked; take it away afterwards.

    Raises:
        ConfigError: The robot runs already, or the directory belongs to somebody else.
    """
    path = private(robot)
    lock = os.open(base_dir() / f"{robot}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            pid = os.pread(lock, 32, 0).decode().strip() or "?"
            raise ConfigError(f"robot {robot!r} runs already, under process {pid}") from None
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)
        for old in path.iterdir():  # left behind by a run that was killed
            shutil.rmtree(old) if old.is_dir() and not old.is_symlink() else old.unlink()
        yield path
        shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(lock)
