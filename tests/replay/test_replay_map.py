"""One recording, two ways: through live processes over the bus and in one process, to the same last byte."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.messages import LaserScan, encode, header

ROOT = Path(__file__).resolve().parents[2]
SCANS, BEAMS = 20, 341
S = 10**9
CONFIG = "nodes:\n  mapper: {mapping: {particles: 30}}\n  matcher: {odometry: {deskew: false}}\n"


def ranges_in_room(x, y, yaw):
    bearing = yaw + np.linspace(-2.0, 2.0, BEAMS)
    c, s = np.cos(bearing) + 1e-12, np.sin(bearing) + 1e-12
    to_x = np.where(c > 0, (3.0 - x) / c, (-2.5 - x) / c)
    to_y = np.where(s > 0, (2.0 - y) / s, (-1.5 - y) / s)
    r = np.minimum(to_x, to_y)
    r[40:60] = np.nan
    r[300:305] = np.inf
    return r


@pytest.fixture
def recording(tmp_path):
    rng = np.random.default_rng(4)
    attachments = {"config.yaml": CONFIG.encode()}
    writer = McapWriter(tmp_path / "run.mcap", {"hallway": {"robot": "robot", "seed": "5"}}, attachments)
    channel = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa"})
    for n in range(1, SCANS + 1):
        at_ns = 1_700_000_000 * S + n * S // 10
        ranges = ranges_in_room(0.03 * n, 0.1 * np.sin(0.3 * n), 0.02 * n) + rng.normal(0, 0.005, BEAMS)
        arrays = ranges.astype(np.float32), np.zeros(0, np.float32)
        scan = LaserScan(header(at_ns, "laser"), -2.0, 2.0, 4.0 / (BEAMS - 1), 1e-4, 0.1, 0.02, 5.6, *arrays)
        writer.add(channel, n, at_ns + 1000, at_ns, encode(scan))
    writer.finish()
    return tmp_path / "run.mcap"


def hallway(tmp_path, *arguments):
    environment = {**os.environ, "HALLWAY_RUN": str(tmp_path / "run"), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "runtime.cli", *map(str, arguments)]
    return subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=110, check=False
    )


def test_live_processes_and_one_process_write_the_same_bytes(recording, tmp_path):
    # Slower than recorded, so that the newest scan is never overwritten on a busy machine.
    live = hallway(
        tmp_path, "replay", recording, "--map", "--out", tmp_path / "live", "--rate", "0.4", "--json"
    )
    assert live.returncode == 0, live.stdout + live.stderr
    report = json.loads(live.stdout)
    assert (report["sent"], report["mapped"], report["missing"]) == (SCANS, SCANS, [])
    offline = hallway(tmp_path, "map", recording, "--out", tmp_path / "offline", "--json")
    assert offline.returncode == 0, offline.stderr
    assert json.loads(offline.stdout)["seed"] == 5
    for name in ("trajectory.tum", "odometry.tum", "map.pgm", "map.yaml"):
        assert (tmp_path / "live" / name).read_bytes() == (tmp_path / "offline" / name).read_bytes(), name
    config = (tmp_path / "offline" / "config.yaml").read_text()
    assert "particles: 30" in config
    assert "deskew: false" in config


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--loop"], "plays the scans of one file once"),
        (["--topics", "scan"], "plays the scans of one file once"),
        (["--out", "busy"], "busy: holds other files and no run.json"),
    ],
)
def test_what_cannot_be_mapped_live_is_one_line(recording, tmp_path, arguments, said):
    (tmp_path / "busy").mkdir()
    (tmp_path / "busy" / "thesis.tex").write_text("")
    done = hallway(tmp_path, "replay", recording, "--map", *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
