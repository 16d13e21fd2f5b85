"""The account of what is missing from a recording."""

import numpy as np
import pytest

from runtime.formats.logs import open_log
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.missing import Hole, Outage, account_of
from runtime.messages import DiagnosticArray, DiagnosticStatus, KeyValue, LaserScan, encode, header
from runtime.recordings.info import describe
from runtime.recordings.recording import END_RECORD, STATUS_TOPIC, STATUS_TYPE
from runtime.recordings.replay import Recorded, ReplayConfig
from runtime.topics import TOPICS

S = 10**9
SCAN = McapChannel("/robot/scan", TOPICS["scan"].type, {"gid": "aa"})
OTHER = McapChannel("/robot/scan", TOPICS["scan"].type, {"gid": "bb"})
TF = McapChannel("/robot/tf", TOPICS["tf"].type, {"gid": "aa"})
TF_OTHER = McapChannel("/robot/tf", TOPICS["tf"].type, {"gid": "bb"})
STATUS = McapChannel(f"/robot/{STATUS_TOPIC}", STATUS_TYPE)


def scan(n):
    arrays = np.ones(3, np.float32), np.zeros(0, np.float32)
    return encode(LaserScan(header(n * S // 10, "laser"), -1.0, 1.0, 1.0, 0.0, 0.1, 0.0, 99.0, *arrays))


def status(**counts):
    values = [KeyValue(key=key.replace("_", "."), value=str(value)) for key, value in counts.items()]
    told = DiagnosticStatus(level=0, name="robot/recording", message="", hardware_id="", values=values)
    return encode(DiagnosticArray(header=header(0, ""), status=[told]))


def write(path, rows, end=None):
    """Write (channel, number, second, payload); finished if `end` is given."""
    writer = McapWriter(path)
    for channel, number, at_s, payload in rows:
        writer.add(channel, number, round(at_s * S), 0, payload)
    if end is None:
        writer.flush()
        writer.abandon()
        return writer.active_path
    writer.finish({END_RECORD: end})
    return path


def test_holes_in_the_numbers_of_a_publisher_are_found_where_they_are(tmp_path):
    rows = ((SCAN, 1), (SCAN, 2), (OTHER, 900), (SCAN, 5), (OTHER, 901), (SCAN, 6))
    path = write(tmp_path / "a.mcap", [(channel, n, n, b"") for channel, n in rows], {})
    account = account_of(path)
    assert account.missing("/robot/scan") == 2
    assert account.holes == [Hole("/robot/scan", 5 * S, 3, 2)]
    assert account.gaps(S) == [{"topic": "/robot/scan", "at_s": 4.0, "first": 3, "count": 2}]
    assert account.gaps(S, ["odom"]) == []


def test_what_lies_between_two_parts_is_missing_too(tmp_path):
    first = write(tmp_path / "a_000.mcap", [(SCAN, n, n, b"") for n in (1, 2)], {})
    third = write(tmp_path / "a_002.mcap", [(SCAN, n, n, b"") for n in (7, 8)], {})
    assert account_of(first, third).losses() == ["4 messages of /robot/scan, by its sequence numbers"]


def test_a_new_publisher_is_an_outage_once_and_only_where_one_speaks(tmp_path):
    rows = [(SCAN, 1, 1.0, b""), (TF, 1, 1.0, b""), (TF_OTHER, 1, 1.1, b""), (TF, 2, 1.2, b"")]
    rows += [(OTHER, 1, 2.5, b""), (SCAN, 2, 2.6, b""), (OTHER, 2, 2.7, b"")]
    account = account_of(write(tmp_path / "a.mcap", rows, {}))
    assert account.outages == [Outage("/robot/scan", 2_500_000_000, 1_500_000_000)]
    assert account.outages_told(S) == ["1.500 s: /robot/scan: a new publisher after 1.5 s without one"]
    assert account.losses() == []


@pytest.mark.parametrize("cut", [False, True])
def test_the_recorders_own_counts_say_what_no_hole_shows(tmp_path, cut):
    # Two scans are missing between others, and three after the last.
    counts = {"unwritten": 0, "scan_lost": 5, "odom_lost": 1}
    rows = [(SCAN, 1, 1, b""), (SCAN, 4, 4, b""), (STATUS, 0, 5, status(**counts))]
    end = None if cut else {"unwritten": "0", "scan.lost": "5", "odom.lost": "1"}
    account = account_of(write(tmp_path / "a.mcap", rows, end))
    told = [
        "2 messages of /robot/scan, by its sequence numbers",
        "3 more messages of scan that the recorder did not get",
        "1 messages of odom that the recorder did not get",
    ]
    assert account.losses()[int(cut) :] == told
    assert account.losses(["scan"])[int(cut) :] == told[:2]
    # Nobody knows whether those were lost in a part that was looked at.
    assert account.losses(["scan"], whole=False)[int(cut) :] == told[:1]


def test_a_damaged_account_of_the_recorder_is_told_and_not_taken_for_nothing(tmp_path):
    path = write(tmp_path / "a.mcap", [(SCAN, 1, 1, b""), (STATUS, 0, 2, b"\x00\x01\x00\x00\xff")])
    assert account_of(path).losses()[1:] == ["the recorder's own account is damaged"]


def test_whoever_reads_a_recording_gets_the_same_answer(tmp_path):
    """Those who list it, map it and play it."""
    numbers = [1, 2, 3, 14, 15]
    end = {"ended": "the disk was full", "unwritten": "0", "scan.lost": "12"}
    path = write(tmp_path / "a.mcap", [(SCAN, n, n / 10, scan(n)) for n in numbers], end)
    told = describe(path)["missing"]
    assert told == [
        "everything after its end: the disk was full",
        "10 messages of /robot/scan, by its sequence numbers",
        "2 more messages of scan that the recorder did not get",
    ]
    recorded = Recorded([path], ReplayConfig())
    assert len(list(recorded.messages())) == len(numbers)
    # A file among several is named.
    assert recorded.losses() == [f"{path}: {told[0]}", *told[1:]]
    assert open_log(path).losses == tuple(f"{path}: {one}" for one in told)
    assert recorded.gaps() == describe(path)["gaps"]
