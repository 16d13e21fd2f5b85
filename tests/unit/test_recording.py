"""Recordings: whole files for everybody, cut files up to the last flush, losses counted inside."""

import errno
import fcntl
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from runtime.cli import main
from runtime.formats.errors import FormatError
from runtime.formats.logs import open_log
from runtime.formats.mcap_log import McapChannel, McapReader
from runtime.formats.mcap_writer import McapWriter, is_written
from runtime.formats.missing import STATUS_TYPE
from runtime.messages import LaserScan, decode, encode, header
from runtime.nodes.recorder import RING
from runtime.recordings import recovery
from runtime.recordings.recording import Counts, Recording, RecordingConfig
from runtime.recordings.recovery import keep_ring, recover_cut, salvage

SCAN = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa" * 16})
S = 1_000_000_000
PLENTY = lambda folder: 10**12  # noqa: E731


def payload(number, beams=40, seed=3):
    ranges = np.random.default_rng(seed + number).uniform(0.1, 5, beams).astype(np.float32)
    ranges[0], ranges[1] = np.nan, np.inf
    return encode(
        LaserScan(
            header=header(number * S // 10, "laser"),
            angle_min=-1.0,
            angle_max=1.0,
            angle_increment=2.0 / (beams - 1),
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.02,
            range_max=5.0,
            ranges=ranges,
            intensities=np.zeros(0, dtype=np.float32),
        )
    )


def write_scans(writer, count, first=1):
    for n in range(first, first + count):
        writer.add(SCAN, n, n * S // 10 + 500, n * S // 10, payload(n))


def recording(path, now_ns=0, free_bytes=PLENTY, **config):
    return Recording(
        path,
        "robot",
        RecordingConfig(**config),
        now_ns,
        {"seed": "7"},
        {"config.yaml": b"a: 1\n"},
        free_bytes,
    )


def read(path):
    reader = McapReader(path)
    return list(reader.messages()), reader.state


def test_a_finished_file_is_read_by_the_reference_library_and_by_ros_tools(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    write_scans(writer, 50)
    writer.finish()
    with (tmp_path / "a.mcap").open("rb") as file:
        rows = list(make_reader(file).iter_messages())
    assert [message.sequence for _, _, message in rows] == list(range(1, 51))
    assert {(schema.name, schema.encoding, channel.message_encoding) for schema, channel, _ in rows} == {
        ("sensor_msgs/msg/LaserScan", "ros2msg", "cdr")
    }
    with AnyReader([tmp_path / "a.mcap"]) as bag:
        scans = [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages()]
    np.testing.assert_array_equal(scans[4].ranges, decode(payload(5), SCAN.msgtype).ranges)


def test_what_was_written_is_read_byte_for_byte_with_stamps_numbers_and_publisher(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap", {"hallway": {"seed": "7"}}, {"config.yaml": b"a: 1\n"})
    write_scans(writer, 3)
    writer.finish({"hallway.end": {"written": "3"}})
    messages, state = read(tmp_path / "a.mcap")
    assert [(m.sequence, m.log_ns, m.publish_ns) for m in messages] == [
        (n, n * S // 10 + 500, n * S // 10) for n in (1, 2, 3)
    ]
    assert [m.payload for m in messages] == [payload(n) for n in (1, 2, 3)]
    assert messages[0].channel.publisher == "aa" * 16
    assert state.complete
    assert state.metadata == {"hallway": {"seed": "7"}, "hallway.end": {"written": "3"}}
    assert state.attachments == {"config.yaml": b"a: 1\n"}
    assert state.troubles() == []


def test_a_file_is_called_active_until_it_is_whole(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    write_scans(writer, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.active"]
    writer.finish()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_file_that_is_being_written_is_locked_until_it_has_its_name(tmp_path, monkeypatch):
    seen = []
    rename = Path.rename

    def look(path, target):
        with path.open("r+b") as file:
            seen.append(is_written(file))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", look)
    writer = McapWriter(tmp_path / "a.mcap")
    writer.finish()
    assert seen == [True]
    with (tmp_path / "a.mcap").open("r+b") as file:
        assert not is_written(file)


def test_a_file_that_was_taken_away_before_it_was_locked_is_made_again(tmp_path, monkeypatch):
    lock, locked = fcntl.flock, []

    def too_late(file, how):
        if not locked:
            (tmp_path / "a.mcap.active").unlink()
        locked.append(how)
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", too_late)
    writer = McapWriter(tmp_path / "a.mcap")
    write_scans(writer, 1)
    writer.finish()
    assert len(locked) == 2
    assert len(read(tmp_path / "a.mcap")[0]) == 1


@pytest.mark.parametrize("keep", [0.1, 0.37, 0.5, 0.8, 0.99])
def test_a_cut_file_is_read_up_to_its_last_whole_chunk(tmp_path, keep):
    writer = McapWriter(tmp_path / "a.mcap")
    for first in range(1, 101, 10):
        write_scans(writer, 10, first)
        writer.flush()
    writer.finish()
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap.active").write_bytes(data[: int(len(data) * keep)])
    messages, state = read(tmp_path / "cut.mcap.active")
    assert [m.sequence for m in messages] == list(range(1, len(messages) + 1))
    assert len(messages) % 10 == 0
    assert (len(messages) == 100) == state.complete == (keep == 0.99)
    told = "the index at the end of the file was cut" if state.complete else "the file was cut"
    assert state.troubles()[0].startswith(told)


def test_any_cut_at_all_is_read_without_an_error(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap", {"hallway": {"seed": "7"}}, {"config.yaml": b"a: 1\n"})
    for first in (1, 3, 5):
        write_scans(writer, 2, first)
        writer.flush()
    writer.finish()
    data = (tmp_path / "a.mcap").read_bytes()
    found = []
    for end in range(8, len(data)):
        (tmp_path / "b").write_bytes(data[:end])
        messages, state = read(tmp_path / "b")
        found.append(len(messages))
        assert all(m.payload == payload(m.sequence) for m in messages)
        assert state.complete or state.troubles()
    assert found == sorted(found)
    assert found[0] == 0
    assert found[-1] == 6


def test_a_flipped_byte_costs_its_chunk_and_is_told(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    for first in range(1, 31, 10):
        write_scans(writer, 10, first)
        writer.flush()
    writer.finish()
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[data.find(b"zstd", len(data) // 3) + 200] ^= 0x55
    (tmp_path / "a.mcap").write_bytes(data)
    messages, state = read(tmp_path / "a.mcap")
    assert len(messages) == 20
    assert state.troubles() == ["1 damaged chunks were left out"]


def test_messages_keep_their_topic_when_the_chunk_that_named_it_is_damaged(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    for first in (1, 11):
        write_scans(writer, 10, first)
        writer.flush()
    writer.finish()
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[data.find(b"zstd") + 200] ^= 0x55
    (tmp_path / "a.mcap").write_bytes(data)
    messages, state = read(tmp_path / "a.mcap")
    assert [m.sequence for m in messages] == list(range(11, 21))
    assert messages[0].channel == SCAN
    assert (state.damaged_chunks, state.nameless) == (1, 0)


def test_another_file_is_refused(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"no recording at all")
    with pytest.raises(FormatError, match="not an MCAP file"):
        read(tmp_path / "a.mcap")


# ---- the recording: flush, split, disk, losses ----


def test_a_kill_costs_what_came_after_the_last_second(tmp_path):
    rec = recording(tmp_path / "a.mcap")
    for n in range(1, 26):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    # Nothing is closed: what a killed process leaves is what the file holds now.
    messages, state = read(tmp_path / "a.mcap.active")
    scans = [m.sequence for m in messages if m.channel == SCAN]
    assert scans == list(range(1, 21))
    assert state.metadata["hallway"]["seed"] == "7"
    assert state.attachments == {"config.yaml": b"a: 1\n"}
    rec.close(3 * S)
    assert len(read(tmp_path / "a.mcap")[0]) == 25 + 3  # and a status at each second and at the end


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (Counts(unwritten=2), "2 messages lost"),
        (Counts(lost={"odom": 1, "scan": 12}), "13 messages lost: scan 12, odom 1; the machine or the link"),
        (
            Counts(lost={"a": 1, "b": 5, "c": 3, "d": 4, "e": 0}),
            "13 messages lost: b 5, d 4, c 3, others; the machine",
        ),
        (Counts(lost={"a": 1, "b": 5, "c": 3, "e": 0}), "9 messages lost: b 5, c 3, a 1; the machine"),
    ],
)
def test_losses_are_told_by_topic_the_worst_first(counts, words):
    assert counts.words().startswith(words)


def test_losses_are_counted_inside_the_file(tmp_path):
    rec = recording(tmp_path / "a.mcap")
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.tick(2 * S, {"scan": 3, "odom": 1})
    messages, _ = read(tmp_path / "a.mcap.active")
    (status,) = [decode(m.payload, STATUS_TYPE).status[0] for m in messages if m.channel.name == "recording"]
    assert status.level == 1
    assert status.message == "4 messages lost: scan 3, odom 1; the machine or the link was too busy"
    assert {one.key: one.value for one in status.values} == {
        "written": "1", "unwritten": "0", "scan.lost": "3", "odom.lost": "1",
    }  # fmt: skip
    rec.close(3 * S)
    assert read(tmp_path / "a.mcap")[1].metadata["hallway.end"]["scan.lost"] == "3"
    assert rec.counts.total_lost == 4


def test_a_recording_is_split_by_time_and_each_part_is_whole(tmp_path):
    rec = recording(tmp_path / "a.mcap", split_s=2.0)
    for n in range(1, 51):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    rec.close(5 * S)
    assert [path.name for path in rec.files] == ["a_000.mcap", "a_001.mcap", "a_002.mcap"]
    parts = [read(path) for path in rec.files]
    scans = [m.sequence for messages, _ in parts for m in messages if m.channel == SCAN]
    assert scans == list(range(1, 51))
    assert [state.metadata["hallway"]["file"] for _, state in parts] == ["0", "1", "2"]
    assert all(state.complete and state.attachments for _, state in parts)


def test_a_recording_is_split_by_size(tmp_path):
    rec = recording(tmp_path / "a.mcap", split_mb=1.0)
    noise = np.random.default_rng(5)
    for n in range(1, 36):
        rec.add(SCAN, n, n * S, n * S, noise.bytes(100_000))
        rec.tick(n * S, {})
    rec.close(36 * S)
    assert len(rec.files) == 4
    assert all(1.0e6 < path.stat().st_size < 1.3e6 for path in rec.files[:-1])


def test_the_disk_is_never_filled_to_the_end(tmp_path):
    free = [600e6]
    rec = recording(tmp_path / "a.mcap", free_bytes=lambda folder: int(free[0]), min_free_mb=500.0)
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.tick(1 * S, {})
    free[0] = 499e6
    rec.add(SCAN, 2, 2, 2, payload(2))
    rec.tick(2 * S, {})
    assert rec.stopped == "the disk was full"
    rec.add(SCAN, 3, 3, 3, payload(3))
    rec.tick(3 * S, {})
    rec.close(4 * S)
    messages, state = read(tmp_path / "a.mcap")
    assert state.complete
    assert [m.sequence for m in messages if m.channel == SCAN] == [1, 2]
    assert rec.counts.unwritten == 1
    assert state.metadata["hallway.end"]["ended"] == "the disk was full"


def test_a_disk_that_is_full_from_the_start_makes_no_file(tmp_path):
    rec = recording(tmp_path / "a.mcap", free_bytes=lambda folder: 0)
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.close(S)
    assert rec.stopped == "the disk was full"
    assert rec.counts.total_lost == 1
    assert list(tmp_path.iterdir()) == []


def break_disk(rec, error):
    """Let every write of a recording fail from now on, the last one at the end of the file too."""
    rec._writer._file.close()
    rec._writer._file = rec._writer._writer._Writer__stream = _Broken(error)


class _Broken:
    def __init__(self, error):
        self.error = error

    def write(self, data):
        raise self.error

    def tell(self):
        return 0

    close = flush = lambda self: self.write(b"")


def test_a_write_that_fails_leaves_what_was_flushed_and_says_why(tmp_path):
    rec = recording(tmp_path / "a.mcap")
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.tick(1 * S, {})
    rec.add(SCAN, 2, 2, 2, payload(2))
    break_disk(rec, OSError(errno.EIO, "Input/output error"))
    rec.tick(2 * S, {})
    rec.add(SCAN, 3, 3, 3, payload(3))
    rec.close(3 * S)
    assert rec.stopped == "Input/output error"
    assert (rec.counts.written, rec.counts.unwritten) == (1, 2)
    assert rec.files == [tmp_path / "a.mcap.active"]
    assert [m.sequence for m in read(tmp_path / "a.mcap.active")[0] if m.channel == SCAN] == [1]


def test_a_split_for_which_there_is_no_room_ends_the_recording_and_counts(tmp_path, monkeypatch):
    rec = recording(tmp_path / "a.mcap", split_s=1.0)
    rec.add(SCAN, 1, 1, 1, payload(1))

    def no_room(writer, to_disk=False):
        raise OSError(errno.ENOSPC, "No space left on device")

    flush = McapWriter.flush
    monkeypatch.setattr(McapWriter, "flush", lambda w, to_disk=False: (flush if to_disk else no_room)(w))
    rec.tick(1 * S, {})
    rec.add(SCAN, 2, 2 * S, 2 * S, payload(2))
    rec.tick(2 * S, {})
    rec.close(3 * S)
    assert rec.stopped == "No space left on device"
    assert (rec.counts.written, rec.counts.unwritten) == (1, 1)
    assert list(tmp_path.iterdir()) == rec.files == [tmp_path / "a_000.mcap"]
    assert read(tmp_path / "a_000.mcap")[1].complete


def test_a_file_that_cannot_be_ended_at_a_split_is_followed_by_no_other(tmp_path, monkeypatch):
    rec = recording(tmp_path / "a.mcap", split_s=1.0)
    rec.add(SCAN, 1, 1, 1, payload(1))

    def fail(writer, about):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapWriter, "finish", fail)
    rec.tick(1 * S, {})
    rec.add(SCAN, 2, 2 * S, 2 * S, payload(2))
    assert rec.stopped == "No space left on device"
    assert list(tmp_path.iterdir()) == rec.files == [tmp_path / "a_000.mcap.active"]
    assert (rec.counts.written, rec.counts.unwritten) == (1, 1)


def test_a_disk_that_is_gone_ends_the_recording(tmp_path):
    there = [10**12]
    rec = recording(tmp_path / "a.mcap", free_bytes=lambda folder: there.pop())
    rec._free_bytes = lambda folder: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error"))
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.tick(1 * S, {})
    assert rec.stopped == "Input/output error"
    assert rec.counts.written == 1


def test_an_earlier_recording_is_never_overwritten(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"whole")
    (tmp_path / "a_001.mcap.active").write_bytes(b"cut")
    rec = recording(tmp_path / "a.mcap")
    rec.close(S)
    assert rec.files == [tmp_path / "a_002.mcap"]
    again = recording(tmp_path / "a.mcap")
    again.close(S)
    assert again.files == [tmp_path / "a_003.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == b"whole"


@pytest.mark.parametrize(
    ("config", "said"),
    [({"split_mb": 0.5}, "split_mb = 0.5"), ({"split_s": -1}, "split_s = -1"), ({"min_free_mb": -1}, "must")],
)
def test_a_wrong_configuration_is_refused(config, said):
    with pytest.raises(ValueError, match=said):
        RecordingConfig(**config)


# ---- recovery ----


def test_a_cut_file_becomes_a_whole_one_that_everybody_reads(tmp_path):
    rec = recording(tmp_path / "a.mcap")
    for n in range(1, 26):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    rec._writer.abandon()
    target, count, troubles = salvage(tmp_path / "a.mcap.active")
    assert (target, count) == (tmp_path / "a.mcap", 22)
    assert "the file was cut" in troubles[0]
    messages, state = read(target)
    assert state.complete
    assert [m.payload for m in messages if m.channel == SCAN] == [payload(n) for n in range(1, 21)]
    assert state.metadata["hallway.salvaged"]["from"] == "a.mcap.active"
    assert state.attachments == {"config.yaml": b"a: 1\n"}
    with AnyReader([target]) as bag:
        assert sum(1 for _ in bag.messages()) == 22
    with pytest.raises(FileExistsError):
        salvage(tmp_path / "a.mcap.active")


def cut_recording(path, scans=25):
    """Leave what a recorder leaves that was killed; it holds the first twenty scans."""
    rec = recording(path)
    for n in range(1, scans + 1):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    rec._writer.abandon()


def test_cut_files_of_a_name_are_recovered_and_no_others(tmp_path):
    for name in ("a", "a_001", "ab", "a_b"):
        cut_recording(tmp_path / f"{name}.mcap")
    told = recover_cut(tmp_path / "a.mcap")
    assert [line.rpartition("/")[2] for line in told] == [
        "a.mcap: 22 messages recovered from a recording that was cut",
        "a_001.mcap: 22 messages recovered from a recording that was cut",
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.mcap", "a_001.mcap", "a_b.mcap.active", "ab.mcap.active",
    ]  # fmt: skip
    assert scans_in([tmp_path / "a_001.mcap"]) == list(range(1, 21))


def test_a_file_that_is_being_written_is_left_to_its_recorder(tmp_path):
    rec = recording(tmp_path / "a.mcap")
    rec.add(SCAN, 1, 1, 1, payload(1))
    rec.tick(1 * S, {})
    assert recover_cut(tmp_path / "a.mcap") == []
    other = recording(tmp_path / "a.mcap")
    rec.add(SCAN, 2, 2, 2, payload(2))
    rec.close(2 * S)
    other.close(2 * S)
    assert (rec.files, other.files) == ([tmp_path / "a.mcap"], [tmp_path / "a_001.mcap"])
    assert scans_in(rec.files) == [1, 2]


def test_a_recorder_that_was_killed_as_it_began_is_in_nobodys_way(tmp_path):
    (tmp_path / "a.mcap.active").touch()
    (tmp_path / "a_001.mcap.active").write_bytes(b"\0" * 100)
    empty, foreign = recover_cut(tmp_path / "a.mcap")
    assert empty.endswith("a.mcap.active: was empty, from a recorder that was killed as it began; taken away")
    assert "a_001.mcap.active: not an MCAP file" in foreign
    assert foreign.endswith("left as it is")
    assert [path.name for path in tmp_path.iterdir()] == ["a_001.mcap.active"]
    rec = recording(tmp_path / "a.mcap")
    rec.close(S)
    assert rec.files == [tmp_path / "a.mcap"]


def test_a_recovery_that_was_killed_is_made_again(tmp_path):
    cut_recording(tmp_path / "a.mcap")
    (tmp_path / ".a.mcap.salvage.active").write_bytes(b"half")
    recover_cut(tmp_path / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert scans_in([tmp_path / "a.mcap"]) == list(range(1, 21))


def test_a_recovery_that_the_disk_spoils_is_told_and_leaves_the_cut_file(tmp_path, monkeypatch):
    cut_recording(tmp_path / "a.mcap")
    monkeypatch.setattr(McapWriter, "add", lambda *args: None)
    (line,) = recover_cut(tmp_path / "a.mcap")
    assert "0 of 22 messages read back after recovery" in line
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.active"]


# ---- a recording is a laser log ----


def test_a_recording_is_mapped_from_its_scans_with_their_own_bits(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    write_scans(writer, 5)
    writer.finish()
    log = open_log(tmp_path / "a.mcap")
    assert log.kind == "MCAP"
    assert log.stamps_ns.tolist() == [n * S // 10 for n in range(1, 6)]
    for record, n in zip(log, range(1, 6), strict=True):
        assert record.ranges_m.tobytes() == decode(payload(n), SCAN.msgtype).ranges.tobytes()
    assert log.losses == log.notices == ()


def test_what_is_missing_in_a_recording_is_told_by_its_log(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    write_scans(writer, 5)
    write_scans(writer, 5, first=8)
    writer.flush()
    writer.abandon()
    (first, second) = open_log(tmp_path / "a.mcap.active").losses
    assert "the file was cut" in first
    assert "2 messages of /robot/scan, by its sequence numbers" in second


# ---- the ring: the last minutes, always, and kept when somebody says so ----


def run_ring(tmp_path, seconds, first=1, **config):
    rec = recording(tmp_path / "ring.mcap", now_ns=first * S // 10, ring_s=10.0, **config)
    for n in range(first, first + seconds * 10):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    return rec


def scans_in(paths):
    return [m.sequence for path in paths for m in read(path)[0] if m.channel == SCAN]


def test_a_ring_holds_the_last_seconds_and_not_much_more(tmp_path):
    rec = run_ring(tmp_path, 45)
    rec.close(46 * S)
    scans = scans_in(rec.files)
    assert scans == list(range(scans[0], 451))
    assert 100 <= len(scans) <= 125
    assert sorted(tmp_path.iterdir()) == rec.files


def test_a_ring_is_bounded_in_size_too(tmp_path):
    rec = recording(tmp_path / "ring.mcap", ring_s=1000.0, ring_mb=2.0)
    noise = np.random.default_rng(5)
    for n in range(1, 101):
        rec.add(SCAN, n, n * S, n * S, noise.bytes(100_000))
        rec.tick(n * S, {})
    rec.close(101 * S)
    assert sum(path.stat().st_size for path in rec.files) < 2.6e6
    assert scans_in(rec.files)[-1] == 100


def test_a_recorder_that_was_started_again_goes_on_with_the_ring(tmp_path):
    rec = run_ring(tmp_path, 15)
    rec._writer.abandon()  # killed
    again = run_ring(tmp_path, 12, first=200)
    again.close(40 * S)
    assert len(list(tmp_path.iterdir())) <= 12
    assert scans_in(again.files)[-1] == 319


def test_what_is_kept_of_a_ring_stays_when_the_ring_goes_on(tmp_path):
    rec = run_ring(tmp_path / "ring", 12)
    kept = keep_ring(tmp_path / "ring" / "ring.mcap", tmp_path / "kept", within_s=0.0)
    before = scans_in(kept)
    for n in range(121, 400):
        rec.add(SCAN, n, n * S // 10, n * S // 10, payload(n))
        rec.tick(n * S // 10, {})
    rec.close(40 * S)
    assert before == list(range(before[0], before[-1] + 1))
    after = scans_in(kept)
    assert after[: len(before)] == before
    assert len(after) >= 100
    assert read(kept[-1])[1].complete  # the newest file went on under its second name until it was whole


def test_what_is_no_part_of_a_ring_is_neither_kept_nor_taken_away(tmp_path):
    others = [tmp_path / name for name in ("other.mcap", "ring_000.mcap", "ring_000.mcap.active")]
    for other in others:
        other.write_bytes(b"of somebody else")
    rec = run_ring(tmp_path, 30)
    kept = keep_ring(tmp_path / "ring.mcap", tmp_path / "kept", within_s=0.0)
    rec.close(31 * S)
    assert len(kept) == len(rec.files)
    assert scans_in(kept)[-1] == 300
    assert all(other.exists() for other in others)


def test_the_newest_file_is_kept_though_it_gets_its_name_in_that_moment(tmp_path, monkeypatch):
    rec = run_ring(tmp_path, 3)
    listed = recovery.ring_files(tmp_path / "ring.mcap")
    rec.close(4 * S)
    monkeypatch.setattr(recovery, "ring_files", lambda ring: listed)
    kept = keep_ring(tmp_path / "ring.mcap", tmp_path / "kept", within_s=0.0)
    assert listed[-1].suffix == ".active"
    assert [path.name for path in kept] == [path.name for path in rec.files]
    assert scans_in(kept)[-1] == 30


def test_a_file_that_a_killed_recorder_left_in_a_ring_is_kept_and_not_waited_for(tmp_path):
    rec = run_ring(tmp_path, 3)
    rec._writer.abandon()
    began = time.monotonic()
    kept = keep_ring(tmp_path / "ring.mcap", tmp_path / "kept", within_s=60.0)
    assert time.monotonic() - began < 10
    assert scans_in(kept) == list(range(1, 22))  # what came in its last second went with it


def test_a_ring_of_another_length_is_refused():
    with pytest.raises(ValueError, match="ring_s = 3"):
        RecordingConfig(ring_s=3.0)


def test_who_waits_for_the_newest_part_of_a_ring_is_told_why(tmp_path, monkeypatch, capsys):
    heard = threading.Event()
    monkeypatch.setattr("runtime.cli.patience.LONG_S", 0.01)
    monkeypatch.setattr("runtime.cli.record._tell", lambda line: (told.append(line), heard.set()))
    monkeypatch.setattr("runtime.rundir.run_dir", lambda robot: tmp_path)
    monkeypatch.setattr(
        "runtime.recordings.recovery.keep_ring",
        lambda ring, folder, within_s: [folder / "a.mcap"] if heard.wait(10.0) else [],
    )
    (tmp_path / RING).symlink_to(tmp_path / "ring.mcap")
    told = []
    assert main(["record", "--keep", "--out", str(tmp_path / "kept")]) == 0
    assert told == ["the newest part is still written; it is kept when it is whole, in 90 s at most"]
    assert capsys.readouterr().out == f"{tmp_path}/kept/: a.mcap\n"
