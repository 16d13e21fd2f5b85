"""`hallway convert`: between formats, out of cut files, and never half a target."""

import json

import numpy as np
import pytest

from runtime.cli import main
from runtime.formats.logs import open_log
from runtime.formats.mcap_log import McapChannel, McapReader
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.tum import read_tum, write_tum
from runtime.messages import (
    DiagnosticArray,
    Odometry,
    Path,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
    encode,
    header,
)

FLASER = "FLASER 4 1.5 0.0 81.83 2.25 0 0 0 0 0 0 {}.250000 host 0.1\n"


@pytest.fixture
def clf(tmp_path):
    (tmp_path / "log.clf").write_text("".join(FLASER.format(n) for n in range(1, 6)))
    return tmp_path / "log.clf"


def table(path):
    return np.stack([record.ranges_m for record in open_log(path)])


@pytest.mark.parametrize("target", ["a.mcap", "a.bag", "a", "a.log"])
def test_a_log_goes_into_every_format_and_comes_back(clf, tmp_path, target, capsys):
    assert main(["convert", str(clf), str(tmp_path / target)]) == 0
    assert f"{target}: 5 scans" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / target), str(tmp_path / "back.clf")]) == 0
    back = open_log(tmp_path / "back.clf")
    assert back.stamps_ns.tolist() == open_log(clf).stamps_ns.tolist()
    np.testing.assert_array_equal(table(tmp_path / "back.clf"), table(clf))


def test_a_folder_that_cannot_be_written_to_is_named_before_any_work(clf, capsys):
    assert main(["convert", str(clf), "/proc/a.mcap"]) == 2  # root is told that it may
    assert capsys.readouterr().err == "hallway convert: /proc/a.mcap: /proc cannot be written to\n"


def test_what_the_target_cannot_hold_is_told_on_stderr_or_in_the_object(clf, tmp_path, capsys):
    assert main(["convert", str(clf), str(tmp_path / "a.log")]) == 0
    assert "a.log cannot hold the period" in capsys.readouterr().err
    assert main(["convert", str(clf), str(tmp_path / "b.log"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["messages"] == 5
    assert "the period, which is estimated again from the stamps" in report["not_held"]


def pose(x):
    return Pose(position=Point(x=x, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def odometry(n):
    zero = Vector3(x=0.0, y=0.0, z=0.0)
    return Odometry(
        header=header(n * 10**9, "odom"),
        child_frame_id="laser",
        pose=PoseWithCovariance(pose=pose(float(n)), covariance=np.zeros(36)),
        twist=TwistWithCovariance(twist=Twist(linear=zero, angular=zero), covariance=np.zeros(36)),
    )


@pytest.fixture
def recording(tmp_path):
    writer = McapWriter(tmp_path / "run.mcap", {"hallway": {"seed": "7"}})
    path = Path(
        header=header(0, "map"),
        poses=[PoseStamped(header=header(n * 10**9, "map"), pose=pose(n + 0.5)) for n in (1, 2, 3)],
    )
    silent = DiagnosticArray(header=header(0, ""), status=[])
    for name, msgtype, message in (
        *(("odom", "nav_msgs/msg/Odometry", odometry(n)) for n in (1, 2, 3)),
        ("trajectory", "nav_msgs/msg/Path", path),
        ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", silent),
    ):
        writer.add(McapChannel(f"/robot/{name}", msgtype, {"gid": "aa"}), 1, 5, 5, encode(message))
    writer.finish()
    return tmp_path / "run.mcap"


def test_the_path_of_the_map_is_the_trajectory_of_a_recording(recording, tmp_path):
    assert main(["convert", str(recording), str(tmp_path / "t.tum")]) == 0
    got = read_tum(tmp_path / "t.tum")
    assert got.stamps_ns.tolist() == [10**9, 2 * 10**9, 3 * 10**9]
    assert got.poses[:, 0].tolist() == [1.5, 2.5, 3.5]


def test_another_topic_of_poses_can_be_asked_for(recording, tmp_path, capsys):
    assert main(["convert", str(recording), str(tmp_path / "t.tum"), "--topic", "odom"]) == 0
    assert read_tum(tmp_path / "t.tum").poses[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert main(["convert", str(recording), str(tmp_path / "u.tum"), "--topic", "diagnostics"]) == 2
    assert "topic 'diagnostics' carries no poses; the file holds /robot/diagnostics, /robot/odom" in (
        capsys.readouterr().err
    )


def test_a_recording_goes_into_a_ros_2_bag_with_all_its_topics(recording, tmp_path):
    assert main(["convert", str(recording), str(tmp_path / "bag")]) == 0
    assert {path.name for path in (tmp_path / "bag").iterdir()} == {"bag.db3", "metadata.yaml"}
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "bag"]) as bag:
        assert {one.topic: one.msgcount for one in bag.connections} == {
            "/robot/odom": 3, "/robot/trajectory": 1, "/robot/diagnostics": 1,
        }  # fmt: skip
        offered = {one.topic: one.ext.offered_qos_profiles for one in bag.connections}
    assert offered["/robot/odom"] == []
    (latched,) = offered["/robot/trajectory"]
    assert (latched.durability.name, latched.depth) == ("TRANSIENT_LOCAL", 1)


def test_a_ros_1_bag_holds_the_scans_only_and_says_so(recording, tmp_path, capsys):
    assert main(["convert", str(recording), str(tmp_path / "a.bag")]) == 0
    assert "a.bag cannot hold 3 messages of /robot/odom: only laser scans go there" in capsys.readouterr().err


def test_a_cut_recording_becomes_a_whole_one_and_costs_exit_code_4(recording, tmp_path, capsys):
    data = recording.read_bytes()
    cut = tmp_path / "run2.mcap.active"
    cut.write_bytes(data[:600])
    assert main(["convert", str(cut), str(tmp_path / "whole.mcap")]) == 4
    assert "run2.mcap.active: the file was cut" in capsys.readouterr().err
    reader = McapReader(tmp_path / "whole.mcap")
    assert list(reader.messages()) == []
    assert reader.state.metadata["hallway"] == {"seed": "7"}
    assert reader.state.troubles() == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap", "run2.mcap.active", "whole.mcap"]


@pytest.mark.parametrize("target", ["b.mcap", "b", "b.bag", "b.clf"])
def test_a_recording_with_a_hole_costs_exit_code_4_whatever_it_becomes(clf, tmp_path, capsys, target):
    assert main(["convert", str(clf), str(tmp_path / "whole.mcap")]) == 0
    writer = McapWriter(tmp_path / "a.mcap")
    for number, message in enumerate(McapReader(tmp_path / "whole.mcap").messages(), start=1):
        assert message.sequence == 0, "a log without numbers was given some"
        if number != 3:
            at_ns = message.log_ns
            writer.add(message.channel, number, at_ns, at_ns, message.payload)
    writer.finish()
    capsys.readouterr()
    assert main(["convert", str(tmp_path / "a.mcap"), str(tmp_path / target)]) == 4
    assert "a.mcap: 1 messages of /robot/scan, by its sequence numbers" in capsys.readouterr().err
    # Chosen by its topic, the laser still has its hole, and its publisher.
    topic = ["--topic", "/robot/scan"]
    assert main(["convert", str(tmp_path / "a.mcap"), str(tmp_path / "c.mcap"), *topic]) == 4
    assert [m.sequence for m in McapReader(tmp_path / "c.mcap").messages()] == [1, 2, 4, 5]


def test_a_trajectory_becomes_a_recording_of_poses_and_comes_back(tmp_path):
    poses = np.array([[1.0, 2.0, 0.5], [3.0, -4.0, -2.0]])
    write_tum(tmp_path / "t.tum", np.array([10**9, 3 * 10**9]), poses)
    assert main(["convert", str(tmp_path / "t.tum"), str(tmp_path / "t.mcap")]) == 0
    assert main(["convert", str(tmp_path / "t.mcap"), str(tmp_path / "u.tum")]) == 0
    assert read_tum(tmp_path / "u.tum").stamps_ns.tolist() == [10**9, 3 * 10**9]
    np.testing.assert_allclose(read_tum(tmp_path / "u.tum").poses, poses, atol=1e-6)


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [
        ("log.clf", "a.xyz", "suffix '.xyz', must be one of .clf, .log, .dat"),
        ("log.clf", "log.clf", "log.clf: exists already"),
        ("log.clf", "no/where.clf", "does not exist"),
        ("nowhere.clf", "a.clf", "nowhere.clf: No such file"),
        ("log.clf", "a.tum", "holds no poses of ours"),
        ("log.clf", "a.dat", "tinySLAM holds 682"),
        ("t.tum", "a.clf", "a trajectory has no scans"),
        ("bad.clf", "a.mcap", "not a laser log"),
    ],
)
def test_what_cannot_be_converted_is_one_line_and_leaves_nothing(clf, tmp_path, capsys, source, target, said):
    write_tum(tmp_path / "t.tum", np.array([1]), np.zeros((1, 3)))
    (tmp_path / "bad.clf").write_text("hello\n")
    before = sorted(path.name for path in tmp_path.iterdir())
    assert main(["convert", str(tmp_path / source), str(tmp_path / target)]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == before
