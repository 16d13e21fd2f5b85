"""The whole chain in real processes: `hallway up`, the base node, its watchdog, `hallway teleop`; one robot.

Only the robot is emulated, in this process, so that what arrives on its wire is timed by one clock.
"""

import contextlib
import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

from drivers.create.emulator import CreateEmulator, stopped_after_ms
from drivers.create.protocol import Mode

ROOT = Path(__file__).resolve().parents[2]
ROBOT, LAPTOP = "10.77.41.1", "10.77.41.2"
CUTS = ("teleop", "driver", "hung driver", "supervisor", "network")
"""What is killed, stopped or cut."""


def wait(condition, within_s, what):
    """Wait until a condition holds."""
    end = time.monotonic() + within_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"waited {within_s} s for {what}")
        time.sleep(0.005)
    return value


class Teleop:
    """`hallway teleop` on a pseudo-terminal, with somebody at the keys."""

    def __init__(self, environment, prefix=()):
        self._keys, theirs = pty.openpty()
        command = [*prefix, sys.executable, "-m", "runtime.cli", "teleop", "--stick", "keyboard"]
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=theirs, stdout=theirs, stderr=theirs,
            start_new_session=True,
        )  # fmt: skip
        os.close(theirs)
        self.screen = b""
        self.held = b""
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._sit, daemon=True)
        self._thread.start()

    def press(self, key):
        with self._lock, contextlib.suppress(OSError):
            os.write(self._keys, key)

    def _sit(self):
        """Read the screen, and let the held key repeat as a terminal does."""
        while not self._end.wait(0.03):
            with contextlib.suppress(OSError):
                while select.select([self._keys], [], [], 0)[0]:
                    self.screen = (self.screen + os.read(self._keys, 65536))[-20_000:]
            if self.held:
                self.press(self.held)

    def kill(self):
        # Under `ip netns exec` it is the same process: that command becomes what it starts.
        self.process.kill()

    def close(self):
        self._end.set()
        self._thread.join()
        self.process.kill()
        self.process.wait()
        os.close(self._keys)


class Stage:
    """See above; use as a context."""

    def __init__(self, network=None):
        self.folder = Path(tempfile.mkdtemp(prefix="stage", dir="/tmp"))
        self.emulator = CreateEmulator(link=self.folder / "robot")
        self.environment = os.environ | {
            "HALLWAY_RUN": str(self.folder / "run"), "HALLWAY_KEYS": str(self.folder / "keys"),
        }  # fmt: skip
        self.network = network
        self.supervisor = None
        self.teleop = None
        graph = f"nodes:\n  base: {{module: base, config: {{path: {self.folder / 'robot'}}}}}\n"
        (self.folder / "graph.yaml").write_text(graph)

    def __enter__(self):
        self.emulator.start()
        if self.network is not None:
            self._make_keys()
        return self

    def __exit__(self, *_):
        if self.teleop is not None:
            self.teleop.close()
        self._end_supervisor()
        self.emulator.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _hallway(self, *arguments, **changes):
        command = [sys.executable, "-m", "runtime.cli", *arguments]
        subprocess.run(command, cwd=ROOT, env=self.environment | changes, check=True, capture_output=True)

    def _make_keys(self):
        self._hallway("keys", "make", "--host", ROBOT)
        card = str(self.folder / "card")
        self._hallway(
            "keys", "invite", "anna", "--role", "operator", "--address", f"{ROBOT}:7448", "--out", card
        )
        self._hallway("keys", "pair", card, HALLWAY_KEYS=str(self.folder / "guest"))

    def _end_supervisor(self):
        if self.supervisor is not None:
            self.supervisor.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.supervisor.wait(10)
            self.supervisor.kill()
            self.supervisor.wait()
            self.supervisor = None

    def base(self):
        """Return the process of the base node, once it is there."""

        def found():
            with contextlib.suppress(psutil.Error):
                for child in psutil.Process(self.supervisor.pid).children(recursive=True):
                    if child.cmdline()[1:4] == ["-m", "runtime.process", "base"]:
                        return child
            return None

        return wait(found, 30, "the base process")

    def up(self):
        """Have everything run that is not running."""
        if self.supervisor is not None and self.supervisor.poll() is not None:
            self.supervisor = None
        if self.supervisor is None:
            # The children of a killed supervisor leave by themselves; they still hold the directory's name.
            remote = ["--remote", f"{ROBOT}:7448"] if self.network else []
            command = [sys.executable, "-m", "runtime.cli", "up", str(self.folder / "graph.yaml")]
            command += ["--headless", "--out", str(self.folder / f"out{time.monotonic_ns()}"), *remote]
            with (self.folder / "up.log").open("ab") as log:
                self.supervisor = subprocess.Popen(
                    command, cwd=ROOT, env=self.environment, stdout=log, stderr=log, start_new_session=True
                )
            wait(lambda: (self.folder / "run" / "robot" / "hub.sock").exists(), 30, "the hub")
        if self.teleop is not None and self.teleop.process.poll() is not None:
            self.teleop.close()
            self.teleop = None
        if self.teleop is None:
            if self.network is None:
                self.teleop = Teleop(self.environment)
            else:
                away = {
                    "HALLWAY_RUN": str(self.folder / "elsewhere"),
                    "HALLWAY_KEYS": str(self.folder / "guest"),
                }
                self.teleop = Teleop(self.environment | away, ["ip", "netns", "exec", self.network.name])

    def drive(self):
        """Arm as a person would, and hold the arrow until the wheels turn."""
        end = time.monotonic() + 60
        while True:
            self.up()
            self.teleop.held = b""
            time.sleep(0.3)
            self.teleop.press(b"\r")
            deadline = time.monotonic() + 1.0
            while time.monotonic() < deadline and self.emulator.mode is not Mode.SAFE:
                time.sleep(0.01)
            self.teleop.held = b"\x1b[A"
            deadline = time.monotonic() + 1.0
            while time.monotonic() < deadline and self.emulator.wheels_mmps[0] < 150:
                time.sleep(0.005)
            if self.emulator.wheels_mmps[0] >= 150:
                return
            if time.monotonic() > end:
                log = (self.folder / "up.log").read_text()[-2000:]
                raise AssertionError(f"the robot does not drive; {self.teleop.screen[-600:]!r}; {log}")

    def cut(self, what):
        """Break one thing while driving; return ms until zeros on the wire, after which came nothing else."""
        self.drive()
        base = self.base()
        fault_ns = time.monotonic_ns()
        if what == "teleop":
            self.teleop.kill()
        elif what == "driver":
            base.kill()
        elif what == "hung driver":
            base.suspend()
        elif what == "supervisor":
            self.supervisor.kill()
        elif what == "network":
            self.network.cut()
            fault_ns = time.monotonic_ns()  # the command itself takes a while
        else:
            raise ValueError(what)
        try:
            wait(lambda: self.emulator.wheels_mmps == (0, 0), 5, f"standing wheels after: {what}")
            time.sleep(0.5)
            assert {w for _, w in self.emulator.drives(time.monotonic_ns() - 300_000_000)} <= {(0, 0)}
            assert self.emulator.mode in (Mode.PASSIVE, Mode.OFF)
        finally:
            if what == "hung driver":
                with contextlib.suppress(psutil.NoSuchProcess):  # the supervisor ends what hangs
                    base.resume()
            if what == "network":
                self.network.mend()
            if what == "supervisor":
                self.supervisor.wait()
        if what == "hung driver":
            self.teleop.held = b"\x1b[A"  # still pushed when the driver wakes up
            time.sleep(0.5)
            assert self.emulator.wheels_mmps == (0, 0)
        return stopped_after_ms(self.emulator, fault_ns)


class Network:
    """A network namespace with one wire to here; a laptop somewhere else."""

    def __init__(self, name="hallwaylaptop"):
        self.name = name

    @staticmethod
    def _ip(*command, check=True):
        return subprocess.run(["ip", *command], capture_output=True, text=True, check=check)

    def __enter__(self):
        self._ip("netns", "add", self.name)
        try:
            self._ip("link", "add", "hwrobot", "type", "veth", "peer", "name", "hwlaptop", "netns", self.name)
            self._ip("addr", "add", f"{ROBOT}/24", "dev", "hwrobot")
            self._ip("link", "set", "hwrobot", "up")
            self._ip("-n", self.name, "addr", "add", f"{LAPTOP}/24", "dev", "hwlaptop")
            self._ip("-n", self.name, "link", "set", "hwlaptop", "up")
        except subprocess.CalledProcessError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        self._ip("netns", "del", self.name, check=False)

    def cut(self):
        """Take the wire away from the robot's end: nothing arrives, and nobody is told."""
        self._ip("link", "set", "hwrobot", "down")

    def mend(self):
        """Put it back."""
        self._ip("link", "set", "hwrobot", "up")
