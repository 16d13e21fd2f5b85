"""`hallway logs`: of a robot that runs, or of what a finished run left."""

import pytest

from runtime.cli import main


@pytest.fixture
def results(tmp_path):
    """What two processes wrote, one of which failed."""
    folder = tmp_path / "res" / "logs"
    folder.mkdir(parents=True)
    failed = "2026-01-01T10:00:02 mapper: failed\nTraceback (most recent call last):\n  ValueError: no\n"
    (folder / "mapper.log").write_text("2026-01-01T10:00:00 mapper: begins\n" + failed)
    (folder / "laser.log").write_text("2026-01-01T10:00:01 laser: streaming\n")
    return tmp_path / "res"


def test_the_logs_of_a_finished_run_are_one_story_in_the_order_of_time(results, capsys):
    assert main(["logs", "--results", str(results)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "2026-01-01T10:00:00 mapper: begins",
        "2026-01-01T10:00:01 laser: streaming",
        "2026-01-01T10:00:02 mapper: failed",
        "2026-01-01T10:00:02 mapper: Traceback (most recent call last):",
        "2026-01-01T10:00:02 mapper:   ValueError: no",
    ]


def test_whoever_asks_after_the_end_is_told_how_to_ask_for_a_finished_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path / "run"))
    assert main(["logs"]) == 1
    told = capsys.readouterr().err
    assert "robot 'robot' does not run here" in told
    assert "of a finished run: `hallway logs --results results/latest`" in told


def test_a_process_that_is_not_there_is_named_with_those_that_are(results, capsys):
    assert main(["logs", "--results", str(results), "lazer"]) == 2
    assert "laser" in capsys.readouterr().err
