"""A process that stands by, everything imported, and takes over when the one at work dies.

Importing what a matcher or a mapper needs takes longer than a robot may be without one.
"""

import contextlib
import subprocess
from collections.abc import Callable
from pathlib import Path

from runtime.process import realtime


class Spare:
    """At most one process that waits for a line on its standard input.

    Args:
        spawn: Starts such a process.
    """

    def __init__(self, spawn: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._spawn = spawn
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Of the process that stands by."""
        return self._process.pid if self._process else None

    def keep(self) -> None:
        """See to it that one stands by."""
        if self._process is not None and self._process.poll() is not None:
            self.dismiss()
        if self._process is None:
            with contextlib.suppress(OSError):  # no memory, too many processes: the next turn tries again
                self._process = self._spawn()

    def call(self) -> subprocess.Popen[bytes] | None:
        """Let it take over and return it; None if there is none that works."""
        process = self._process
        if process is None or process.stdin is None or process.poll() is not None or is_stopped(process.pid):
            self.dismiss()
            return None
        try:
            with process.stdin as line:
                line.write(b"go\n")
            # It may still import, and on a busy machine it would for ever: it cannot read that it is called.
            realtime.step_forward(process.pid, like=0)
        except OSError:  # it has gone, or the kernel does not let it rise: begin at the beginning
            self.dismiss()
            return None
        self._process = None
        return process

    def dismiss(self) -> None:
        """End it."""
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        if process.stdin is not None:
            process.stdin.close()


def is_stopped(pid: int) -> bool:
    """Whether a process stands still by SIGSTOP; a debugger's stop has another letter."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] == "T"
