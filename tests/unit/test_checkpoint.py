"""A process that was killed goes on where it was, or begins anew; never with half a state."""

from pathlib import Path

import pytest

from runtime.process.checkpoint import LONGEST_NS, Checkpoint

EVERY_NS = 500


def test_the_next_process_reads_what_the_last_one_wrote(tmp_path):
    Checkpoint(tmp_path / "a", EVERY_NS, "config").write(1, {"x": [1, 2]})
    assert Checkpoint(tmp_path / "a", EVERY_NS, "config").read() == {"x": [1, 2]}


def test_another_configuration_begins_anew(tmp_path):
    Checkpoint(tmp_path / "a", EVERY_NS, "config").write(1, "state")
    assert Checkpoint(tmp_path / "a", EVERY_NS, "other").read() is None


def test_without_a_checkpoint_there_is_no_state(tmp_path):
    assert Checkpoint(tmp_path / "a", EVERY_NS, "config").read() is None


@pytest.mark.parametrize("cut", [0, 1, 10, 40])
def test_a_damaged_one_counts_as_none(tmp_path, cut):
    Checkpoint(tmp_path / "a", EVERY_NS, "config").write(1, list(range(100)))
    whole = (tmp_path / "a").read_bytes()
    (tmp_path / "a").write_bytes(whole[:cut])
    assert Checkpoint(tmp_path / "a", EVERY_NS, "config").read() is None


def test_a_state_that_cannot_be_written_leaves_the_last_one(tmp_path):
    checkpoint = Checkpoint(tmp_path / "a", EVERY_NS, "config")
    checkpoint.write(1, "good")
    with pytest.raises(AttributeError):
        checkpoint.write(2, lambda: "no pickle for this")
    assert checkpoint.read() == "good"


def test_a_state_is_taken_once(tmp_path):
    checkpoint = Checkpoint(tmp_path / "a", EVERY_NS, "config")
    checkpoint.write(1, "state")
    assert (checkpoint.read(), checkpoint.read()) == ("state", None)


def test_what_was_being_written_at_a_kill_does_not_stay(tmp_path):
    Checkpoint(tmp_path / "a", EVERY_NS, "config").write(1, "state")
    (tmp_path / ".a.4711").write_bytes(bytes(100))
    (tmp_path / ".ab.4711").write_bytes(bytes(100))  # another's
    assert Checkpoint(tmp_path / "a", EVERY_NS, "config").read() == "state"
    assert [path.name for path in tmp_path.iterdir()] == [".ab.4711"]


def test_a_disk_that_refuses_is_told_and_nothing_is_left(tmp_path):
    assert not Checkpoint(tmp_path / "none" / "a", EVERY_NS, "config").write(1, "state")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "full").touch()
    assert not Checkpoint(tmp_path / "a", EVERY_NS, "config").write(1, "state")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_it_is_due_at_first_and_then_by_the_stamps(tmp_path):
    checkpoint = Checkpoint(tmp_path / "a", EVERY_NS, "config", lambda: 0)
    assert checkpoint.due(1000)
    checkpoint.write(1000, "state")
    assert [checkpoint.due(stamp) for stamp in (1000, 1499, 1500, 999)] == [False, False, True, True]


def test_without_a_run_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checkpoint = Checkpoint(Path("a"), EVERY_NS, "config")
    assert not checkpoint.due(1)
    assert checkpoint.read() is None


def after_writings(path, *took_ns):
    """Return the shortest pause until it is due again, when writing took so long each time."""
    times = [time for took in took_ns for time in (0, took)]
    clock = iter(times)
    checkpoint = Checkpoint(path, EVERY_NS, "config", lambda: next(clock))
    for number in range(len(took_ns)):
        checkpoint.write(number, "state")
    last = len(took_ns) - 1
    return next(ns for ns in (EVERY_NS, 2000, LONGEST_NS) if checkpoint.due(last + ns))


def test_a_slow_disk_gets_a_twentieth_of_the_time_and_no_state_is_older_than_ten_seconds(tmp_path):
    assert after_writings(tmp_path / "a", 100, 100) == 2000
    assert after_writings(tmp_path / "a", 10**12, 10**12) == LONGEST_NS


def test_one_stall_does_not_make_a_disk_slow(tmp_path):
    assert after_writings(tmp_path / "a", 10**12) == EVERY_NS
    assert after_writings(tmp_path / "a", 10, 10**12) == EVERY_NS
    assert after_writings(tmp_path / "a", 100, 10**12, 100) == 2000
