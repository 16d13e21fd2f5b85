import json

import numpy as np
import pytest
from PIL import Image

from runtime.cli import main
from runtime.cli.study import drives, stages
from runtime.picture import HITS, PATH


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    assert main(["paper", "--out", str(folder), "--scans", "60", "--buildings", "room"]) == 0
    return folder


def test_every_stage_is_measured_and_told(paper):
    numbers = json.loads((paper / "numbers.json").read_text())
    assert set(numbers["room"]) == set(stages.variants())
    whole = numbers["room"][stages.WHOLE]
    assert whole["match_mm"] < 10.0
    assert whole["max_m"] < 0.1
    table = (paper / "tables.md").read_text()
    assert all(f"| {variant} |" in table for variant in stages.variants())


def test_the_figures_show_the_way_and_its_hits(paper):
    names = {path.name for path in paper.glob("*.png")}
    assert {f"fig{what}-room.png" for what in ("2-resampling", "4-evolution", "6-way", "8-map")} == names
    pixels = np.asarray(Image.open(paper / "fig6-way-room.png")).astype(int)
    for colour, least in ((HITS, 1000), (PATH, 50)):
        assert (np.abs(pixels - colour).max(axis=-1) < 20).sum() > least


def test_the_same_seed_gives_the_same_drive_and_another_seed_another():
    first, again, other = (drives.drive("room", 30, seed) for seed in (1, 1, 2))
    pairs = zip(first.scans, again.scans, strict=True)
    assert all(np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True) for a, b in pairs)
    assert not np.array_equal(first.scans[5].ranges_m, other.scans[5].ranges_m, equal_nan=True)


def test_errors_of_the_truth_itself_are_none():
    driven = drives.drive("room", 60, 1)
    perfect = drives.Followed(driven.truth, np.zeros((0, 2)), 0, 0, 1.0)
    errors = drives.errors(driven, perfect)
    assert errors["match_mm"] == pytest.approx(0.0, abs=1e-6)
    assert errors["max_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"), [(["--scans", "3"], "--scans = 3"), (["--buildings", "rom"], "rom")]
)
def test_a_wrong_wish_is_one_clear_line(wrong, message, tmp_path, capsys):
    assert main(["paper", "--out", str(tmp_path / "p"), *wrong]) == 2
    assert message in capsys.readouterr().err
