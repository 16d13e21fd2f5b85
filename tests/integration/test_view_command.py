"""`hallway view` as a person types it."""

import os
import signal
import subprocess
import sys
import time

import pytest

from runtime import messages
from runtime.cli import main
from runtime.formats.mcap_log import McapChannel, McapReader
from runtime.nodes.viewing import server as viewer_server
from runtime.recordings.recording import Recording, RecordingConfig
from runtime.topics import topic
from tests.integration import viewer_story as story


@pytest.fixture
def recording(tmp_path):
    """A drive of four seconds as an MCAP file."""
    writer = Recording(tmp_path / "drive.mcap", "robot", RecordingConfig(min_free_mb=0), story.BEGIN_NS)
    for number, one in enumerate(story.drive(40)):
        channel = McapChannel(f"/robot/{one.topic}", topic(one.topic).type, {})
        payload = messages.encode(one.message)
        writer.add(channel, number, one.received_ns, one.published_ns, payload)
    writer.close(story.stamp(50))
    return tmp_path / "drive.mcap"


def entities(rrd):
    command = [viewer_server.program(), "rrd", "stats", str(rrd)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_a_recording_becomes_a_picture_in_a_file(recording, tmp_path, capsys):
    file = tmp_path / "drive.rrd"
    assert main(["view", str(recording), "--save", str(file)]) == 0
    assert "of 'robot'" in capsys.readouterr().err
    stats = entities(file)
    assert "/world/map: " in stats
    assert "/latency/scan_to_pose: " in stats


def test_a_picture_of_a_recording_without_a_map_brings_its_layout_too(recording, tmp_path):
    bare = Recording(tmp_path / "bare.mcap", "robot", RecordingConfig(min_free_mb=0), story.BEGIN_NS)
    for message in McapReader(recording).messages():
        if message.channel.name in ("scan", "pose"):
            bare.add(message.channel, message.sequence, message.log_ns, message.publish_ns, message.payload)
    bare.close(story.stamp(50))
    file = tmp_path / "bare.rrd"
    assert main(["view", str(tmp_path / "bare.mcap"), "--save", str(file)]) == 0
    command = [viewer_server.program(), "rrd", "print", str(file)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "make_active: true" in told


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_a_recording_is_shown_on_a_page_until_ctrl_c(recording, tmp_path, kind):
    file = recording
    if kind == "rrd":
        file = tmp_path / "drive.rrd"
        assert main(["view", str(recording), "--save", str(file)]) == 0
    port = viewer_server.free_port(0)
    page = viewer_server.free_port(0, taken=port)
    ports = ["--port", str(port), "--web-port", str(page)]
    command = [sys.executable, "-m", "runtime.cli", "view", str(file), "--web", *ports]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "look at this page, Ctrl-C ends:\n"
        address = process.stdout.readline().removesuffix("\n")
        assert address == f"http://127.0.0.1:{page}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(5) == 130
        assert time.monotonic() - began < 2.0
    assert not viewer_server.listens(port)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["view", "--web", "--save", "x.rrd"], "choose one"),
        (["view", "nowhere.mcap", "--save", "x.rrd"], "nowhere.mcap: No such file"),
        (["view", "nowhere.rrd", "--web"], "nowhere.rrd: No such file"),
        (["view", "empty.mcap", "--save", "x.rrd"], "empty.mcap: the file is empty"),
        (["view", "empty.mcap", "--save", "x.txt"], "--save x.txt: must end in .rrd"),
        (["view", "empty.mcap", "--save", "empty.mcap/x.rrd"], "empty.mcap cannot be written to"),
        (["view", ".", "--save", "x.rrd"], ".: a folder without session.mcap"),
        (["view", "--memory", "1"], "memory_mb = 1"),
        (["view", "--robot", "nobody", "--web"], "nobody"),
        (["view", "--robot", "nobody", "--connect", "10.0.0.7", "--web"], "not paired with 'nobody'"),
    ],
)
def test_a_wrong_wish_is_one_clear_line(arguments, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "empty.mcap").touch()
    assert main(arguments) not in (0, 130)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not os.path.exists("x.rrd")


def test_a_file_that_exists_is_not_overwritten(recording, tmp_path, capsys):
    file = tmp_path / "drive.rrd"
    file.write_text("mine")
    assert main(["view", str(recording), "--save", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert file.read_text() == "mine"


def test_the_states_of_a_recording_are_shown_too(recording, tmp_path):
    file = tmp_path / "drive.rrd"
    assert main(["view", str(recording), "--save", str(file)]) == 0
    stats = entities(file)
    assert "/state/tracking: " in stats
    assert "/state/words: " in stats


def test_a_recording_of_something_else_is_named_before_anything_is_written(tmp_path, capsys):
    writer = Recording(tmp_path / "other.mcap", "robot", RecordingConfig(min_free_mb=0), story.BEGIN_NS)
    channel = McapChannel("/robot/truth", "geometry_msgs/msg/PoseStamped", {})
    writer.add(channel, 1, story.BEGIN_NS, story.BEGIN_NS, b"\0\1\0\0")
    writer.close(story.stamp(1))
    assert main(["view", str(tmp_path / "other.mcap"), "--save", str(tmp_path / "x.rrd")]) == 2
    assert "nothing to show" in capsys.readouterr().err
    assert not (tmp_path / "x.rrd").exists()


def test_looking_at_a_robot_ends_with_the_robot(tmp_path):
    graph = tmp_path / "graph.yaml"
    graph.write_text("robot: looked_at\nnodes:\n  simulator: {module: simulator}\n")
    hallway = [sys.executable, "-m", "runtime.cli"]
    up = [*hallway, "up", str(graph), "--headless", "--duration", "6", "--out", str(tmp_path / "run")]
    view = [*hallway, "view", "--robot", "looked_at", "--save", str(tmp_path / "look.rrd")]
    with subprocess.Popen(up, stdout=subprocess.PIPE, text=True) as robot:
        for line in robot.stdout:
            if line.startswith("all processes run"):
                break
        else:
            raise AssertionError("the robot did not start")
        look = subprocess.run(view, capture_output=True, text=True, timeout=60, check=False)
        robot.stdout.read()
    assert look.returncode == 0, look.stderr
    assert look.stdout.startswith("saving to ")
    assert "/state/words: " in entities(tmp_path / "look.rrd")
