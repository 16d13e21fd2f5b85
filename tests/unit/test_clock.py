"""One clock for a run: steady, and the same in every process."""

import time

import pytest

from runtime.clock import OFFSET_VARIABLE, Clock, ManualClock


def test_two_clocks_of_one_offset_agree():
    ours = Clock()
    theirs = Clock(ours.offset_ns)
    before, between, after = ours.now_ns(), theirs.now_ns(), ours.now_ns()
    assert before <= between <= after


def test_a_stamp_is_wall_time_at_the_start_of_the_run():
    assert abs(Clock().now_ns() - time.time_ns()) < 1_000_000_000


def test_a_process_takes_the_offset_of_its_run_from_the_environment(monkeypatch):
    monkeypatch.setenv(OFFSET_VARIABLE, "12345")
    assert Clock.from_environment().offset_ns == 12345


def test_a_step_of_the_wall_clock_moves_no_stamp_and_is_seen(monkeypatch):
    clock = Clock()
    before_ns = clock.now_ns()
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + 3_600_000_000_000)
    assert 0 <= clock.now_ns() - before_ns < 1_000_000_000
    assert abs(clock.wall_step_ns() - 3_600_000_000_000) < 1_000_000_000


def test_an_instant_of_the_monotonic_clock_has_a_stamp():
    assert Clock(7).from_monotonic_ns(100) == 107


def test_a_manual_clock_moves_when_told_and_never_back():
    clock = ManualClock(5)
    clock.advance(10)
    assert clock.now_ns() == 15
    with pytest.raises(ValueError, match="step_ns = -1"):
        clock.advance(-1)
