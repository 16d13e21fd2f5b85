"""Histograms are right to 5 % and never grow; a minute is forgotten; every scan is followed to its pose."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime import messages
from runtime.latency import BUCKET, RECENT_NS, Histogram, Journeys, Rate, Recent
from runtime.port import Received

MS = 1_000_000


SHARES = st.floats(0.01, 1.0)


@given(st.lists(st.floats(1e-3, 1.1e6), min_size=1, max_size=300), SHARES)
def test_a_quantile_is_never_below_the_exact_one_and_at_most_five_percent_above(durations, share):
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    exact = sorted(durations)[math.ceil(share * len(durations)) - 1]
    rounding = 1e-9
    assert exact * (1 - rounding) <= histogram.quantile_ms(share) <= exact * BUCKET * (1 + rounding)
    assert histogram.max_ms == max(durations)


@given(st.lists(st.floats(-1e9, 1e15), min_size=1, max_size=30), SHARES)
def test_durations_that_no_bucket_is_made_for_stay_within_the_extremes(durations, share):
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    assert 0.0 <= histogram.quantile_ms(share) <= max(0.0, *durations)


def test_the_extremes_are_counted_and_cost_nothing():
    histogram = Histogram()
    for duration in (-5.0, 0.0, 1e-9, 1e12):
        histogram.add(duration)
    assert histogram.count == 4
    assert histogram.summary()["max"] == histogram.quantile_ms(1.0) == 1e12
    assert len(histogram._counts) == 430


@given(
    st.lists(st.tuples(st.integers(0, RECENT_NS // 2), st.floats(0.0, 1e5)), min_size=1, max_size=60),
    st.integers(0, 3 * RECENT_NS),
)
def test_what_is_a_minute_old_is_forgotten_and_the_rest_is_exact(steps, later_ns):
    recent, now_ns, known = Recent(), 0, []
    for step_ns, duration in steps:
        now_ns += step_ns
        recent.add(duration, now_ns)
        known.append((now_ns, duration))
    now_ns += later_ns
    left = sorted(duration for at_ns, duration in known if at_ns > now_ns - RECENT_NS)
    expected = {}
    if left:
        nearest = {"method": "inverted_cdf"}
        expected = {"p50": np.quantile(left, 0.5, **nearest), "p99": np.quantile(left, 0.99, **nearest)}
        expected["max"] = left[-1]
    assert recent.summary(now_ns) == expected


def test_the_last_minute_does_not_grow_however_much_happens_in_it():
    recent = Recent()
    for number in range(10_000):
        recent.add(float(number), number)
    assert len(recent._durations) == 4096
    assert recent.summary(10_000)["max"] == 9999.0


def test_nothing_measured_is_nan():
    assert math.isnan(Histogram().quantile_ms(0.5))


def message(topic, stamp_ms, published_ms):
    payload = b"\x00\x01\x00\x00" + np.array([0, stamp_ms * MS], "<u4").tobytes()
    assert messages.peek_stamp_ns(payload) == stamp_ms * MS
    return Received(topic, None, 1, published_ms * MS, published_ms * MS, payload)


def test_a_scan_is_followed_to_its_pose_and_its_map():
    journeys = Journeys()
    for topic, at in (("scan", 110), ("odom", 125), ("pose", 155), ("map", 400)):
        journeys.see(message(topic, 10, at))
    exact = {"scan": 100, "match": 15, "map": 30, "whole": 145, "grid": 390}
    assert {name: hop.run.max_ms for name, hop in journeys.hops.items()} == exact
    assert journeys.values(500 * MS)["latency.match.p99_ms"] == "15.00"
    assert (journeys.scans, journeys.matched, journeys.mapped, journeys.late) == (1, 1, 1, 0)


def test_a_scan_that_was_overtaken_is_late_and_one_under_way_is_not():
    journeys = Journeys()
    for stamp in (10, 20, 30, 40):
        journeys.see(message("scan", stamp, stamp + 5))
    for stamp in (10, 30):
        journeys.see(message("odom", stamp, stamp + 50))
        journeys.see(message("pose", stamp, stamp + 60))
    assert (journeys.scans, journeys.mapped, journeys.late) == (4, 2, 1)


def test_scans_that_nobody_answers_do_not_grow_it():
    journeys = Journeys()
    for stamp in range(1, 1001):
        journeys.see(message("scan", stamp, stamp))
    assert journeys.scans == 1000
    assert len(journeys._under_way) == 256


def test_garbage_and_foreign_messages_are_let_pass():
    journeys = Journeys()
    journeys.see(Received("scan", None, 1, 5, 0, b"123"))
    journeys.see(Received("scan", None, -1, 0, 0, b"\x00\x01\x00\x00" + bytes(8)))
    assert journeys.scans == 0


def test_a_rate_is_that_of_the_last_seconds():
    rate = Rate()
    assert rate.update(0.0, 0) == 0.0
    for second in range(1, 20):
        value = rate.update(float(second), 10 * second)
    assert value == pytest.approx(10.0)
    for second in range(20, 40):
        value = rate.update(float(second), 190)
    assert value == 0.0
