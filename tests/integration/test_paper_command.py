import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from runtime.cli import main
from runtime.cli.study import drives, figures, stages
from runtime.formats.logs import open_log
from runtime.reports.picture import HITS, PATH, UNKNOWN


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    assert main(["paper", "--out", str(folder), "--scans", "60", "--buildings", "doorway"]) == 0
    return folder


def test_every_stage_is_measured_and_told(paper):
    numbers = json.loads((paper / "numbers.json").read_text())
    assert (
        set(numbers["hurried"]["doorway"]) == set(numbers["buildings"]["doorway"]) == set(stages.variants())
    )
    whole = numbers["buildings"]["doorway"][stages.WHOLE]
    assert whole["match_mm"] < 10.0
    assert whole["max_m"] < 0.1
    table = (paper / "tables.md").read_text()
    assert all(f"| {variant} |" in table for variant in stages.variants())


def test_the_figures_show_the_way_and_its_hits(paper):
    kinds = ("2-resampling", "4-evolution", "5-matching", "6-way", "7-way", "8-map", "9-particles")
    names = {path.name for path in paper.glob("*.png")}
    assert {f"fig{kind}-doorway.png" for kind in kinds} == names
    assert all(f"({name})" in (paper / "tables.md").read_text() for name in names)
    assert all(f'<img src="{name}"' in (paper / "index.html").read_text() for name in names)
    pixels = np.asarray(Image.open(paper / "fig6-way-doorway.png")).astype(int)
    for colour, least in ((HITS, 1000), (PATH, 50)):
        assert (np.abs(pixels - colour).max(axis=-1) < 20).sum() > least


def test_the_same_seed_gives_the_same_drive_and_another_seed_another():
    first, again, other = (drives.drive("doorway", 30, seed) for seed in (1, 1, 2))
    pairs = zip(first.scans, again.scans, strict=True)
    assert all(np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True) for a, b in pairs)
    assert not np.array_equal(first.scans[5].ranges_m, other.scans[5].ranges_m, equal_nan=True)


def test_a_log_without_truth_is_told_by_how_crisp_its_map_is(tmp_path):
    driven = drives.drive("doorway", 60, 1)
    log = tmp_path / "walk.log"
    write_carmen(log, driven)
    out = tmp_path / "paper"
    assert main(["paper", "--out", str(out), "--scans", "60", "--buildings", "--logs", str(log)]) == 0
    numbers = json.loads((out / "numbers.json").read_text())
    assert numbers["buildings"] == {}
    assert set(numbers["logs"]["walk"]) == set(stages.of_a_log())
    assert numbers["logs"]["walk"][stages.WHOLE]["conflict"] < 0.2
    assert (out / "fig8-map-walk.png").is_file()


def test_a_log_that_lost_something_is_studied_and_named(tmp_path, monkeypatch, capsys):
    log, out = tmp_path / "walk.log", tmp_path / "paper"
    write_carmen(log, drives.drive("doorway", 30, 1))
    lossy = replace(open_log(log), losses=("walk.log: the file was cut",))
    monkeypatch.setattr("runtime.formats.logs.open_log", lambda path: lossy)
    assert main(["paper", "--out", str(out), "--scans", "20", "--buildings", "--logs", str(log)]) == 4
    assert "hallway paper: walk.log: the file was cut\n" in capsys.readouterr().err
    assert (out / "index.html").is_file()


def write_carmen(path, driven):
    lines = []
    for number, scan in enumerate(driven.scans):
        ranges = np.where(np.isfinite(scan.ranges_m[:681]), scan.ranges_m[:681], 81.9)[34:-34:4]
        text = " ".join(f"{r:.3f}" for r in ranges)
        lines.append(f"FLASER {len(ranges)} {text} 0 0 0 0 0 0 {number / 10} h {number / 10}")
    path.write_text("\n".join(lines) + "\n")


def test_errors_of_the_truth_itself_are_none():
    driven = drives.drive("doorway", 60, 1)
    perfect = drives.Followed(driven.truth, np.zeros((0, 2)), 0, 0, 1.0)
    errors = drives.errors(driven, perfect)
    assert errors["match_mm"] == pytest.approx(0.0, abs=1e-6)
    assert errors["max_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--scans", "3"], "--scans = 3"),
        (["--buildings", "rom"], "rom"),
        (["--seed", "-1"], "--seed = -1, must be in"),
        (["--out", __file__], "is a file, must be a folder"),
        (["--out", "/dev/null/paper"], "/dev/null cannot be written to"),
    ],
)
def test_a_wrong_wish_is_one_clear_line(wrong, message, tmp_path, capsys):
    assert main(["paper", "--out", str(tmp_path / "p"), *wrong]) == 2
    assert message in capsys.readouterr().err


def test_both_halves_of_the_resampling_figure_show_the_same_ground():
    image = np.asarray(figures.resampling(drives.drive("doorway", 40, 1), 20))
    ends = [np.flatnonzero((image[:, column] == UNKNOWN).all(axis=-1))[-1] for column in (3, -3)]
    assert ends[0] == ends[1]


def test_the_curves_have_room_beside_a_low_picture():
    wide = figures.matching(drives.drive("hallway", 40, 1), 20, 1)
    assert wide.height >= 320
