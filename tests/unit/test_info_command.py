"""`hallway info`: what is there, and what is missing."""

import json

import numpy as np
import pytest

from runtime.cli import main
from runtime.cli.info import _began
from runtime.formats.mcap_log import McapChannel
from runtime.formats.session import Parts, SessionWriter
from runtime.recordings.recording import Recording, RecordingConfig

S = 10**9
SCAN = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa"})


def recorded(path, numbers, lost=None):
    rec = Recording(path, "robot", RecordingConfig(min_free_mb=0), 0, {"seed": "7"}, {"config.yaml": b""})
    for n in numbers:
        rec.add(SCAN, n, n * S // 10, n * S // 10, b"\x00\x01\x00\x00" + bytes(100))
    rec.tick(2 * S, lost or {})
    return rec


def info(capsys, path, *arguments):
    code = main(["info", str(path), "--json", *arguments])
    return code, json.loads(capsys.readouterr().out)


def test_a_whole_recording_lacks_nothing(tmp_path, capsys):
    recorded(tmp_path / "a.mcap", range(1, 21)).close(3 * S)
    code, report = info(capsys, tmp_path / "a.mcap")
    assert code == 0
    assert report["missing"] == report["gaps"] == []
    row = report["topics"]["/robot/scan"]
    assert (row["messages"], row["missing"], row["publishers"]) == (20, 0, 1)
    assert row["rate_hz"] == pytest.approx(10.0)
    assert report["hallway"]["seed"] == "7"
    assert report["hallway.end"]["written"] == "20"
    assert report["attachments"] == ["config.yaml"]


def test_a_killed_recording_says_so_and_what_it_lost(tmp_path, capsys):
    rec = recorded(tmp_path / "a.mcap", [1, 2, 5, 6], {"odom": 3})
    code, report = info(capsys, tmp_path / "a.mcap.active")
    rec.close(3 * S)
    assert code == 4
    assert report["missing"] == [
        "the file was cut (its last record ends too early)",
        "2 messages of /robot/scan, by its sequence numbers",
        "3 messages of odom that the recorder did not get",
    ]
    assert report["gaps"] == [{"topic": "/robot/scan", "at_s": 0.4, "first": 3, "count": 2}]


def test_a_process_that_was_started_again_leaves_an_outage_in_its_recording(tmp_path, capsys):
    again = McapChannel(SCAN.topic, SCAN.msgtype, {"gid": "bb"})
    rec = recorded(tmp_path / "a.mcap", range(1, 11))
    for n in range(1, 6):
        at_ns = (22 + n) * S // 10
        rec.add(again, n, at_ns, at_ns, b"\x00\x01\x00\x00" + bytes(100))
    rec.close(3 * S)
    code, report = info(capsys, tmp_path / "a.mcap")
    assert report["outages"] == ["2.200 s: /robot/scan: a new publisher after 1.3 s without one"]
    assert report["topics"]["/robot/scan"]["publishers"] == 2
    # Nothing that was said is missing: nobody said anything.
    assert (code, report["missing"], report["gaps"]) == (0, [], [])
    assert main(["info", str(tmp_path / "a.mcap")]) == 0
    assert "outage               2.200 s: /robot/scan: a new publisher" in capsys.readouterr().out


def test_a_recording_that_ended_on_a_full_disk_says_so(tmp_path, capsys):
    free = [10**12]
    rec = Recording(tmp_path / "a.mcap", "robot", RecordingConfig(), 0, free_bytes=lambda folder: free[0])
    free[0] = 10**6
    rec.tick(2 * S, {})
    code, report = info(capsys, tmp_path / "a.mcap")
    assert code == 4
    assert report["missing"] == ["everything after its end: the disk was full"]


def test_people_get_a_table(tmp_path, capsys):
    recorded(tmp_path / "a.mcap", [1, 2, 5]).close(3 * S)
    assert main(["info", str(tmp_path / "a.mcap")]) == 4
    out = capsys.readouterr().out
    assert "began                at 0.100 s of a clock that knows no date\n" in out
    rows = [line.split() for line in out.splitlines()]
    assert ["/robot/scan", "3", "5.00", "2", "sensor_msgs/msg/LaserScan"] in rows
    assert "missing messages of               time s    first   count\n" in out
    assert "/robot/scan                        0.400        3       2\n" in out
    assert "missing              2 messages of /robot/scan, by its sequence numbers" in out


def test_a_laser_log_is_described_by_its_geometry_and_rate(tmp_path, capsys):
    lines = [f"FLASER 180 {'1.0 ' * 180}0 0 0 0 0 0 {n * 0.2:.1f} h 0\n" for n in range(1, 11)]
    (tmp_path / "a.clf").write_text("".join(lines))
    code, report = info(capsys, tmp_path / "a.clf")
    assert code == 0
    assert (report["kind"], report["scans"], report["count"]) == ("CARMEN FLASER", 10, 180)
    assert report["period_s"] == pytest.approx(0.2)
    assert report["duration_s"] == pytest.approx(1.8)


def test_what_has_parts_of_its_own_is_in_brackets(tmp_path, capsys):
    (tmp_path / "run.json").write_text('{"session": {"drives": 2, "cells": {"wall": 3, "erased": 0}}}')
    assert main(["info", str(tmp_path)]) == 0
    assert "session              drives=2, cells=(wall=3, erased=0)\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("stamp_s", "said"),
    [(212.57, "at 212.570 s of a clock that knows no date"), (976052857.3, "2000-12-05 21:47:37 UTC")],
)
def test_a_beginning_is_a_date_where_the_clock_knows_one(stamp_s, said):
    assert _began(stamp_s) == said


def test_people_read_rounded_numbers_of_a_session_and_machines_exact_ones(tmp_path, capsys):
    arrays = {"paints": np.zeros(0, np.uint8)}
    parts = Parts(
        posterior={"keys": np.arange(4)},
        config="",
        trajectory=b"",
        picture=b"",
        resolution_m=0.05,
        origin_m=(-19.700000000000003, 2.0),
        layer=arrays,
    )
    SessionWriter(tmp_path / "a.mcap", {"version": "1.2"}).finish(parts)
    _, report = info(capsys, tmp_path / "a.mcap")
    assert report["session"]["origin_m"] == [-19.700000000000003, 2.0]
    main(["info", str(tmp_path / "a.mcap")])
    assert "resolution_m=0.05, origin_m=(-19.7, 2), key_scans=4" in capsys.readouterr().out


def test_a_log_whose_last_line_is_cut_off_lacks_it(tmp_path, capsys):
    lines = [f"FLASER 2 1.0 2.0 0 0 0 0 0 0 {k / 10:.6f} host 0\n" for k in range(1, 8)]
    (tmp_path / "a.clf").write_text("".join(lines)[:-25])
    code, report = info(capsys, tmp_path / "a.clf")
    assert (code, report["scans"]) == (4, 6)
    assert report["missing"] == [f"{tmp_path / 'a.clf'}:7: the last line is cut off, and left out"]


def test_the_results_of_a_live_run_fit_a_page(tmp_path, capsys):
    run = {
        "processes": {"hub": {"state": "ended", "restarts": 0}, "laser": {"state": "ended", "reasons": []}},
        "latency": {"unit": "ms", "late": 3, "hops": {"scan": {"p50": 1.5}, "map": {"p50": 2.5}}},
        "events": ["1 hub: starts", "2 hub: ended"],
        "finished": True,
    }
    (tmp_path / "run.json").write_text(json.dumps(run))
    assert main(["info", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[2:-1] == [
        "processes hub        state=ended, restarts=0",
        "processes laser      state=ended, reasons=none",
        "latency              unit=ms, late=3",
        "latency hops scan    p50=1.5",
        "latency hops map     p50=2.5",
        "events               2, in run.json and in the logs",
        "finished             yes",
    ]


def test_a_results_folder_tells_what_made_it(tmp_path, capsys):
    (tmp_path / "run.json").write_text('{"seed": 3}')
    (tmp_path / "metrics.json").write_text('{"scans": 9}')
    code, report = info(capsys, tmp_path)
    assert (code, report["seed"], report["scans"]) == (0, 3, 9)


@pytest.mark.parametrize(("content", "said"), [(b"", "empty"), (b"hello\n", "not a laser log")])
def test_anything_else_is_one_line(tmp_path, capsys, content, said):
    (tmp_path / "a").write_bytes(content)
    assert main(["info", str(tmp_path / "a")]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1
