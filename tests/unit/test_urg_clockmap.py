"""Sensor time to host time: drift, wrap, reset, steps of either clock, late and wrong stamps."""

import numpy as np
import pytest

from drivers.urg04lx.clockmap import ClockConfig, ClockMap, Sequence

PERIOD_MS = 99.889
HOUR_MS = 3_600_000


class Line:
    """A sensor and a host as their makers meant them: true times known, delays and faults on demand."""

    def __init__(self, seed=0, drift=0.0, start_ms=0.0, jitter_ms=2.0):
        self.rng = np.random.default_rng(seed)
        self.clock = ClockMap()
        self.drift, self.sensor_zero_ms, self.jitter_ms = drift, start_ms, jitter_ms
        self.turn = 0
        self.host_step_ms = 0.0
        self.true_ms = []
        self.errors_ms = []
        self.dropped = 0

    def send(self, delay_ms=0.0, stamp_ms=None):
        """One scan more; `stamp_ms` in place of the right one."""
        step_0_ms = self.turn * PERIOD_MS
        self.turn += 1
        right = int(self.sensor_zero_ms + step_0_ms * (1 + self.drift))
        raw = (right if stamp_ms is None else stamp_ms) % (1 << 24)
        arrival_ms = step_0_ms + 99 + self.rng.uniform(0, self.jitter_ms) + delay_ms + self.host_step_ms
        self.true_ms.append(step_0_ms + self.host_step_ms)
        decided = self.clock.observe(raw, round((arrival_ms + HOUR_MS) * 1e6))
        for host_ns in decided:
            true_ms = self.true_ms.pop(0)
            if host_ns is None:
                self.dropped += 1
            else:
                self.errors_ms.append(host_ns / 1e6 - HOUR_MS - true_ms)
        return decided

    def rms_ms(self, last=None):
        return float(np.sqrt(np.mean(np.square(self.errors_ms[-(last or 10**9) :]))))


@pytest.mark.parametrize("drift", [0.0, 0.002, -0.002])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_stamps_are_right_within_a_millisecond_whatever_the_drift(seed, drift):
    line = Line(seed, drift)
    for _ in range(600):
        assert len(line.send()) == 1
    assert line.rms_ms() < 0.7
    assert max(map(abs, line.errors_ms)) < 3.0
    assert line.clock.drift == pytest.approx(-drift, abs=3e-4)
    assert (line.clock.jumps, line.clock.outliers) == (0, 0)


def test_the_very_first_stamp_is_within_the_jitter():
    errors = []
    for seed in range(200):
        line = Line(seed)
        line.send()
        errors += line.errors_ms
    assert max(map(abs, errors)) < 2.0
    assert abs(float(np.mean(errors))) < 0.3


def test_the_wrap_of_the_counter_after_four_hours_is_not_seen():
    line = Line(1, start_ms=16_777_216 - 5_000)
    for _ in range(200):
        assert len(line.send()) == 1
    assert line.rms_ms() < 1.0
    assert line.clock.jumps == 0


@pytest.mark.parametrize("uptime_ms", [10_000, 3_000_000, 12_000_000])
def test_a_reset_of_the_sensor_begins_a_new_line_and_loses_no_scan(uptime_ms):
    line = Line(2, start_ms=uptime_ms)
    for _ in range(100):
        line.send()
    line.sensor_zero_ms = -line.turn * PERIOD_MS  # its counter is zero now
    for _ in range(100):
        line.send()
    assert line.clock.jumps == 1
    assert len(line.errors_ms) + line.dropped + len(line.true_ms) == 200
    assert line.dropped == 0
    assert line.rms_ms() < 1.0
    assert max(map(abs, line.errors_ms)) < 3.0


@pytest.mark.parametrize("step_ms", [1000.0, -1000.0, 72.0, -72.0])
def test_a_step_of_the_host_clock_never_gives_a_wrong_stamp(step_ms):
    line = Line(3, drift=0.002)
    for _ in range(100):
        line.send()
    line.host_step_ms = step_ms
    for _ in range(100):
        line.send()
    assert line.clock.jumps == 1
    assert line.dropped == 0
    assert max(map(abs, line.errors_ms)) < 3.0
    assert line.rms_ms() < 1.0


def test_a_late_scan_is_held_back_until_the_next_one_and_keeps_its_own_time():
    line = Line(4)
    for _ in range(100):
        line.send()
    assert line.send(delay_ms=70.0) == []
    assert len(line.send()) == 2
    assert line.rms_ms(last=2) < 1.5
    assert (line.clock.jumps, line.clock.outliers) == (0, 0)


def test_a_backlog_that_is_worked_off_keeps_every_scan_and_its_time():
    line = Line(5, jitter_ms=0.5)
    for _ in range(100):
        line.send()
    for behind in range(12, 0, -1):  # the host slept 1.2 s and then reads everything at once
        line.send(delay_ms=behind * PERIOD_MS)
    for _ in range(5):
        line.send()
    assert line.dropped == 0
    assert len(line.errors_ms) == 117
    assert max(map(abs, line.errors_ms)) < 3.0
    assert line.clock.jumps == 0


@pytest.mark.parametrize("wrong_by_ms", [4096, -4096, 64 * 100, 200_000])
def test_a_wrong_stamp_is_dropped_and_the_line_holds(wrong_by_ms):
    line = Line(6, start_ms=1_000_000)
    for _ in range(100):
        line.send()
    right = int(line.sensor_zero_ms + line.turn * PERIOD_MS)
    assert line.send(stamp_ms=right + wrong_by_ms) == []
    decided = line.send()
    assert decided[0] is None
    assert decided[1] is not None
    for _ in range(20):
        line.send()
    assert (line.dropped, line.clock.outliers, line.clock.jumps) == (1, 1, 0)
    assert max(map(abs, line.errors_ms)) < 3.0


def test_more_delay_from_now_on_becomes_a_new_line_after_three_scans():
    line = Line(7)
    for _ in range(50):
        line.send()
    counts = [len(line.send(delay_ms=60.0)) for _ in range(4)]
    assert counts == [0, 0, 3, 1]
    assert line.clock.jumps == 1


def test_forgetting_starts_anew_with_another_offset():
    line = Line(8)
    for _ in range(20):
        line.send()
    line.clock.restart()
    line.sensor_zero_ms = -line.turn * PERIOD_MS
    assert len(line.send()) == 1
    assert abs(line.errors_ms[-1]) < 2.5
    assert line.clock.jumps == 0


def test_what_is_held_back_when_the_line_is_forgotten_is_counted():
    line = Line(9)
    for _ in range(20):
        line.send()
    line.send(delay_ms=500.0)
    line.clock.restart()
    assert line.clock.outliers == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"window_s": 0.5}, {"latency_ms": -1.0}, {"drift_limit": 0.5}, {"jump_ms": 1.0}, {"jitter_ms": 50.0},
    ],
)  # fmt: skip
def test_an_assumption_that_cannot_be_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=f"{name} = "):
        ClockConfig(**wrong)


def test_missing_and_double_scans_are_counted_by_their_stamps():
    sequence = Sequence()
    fresh = [sequence.fresh(stamp) for stamp in (0, 99, 199, 199, 499, 500 + 59_900)]
    assert fresh == [True, True, True, False, True, True]
    assert (sequence.duplicates, sequence.missed) == (1, 2 + 598)


def test_left_out_scans_are_not_missed_and_neither_is_anything_after_a_reset_or_a_wrap():
    sequence = Sequence(skip=1)
    for stamp in (16_777_000, 16_777_200, 184, 384, 500_000, 0):
        assert sequence.fresh(stamp)
    assert sequence.missed == round((500_000 - 384) / 200) - 1
    sequence.restart()
    assert sequence.fresh(0)
    assert sequence.duplicates == 0
