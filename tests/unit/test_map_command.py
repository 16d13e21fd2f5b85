"""`hallway map`: a log in, a results folder out, or one clear line and nothing."""

import base64
import hashlib
import json
import os
import signal

import numpy as np
import pytest

from processing import se2
from processing.odometry import Tracking
from runtime.cli import main
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.tum import read_tum
from runtime.messages import LaserScan, encode, header
from runtime.nodes.offline import OfflineRun
from runtime.nodes.offline_config import OfflineConfig

SCANS, BEAMS = 24, 181
STAMPS = [f"{976052857 + i // 10}.{337530 + i % 10 * 60_000:06d}" for i in range(SCANS)]
STAMPS[7], STAMPS[8] = STAMPS[8], STAMPS[7]  # as in real logs, a step backwards


def room_ranges(x, y, yaw):
    """Ranges in a room of 6 m x 4 m with a niche, seen from a pose."""
    bearing = yaw - np.pi / 2 + np.arange(BEAMS) * np.pi / (BEAMS - 1)
    c, s = np.cos(bearing), np.sin(bearing)
    c, s = c + 1e-12, s + 1e-12  # no ray is exactly parallel to a wall
    to_x = np.where(c > 0, (3.0 - x) / c, (-3.0 - x) / c)
    to_y = np.where(s > 0, (2.0 - y) / s, (-2.0 - y) / s)
    r = np.minimum(to_x, to_y)
    niche = (x + r * c > 0.5) & (x + r * c < 1.5) & (s > 0)
    return np.where(niche, np.minimum(to_x, (2.6 - y) / np.maximum(s, 1e-9)), r)


def poses():
    return [(-1.0 + 0.05 * i, 0.1 * np.sin(0.2 * i), 0.01 * i) for i in range(SCANS)]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    rng = np.random.default_rng(11)
    lines = ["# CARMEN Logfile\n"]
    for stamp, pose in zip(STAMPS, poses(), strict=True):
        ranges = room_ranges(*pose) + rng.normal(0, 0.005, BEAMS)
        lines.append(f"FLASER {BEAMS} {' '.join(f'{r:.3f}' for r in ranges)} 0 0 0 0 0 0 {stamp} host 0.1\n")
    path = tmp_path_factory.mktemp("log") / "room.clf"
    path.write_text("".join(lines))
    return path


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def test_every_scan_has_a_pose_under_its_raw_stamp_in_file_order(log, tmp_path, capsys):
    assert main(["map", str(log), "--out", str(tmp_path / "run"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    for name in ("trajectory.tum", "odometry.tum"):
        lines = (tmp_path / "run" / name).read_text().splitlines()
        assert [line.split()[0] for line in lines] == STAMPS
        assert {len(line.split()) for line in lines} == {8}
    assert report["scans"] == SCANS
    assert report["times_real_time"] > 0
    assert set(os.listdir(tmp_path / "run")) >= {"map.pgm", "map.yaml", "map.png", "metrics.json", "run.json"}


def test_the_report_has_the_picture_of_the_map_as_it_is(log, tmp_path):
    assert main(["map", str(log), "--out", str(tmp_path / "run")]) == 0
    picture = base64.b64encode((tmp_path / "run" / "map.png").read_bytes()).decode()
    assert picture in (tmp_path / "run" / "report.html").read_text()


def test_the_trajectory_is_where_the_laser_went(log, tmp_path):
    assert main(["map", str(log), "--out", str(tmp_path / "run")]) == 0
    true = np.array(poses())
    expected = se2.between(np.broadcast_to(true[0], true.shape), true)
    got = read_tum(tmp_path / "run" / "trajectory.tum").poses
    assert np.hypot(*(got - expected)[:, :2].T).max() < 0.06
    assert np.abs(got - expected)[:, 2].max() < 0.02


def test_the_same_log_configuration_and_seed_give_the_same_bytes(log, tmp_path):
    for name in ("a", "b"):
        assert main(["map", str(log), "--out", str(tmp_path / name), "--seed", "3"]) == 0
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


def test_the_resolved_configuration_makes_the_run_again(log, tmp_path):
    assert main(["map", str(log), "--out", str(tmp_path / "a")]) == 0
    config = str(tmp_path / "a" / "config.yaml")
    assert main(["map", str(log), "--out", str(tmp_path / "b"), "--config", config]) == 0
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


def test_a_mounting_makes_the_poses_those_of_the_base(log, tmp_path):
    (tmp_path / "c.yaml").write_text("laser_in_base: [-0.04, 0.1, 0.3]\n")
    assert main(["map", str(log), "--out", str(tmp_path / "a")]) == 0
    assert main(["map", str(log), "--out", str(tmp_path / "b"), "--config", str(tmp_path / "c.yaml")]) == 0
    for name in ("trajectory.tum", "odometry.tum"):
        laser, base = (read_tum(tmp_path / run / name).poses for run in "ab")
        expected = se2.compose(laser, se2.invert(np.array([-0.04, 0.1, 0.3])))
        np.testing.assert_allclose(base, expected, atol=2e-6)
    assert json.loads((tmp_path / "b" / "run.json").read_text())["frame"] == "base_link"
    for same in ("map.pgm", "map.yaml"):
        assert (tmp_path / "a" / same).read_bytes() == (tmp_path / "b" / same).read_bytes()


def test_without_a_name_the_results_go_where_people_look_for_them(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["map", str(log)]) == 0
    assert os.readlink("results/latest") == "room"
    assert os.path.isfile("results/latest/map.png")


def test_odd_input_is_told_before_the_run(log, tmp_path, capsys):
    assert main(["map", str(log), "--out", str(tmp_path / "run")]) == 0
    captured = capsys.readouterr()
    assert "stamps go backwards 1 times (first at scan 9: " in captured.err
    assert json.loads((tmp_path / "run" / "run.json").read_text())["notices"] == [
        "room.clf: stamps go backwards 1 times (first at scan 9: 976052857.817530 -> 976052857.757530 s);"
        " the order of the file is kept"
    ]
    assert f"{SCANS} scans in" in captured.out


def test_a_log_whose_last_line_is_cut_off_is_mapped_up_to_there_with_exit_code_4(log, tmp_path, capsys):
    (tmp_path / "cut.clf").write_text(log.read_text()[:-300])
    assert main(["map", str(tmp_path / "cut.clf"), "--out", str(tmp_path / "run"), "--json"]) == 4
    captured = capsys.readouterr()
    said = f"cut.clf:{SCANS + 1}: the last line is cut off, and left out"
    assert f"hallway map: {tmp_path / said}\n" in captured.err
    assert json.loads(captured.out)["losses"] == [str(tmp_path / said)]
    assert said in json.loads((tmp_path / "run" / "run.json").read_text())["notices"]
    assert len(read_tum(tmp_path / "run" / "trajectory.tum")) == SCANS - 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["map", "{log}", "--continue", "{log}"],
        ["map", "{log}", "--config", "nowhere.yaml"],
        ["map", "{log}", "--out", "{log}"],
        ["localize", "{log}", "{log}"],
        ["localize", "{log}", "nowhere.clf"],
    ],
)
def test_nobody_waits_for_loops_to_be_compiled_before_what_is_missing_is_said(log, monkeypatch, arguments):
    monkeypatch.setattr("runtime.cli.compiling.compile_here", lambda verb: pytest.fail("compiles"))
    assert main([word.format(log=log) for word in arguments]) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["{empty}"], "the file is empty"),
        (["{foreign}"], "not a laser log"),
        (["{broken}"], ":3: FLASER with"),
        (["{other}"], ":3: scan of 3 beams, must be 181 as in line 2"),
        (["nowhere.clf"], "nowhere.clf: No such file or directory"),
        (["{log}", "--seed", "-1"], "--seed = -1, must be in"),
        (["{log}", "--topic", "/scan"], "a text log has no topics"),
        (["{log}", "--config", "{bad}"], "bad.yaml.slam.maping: unknown key; did you mean 'mapping'?"),
        (["{log}", "--config", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["{log}", "--out", "{busy}"], "busy: holds other files and no run.json"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2_and_nothing_written(log, tmp_path, capsys, arguments, said):
    text = log.read_text()
    for name, content in {
        "empty": "", "foreign": "hello\n", "broken": text[: len(text) // 15] + "\n",
        "other": "".join(text.splitlines(True)[:2]) + "FLASER 3 1 1 1 0 0 0 0 0 0 1.0 h 0\n",
        "bad.yaml": "slam: {maping: {}}\n",
    }.items():  # fmt: skip
        (tmp_path / name).write_text(content)
    (tmp_path / "busy").mkdir()
    (tmp_path / "busy" / "thesis.tex").write_text("")
    places = {name: tmp_path / name for name in ("empty", "foreign", "broken", "other", "busy")}
    filled = [one.format(log=log, bad=tmp_path / "bad.yaml", **places) for one in arguments]
    if "--out" not in filled:
        filled += ["--out", str(tmp_path / "run")]
    assert main(["map", *filled]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert not (tmp_path / "run").exists()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def stepping(monkeypatch, change):
    real = OfflineRun.step

    def step(self, scan, missed=0):
        result = real(self, scan, missed)
        change(self)
        return result

    monkeypatch.setattr(OfflineRun, "step", step)


def test_ctrl_c_saves_what_is_there(log, tmp_path, monkeypatch, capsys):
    def interrupt(run):
        if sum(run.states.values()) == 9:
            os.kill(os.getpid(), signal.SIGINT)

    stepping(monkeypatch, interrupt)
    before = signal.getsignal(signal.SIGINT)
    assert main(["map", str(log), "--out", str(tmp_path / "run")]) == 130
    assert signal.getsignal(signal.SIGINT) is before
    lines = (tmp_path / "run" / "trajectory.tum").read_text().splitlines()
    assert [line.split()[0] for line in lines] == STAMPS[:9]
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert about["interrupted"] is True
    assert about["scans"] == {"in_log": SCANS, "used": 9}


def test_a_track_that_ends_lost_is_exit_code_5_with_the_results(log, tmp_path, monkeypatch, capsys):
    def lose(run):
        run.state = Tracking.LOST.name

    stepping(monkeypatch, lose)
    assert main(["map", str(log), "--out", str(tmp_path / "run")]) == 5
    assert "the track was lost and not found again" in capsys.readouterr().err
    assert (tmp_path / "run" / "map.png").is_file()


def recording(path, numbers):
    writer = McapWriter(path)
    channel = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa"})
    for number in numbers:
        scan = LaserScan(
            header=header(10**9 + number * 10**8, "laser"),
            angle_min=-np.pi / 2, angle_max=np.pi / 2, angle_increment=np.pi / (BEAMS - 1),
            time_increment=0.0, scan_time=0.1, range_min=0.02, range_max=30.0,
            ranges=room_ranges(*poses()[number]).astype(np.float32), intensities=np.zeros(0, np.float32),
        )  # fmt: skip
        writer.add(channel, number + 1, 0, 0, encode(scan))
    writer.finish()


def test_a_recording_with_missing_scans_is_mapped_and_costs_exit_code_4(tmp_path, capsys):
    recording(tmp_path / "whole.mcap", range(10))
    assert main(["map", str(tmp_path / "whole.mcap"), "--out", str(tmp_path / "a")]) == 0
    recording(tmp_path / "holes.mcap", [0, 1, 2, 5, 6, 7, 8, 9])
    assert main(["map", str(tmp_path / "holes.mcap"), "--out", str(tmp_path / "b")]) == 4
    said = capsys.readouterr()
    assert "2 messages of /robot/scan, by its sequence numbers" in said.err
    # What and where: topic, time, first number, count.
    assert ["/robot/scan", "0.000", "4", "2"] in [line.split() for line in said.out.splitlines()]
    assert len(read_tum(tmp_path / "b" / "trajectory.tum")) == 8


def test_a_mounting_must_be_finite():
    with pytest.raises(ValueError, match="laser_in_base"):
        OfflineConfig(laser_in_base=(0.0, float("nan"), 0.0))
