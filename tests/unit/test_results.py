"""A results folder is complete or not there at all."""

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from runtime.errors import ConfigError
from runtime.formats.map_server import GridMap, read_map
from runtime.formats.tum import read_tum
from runtime.reports.results import (
    RunResult,
    check_free,
    content_hash,
    link_latest,
    provenance,
    save,
    to_json,
)

FILES = ["config.yaml", "map.pgm", "map.png", "map.yaml"]
FILES += ["metrics.json", "odometry.tum", "run.json", "trajectory.tum"]


def result(poses=3, metrics=None):
    probability = np.full((20, 30), np.nan, dtype=np.float32)
    probability[5:10, 5:25] = 0.1
    probability[4, 5:25] = 0.9
    line = np.column_stack((np.linspace(0.3, 1.2, poses), np.full(poses, 0.35), np.zeros(poses)))
    return RunResult(
        config={"slam": {"particles": 40}},
        stamps_ns=np.arange(poses) * 100_000_000,
        trajectory=line,
        odometry=line + 0.01,
        grid=GridMap(probability, 0.05, (0.0, 0.0)),
        path_m=line[:, :2],
        metrics=metrics or {"scans": poses, "entropy": float("nan")},
        run=provenance(7),
    )


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def test_a_run_leaves_every_file_that_people_know(tmp_path):
    save(tmp_path / "run", result())
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == FILES
    assert len(read_tum(tmp_path / "run" / "trajectory.tum")) == 3
    assert read_tum(tmp_path / "run" / "odometry.tum").poses[0, 0] == 0.31
    assert read_map(tmp_path / "run" / "map.yaml").probability.shape == (20, 30)
    assert json.loads((tmp_path / "run" / "metrics.json").read_text()) == {"scans": 3, "entropy": None}
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert about["seed"] == 7
    assert about["host"]["node"] == os.uname().nodename
    with Image.open(tmp_path / "run" / "map.png") as picture:
        assert picture.convert("RGB").getextrema()[0][1] == 255


def test_the_same_result_gives_the_same_bytes(tmp_path):
    save(tmp_path / "a", result())
    save(tmp_path / "b", result())
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


def test_an_earlier_run_of_that_name_is_replaced_whole(tmp_path):
    save(tmp_path / "run", result(3))
    (tmp_path / "run" / "old.txt").write_text("of the earlier run")
    save(tmp_path / "run", result(5))
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == FILES
    assert len(read_tum(tmp_path / "run" / "trajectory.tum")) == 5
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_folder_with_anything_else_in_it_is_left_alone(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    with pytest.raises(ConfigError, match=r"thesis: holds other files and no run\.json"):
        save(tmp_path / "thesis", result())
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "years of work"


def test_a_file_of_that_name_is_refused_before_any_work(tmp_path):
    (tmp_path / "run").write_text("")
    with pytest.raises(ConfigError, match="run: is a file"):
        check_free(tmp_path / "run")


@pytest.mark.parametrize("folder", [".", "..", "../here", "/proc"])
def test_the_folder_where_one_stands_and_a_disk_are_refused_before_any_work(tmp_path, monkeypatch, folder):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(ConfigError, match=r"choose a folder in it, \S*map"):
        check_free(Path(folder))
    check_free(Path("map"))
    check_free(Path("../there"))


def test_a_parent_that_is_a_file_is_refused_before_any_work(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written to"):
        check_free(tmp_path / "file" / "run")


def test_an_error_on_the_way_leaves_nothing_behind(tmp_path):
    save(tmp_path / "run", result(3))
    before = digests(tmp_path / "run")
    for name in ("run", "other"):
        with pytest.raises(TypeError):
            save(tmp_path / name, result(3, metrics={"no JSON": {2j}}))
    assert digests(tmp_path / "run") == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_latest_is_a_link_that_moves_in_one_step(tmp_path):
    for name in ("a", "b"):
        save(tmp_path / name, result())
        link_latest(tmp_path / name)
    assert os.readlink(tmp_path / "latest") == "b"
    assert (tmp_path / "latest" / "map.png").is_file()


def test_a_real_folder_called_latest_is_not_replaced(tmp_path):
    (tmp_path / "latest").mkdir()
    save(tmp_path / "a", result())
    link_latest(tmp_path / "a")
    assert not (tmp_path / "latest").is_symlink()


def test_an_input_is_named_by_its_content(tmp_path):
    (tmp_path / "a").write_bytes(b"scan")
    assert content_hash(tmp_path / "a") == hashlib.sha256(b"scan").hexdigest()
    assert provenance(1, tmp_path / "a")["input"] == {
        "name": "a",
        "sha256": hashlib.sha256(b"scan").hexdigest(),
    }
    before = content_hash(tmp_path)
    (tmp_path / "b").write_bytes(b"")
    assert content_hash(tmp_path) != before


def test_json_has_no_nan_and_takes_numpy_numbers():
    text = to_json({"a": np.float64("inf"), "b": [np.int64(3), np.float32(0.5)]})
    assert json.loads(text) == {"a": None, "b": [3, 0.5]}
