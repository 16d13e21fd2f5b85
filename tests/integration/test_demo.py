"""The demo as a person sees it: real drivers, matcher and mapper on emulated devices; both killed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from runtime.bus import links
from runtime.bus.zenoh_bus import ZenohBus
from runtime.formats.mcap_log import McapReader
from runtime.process.health import Health

ROOT = Path(__file__).resolve().parents[2]
KILLED = ("matcher", "mapper")


@pytest.fixture
def environment(tmp_path):
    own = {key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")}
    return {**own, "HALLWAY_RUN": str(tmp_path / "run"), "PYTHONPATH": str(ROOT)}


def until(condition, within_s):
    end = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.05)
    return value


def pid_of(health, name):
    vital = health.vitals().get(name)
    return int(vital.number("pid")) if vital is not None and name in health.ready() else 0


@pytest.mark.timeout(300)
def test_the_demo_makes_a_map_although_matcher_and_mapper_are_killed(tmp_path, environment):
    command = [
        sys.executable,
        "-m",
        "runtime.cli",
        "up",
        "demo",
        "--headless",
        "--out",
        str(tmp_path / "res"),
    ]
    run_dir = tmp_path / "run" / "robot"
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as up:
        try:
            until((run_dir / "hub.sock").exists, 200)
            with ZenohBus(links.peer(run_dir, "test")) as bus:
                health = Health(bus, "robot")
                for name in KILLED:
                    seen = mapped(health)
                    until(lambda seen=seen: mapped(health) > seen + 20, 60)
                    old = pid_of(health, name)
                    os.kill(old, signal.SIGKILL)
                    until(lambda name=name, old=old: pid_of(health, name) not in (0, old), 30)
                seen = mapped(health)
                until(lambda: mapped(health) > seen + 20, 60)
                assert health.ready() >= {"simulator", "laser", "base", "operator", "matcher", "mapper"}
        finally:
            up.send_signal(signal.SIGINT)
            out, err = up.communicate(timeout=60)
    complaints = [line for line in err.splitlines() if not line.startswith("still loading")]
    assert (up.returncode, complaints) == (130, [])
    results = tmp_path / "res"
    names = {
        "map.pgm",
        "map.yaml",
        "map.png",
        "trajectory.tum",
        "odometry.tum",
        "metrics.json",
        "config.yaml",
    }
    assert names <= {path.name for path in results.iterdir()}
    readers = [McapReader(path) for path in (results / "ring").iterdir()]
    topics = {message.channel.name for reader in readers for message in reader.messages()}
    assert {"scan", "pose", "map"} <= topics
    assert {reader.state.run_seed for reader in readers} == {1}
    run = json.loads((results / "run.json").read_text())
    restarts = {
        name: process["restarts"] for name, process in run["processes"].items() if process["restarts"]
    }
    assert restarts == dict.fromkeys(KILLED, 1)
    poses = np.loadtxt(results / "trajectory.tum")
    assert poses[-1, 0] - poses[0, 0] > 4.5  # from before the first kill to after the last
    steps_m = np.hypot(*np.diff(poses[:, 1:3], axis=0).T)
    seconds = np.diff(poses[:, 0])
    # The robot drives at 0.3 m/s at most; a frame that began anew would be a leap.
    assert np.all(steps_m < 0.6 * seconds + 0.1)
    assert "matcher: killed by SIGKILL" in out


def mapped(health):
    vital = health.vitals().get("mapper")
    return int(vital.number("scans")) if vital is not None else 0
