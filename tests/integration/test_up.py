"""`hallway up` as a person runs it: real processes, real bus, from the first line to the exit code."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from runtime.bus import links
from runtime.bus.zenoh_bus import ZenohBus
from runtime.process.health import Health

ROOT = Path(__file__).resolve().parents[2]

NODES = {
    "source": """
        import time
        import numpy as np
        from dataclasses import dataclass
        from runtime import messages
        SUBSCRIBES, PUBLISHES = (), ("scan",)
        @dataclass(frozen=True, slots=True, kw_only=True)
        class Config:
            period_s: float = 0.05
            crash_after: int = 0
            hang_after: int = 0
            def __post_init__(self):
                if self.period_s <= 0:
                    raise ValueError(f"period_s = {self.period_s}, must be more than 0")
        def run(port, config):
            port.ready()
            sent = 0
            while not port.stopping:
                time.sleep(config.period_s)
                sent += 1
                if config.crash_after and sent > config.crash_after:
                    raise RuntimeError("the mirror fell off")
                while config.hang_after and sent > config.hang_after:
                    time.sleep(1.0)
                head = messages.header(port.clock.now_ns(), "laser")
                arrays = np.ones(682, np.float32), np.zeros(0, np.float32)
                scan = messages.LaserScan(head, 0.0, 1.0, 0.1, 0.0, 0.1, 0.0, 9.0, *arrays)
                port.publish("scan", scan)
            return 0
    """,
    "sink": """
        import json
        import numpy as np
        from dataclasses import dataclass
        from runtime import messages
        from runtime.nodes.convert import pose_to_message
        SUBSCRIBES, PUBLISHES = ("scan",), ("pose",)
        @dataclass(frozen=True, slots=True, kw_only=True)
        class Config:
            deaf: bool = False
        def run(port, config):
            scans = port.subscribe("scan")
            port.ready()
            count = 0
            while config.deaf or not port.stopping:
                received = scans.wait(0.2)
                if received is not None:
                    count += 1
                    pose = messages.PoseWithCovariance(pose_to_message(np.zeros(3)), np.zeros(36))
                    port.publish("pose", messages.PoseWithCovarianceStamped(received.message.header, pose))
                    port.report("ok", "counting", state="TRACKING")
            port.results_dir.mkdir(parents=True, exist_ok=True)
            (port.results_dir / "trajectory.tum").write_text("poses\\n" * count)
            (port.results_dir / "metrics.json").write_text(json.dumps({"counted": count}))
            return 0
    """,
}
GRAPH = """
robot: trial
nodes:
  monitor: {{module: monitor, required: false}}
  sink: {{module: up_nodes.sink{sink}}}
  source: {{module: up_nodes.source, after: [sink, monitor]{source}}}
"""


class Desk:
    """A folder with nodes and a graph, and `hallway` to run on it."""

    def __init__(self, folder):
        self.folder = folder
        package = folder / "up_nodes"
        package.mkdir()
        for name, text in NODES.items():
            (package / f"{name}.py").write_text(textwrap.dedent(text))
        self.graph()
        self.environment = {
            **{key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")},
            "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}",
            "HALLWAY_RUN": str(folder / "run"),
        }

    def graph(self, source="", sink=""):
        (self.folder / "g.yaml").write_text(GRAPH.format(source=source, sink=sink))

    def start(self, *arguments):
        return subprocess.Popen(
            [sys.executable, "-m", "runtime.cli", *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def hallway(self, *arguments, within_s=60.0):
        process = self.start(*arguments)
        out, err = self.ended(process, within_s)
        return process.returncode, out, err

    def ended(self, process, within_s):
        """Return what it said until its end, without the word that on a busy machine loading takes long."""
        out, err = process.communicate(timeout=within_s)
        said = [line for line in err.splitlines(keepends=True) if not line.startswith("still loading")]
        return out, "".join(said)

    def left(self):
        """Return the processes of this desk that still live."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                if str(self.folder).encode() in (entry / "cmdline").read_bytes():
                    found.append(entry.name)
            except OSError:
                continue
        return found


@pytest.fixture
def desk(tmp_path):
    made = Desk(tmp_path)
    yield made
    assert made.left() == []


def wait_for_line(process, text):
    lines = []
    for line in process.stdout:
        lines.append(line)
        if text in line:
            return lines
    raise AssertionError("".join(lines) + process.stderr.read())


def test_a_node_whose_loop_hangs_while_its_heartbeat_goes_on_is_started_again(desk):
    desk.graph(source=", turn_s: 1.5, config: {hang_after: 10}")
    up = desk.start("up", "g.yaml", "--headless", "--out", "res")
    lines = wait_for_line(up, "source: its loop has not turned for 1.5 s")
    wait_for_line(up, "source: ready")
    up.send_signal(signal.SIGINT)
    up.communicate(timeout=20)
    told = json.loads((desk.folder / "res" / "run.json").read_text())["processes"]
    assert told["source"]["reasons"][0] == "its loop has not turned for 1.5 s"
    assert [told[name]["restarts"] for name in ("sink", "monitor")] == [0, 0]
    assert not any("sink: its" in line for line in lines)


def test_a_graph_runs_for_its_time_and_leaves_its_results(desk):
    code, out, err = desk.hallway("up", "g.yaml", "--headless", "--duration", "3", "--out", "res")
    assert (code, err) == (0, "")
    assert "all processes run after" in out
    results = desk.folder / "res"
    metrics = json.loads((results / "metrics.json").read_text())
    assert metrics["counted"] > 30
    assert metrics["counted"] == len((results / "trajectory.tum").read_text().splitlines())
    assert metrics["latency"]["mapped"] <= metrics["latency"]["scans"] <= metrics["counted"] + 5
    assert metrics["latency"]["hops"]["whole"]["p50"] < 1000
    run = json.loads((results / "run.json").read_text())
    assert run["exit_code"] == 0
    assert {name: process["state"] for name, process in run["processes"].items()} == dict.fromkeys(
        ("hub", "monitor", "sink", "source"), "ended"
    )
    assert "period_s: 0.05" in (results / "config.yaml").read_text()
    assert sorted(p.name for p in (results / "logs").iterdir()) == [
        "hub.log",
        "monitor.log",
        "sink.log",
        "source.log",
        "supervisor.log",
    ]
    assert f"used {metrics['latency']['mapped']} of {metrics['latency']['scans']} scans" in out
    assert not (desk.folder / "run" / "trial").exists()


def test_ctrl_c_ends_everything_within_two_seconds_with_the_results_saved(desk):
    process = desk.start("up", "g.yaml", "--out", "res")
    wait_for_line(process, "all processes run after")
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.wait(20)
    took_s = time.monotonic() - began
    process.communicate()
    assert process.returncode == 130
    assert took_s < 4.0  # two, and as much again for a machine that others use
    assert (desk.folder / "res" / "trajectory.tum").exists()
    assert json.loads((desk.folder / "res" / "run.json").read_text())["exit_code"] == 130


def test_a_process_that_ignores_everything_is_ended_and_the_rest_is_saved(desk):
    desk.graph(sink=", config: {deaf: true}")
    process = desk.start("up", "g.yaml", "--out", "res")
    wait_for_line(process, "all processes run after")
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=20)
    assert "sink: saves what it has; 1 s more at most" in out
    assert "sink: did not end within 1.8 s" in out
    assert process.returncode == 0


def test_a_supervisor_that_is_killed_leaves_nobody_behind(desk):
    process = desk.start("up", "g.yaml", "--out", "res")
    wait_for_line(process, "all processes run after")
    process.kill()
    process.communicate()
    end = time.monotonic() + 10
    while desk.left() and time.monotonic() < end:
        time.sleep(0.05)
    assert desk.left() == []
    assert json.loads((desk.folder / "res" / "run.json").read_text()) == {"finished": False}
    code, _, err = desk.hallway("up", "g.yaml", "--out", "res", "--duration", "0.5")
    assert (code, err) == (0, "")
    assert json.loads((desk.folder / "res" / "run.json").read_text())["finished"]


def test_a_process_that_is_killed_comes_back_and_the_run_goes_on(desk):
    process = desk.start("up", "g.yaml", "--out", "res", "--duration", "6")
    lines = wait_for_line(process, "all processes run after")
    assert any("source: ready" in line for line in lines)
    pid = next(
        int(pid)
        for pid in desk.left()
        if b"runtime.process\0source\0" in Path(f"/proc/{pid}/cmdline").read_bytes()
    )
    os.kill(pid, signal.SIGKILL)
    out, err = desk.ended(process, within_s=40)
    assert (process.returncode, err) == (0, "")
    assert "source: killed by SIGKILL; starts again in 0 s" in out
    assert "source: 1 restarts, last: killed by SIGKILL" in out


def test_a_crash_loop_ends_the_run_with_its_reason(desk):
    desk.graph(source=", config: {crash_after: 1}, restart: never")
    code, out, err = desk.hallway("up", "g.yaml", "--out", "res", "--json")
    assert code == 1
    assert err == "hallway up: source: exit code 1: RuntimeError: the mirror fell off\n"
    report = json.loads(out)
    assert report["reason"] == "source: exit code 1: RuntimeError: the mirror fell off"
    assert "Traceback" in (desk.folder / "res" / "logs" / "source.log").read_text()


@pytest.mark.parametrize(
    ("source", "text"),
    [
        (", config: {period_s: 0}", "nodes.source.config: period_s = 0.0, must be more than 0"),
        (", config: {preiod_s: 1}", "nodes.source.config.preiod_s: unknown key; did you mean 'period_s'?"),
        (", modul: x", "nodes.source.modul: unknown key; did you mean 'module'?"),
    ],
)
def test_a_wrong_graph_is_one_line_and_nothing_starts(desk, source, text):
    desk.graph(source=source)
    code, out, err = desk.hallway("up", "g.yaml", "--out", "res")
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1
    assert not (desk.folder / "res").exists()


def test_one_robot_runs_once_and_another_beside_it(desk):
    first = desk.start("up", "g.yaml", "--out", "one")
    wait_for_line(first, "all processes run after")
    code, _, err = desk.hallway("up", "g.yaml", "--out", "two")
    assert code == 2
    assert f"robot 'trial' runs already, under process {first.pid}" in err
    assert not (desk.folder / "two").exists()
    code, out, _ = desk.hallway("up", "g.yaml", "--out", "three", "--robot", "other", "--duration", "1")
    assert code == 0
    code, out, _ = desk.hallway("status", "--robot", "trial", "--once", "--json")
    status = json.loads(out)
    assert (code, status["tracking"]) == (0, "")
    assert {line["name"] for line in status["processes"]} >= {
        "hub",
        "monitor",
        "sink",
        "source",
        "supervisor",
    }
    code, out, _ = desk.hallway("topic", "--robot", "trial", "hz", "scan", "-n", "10")
    assert code == 0
    code, out, _ = desk.hallway("topic", "--robot", "trial", "list")
    assert "trial/scan" in out
    code, out, _ = desk.hallway("logs", "--robot", "trial", "source")
    assert code == 0
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=20)


def test_the_status_as_a_stream_tells_of_the_hub_and_of_the_clock(desk):
    up = desk.start("up", "g.yaml", "--out", "res")
    wait_for_line(up, "all processes run after")
    status = desk.start("status", "--robot", "trial", "--json")
    hub = clock = None
    for line in status.stdout:
        told = json.loads(line)
        hub = next((process for process in told["processes"] if process["name"] == "hub"), None)
        clock = told["clock_offset_ns"]
        if hub is not None and clock is not None and hub["pid"]:
            break
    status.send_signal(signal.SIGINT)
    status.communicate(timeout=20)
    assert b"runtime.supervision.hub" in Path(f"/proc/{hub['pid']}/cmdline").read_bytes()
    assert hub["rss_mb"] > 1
    assert abs(clock) < 50_000_000  # one machine, one clock
    with ZenohBus(links.peer(desk.folder / "run" / "trial", "test")) as bus:
        health = Health(bus, "trial")
        end = time.monotonic() + 20
        while "supervisor" not in health.vitals():
            assert time.monotonic() < end
            time.sleep(0.05)
        assert health.vitals()["supervisor"].number("loop_age_s") < 1.5
    staying = desk.start("status", "--robot", "trial", "--json")
    first = staying.stdout.readline()
    up.send_signal(signal.SIGINT)
    up.communicate(timeout=20)
    out, err = staying.communicate(timeout=20)
    assert all(json.loads(line)["robot"] == "trial" for line in (first, *out.splitlines()))
    assert err == "robot 'trial' has ended\n"


def test_old_results_of_that_name_are_kept_beside_the_new(desk):
    for _ in range(2):
        code, _, err = desk.hallway("up", "g.yaml", "--out", "res", "--duration", "0.5")
        assert (code, err) == (0, "")
    assert (desk.folder / "res" / "run.json").exists()
    assert (desk.folder / "res.old" / "run.json").exists()


def test_a_folder_of_other_things_is_not_touched(desk):
    (desk.folder / "photos").mkdir()
    (desk.folder / "photos" / "cat.png").write_text("cat")
    code, _, err = desk.hallway("up", "g.yaml", "--out", "photos")
    assert code == 2
    assert "photos: holds " in err
    assert (desk.folder / "photos" / "cat.png").read_text() == "cat"


def test_without_keys_no_door_is_opened(desk):
    desk.environment["HALLWAY_KEYS"] = str(desk.folder / "keys")
    code, out, err = desk.hallway("up", "g.yaml", "--out", "res", "--remote")
    assert (code, out) == (2, "")
    assert "robot 'trial' has no keys yet; make them with: hallway keys make" in err
