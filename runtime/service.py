"""A robot that starts at boot: the systemd unit of a graph.

The supervisor tells systemd when every process runs and, twice a second, that it still turns; if it does
not, systemd starts everything again. Nothing runs as root.
"""

import getpass
import os
import shlex
import sys
from pathlib import Path

from runtime.errors import ConfigError

DEFAULT_DIR = Path("/etc/systemd/system")
_WATCHDOG_S = 10

_UNIT = """\
[Unit]
Description=Hallway: {graph} of robot {robot}
After=network.target time-sync.target

[Service]
Type=notify
NotifyAccess=main
WatchdogSec={watchdog_s}
ExecStart={command}
WorkingDirectory={folder}
User={user}
Environment=HALLWAY_RUN=/run/hallway
RuntimeDirectory=hallway
RuntimeDirectoryMode=0700
# 2, 3: a wrong configuration, or a device that is not there; trying again does not help.
Restart=on-failure
RestartSec=1
RestartPreventExitStatus=2
SuccessExitStatus=130
# The supervisor ends its processes itself, in order; what is left after that goes with it.
KillMode=mixed
KillSignal=SIGTERM
TimeoutStartSec=180
TimeoutStopSec=30
LimitRTPRIO=50
LimitNICE=+0
LimitMEMLOCK=infinity

[Install]
WantedBy=multi-user.target
"""


def unit(graph: Path, robot: str, results: Path, user: str, extra: list[str]) -> str:
    """Return the unit's text.

    Args:
        graph: File, absolute.
        robot: Its name.
        results: Folder in which every start makes one of its own.
        user: Under whom it runs; owns `results` and belongs to the groups of the serial ports.
        extra: More arguments of `hallway up`.
    """
    words = [sys.executable, "-m", "runtime.cli", "up", str(graph), "--headless", "--robot", robot, *extra]
    for word in (str(graph), str(results), user, *words):
        if "\n" in word or "%" in word:
            raise ConfigError(f"{word!r}: a unit cannot hold a line break or '%'")
    return _UNIT.format(
        graph=graph.name,
        robot=robot,
        watchdog_s=_WATCHDOG_S,
        command=shlex.join(words),
        folder=results,
        user=user,
    )


def install(text: str, robot: str, folder: Path = DEFAULT_DIR) -> Path:
    """Write the unit of a robot; raises ConfigError where that is not allowed."""
    path = folder / f"hallway-{robot}.service"
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(path)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; try sudo, or another folder"
        ) from error
    return path


def owner() -> str:
    """Return who shall run the robot: whoever called sudo, or this user."""
    return os.environ.get("SUDO_USER") or getpass.getuser()
