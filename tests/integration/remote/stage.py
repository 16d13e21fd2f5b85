"""A robot and its guests in two network namespaces, which are joined by one wire and see nothing else.

`CI_REQUIRE_NETNS=1` makes it a failure, not a skip, when this machine does not let us make them.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from runtime.access import keys

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
ROBOT, LAPTOP = "10.77.31.1", "10.77.31.2"

KNOWN_CELLS = 300 * 300


def network(*command):
    return subprocess.run(["ip", *command], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def namespaces():
    """Two network namespaces with a wire between them."""
    robot, laptop = f"hallway-r{os.getpid()}", f"hallway-l{os.getpid()}"
    made = [network("netns", "add", name) for name in (robot, laptop)]
    wires = [
        ("link", "add", "hw0", "netns", robot, "type", "veth", "peer", "name", "hw0", "netns", laptop),
        *(("-n", ns, "addr", "add", f"{a}/24", "dev", "hw0") for ns, a in ((robot, ROBOT), (laptop, LAPTOP))),
        *(("-n", ns, "link", "set", dev, "up") for ns in (robot, laptop) for dev in ("lo", "hw0")),
    ]
    made += [network(*wire) for wire in wires]
    try:
        if bad := [done.stderr.strip() for done in made if done.returncode]:
            if os.environ.get("CI_REQUIRE_NETNS"):
                pytest.fail(f"network namespaces: {bad[0]}")
            pytest.skip(f"needs network namespaces: {bad[0]}")
        yield robot, laptop
    finally:
        for name in (robot, laptop):
            network("netns", "del", name)


class Robot:
    """A robot in its namespace, and guests in the other."""

    def __init__(self, folder, namespaces):
        self.folder, (self.here, self.there) = folder, namespaces
        self.process = None
        (folder / "run").mkdir(mode=0o700)

    def environment(self, user):
        return {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "HALLWAY_KEYS": str(self.folder / user),
            "HALLWAY_RUN": str(self.folder / f"{user}-run"),
        }

    def invite(self, guest, role):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("HALLWAY_KEYS", str(self.folder / "owner"))
            invitation = keys.invite("robot", guest, role, ROBOT)
            file = self.folder / f"{guest}.invitation"
            keys.write_private(file, invitation.to_bytes())
            patch.setenv("HALLWAY_KEYS", str(self.folder / guest))
            keys.pair(file)

    def command(self, namespace, *words):
        """Return what runs our Python in a namespace."""
        return ["ip", "netns", "exec", namespace, sys.executable, *map(str, words)]

    def started(self, *words):
        """Start the robot, which ends with the block; its log is in a file."""
        with (self.folder / "robot.log").open("w") as log:
            self.process = subprocess.Popen(
                self.command(self.here, HERE / "robot_side.py", self.folder / "run", ROBOT, *words),
                env=self.environment("owner"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        if self.process.stdout.readline() != "up\n":
            self.process.communicate()
            raise AssertionError((self.folder / "robot.log").read_text())
        return self

    def __enter__(self):
        return self if self.process is not None else self.started()

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.commands()

    def guest(self, name, mode="client", endpoint=None):
        """Let a guest look and drive for some seconds; return what it saw."""
        words = [KNOWN_CELLS, mode, *([endpoint] if endpoint else [])]
        done = subprocess.run(
            self.command(self.there, HERE / "guest_side.py", *words),
            env=self.environment(name),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def staying(self, name):
        """Start a guest that looks and drives until it is told to end, and says how it goes."""
        return self._opened(name, HERE / "staying_guest.py", stdin=subprocess.PIPE)

    def typed(self, name, *words):
        """Start a command as a guest types it."""
        return self._opened(name, "-m", "runtime.cli", *words, stderr=subprocess.PIPE)

    def _opened(self, name, *words, **pipes):
        command, environment = self.command(self.there, *words), self.environment(name)
        pipes["stdout"] = subprocess.PIPE
        return subprocess.Popen(command, env=environment, cwd=self.folder, text=True, bufsize=1, **pipes)

    def commands(self):
        """End the robot; return how many commands reached its wheels."""
        out, _ = self.process.communicate("end\n", timeout=30)
        return json.loads(out)["commands"]


@pytest.fixture
def robot(tmp_path, namespaces, monkeypatch):
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    keys.make("robot", [ROBOT])
    return Robot(tmp_path, namespaces)
