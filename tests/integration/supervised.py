"""Real processes under a supervisor: one-line programs, and a test that says who is ready."""

import contextlib
import os
import sys
import time

import pytest

from runtime.clock import Clock
from runtime.graph import Graph, NodeSpec
from runtime.supervision.supervisor import Supervisor

SLEEPS = "import time; time.sleep(600)"
POLITE = (
    "import signal, sys, time\n"
    "signal.signal(signal.SIGINT, lambda *_: sys.exit(0))\n"
    "print('up', flush=True)\n"
    "time.sleep(600)"
)
STUBBORN = (
    "import signal, time\n"
    "for number in (signal.SIGINT, signal.SIGTERM):\n"
    "    signal.signal(number, signal.SIG_IGN)\n"
    "print('up', flush=True)\n"
    "while True: time.sleep(600)"
)


class Scene:
    """A supervisor over one-line programs; the test says who is ready."""

    def __init__(self, folder, programs, elsewhere=(), **specs):
        self.logs = folder / "logs"
        self.events = []
        self.forgotten = []
        self.clock = Clock()
        nodes = {name: specs.get(name, NodeSpec(module="m")) for name in programs}
        self.supervisor = Supervisor(
            Graph(nodes=nodes),
            {name: [sys.executable, "-c", text] for name, text in programs.items()},
            self.logs,
            self.clock,
            lambda event: self.events.append((event.node, event.text)),
            self.forgotten.append,
            elsewhere,
        )
        self.children = self.supervisor.children
        self.ready, self.silent, self.loop_ages_s = set(), set(), {}

    def until(self, condition, within_s=20.0):
        end = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end, self.events
            self.supervisor.step(self.ready, self.silent, self.loop_ages_s)
            time.sleep(0.01)

    def state(self, name):
        return self.children[name].state

    def wrote(self, name, text):
        log = self.logs / f"{name}.log"
        return log.exists() and log.read_text() == text

    def said(self, name):
        return [text for node, text in self.events if node == name]


def alive(pid):
    with contextlib.suppress(ProcessLookupError, FileNotFoundError):
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.fixture
def scene(tmp_path):
    made = []

    def make(programs, **how):
        made.append(Scene(tmp_path, programs, **how))
        return made[-1]

    yield make
    for one in made:
        one.supervisor.close()
        assert all(child.pid is None for child in one.children.values())
