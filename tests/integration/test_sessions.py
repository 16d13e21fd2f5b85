"""A map that is gone on with: by log and live, painted on, followed on, and refused elsewhere."""

import hashlib
import json
import os

import numpy as np
import pytest
from PIL import Image

from drivers import world
from processing import se2
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from runtime.cli import main
from runtime.clock import Clock
from runtime.formats.map_server import read_map
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.session import read_session, scans_of
from runtime.formats.tum import read_tum
from runtime.messages import encode
from runtime.nodes import mapper
from runtime.nodes.convert import motion_to_message, pose_from_message, scan_to_message
from runtime.port import ListPort
from tests.lasers import beams_of_laser

LASER = world.Urg04lx()
BEAMS = beams_of_laser(LASER)
ROOM = world.room()
BACK = ROOM.route[[2, 3, 0, 1]]


def drive(building, scans, seed, route=None):
    """Return scans, and the true poses in the building."""
    made = world.simulate_scans(
        building, route, laser=LASER, max_scans=scans, seed=seed, rest_s=0.0, speed_mps=0.5
    )
    return [(Scan(stamp_ns, ranges_m, BEAMS), pose) for stamp_ns, ranges_m, pose in made]


def log_of(path, steps):
    writer = McapWriter(path)
    channel = McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan", {"gid": "aa"})
    for number, (scan, _) in enumerate(steps):
        writer.add(channel, number + 1, scan.stamp_ns, scan.stamp_ns, encode(scan_to_message(scan)))
    writer.finish()
    return path


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The log of a drive round a room, its results, and where it began."""
    folder = tmp_path_factory.mktemp("first")
    steps = drive(ROOM, 260, 1)
    log_of(folder / "day1.mcap", steps)
    assert main(["map", str(folder / "day1.mcap"), "--out", str(folder / "map"), "--seed", "3"]) == 0
    return folder / "map", steps[0][1]


@pytest.fixture(scope="module")
def second(tmp_path_factory):
    """The log of a drive that begins in another corner, and its true poses."""
    steps = drive(ROOM, 150, 2, BACK)
    return log_of(tmp_path_factory.mktemp("second") / "day2.mcap", steps), steps


def farthest(poses, steps, start):
    truth = se2.between(np.broadcast_to(start, (len(steps), 3)), np.array([pose for _, pose in steps]))
    error = se2.between(truth, poses)
    return float(np.hypot(error[:, 0], error[:, 1]).max())


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def test_a_second_drive_goes_on_in_the_frame_of_the_first(first, second, tmp_path, capsys):
    log, steps = second
    arguments = ["map", str(log), "--continue", str(first[0]), "--json"]
    assert main([*arguments, "--out", str(tmp_path / "a")]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert report["found_s"] < 5.0
    assert report["seed"] == 3  # that of the session
    trajectory = read_tum(tmp_path / "a" / "trajectory.tum")
    assert len(trajectory) == len(steps)
    assert farthest(trajectory.poses, steps, first[1]) < 0.15
    session = read_session(tmp_path / "a")
    assert session.drives == 2
    assert [number for number, _, _ in scans_of(session.path)] == [1] * 260 + [2] * 150
    assert len(session.parts.trajectory.splitlines()) == 410
    about = json.loads((tmp_path / "a" / "run.json").read_text())
    assert about["session"] == {"name": "session.mcap", "drives": 1, "found": True}
    # The same again gives the same bytes, and a third day begins on both.
    assert main([*arguments, "--out", str(tmp_path / "b")]) == 0
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    assert main(["localize", str(tmp_path / "b"), str(log), "--out", str(tmp_path / "c")]) == 0
    capsys.readouterr()
    assert main(["info", str(session.path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["kind"] == "session"
    assert told["session"]["drives"] == "2"


def test_a_drive_is_followed_on_a_map_that_stays_as_it_is(first, second, tmp_path, capsys):
    log, steps = second
    assert main(["localize", str(first[0] / "session.mcap"), str(log), "--out", str(tmp_path / "on")]) == 0
    assert "found on the saved map at" in capsys.readouterr().err
    assert farthest(read_tum(tmp_path / "on" / "trajectory.tum").poses, steps, first[1]) < 0.15
    before, after = (read_map(folder / "map.yaml") for folder in (first[0], tmp_path / "on"))
    assert np.array_equal(before.probability, after.probability, equal_nan=True)
    assert not (tmp_path / "on" / "session.mcap").exists()


def test_a_drive_elsewhere_is_told_and_kept_as_a_map_of_its_own(first, tmp_path, capsys):
    log = log_of(tmp_path / "hall.mcap", drive(world.pillar_hall(), 60, 4))
    out = tmp_path / "own"
    assert main(["map", str(log), "--continue", str(first[0]), "--out", str(out)]) == 5
    assert "was not found on" in capsys.readouterr().err
    assert read_session(out).drives == 1
    assert len(read_tum(out / "trajectory.tum")) == 60
    assert main(["localize", str(first[0]), str(log), "--out", str(tmp_path / "no")]) == 5
    assert "within 60 scans" in (said := capsys.readouterr().err)
    assert "nothing was written" in said
    assert not (tmp_path / "no").exists()


def test_sessions_that_are_none_and_other_scanners_are_one_line(first, second, tmp_path, capsys):
    log = str(second[0])
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((first[0] / "session.mcap").read_bytes()[:-5000])
    other = tmp_path / "other.clf"
    other.write_text("FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 1.0 h 0\n" * 3)
    for arguments, code, said in (
        (["map", log, "--continue", str(cut)], 4, "the file was cut"),
        (["map", log, "--continue", log], 2, "a recording and no session"),
        (["localize", str(other), log], 2, "no MCAP file"),
        (["localize", str(tmp_path / "nowhere"), log], 2, "No such file"),
        (["localize", str(first[0]), str(other)], 2, "scans of 3 beams, must be 682"),
        (["layer", str(cut), "x.png"], 4, "the file was cut"),
        (["layer", str(first[0])], 2, "nothing to do"),
    ):
        assert main([*arguments, *(["--out", str(tmp_path / "out")])]) == code
        captured = capsys.readouterr()
        assert said in captured.err
        assert captured.err.count("\n") == 1
        assert not (tmp_path / "out").exists()


def paint(source, target, strokes):
    with Image.open(source) as picture:
        edited = picture.convert("RGB")
    for (left, top, right, bottom), colour in strokes:
        edited.paste(colour, (left, top, right, bottom))
    edited.save(target)
    return edited.size


def test_what_is_painted_is_a_layer_that_stays(first, second, tmp_path, capsys):
    log, _ = second
    results = tmp_path / "map"
    results.mkdir()
    for path in first[0].iterdir():
        os.link(path, results / path.name)
    known = read_map(results / "map.yaml")
    rows = known.probability.shape[0]
    row, col = (int(v) for v in np.argwhere(known.probability == 1.0)[0])
    spot = (col, rows - 1 - row, col + 1, rows - row)
    edited = tmp_path / "edited.png"
    paint(
        results / "map.pgm",
        edited,
        [(spot, (255, 255, 255)), ((2, 2, 12, 5), (0, 0, 0)), ((20, 30, 26, 34), (230, 30, 30)),
         ((40, 40, 42, 42), (120, 120, 120))],
    )  # fmt: skip
    assert main(["layer", str(results), str(edited), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["cells"] == {"erased": 1, "wall": 30, "keep_out": 24}
    assert told["left_alone"] == 4
    assert {"metrics.json", "report.html", "odometry.tum"} <= {path.name for path in results.iterdir()}

    def check(folder):
        shown, mask = read_map(folder / "map.yaml"), read_map(folder / "keepout.yaml")
        off = np.round((np.array(known.origin_m) - shown.origin_m) / 0.05).astype(int)
        assert shown.probability[row + off[1], col + off[0]] == 0.0
        walled = shown.probability[rows - 5 + off[1] : rows - 2 + off[1], 2 + off[0] : 12 + off[0]]
        assert (walled == 1.0).all()
        assert mask.probability.shape == shown.probability.shape
        assert mask.origin_m == shown.origin_m
        assert (mask.probability == 1.0).sum() == 24
        assert (mask.probability == 0.0).sum() == mask.probability.size - 24

    check(results)
    # It is there when the laser is followed, and when the map is gone on with.
    assert main(["localize", str(results), str(log), "--out", str(tmp_path / "on")]) == 0
    check(tmp_path / "on")
    assert main(["map", str(log), "--continue", str(results), "--out", str(tmp_path / "both")]) == 0
    check(tmp_path / "both")
    # And it can be taken off again; the same picture without a stroke is refused.
    capsys.readouterr()
    assert main(["layer", str(results), str(results / "map.pgm")]) == 2
    assert "differs nowhere" in capsys.readouterr().err
    assert main(["layer", str(results), str(results / "map.png")]) == 2
    assert "map.png has margins" in capsys.readouterr().err
    assert main(["layer", str(results), "--clear", "all"]) == 0
    assert not (results / "keepout.pgm").exists()
    assert (results / "map.pgm").read_bytes() == (first[0] / "map.pgm").read_bytes()


def test_a_mask_takes_the_place_of_what_was_kept_out(first, tmp_path, capsys):
    out = tmp_path / "out"
    size = paint(first[0] / "map.pgm", tmp_path / "m.pgm", [])
    mask = Image.new("L", size, 254)
    mask.paste(0, (3, 3, 7, 5))
    mask.save(tmp_path / "m.pgm")
    assert main(["layer", str(first[0]), "--keepout", str(tmp_path / "m.pgm"), "--out", str(out)]) == 0
    assert (out / "keepout.pgm").read_bytes() == (tmp_path / "m.pgm").read_bytes()
    assert read_session(out).drives == 1
    assert len(read_tum(out / "trajectory.tum")) == 260


class Paced(ListPort):
    """Gives one message at a time, as a laser and a matcher do."""

    def subscribe(self, topic, **how):
        subscription = super().subscribe(topic, **how)
        subscription.drain = list
        return subscription


def live(steps, tmp_path, config):
    odometry = LaserOdometry(OdometryConfig(), 0)
    inputs = []
    for scan, _ in steps:
        inputs.append(("scan", scan_to_message(scan)))
        inputs.append(("odom", motion_to_message(odometry.step(scan).motion)))
    for folder in ("run", "results"):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    results = tmp_path / "results"
    port = Paced(*inputs, run_dir=tmp_path / "run", results_dir=results / "mapper", clock=Clock())
    assert mapper.run(port, config) == 0
    return port, results


def test_a_live_run_leaves_a_session_and_another_is_followed_on_it(first, second, tmp_path):
    _, left = live(drive(ROOM, 260, 1), tmp_path / "one", mapper.Config())
    session = read_session(left / "mapper")
    assert session.drives == 1
    assert len(list(scans_of(session.path))) == 260
    assert not list(left.glob("scans_*"))
    port, results = live(second[1], tmp_path / "two", mapper.Config(session=str(left / "mapper")))
    poses = [pose_from_message(message.pose.pose) for message in port.said("pose")]
    # No pose before it is found, then one a scan, on the saved map.
    assert 100 < len(poses) < 150
    assert farthest(np.array(poses), second[1][-len(poses) :], first[1]) < 0.15
    assert len(port.said("map")) >= 1
    assert not (results / "mapper" / "session.mcap").exists()
    config = mapper.Config(session=str(left / "mapper"), extend=True)
    _, results = live(second[1], tmp_path / "three", config)
    assert read_session(results / "mapper").drives == 2
    assert len(read_tum(results / "mapper" / "trajectory.tum")) == 150


def killed(self):
    """End as a kill does: nothing is finished, and the system closes the files."""
    self._session._scans._writer._writer.abandon()
    with self._keys:
        pass


def test_a_mapper_that_was_killed_loses_no_scan_of_its_session(second, tmp_path, monkeypatch):
    steps = second[1]
    monkeypatch.setattr(mapper, "CHECKPOINT_NS", 1)
    monkeypatch.setattr(mapper._Mapper, "save", killed)
    live(steps[:60], tmp_path, mapper.Config())
    monkeypatch.undo()
    port, results = live(steps[60:100], tmp_path, mapper.Config())
    assert port.counters["resumptions"] == 1
    session = read_session(results / "mapper")
    stamps = [stamp for _, stamp, _ in scans_of(session.path)]
    known = len(stamps) - 40  # by the last checkpoint before the kill
    assert 0 < known <= 60
    assert stamps == [scan.stamp_ns for scan, _ in steps[:known] + steps[60:100]]
    assert len(read_tum(results / "mapper" / "trajectory.tum")) == len(stamps)
    assert not list(results.glob("scans_*"))


def test_growing_needs_a_session():
    with pytest.raises(ValueError, match="extend = True, must be False without a session"):
        mapper.Config(extend=True)
