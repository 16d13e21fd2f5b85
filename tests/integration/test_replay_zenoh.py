"""Replay and record as people run them: two commands, a real bus, and the same bytes at both ends."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from runtime import rundir
from runtime.bus import links
from runtime.bus.zenoh_bus import ZenohBus
from runtime.cli import main
from runtime.clock import Clock
from runtime.formats.mcap_log import McapChannel, McapReader
from runtime.formats.mcap_writer import McapWriter
from runtime.messages import LaserScan, encode, header, topic_key
from runtime.process.identity import Identity
from runtime.process.node import BusPort

ROOT = Path(__file__).resolve().parents[2]
S = 10**9
SCAN = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa" * 16})
COMMAND = McapChannel("/robot/cmd_vel", "geometry_msgs/msg/TwistStamped", {"gid": "bb" * 16})


def payload(n):
    ranges = np.random.default_rng(n).uniform(0.1, 5, 682).astype(np.float32)
    head = header(1_700_000_000 * S + n * S // 10, "laser")
    return encode(LaserScan(head, -2.0, 2.0, 0.006, 0.0, 0.1, 0.02, 5.6, ranges, np.zeros(0, np.float32)))


@pytest.fixture
def recording(tmp_path):
    writer = McapWriter(tmp_path / "run.mcap", {"hallway": {"robot": "robot"}})
    for n in range(1, 41):
        at_ns = 1_700_000_000 * S + n * S // 20
        writer.add(SCAN, n, at_ns, at_ns, payload(n))
        writer.add(COMMAND, n, at_ns, at_ns, b"\x00\x01\x00\x00")
    writer.finish()
    return tmp_path / "run.mcap"


@pytest.fixture
def desk(tmp_path):
    """Starts commands that share a run directory of their own, and ends those that a failed test leaves."""
    started = []
    environment = {**os.environ, "HALLWAY_RUN": str(tmp_path / "run"), "PYTHONPATH": str(ROOT)}

    def start(*arguments):
        command = [sys.executable, "-m", "runtime.cli", *map(str, arguments)]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        child = subprocess.Popen(command, cwd=tmp_path, env=environment, text=True, **pipes)
        started.append(child)
        return child

    yield start
    for child in started:
        if child.poll() is None:
            child.kill()
            child.communicate()


def test_what_is_replayed_is_recorded_byte_for_byte(desk, recording, tmp_path):
    player = desk("replay", recording, "--as", "ghost", "--wait", "--json")
    hub = tmp_path / "run" / "ghost" / "hub.sock"
    _wait(lambda: hub.exists() or player.poll() is not None)
    recorder = desk("record", "--robot", "ghost", "--out", tmp_path / "copy.mcap", "--json")
    played, told = player.communicate(timeout=60)
    assert player.returncode == 0, told
    recorded, told = recorder.communicate(timeout=30)
    assert recorder.returncode == 0, told
    assert json.loads(played)["sent"] == {"scan": 40}
    assert json.loads(recorded)["lost"] == 0
    messages = list(McapReader(tmp_path / "copy.mcap").messages())
    scans = [m for m in messages if m.channel.topic == "/ghost/scan"]
    assert [m.payload for m in scans] == [payload(n) for n in range(1, 41)]
    arrivals = np.array([m.log_ns for m in scans]) / 1e9
    # Neither all at once nor at half the rate; on a busy machine some are late.
    assert 0.5 < (arrivals[-1] - arrivals[0]) / (39 * 0.05) < 1.95
    assert not any(m.channel.name == "cmd_vel" for m in messages)


def test_what_is_missing_from_the_recording_is_a_table_and_exit_code_4(desk, tmp_path):
    writer = McapWriter(tmp_path / "holed.mcap")
    for n in (*range(1, 11), *range(21, 31)):
        at_ns = 1_700_000_000 * S + n * S // 20
        writer.add(SCAN, n, at_ns, at_ns, payload(n))
    writer.finish()
    player = desk("replay", "holed.mcap", "--as", "ghost", "--rate", "0")
    out, told = player.communicate(timeout=60)
    assert player.returncode == 4, told
    assert "not in the recording              time s    first   count\n" in out
    assert "/robot/scan                        1.000       11      10\n" in out
    assert "hallway replay: 10 messages of /robot/scan, by its sequence numbers" in told
    player = desk("replay", "holed.mcap", "--as", "ghost", "--rate", "0", "--json")
    report = json.loads(player.communicate(timeout=60)[0])
    assert player.returncode == 4
    assert report["losses"] == ["10 messages of /robot/scan, by its sequence numbers"]
    assert report["gaps"] == [{"topic": "/robot/scan", "at_s": 1.0, "first": 11, "count": 10}]


def test_a_robot_that_speaks_itself_is_not_played_over(desk, recording, tmp_path):
    first = desk("replay", recording, "--as", "ghost", "--wait")
    hub = tmp_path / "run" / "ghost" / "hub.sock"
    _wait(lambda: hub.exists() or first.poll() is not None)
    for _ in range(20):  # its tokens come a moment after its hub
        second = desk("replay", recording, "--as", "ghost", "--rate", "0")
        _, told = second.communicate(timeout=30)
        if second.returncode == 2:
            break
    assert second.returncode == 2
    assert "robot 'ghost' runs and publishes scan itself; play as another with --as" in told
    first.terminate()
    first.communicate(timeout=10)
    assert first.returncode == 130


def _wait(done, within_s=20.0):
    end = time.monotonic() + within_s
    while not done() and time.monotonic() < end:
        time.sleep(0.02)
    assert done()


def test_a_replay_in_a_domain_of_its_own_is_recorded_there_as_the_run_that_it_was(desk, tmp_path):
    about = {"hallway": {"robot": "robot", "seed": "5"}}
    writer = McapWriter(tmp_path / "run.mcap", about, {"config.yaml": b"nodes: {}\n"})
    for n in range(1, 21):
        at_ns = 1_700_000_000 * S + n * S // 20
        writer.add(SCAN, n, at_ns, at_ns, payload(n))
    writer.finish()
    player = desk("replay", "run.mcap", "--as", "ghost", "--wait", "--domain", "7", "--json")
    hub = tmp_path / "run" / "ghost" / "hub.sock"
    _wait(lambda: hub.exists() or player.poll() is not None)
    recorder = desk("record", "--robot", "ghost", "--out", tmp_path / "copy.mcap", "--json")
    _, told = player.communicate(timeout=60)
    assert player.returncode == 0, told
    _, told = recorder.communicate(timeout=30)
    assert recorder.returncode == 0, told
    reader = McapReader(tmp_path / "copy.mcap")
    scans = [m for m in reader.messages() if m.channel.name == "scan"]
    assert len(scans) == 20
    assert scans[0].channel.metadata["zenoh_key"].startswith("7/ghost/scan/")
    assert reader.state.run_seed == 5
    assert reader.state.run_config == "nodes: {}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.mcap"], "nowhere.mcap: No such file"),
        (["run.mcap", "--rate", "-1"], "rate = -1.0"),
        (["run.mcap", "--topics", "map"], "topic 'map': not recorded; there are cmd_vel, scan"),
        (["run.mcap", "--as", "R2 D2"], "must be lower-case letters"),
        (["run.mcap", "--out", "x"], "--out: only with --map"),
        (["bad.mcap"], "not an MCAP file"),
    ],
)
def test_what_cannot_be_played_is_one_line_and_exit_code_2(
    recording, tmp_path, monkeypatch, capsys, arguments, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.mcap").write_text("no recording")
    assert main(["replay", *arguments]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1


@pytest.fixture
def robot_in_domain_7(tmp_path, monkeypatch):
    """A robot that says scans and whose directory tells what it is; its clock is an hour ahead."""
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path / "run"))
    ahead = Clock(Clock().offset_ns + 3600 * S)
    leaving = threading.Event()

    def speak(port):
        while not leaving.wait(0.02):
            port.publish_raw("scan", payload(1))

    with rundir.claimed("ghost") as run_dir, ZenohBus(links.hub(run_dir)) as hub:
        Identity(seed=5, domain=7, clock_offset_ns=ahead.offset_ns).leave(run_dir)
        with BusPort("laser", lambda: hub, publishes=("scan",), robot="ghost", domain=7, clock=ahead) as port:
            speaking = threading.Thread(target=speak, args=(port,))
            speaking.start()
            yield run_dir
            leaving.set()
            speaking.join()


def record(tmp_path, *arguments):
    code = main(["record", "--robot", "ghost", "--out", str(tmp_path / "a.mcap"), *arguments])
    reader = McapReader(tmp_path / "a.mcap")
    return code, [m for m in reader.messages() if m.channel.name == "scan"], reader.state


def test_a_recording_is_made_by_the_domain_the_clock_and_the_seed_of_its_robot(
    robot_in_domain_7, tmp_path, capsys
):
    code, scans, state = record(tmp_path, "--duration", "1")
    assert code == 0
    assert len(scans) > 10
    assert scans[0].channel.metadata["zenoh_key"].startswith("7/ghost/scan/")
    assert all(0 <= m.log_ns - m.publish_ns < 5 * S for m in scans)
    assert state.run_seed == 5
    assert "no scan" not in capsys.readouterr().err


def test_a_recording_is_played_in_the_domain_of_the_robot_that_runs(robot_in_domain_7, tmp_path, capsys):
    writer = McapWriter(tmp_path / "run.mcap")
    battery = McapChannel("/robot/battery", "sensor_msgs/msg/BatteryState", {"gid": "aa"})
    for n in range(1, 4):
        writer.add(battery, n, n * S, n * S, b"\x00\x01\x00\x00")
        writer.add(SCAN, n, n * S, n * S, payload(n))
    writer.finish()
    heard = []
    with ZenohBus(links.visitor(robot_in_domain_7)) as bus:
        for domain in (0, 7):
            key = topic_key("ghost/battery", battery.msgtype, domain)
            bus.subscribe(key, lambda arrival: heard.append(arrival.key))
        play = ["replay", str(tmp_path / "run.mcap"), "--as", "ghost", "--rate", "0"]
        assert main([*play, "--topics", "battery"]) == 0
        _wait(lambda: len(heard) == 3)
        assert {key.partition("/")[0] for key in heard} == {"7"}
        # It says scans there, and nowhere else.
        assert main([*play, "--topics", "scan"]) == 2
        assert main([*play, "--topics", "battery", "scan", "--domain", "0"]) == 0
        _wait(lambda: len(heard) == 6)
        assert {key.partition("/")[0] for key in heard[3:]} == {"0"}


def test_a_recording_without_a_scan_says_so(robot_in_domain_7, tmp_path, capsys):
    code, scans, _ = record(tmp_path, "--duration", "0.5", "--domain", "0")
    assert (code, scans) == (0, [])
    assert "no scan came from robot 'ghost' in ROS domain 0" in capsys.readouterr().err


def test_a_recording_that_the_disk_ends_is_over_at_once(robot_in_domain_7, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "runtime.recordings.recording.shutil.disk_usage", lambda folder: SimpleNamespace(free=0)
    )
    assert main(["record", "--robot", "ghost", "--out", str(tmp_path / "a.mcap"), "--json"]) == 4
    report = json.loads(capsys.readouterr().out)
    assert (report["files"], report["stopped"]) == ([], "the disk was full")


def test_a_ring_is_kept_by_its_name_and_nothing_else_of_its_folder(robot_in_domain_7, tmp_path, capsys):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "other.mcap").write_bytes(b"of somebody else")
    keep = ["record", "--robot", "ghost", "--keep", "--out", str(tmp_path / "kept")]
    assert main(keep) == 2
    assert "keeps no ring here" in capsys.readouterr().err
    ring = ["--ring", "10", "--duration", "0.5", "--out", str(tmp_path / "a.mcap")]
    assert main(["record", "--robot", "ghost", *ring]) == 0
    assert main(keep) == 0
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["a_00000000.mcap"]


def test_recording_a_robot_that_does_not_run_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path / "run"))
    monkeypatch.chdir(tmp_path)
    assert main(["record", "--robot", "nobody"]) == 1
    assert "robot 'nobody' does not run here" in capsys.readouterr().err
    assert not (tmp_path / "recordings").exists()
