"""The directory of a running robot: its sockets and device links, for its owner's eyes only.

One directory for each robot's name, locked while its supervisor lives; whoever wants to look at a running
robot finds it by that name. A robot that starts at boot has a place of its own, which systemd makes for it
and takes away with it: what belonged to several would go with the first that ends.
"""

import contextlib
import fcntl
import os
import shutil
import socket
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from runtime.errors import ConfigError, HallwayError

VARIABLE = "HALLWAY_RUN"
_SYSTEM = Path("/run")
GONE_S = 2.0
_LOOK_S = 0.3


class NotRunningError(HallwayError):
    """No robot of that name runs here."""


def base_dir() -> Path:
    """Return where the directories of all robots are."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    if home := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(home) / "hallway"
    return Path(f"/tmp/hallway-{os.getuid()}")


def boot_name(robot: str) -> str:
    """Return the name under which systemd keeps the directory of a robot that starts at boot."""
    return f"hallway-{robot}"


def boot_dir(robot: str) -> Path:
    """Return where such a robot's directory is: what `base_dir` is to all others."""
    return _SYSTEM / boot_name(robot)


def run_dir(robot: str) -> Path:
    """Return the directory of one robot: where it runs, or else where it would."""
    return next(filter(_listens, _places(robot)), base_dir() / robot)


def is_running(robot: str) -> bool:
    """Whether a robot of that name runs here."""
    return _listens(run_dir(robot))


def _places(robot: str) -> list[Path]:
    ours = base_dir() / robot
    # Who says where robots are means those and no others.
    return [ours] if os.environ.get(VARIABLE) else [ours, boot_dir(robot) / robot]


def _listens(place: Path) -> bool:
    """Whether a hub is behind the socket; a machine that killed it left the file behind."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.setblocking(False)
        try:
            line.connect(str(place / "hub.sock"))
        except BlockingIOError:  # so many come to it that it does not keep up
            return True
        except OSError:  # nobody, or somebody else's place
            return False
    return True


class Presence:
    """Whether a robot of this machine is still there, to somebody who looks again and again.

    Its hub may begin anew, and has no socket meanwhile; a robot that was never here is never gone.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._here = is_running(robot)
        self._seen = self._looked = time.monotonic()

    @property
    def gone(self) -> bool:
        """Whether it was here, and has not been for some seconds; may be asked at any rate."""
        now = time.monotonic()
        if not self._here:
            self._seen = now
        elif now - self._looked > _LOOK_S:
            self._looked = now
            if is_running(self._robot):
                self._seen = now
        return now - self._seen > GONE_S


def running(robot: str) -> Path:
    """Return the directory of a robot that runs.

    Raises:
        NotRunningError: It does not; the text names those that do, or how to come to one.
    """
    path = run_dir(robot)
    if _listens(path):
        return path
    others = [place.name for place in _robots_in(base_dir(), "*")]
    if not os.environ.get(VARIABLE):
        boot = boot_dir(robot)
        if boot.is_dir() and not os.access(boot, os.X_OK):
            raise NotRunningError(f"robot {robot!r} was started at boot and belongs to user {boot.owner()!r}")
        others += [place.name for place in _robots_in(_SYSTEM, f"{boot_name('*')}/*")]
    way_out = (
        f"running: {', '.join(sorted(others))}; say which with --robot"
        if others
        else "nor does any other; start one with `hallway up demo`, "
        "or pair with one elsewhere with `hallway keys pair FILE`"
    )
    raise NotRunningError(f"robot {robot!r} does not run here, {way_out}")


def _robots_in(folder: Path, pattern: str) -> list[Path]:
    return [found.parent for found in folder.glob(f"{pattern}/hub.sock") if _listens(found.parent)]


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
    if (elsewhere := run_dir(robot)) != base_dir() / robot:
        raise ConfigError(f"robot {robot!r} runs already, since boot, in {elsewhere}")
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
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(lock)
