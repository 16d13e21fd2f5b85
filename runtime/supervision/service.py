"""A robot that starts at boot: the systemd unit of a graph, written and switched on.

The supervisor tells systemd when every process runs and, twice a second, that it still turns; if it does
not, systemd starts everything again. Nothing runs as root.
"""

import getpass
import os
import shlex
import subprocess
import sys
from pathlib import Path

from runtime import rundir
from runtime.errors import ConfigError, HallwayError

DEFAULT_DIR = Path("/etc/systemd/system")
_WATCHDOG_S = 10

_UNIT = """\
[Unit]
Description=Hallway: {graph} of robot {robot}
After=network.target time-sync.target
# A device that is not there at boot may come: it is looked for again, without end.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
WatchdogSec={watchdog_s}
ExecStart={command}
WorkingDirectory={folder}
User={user}
Environment={run_variable}={run_dir}
# One for each unit: with the service that ends, systemd takes its directory away.
RuntimeDirectory={run_name}
RuntimeDirectoryMode=0700
# 2: a wrong configuration; trying again does not help.
Restart={restart}
RestartSec=2
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


def unit(graph: Path, robot: str, results: Path, user: str, extra: list[str], *, again: bool = False) -> str:
    """Return the unit's text.

    Args:
        graph: File, absolute.
        robot: Its name.
        results: Folder in which every start makes one of its own.
        user: Under whom it runs; owns `results` and belongs to the groups of the serial ports.
        extra: More arguments of `hallway up`.
        again: Whether it starts again when it has ended well, as with a robot on another machine.

    Raises:
        ConfigError: The user is root, or something has a character that a unit cannot hold.
    """
    if user == "root":
        raise ConfigError("a robot does not run as root: say it with sudo, as the user that shall run it")
    words = [sys.executable, "-m", "runtime.cli", "up", str(graph), "--headless", "--robot", robot, *extra]
    for word in (str(graph), str(results), user, *words):
        if "\n" in word or "%" in word:
            raise ConfigError(f"{word!r}: a unit cannot hold a line break or '%'")
    return _UNIT.format(
        graph=graph.name,
        robot=robot,
        watchdog_s=_WATCHDOG_S,
        run_variable=rundir.VARIABLE,
        run_dir=rundir.boot_dir(robot),
        run_name=rundir.boot_name(robot),
        command=shlex.join(words),
        folder=results,
        restart="always" if again else "on-failure",
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


def enable(path: Path) -> None:
    """Let a robot start now and at every boot.

    Args:
        path: Of its unit.

    Raises:
        HallwayError: systemd is not there, or refuses; the text is its own.
    """
    for words in (["daemon-reload"], ["enable", "--now", str(path.absolute())]):
        try:
            done = subprocess.run(["systemctl", *words], capture_output=True, text=True, check=False)
        except FileNotFoundError as error:
            raise HallwayError(f"{path}: written, but there is no systemctl here") from error
        if done.returncode:
            said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise HallwayError(f"{path}: written, but systemctl {words[0]}: {said[-1]}")


def owner() -> str:
    """Return who shall run the robot: whoever called sudo, or this user."""
    return os.environ.get("SUDO_USER") or getpass.getuser()
