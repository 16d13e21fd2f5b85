"""`hallway evaluate`: figures, table, JSON, and what is missing."""

import json

import numpy as np
import pytest

from processing import se2
from runtime.cli import main
from runtime.formats.tum import write_tum

STAMPS = 976052857337530000 + np.arange(50) * 200_000_000
POSES = np.column_stack((np.linspace(0, 5, 50), np.zeros(50), np.linspace(0, 1, 50)))


@pytest.fixture
def files(tmp_path):
    write_tum(tmp_path / "trajectory.tum", STAMPS, POSES)
    rows = []
    for a, b in ((0, 10), (10, 40)):
        x, y, yaw = se2.between(POSES[a], POSES[b])
        sa, sb = (f"{s // 10**9}.{s % 10**9 // 1000:06d}" for s in (int(STAMPS[a]), int(STAMPS[b])))
        rows.append(f"{sa} {sb} {x + 0.1:.9f} {y:.9f} 0 0 0 {yaw:.9f}\n")
    (tmp_path / "relations").write_text("".join(rows))
    (tmp_path / "bad.tum").write_text("1 2 3\n")
    return tmp_path


def test_relations_are_scored_by_raw_stamps(files, capsys):
    code = main(
        ["evaluate", str(files / "trajectory.tum"), "--relations", str(files / "relations"), "--json"]
    )
    assert code == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["truths"], report["compared"]) == (2, 2)
    assert report["relation"]["translation_m"]["mean"] == pytest.approx(0.1, abs=1e-5)
    assert report["relation"]["translation_m"]["std"] == pytest.approx(0.0, abs=1e-5)
    assert report["relation"]["rotation_deg"]["max"] < 1e-4


def test_a_results_folder_stands_for_its_trajectory(files, capsys):
    assert main(["evaluate", str(files), "--relations", str(files / "relations")]) == 0
    out = capsys.readouterr().out
    assert "2 of 2 truths compared" in out
    assert "0.1000 ± 0.0000" in out


def test_truths_without_a_pose_are_told_and_cost_the_exit_code(files, capsys):
    write_tum(files / "short.tum", STAMPS[:20], POSES[:20])
    code = main(["evaluate", str(files / "short.tum"), "--relations", str(files / "relations")])
    assert code == 4
    captured = capsys.readouterr()
    assert "1 of 2 truths compared" in captured.out
    assert captured.err == (
        "hallway evaluate: 1 of 2 truths have no pose at their stamps; the errors speak of the others only\n"
    )


@pytest.mark.parametrize("cut", ["--reference", "trajectory"])
def test_a_file_that_is_cut_off_is_compared_up_to_there_and_costs_the_exit_code(files, capsys, cut):
    text = (files / "trajectory.tum").read_text()
    (files / "cut.tum").write_text(text[:-20])
    pair = ("trajectory.tum", "cut.tum") if cut == "--reference" else ("cut.tum", "trajectory.tum")
    code = main(["evaluate", str(files / pair[0]), "--reference", str(files / pair[1]), "--json"])
    assert code == 4
    captured = capsys.readouterr()
    said = f"{files / 'cut.tum'}:50: the last line is cut off, and left out"
    assert json.loads(captured.out)["losses"] == [said]
    assert f"hallway evaluate: {said}\n" in captured.err


def test_relations_of_another_log_are_refused(files, capsys):
    write_tum(files / "other.tum", STAMPS - 10**15, POSES)
    assert main(["evaluate", str(files / "other.tum"), "--relations", str(files / "relations")]) == 2
    assert "none of its 2 pairs of stamps is in" in capsys.readouterr().err


def test_a_reference_gives_ate_and_rpe_whatever_its_frame(files, capsys):
    write_tum(files / "truth.tum", STAMPS + 5_000_000, se2.compose(np.array([1.0, 2.0, 0.5]), POSES))
    code = main(["evaluate", str(files), "--reference", str(files / "truth.tum"), "--json"])
    assert code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ate"]["translation_m"]["max"] < 1e-5
    assert report["rpe"]["count"] > 30
    assert report["rpe"]["rotation_deg"]["max"] < 1e-4


def test_a_way_shorter_than_a_stretch_is_told(files, capsys):
    assert main(["evaluate", str(files), "--reference", str(files), "--stretch", "1000"]) == 0
    out, err = capsys.readouterr()
    assert "RPE" not in out
    assert err == "hallway evaluate: no RPE: the way is shorter than --stretch 1000 m\n"


def test_the_mounting_of_the_laser_turns_its_poses_into_the_bases(files, capsys):
    mounting = np.array([-0.04, 0.1, 0.3])
    write_tum(files / "laser.tum", STAMPS, se2.compose(POSES, mounting))
    arguments = ["evaluate", str(files / "laser.tum"), "--reference", str(files / "trajectory.tum"), "--json"]
    assert main([*arguments, "--laser-in-base", "-0.04", "0.1", "0.3"]) == 0
    assert json.loads(capsys.readouterr().out)["rpe"]["translation_m"]["max"] < 1e-5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.tum", "--relations", "r"], "nowhere.tum: No such file or directory"),
        (["{}/trajectory.tum", "--reference", "{}/bad.tum"], "bad.tum:1: 3 columns, must be 8"),
        (["{}", "--reference", "{}/trajectory.tum", "--stretch", "0"], "--stretch = 0.0, must be positive"),
        (["{}", "--reference", "{}", "--stretch", "inf"], "--stretch = inf, must be positive and finite"),
        (["{}", "--reference", "{}/trajectory.tum", "--max-difference", "-1"], "--max-difference = -1.0"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_line_and_exit_code_2(files, capsys, arguments, said):
    assert main(["evaluate", *(one.format(files) for one in arguments)]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
