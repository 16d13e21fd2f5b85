"""How a node's process is scheduled: a spare one stands aside while it imports, a pinned one stays."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from runtime.clock import Clock
from runtime.process import __main__ as process
from runtime.process.realtime import PARENT_VARIABLE
from runtime.supervision.supervisor import child_environment

ROOT = Path(__file__).resolve().parents[2]

READY = ["diagnostic_msgs/msg/DiagnosticArray", "settle"]
"""What a spare process has done before it is called, besides what it imports."""
NODE = """
    from dataclasses import dataclass
    SUBSCRIBES = PUBLISHES = ()
    @dataclass(frozen=True, slots=True, kw_only=True)
    class Config:
        pass
    def run(port, config):
        return 0
"""


@pytest.fixture
def stages(tmp_path, monkeypatch):
    """Return how a spare process was scheduled, given whether it is called at once."""
    (tmp_path / "spare_nodes").mkdir()
    (tmp_path / "spare_nodes" / "idle.py").write_text(textwrap.dedent(NODE))
    (tmp_path / "g.yaml").write_text("nodes: {a: {module: spare_nodes.idle}}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(PARENT_VARIABLE, raising=False)
    monkeypatch.setattr("runtime.process.__main__.signal.signal", lambda *_: None)
    monkeypatch.setattr("runtime.process.__main__.realtime.schedule", lambda *_, **__: None)

    def run(called):
        steps = []
        reading, writing = os.pipe()

        def step_aside():
            steps.append("aside")
            os.write(writing, b"go\n")  # only now
            return True

        monkeypatch.setattr("runtime.process.__main__.realtime.step_aside", step_aside)
        monkeypatch.setattr(
            "runtime.process.__main__.realtime.step_forward", lambda pid, like: steps.append("forward")
        )
        monkeypatch.setattr("runtime.process.__main__.messages.prepare", lambda kind: steps.append(kind))
        monkeypatch.setattr("runtime.process.__main__.realtime.settle", lambda: steps.append("settle"))
        if called:
            os.write(writing, b"go\n")
        with open(reading, encoding="ascii") as stdin:
            monkeypatch.setattr("sys.stdin", stdin)
            arguments = ["a", "--graph", str(tmp_path / "g.yaml"), "--run-dir", str(tmp_path), "--spare"]
            assert process.main(arguments) == 0
        os.close(writing)
        return steps

    return run


def test_who_only_stands_by_leaves_the_processor_to_others(stages):
    assert stages(called=False) == ["aside", *READY, "forward"]


def test_who_is_called_before_it_has_imported_anything_hurries(stages):
    assert stages(called=True) == READY


LARGE_AND_SMALL = """
import numpy as np
def resident_mb():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS")) / 1e3
kept, before = [], 0.0
for turn in range(5):
    large = [np.ones(250_000) for _ in range(20)]  # 40 MB, as when a map is drawn anew
    kept.append(np.ones(1000))  # 8 kB that stay
    del large
    before = before or resident_mb()
print(resident_mb(), before)
"""


def test_what_was_large_goes_back_to_the_system_though_something_small_came_after_it():
    ran = subprocess.run(
        [sys.executable, "-c", LARGE_AND_SMALL],
        env=child_environment(Clock()),
        capture_output=True,
        text=True,
        check=True,
    )
    after_mb, first_mb = map(float, ran.stdout.split())
    assert after_mb - first_mb < 4.0


def test_a_pinned_process_stays_on_its_core_with_all_its_threads(tmp_path):
    core = min(os.sched_getaffinity(0))
    (tmp_path / "pinned").mkdir()
    text = NODE.replace(
        "        return 0\n",
        "        import json, os, threading\n"
        "        found = [sorted(os.sched_getaffinity(0))]\n"
        "        look = lambda: found.append(sorted(os.sched_getaffinity(0)))\n"
        "        thread = threading.Thread(target=look)\n"
        "        thread.start()\n"
        "        thread.join()\n"
        "        port.results_dir.mkdir()\n"
        "        (port.results_dir / 'cores.json').write_text(json.dumps(found))\n"
        "        return 0\n",
    )
    (tmp_path / "pinned" / "node.py").write_text(textwrap.dedent(text))
    (tmp_path / "g.yaml").write_text(f"nodes: {{a: {{module: pinned.node, cores: [{core}]}}}}")
    command = [sys.executable, "-m", "runtime.process", "a", "--graph", "g.yaml"]
    command += ["--run-dir", str(tmp_path), "--results-dir", str(tmp_path / "a")]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
    environment.pop(PARENT_VARIABLE, None)
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / "a" / "cores.json").read_text()) == [[core], [core]]
