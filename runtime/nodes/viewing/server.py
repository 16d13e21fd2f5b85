"""The program that shows the picture: a window, or a page on this machine, as a child that we end ourselves.

The `rerun` command is a wrapper around the program; ending the wrapper would leave the window behind, so
the program itself is started. It listens on 127.0.0.1 alone, and its memory is bounded.
"""

import importlib.util
import os
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from runtime.errors import ConfigError, HallwayError
from runtime.process.realtime import die_with_parent

START_S = 20.0
_HOST = "127.0.0.1"
_PROBE_S = 0.2


class ViewerError(HallwayError):
    """The program that shows the picture does not run."""


class ViewerServer:
    """The running program; `url` takes the picture in, `page` shows it in a browser (empty for a window)."""

    def __init__(
        self, *, web: bool, port: int, web_port: int, memory_mb: int, log: Path | None = None
    ) -> None:
        self.port = free_port(port)
        self.url = f"rerun+http://{_HOST}:{self.port}/proxy"
        arguments = ["--bind", _HOST, "--port", str(self.port), f"--server-memory-limit={memory_mb}MB"]
        self.page = ""
        if web:
            page_port = free_port(web_port, taken=self.port)
            arguments += ["--serve-web", "--web-viewer-port", str(page_port)]
            inside = self.url.replace("+", "%2B").replace(":", "%3A").replace("/", "%2F")
            self.page = f"http://{_HOST}:{page_port}/?url={inside}"
        else:
            arguments += [f"--memory-limit={2 * memory_mb}MB", "--expect-data-soon"]
        self._log = log
        self._process = start(arguments, log)
        self._await(self.port if not web else page_port)

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def listens(self) -> bool:
        """Whether it would take a connection now."""
        return listens(self.port)

    def close(self) -> None:
        """End it."""
        end(self._process)

    def _await(self, port: int) -> None:
        until = time.monotonic() + START_S
        while time.monotonic() < until:
            if self.exit_code is not None:
                why = f"ended with code {self.exit_code} before it listened"
                raise ViewerError(f"the viewer {why}{self._last_words()}")
            if listens(port) and self.listens():
                return
            time.sleep(0.05)
        self.close()
        why = f"did not listen on {_HOST}:{port} within {START_S:g} s"
        raise ViewerError(f"the viewer {why}{self._last_words()}")

    def _last_words(self) -> str:
        if self._log is None or not self._log.is_file():
            return ""
        lines = [line for line in self._log.read_text(errors="replace").splitlines() if line.strip()]
        return f": {lines[-1].strip()}" if lines else ""


def program() -> str:
    """Return the path of the viewer that came with the rerun package; raises ConfigError."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or []) if spec is not None else []:
        path = Path(folder) / "rerun"
        if os.access(path, os.X_OK):
            return str(path)
    raise ConfigError("rerun_cli: no program in it; install rerun-sdk for this machine's architecture")


def start(arguments: Sequence[str], log: Path | None = None) -> "subprocess.Popen[bytes]":
    """Start the program as a child that does not outlive us."""
    # It counts its users on the internet unless it believes to be in an automated test.
    environment = os.environ | {"CI": "1", "TELEMETRY_ENABLED": "false"}
    with (log or Path(os.devnull)).open("ab") as output:
        return subprocess.Popen(
            [program(), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            preexec_fn=die_with_parent,
            process_group=0,  # Ctrl-C in the terminal reaches us alone, and we end it when we have let go
        )


def end(process: "subprocess.Popen[Any]", grace_s: float = 0.5) -> None:
    """End a child: ask, then insist."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(grace_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def listens(port: int) -> bool:
    """Whether something on this machine takes connections on a port."""
    try:
        socket.create_connection((_HOST, port), _PROBE_S).close()
    except OSError:
        return False
    return True


def free_port(wanted: int, *, taken: int = 0) -> int:
    """Return `wanted` if nobody has it, else a port that is free."""
    for port in (wanted, 0, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((_HOST, port))
            except OSError:
                continue
            found = int(probe.getsockname()[1])
            if found != taken:
                return found
    raise ViewerError(f"no free port on {_HOST} beside {wanted}")
