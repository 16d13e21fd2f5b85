"""The recorder process, on a bus in memory."""

import dataclasses
import logging
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from runtime.bus.memory import MemoryBus
from runtime.clock import Clock
from runtime.errors import ConfigError
from runtime.formats.mcap_log import McapReader
from runtime.messages import decode
from runtime.nodes import recorder
from runtime.nodes.keeping import RingKeeper, ask_to_keep
from runtime.port import ListPort
from runtime.process.identity import Identity, left_in
from runtime.process.node import BusPort
from runtime.recordings.recording import RecordingConfig
from runtime.topics import TOPICS

PLENTY = RecordingConfig(min_free_mb=0.0)


def config(path, **kwargs):
    return recorder.Config(file=str(path), recording=PLENTY, **kwargs)


@pytest.fixture
def bus():
    with MemoryBus() as bus:
        yield bus


def recorder_port(bus, tmp_path):
    port = BusPort("recorder", lambda: bus.join(), subscribes=recorder.SUBSCRIBES, run_dir=tmp_path)
    port.clock = Clock()
    return port


def publisher(bus, *topics):
    return BusPort("source", lambda: bus.join(), publishes=topics)


def record_while(bus, tmp_path, say, **kwargs):
    """Run the recorder; `say(turn)` is called between its turns and returns whether it is over."""
    turns = iter(range(10_000))
    with recorder_port(bus, tmp_path) as port:

        def turn(recording):
            if say(next(turns)):
                port.stop()

        settings = config(tmp_path / "a.mcap", **kwargs)
        recording = recorder.record(port, settings, turn, left_in(tmp_path))
    reader = McapReader(tmp_path / "a.mcap")
    return recording, list(reader.messages()), reader.state


def test_every_message_is_in_the_file_with_its_number_and_publisher(bus, tmp_path):
    with publisher(bus, "scan", "odom") as source:

        def say(turn):
            source.publish_raw("scan", b"scan%d" % turn)
            source.publish_raw("odom", b"odom%d" % turn)
            return turn == 9

        recording, messages, state = record_while(bus, tmp_path, say)
    scans = [m for m in messages if m.channel.topic == "/robot/scan"]
    assert [m.payload for m in scans] == [b"scan%d" % n for n in range(10)]
    assert [m.sequence for m in scans] == list(range(1, 11))
    assert len({m.channel.publisher for m in scans}) == 1
    assert all(0 < m.publish_ns <= m.log_ns for m in scans)
    assert [m.log_ns for m in messages] == sorted(m.log_ns for m in messages)
    assert (
        scans[0].channel.metadata["zenoh_key"].startswith("0/robot/scan/sensor_msgs::msg::dds_::LaserScan_/")
    )
    assert recording.counts.total_lost == 0
    assert state.troubles() == []


def test_the_file_tells_versions_clock_seed_and_configuration(bus, tmp_path):
    Identity(seed=7, domain=3, version="1.2", host="onboard").leave(tmp_path)
    (tmp_path / "config.yaml").write_text("nodes: {}\n")
    _, _, state = record_while(bus, tmp_path, lambda turn: turn == 1)
    about = state.metadata["hallway"]
    assert about["robot"] == "robot"
    assert state.run_seed == 7
    assert (about["robot.version"], about["robot.host"]) == ("1.2", "onboard")
    assert about["version.mcap"][0].isdigit()
    assert int(about["clock_offset_ns"]) > 10**18
    assert state.attachments == {"config.yaml": b"nodes: {}\n"}


def test_what_nobody_tells_of_a_run_is_unknown_in_its_recording(bus, tmp_path):
    _, _, state = record_while(bus, tmp_path, lambda turn: turn == 1)
    about = state.metadata["hallway"]
    assert {about[name] for name in ("seed", "robot.version", "robot.host")} == {"unknown"}
    assert state.run_seed is None
    assert state.attachments == {}


def record_ring(bus, tmp_path, name, turn):
    settings = recorder.Config(
        file=str(tmp_path / name), recording=RecordingConfig(ring_s=10, min_free_mb=0.0)
    )
    with recorder_port(bus, tmp_path) as port:
        return recorder.record(port, settings, lambda recording: turn(port, recording), Identity())


def test_a_ring_has_a_folder_of_its_own_that_the_robot_leads_to(bus, tmp_path):
    def turn(port, recording):
        assert (tmp_path / "ring").readlink() == tmp_path / "a" / "a.mcap"
        port.stop()

    recording = record_ring(bus, tmp_path, "a.mcap", turn)
    assert recording.files == [tmp_path / "a" / "a_00000000.mcap"]


def test_a_second_ring_leaves_the_first_one_its_files_and_its_place(bus, tmp_path, caplog):
    def turn(port, recording):
        with pytest.raises(ConfigError, match="another recorder keeps a ring there"):
            record_ring(bus, tmp_path, "a.mcap", turn)
        second = record_ring(bus, tmp_path, "b.mcap", lambda port, recording: port.stop())
        assert second.files == [tmp_path / "b" / "b_00000000.mcap"]
        port.stop()

    record_ring(bus, tmp_path, "a.mcap", turn)
    assert (tmp_path / "ring").readlink() == tmp_path / "a" / "a.mcap"
    assert "`hallway record --keep` keeps this ring, not the new one" in caplog.text
    record_ring(bus, tmp_path, "c.mcap", lambda port, recording: port.stop())
    assert (tmp_path / "ring").readlink() == tmp_path / "c" / "c.mcap"


def test_a_ring_is_kept_once_when_somebody_asks_twice_on_the_bus(bus, tmp_path):
    answers = []

    def turn(port, recording):
        answers.append(ask_to_keep(bus, "robot"))
        if len(answers) == 2:
            port.stop()

    record_ring(bus, tmp_path, "a.mcap", turn)
    assert answers[0] == answers[1]
    (folder,) = map(Path, answers[0])
    assert folder.parent == tmp_path
    assert folder.name.startswith("a-kept-")
    assert [path.name for path in folder.iterdir()] == ["a_00000000.mcap"]
    assert McapReader.is_whole(folder / "a_00000000.mcap")
    assert ask_to_keep(bus, "robot") == []  # the recorder has gone


def test_a_ring_that_cannot_be_kept_is_told_in_the_log(tmp_path, caplog):
    (tmp_path / "ring").mkdir()
    (tmp_path / "ring" / "ring_00000000.mcap").touch()
    keeper = RingKeeper(tmp_path / "ring" / "ring.mcap", 0.0, logging.getLogger("test"))
    (tmp_path / f"ring-kept-{time.strftime('%Y%m%d-%H%M%S')}").touch()
    (tmp_path / f"ring-kept-{time.strftime('%Y%m%d-%H%M%S', time.localtime(time.time() + 1))}").touch()
    folder = keeper.answer(b"").decode()
    keeper.close()
    assert f"{folder}: the ring could not be kept: File exists" in caplog.text


def test_only_the_topics_asked_for_are_recorded(bus, tmp_path):
    with publisher(bus, "scan", "odom") as source:

        def say(turn):
            source.publish_raw("scan", b"s")
            source.publish_raw("odom", b"o")
            return turn == 3

        _, messages, _ = record_while(bus, tmp_path, say, topics=("odom",))
    assert {m.channel.name for m in messages} == {"odom", "recording"}


def test_a_burst_beyond_the_mailbox_is_counted_inside_the_file(bus, tmp_path):
    with publisher(bus, "map") as source:

        def say(turn):
            for _ in range(recorder.BIG_KEEP + 7 if turn == 2 else 0):
                source.publish_raw("map", b"m")
            return turn == 5

        recording, messages, state = record_while(bus, tmp_path, say)
    maps = [m.sequence for m in messages if m.channel.name == "map"]
    assert maps == list(range(8, 8 + recorder.BIG_KEEP))
    assert recording.counts.lost == {"map": 7}
    assert state.metadata["hallway.end"]["map.lost"] == "7"
    status = [m for m in messages if m.channel.name == "recording"][-1]
    assert decode(status.payload, status.channel.msgtype).status[0].message == "7 messages lost"


def test_ros_is_told_which_topics_are_latched(bus, tmp_path):
    from mcap.reader import make_reader

    with publisher(bus, "map", "scan") as source:

        def say(turn):
            source.publish_raw("map", b"m")
            source.publish_raw("scan", b"s")
            return turn == 2

        record_while(bus, tmp_path, say)
    with (tmp_path / "a.mcap").open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    offered = {channel.topic: channel.metadata["offered_qos_profiles"] for channel in channels}
    assert offered["/robot/scan"] == ""
    assert "durability: transient_local" in offered["/robot/map"]


def test_a_publisher_that_was_started_again_is_another_channel_and_no_hole(bus, tmp_path):
    def say(turn):
        if turn in (1, 3):
            with publisher(bus, "scan") as source:
                source.publish_raw("scan", b"one")
                source.publish_raw("scan", b"two")
        return turn == 5

    recording, messages, _ = record_while(bus, tmp_path, say)
    scans = [m for m in messages if m.channel.name == "scan"]
    assert [m.sequence for m in scans] == [1, 2, 1, 2]
    assert len({m.channel.publisher for m in scans}) == 2
    assert recording.counts.total_lost == 0


def test_a_recording_ends_by_itself_after_its_duration(bus, tmp_path):
    recording, _, state = record_while(bus, tmp_path, lambda turn: False, duration_s=0.2)
    span_ns = int(state.metadata["hallway.end"]["ended_ns"]) - int(state.metadata["hallway"]["began_ns"])
    assert span_ns >= 0.2e9
    assert recording.files == [tmp_path / "a.mcap"]


def test_the_node_says_what_was_lost_in_its_report_and_exit_code(tmp_path, monkeypatch):
    port = ListPort(run_dir=tmp_path, stop_after=0)
    monkeypatch.setattr(recorder, "_drain", lambda port, subscriptions, recording, *_: _lose(recording))
    assert recorder.run(port, config(tmp_path / "a.mcap")) == 4
    assert port.reports[-1][:2] == ("warn", "5 messages lost")


def test_the_node_says_why_it_records_nothing_any_more(tmp_path, monkeypatch):
    port = ListPort(run_dir=tmp_path)
    monkeypatch.setattr(
        "runtime.recordings.recording.shutil.disk_usage", lambda folder: SimpleNamespace(free=0)
    )
    recorder.run(port, recorder.Config(file=str(tmp_path / "a.mcap")))
    assert port.reports[-1][:2] == ("error", "the disk was full: 0 messages not recorded")


def _lose(recording):
    recording.counts.lost = {"scan": 5}


def test_everything_that_may_be_recorded_is_subscribed():
    assert set(recorder.SUBSCRIBES) == {name for name, row in TOPICS.items() if row.recorded}


@pytest.mark.parametrize(
    ("kwargs", "said"),
    [
        ({"file": "a.bag"}, "end with .mcap"),
        ({"topics": ("scam",)}, "scam"),
        ({"duration_s": -1.0}, "least 0"),
    ],
)
def test_a_wrong_configuration_is_refused(kwargs, said):
    with pytest.raises(ValueError, match=said):
        dataclasses.replace(recorder.Config(), **kwargs)
