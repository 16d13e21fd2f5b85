"""One process under supervision: how it is started, why it ended, when it may start again.

States: waiting (for others), starting, running, backoff, stopping, ended (on its own, well), failed (for
good).
"""

import contextlib
import enum
import os
import re
import shutil
import signal
import subprocess
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

from runtime.graph import NodeSpec
from runtime.process.usage import Usage
from runtime.supervision.spare import Spare, is_stopped

_BACKOFF_S = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
_STEADY_S = 5.0  # after so long without failure, an old failure is forgotten
_LOOP_FAILURES = 6  # so many failures without a steady time in between: a crash loop
_SPARE_AFTER_S = 3.0
_LOG_BYTES = 2_000_000
_LOG_FILES = 3
_REQUESTS = (signal.SIGINT, signal.SIGTERM)
"""Ways to ask a process to end; one that does not work yet just does."""
_PREFIX = re.compile(r"^\S+ [A-Z]+ +[\w.]+: ")


class State(enum.Enum):
    """Of a process, in the order of its life."""

    WAITING = "waiting"
    STARTING = "starting"
    RUNNING = "running"
    BACKOFF = "backoff"
    STOPPING = "stopping"
    ENDED = "ended"
    FAILED = "failed"


class Child:
    """A process that is started, watched and started again; driven by the supervisor's one thread.

    That thread must live as long as the process: the kernel ends a process when the *thread* that started
    it goes.
    """

    def __init__(
        self, name: str, spec: NodeSpec, command: Sequence[str], log: Path, environment: Mapping[str, str]
    ) -> None:
        self.name, self.spec, self.log_path = name, spec, log
        self.state = State.WAITING
        self.restarts = 0
        self.reasons: deque[str] = deque(maxlen=20)
        """Why it ended, each time; the newest last."""
        self.exit_code = 0
        self.since = time.monotonic()
        """When the state was entered."""
        self.was_ready = False
        self.for_good = False
        """Whether the run ends: when the process does, however, it does not start again."""
        self._command, self._environment = list(command), dict(environment)
        self._process: subprocess.Popen[bytes] | None = None
        self._usage: Usage | None = None
        self._failures = 0
        self._due = 0.0
        self._blamed = ""
        self._pressed = False
        self._spare = Spare(lambda: self._spawned([*self._command, "--spare"], subprocess.PIPE))

    @property
    def pid(self) -> int | None:
        """Of the living process."""
        return self._process.pid if self._process else None

    def usage(self) -> dict[str, str]:
        """Return what the living process takes of the machine, as `Usage.values`; nothing without one."""
        return self._usage.values() if self._process and self._usage else {}

    @property
    def dying(self) -> bool:
        """Whether the process was ended; one that waits for a disk that does not answer is not gone yet."""
        return bool(self._blamed)

    @property
    def age_s(self) -> float:
        """Of the present state."""
        return time.monotonic() - self.since

    def enter(self, state: State) -> None:
        """Change the state."""
        self.state, self.since = state, time.monotonic()

    def start(self) -> str:
        """Start the process, or let the spare one take over; return what happened, in words."""
        self._blamed = ""
        word = "starts again" if self.state is State.BACKOFF else "starts"
        try:
            self._process = self._spare.call() or self._spawned(self._command, subprocess.DEVNULL)
        except OSError as error:  # no memory, no disk, too many processes: that may pass
            return self._failed(f"cannot be started: {error.strerror}")
        self._usage = Usage(self._process.pid)
        self.enter(State.STARTING)
        return word

    def _spawned(self, command: Sequence[str], stdin: int) -> subprocess.Popen[bytes]:
        with self.log_path.open("ab") as log:
            return subprocess.Popen(
                command,
                stdin=stdin,
                stdout=log,
                stderr=log,
                env=self._environment,
                process_group=0,  # Ctrl-C in the terminal reaches the supervisor alone
            )

    def ready(self) -> None:
        """Take note that the process has declared itself ready."""
        if self.state is State.STARTING:
            self.was_ready = True
            self.enter(State.RUNNING)

    def poll(self) -> str | None:
        """Look after the process; return what happened, in words, if something did."""
        now = time.monotonic()
        if self.state is State.BACKOFF and self.for_good:
            self.stop()
        if self.state is State.BACKOFF and now >= self._due:
            return self.start()
        if self._process is None:
            return None
        if self.state is State.RUNNING:
            # At the start of a run not in the first seconds: all others start, too. After a blow at once:
            # the next one would find nobody.
            if self.spec.spare and (self.restarts or now - self.since > _SPARE_AFTER_S):
                self._spare.keep()
            if now - self.since > _STEADY_S:
                self._failures = 0
        code = self._process.poll()
        if code is not None:
            return self._buried(code)
        if self.dying:
            return None
        if self.state is State.STARTING and now - self.since > self.spec.start_s:
            return self.kill(f"was not ready within {self.spec.start_s:g} s")
        if self.state is not State.STOPPING and is_stopped(self._process.pid):
            return self.kill("was stopped by a signal")
        return None

    def kill(self, why: str) -> str:
        """End the process at once because it does not work any more; it is buried by the next poll."""
        self._blamed = why
        self.signal(signal.SIGKILL)
        return why

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process and everything it started."""
        if self._process is not None and self._process.poll() is None:
            try:
                os.killpg(self._process.pid, number)
            except ProcessLookupError:
                return

    def stop(self) -> None:
        """Ask the process to end; it will not start again."""
        self._spare.dismiss()
        if self._process is None:
            if self.state is not State.FAILED:
                self.enter(State.ENDED)
            return
        self.enter(State.STOPPING)
        self._pressed = False
        self.signal(signal.SIGINT)
        self.signal(signal.SIGCONT)

    def press(self) -> str | None:
        """Ask again half-way through the time it has to end, and end it after that; say so."""
        if self.state is not State.STOPPING or self._blamed:
            return None
        if self.age_s > self.spec.stop_s:
            return self.kill(f"did not end within {self.spec.stop_s:g} s")
        if self.age_s > self.spec.stop_s / 2 and not self._pressed:
            self._pressed = True
            self.signal(signal.SIGTERM)
        return None

    def end(self) -> None:
        """End the process and everything it started, and wait until it is gone."""
        self._spare.dismiss()
        if (process := self._process) is not None:
            self.stop()
            _end_group(process.pid)
            process.wait()
            self._process = None
            self.enter(State.ENDED)

    def rotate_log(self) -> None:
        """Keep the log and its predecessors bounded."""
        try:
            self._rotate_log()
        except OSError:  # a full disk, most likely, which must end no robot; the log itself gives way
            with contextlib.suppress(OSError):
                os.truncate(self.log_path, 0)

    def _rotate_log(self) -> None:
        try:
            if self.log_path.stat().st_size < _LOG_BYTES:
                return
        except FileNotFoundError:
            return
        for number in range(_LOG_FILES - 1, 0, -1):
            older = self.log_path.with_suffix(f".log.{number}")
            if older.exists():
                older.replace(self.log_path.with_suffix(f".log.{number + 1}"))
        # Copied and cut, not renamed: the process writes on through the file it has open.
        shutil.copyfile(self.log_path, self.log_path.with_suffix(".log.1"))
        os.truncate(self.log_path, 0)

    def _buried(self, code: int) -> str:
        process, self._process = self._process, None
        if process is not None:
            _end_group(process.pid)
        if self.state is State.STOPPING:
            self.exit_code = max(code, 0) if not self._blamed else 1
            self.enter(State.ENDED)
            if code == 0 or (-code in _REQUESTS and not self._blamed):
                return "ended"
            self.reasons.append(self._reason(code))
            return self.reasons[-1]
        if code == 0 and self.spec.restart != "always":
            self._spare.dismiss()
            self.enter(State.ENDED)
            return "ended by itself"
        # What a person wrote does not heal, and a device that never was there will not come.
        hopeless = code == 2 or (code == 3 and not self.was_ready)
        return self._failed(self._reason(code), code if 0 <= code <= 5 else 1, hopeless=hopeless)

    def _failed(self, reason: str, exit_code: int = 1, *, hopeless: bool = False) -> str:
        """Decide what follows when the process has failed; return that in words."""
        self.reasons.append(reason)
        self.exit_code = exit_code
        self._failures += 1
        if self.for_good:
            self._spare.dismiss()
            self.enter(State.ENDED)
            return reason
        if self.spec.restart == "never" or hopeless:
            self._spare.dismiss()
            self.enter(State.FAILED)
            return reason
        if self._failures >= _LOOP_FAILURES:
            self._spare.dismiss()
            self.enter(State.FAILED)
            return f"{reason}; crash loop: {self._failures} failures, given up"
        self.restarts += 1
        delay_s = _BACKOFF_S[min(self._failures, len(_BACKOFF_S)) - 1]
        self._due = time.monotonic() + delay_s
        self.enter(State.BACKOFF)
        return f"{reason}; starts again in {delay_s:g} s"

    def _reason(self, code: int) -> str:
        if self._blamed:
            return self._blamed
        if code < 0:
            return f"killed by {_name_of(-code)}"
        line = last_line(self.log_path)
        return f"exit code {code}" + (f": {line}" if line else "")


def _name_of(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # those of real time between the first and the last have none
        return f"signal {number}"


def last_line(log: Path) -> str:
    """Return the last line of a log without its time and name; empty if there is none."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4096))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return _PREFIX.sub("", lines[-1]).strip() if lines else ""


def _end_group(group: int) -> None:
    """End what a process that has ended left behind."""
    try:
        os.killpg(group, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return
