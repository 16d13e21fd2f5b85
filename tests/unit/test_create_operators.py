"""Who steers, and how old an input really is."""

import pytest

from drivers.create.operators import Input, Operators

MS = 1_000_000
LIMIT = 250 * MS


def said(operators, name, stamp_ms, arrived_ms, speed=0.1):
    """Let an operator say something; return its age in ms, or None if it did not count."""
    given = Input(name, round(stamp_ms * MS), round(arrived_ms * MS), speed, 0.0)
    made_ns = operators.admit(given, LIMIT)
    return None if made_ns is None else (given.received_ns - made_ns) / MS


def test_the_first_to_speak_has_the_robot():
    operators = Operators()
    assert said(operators, "anna", 0, 1) == 1
    assert said(operators, "ben", 0, 2) is None
    assert (operators.holder, operators.refused, operators.refused_inputs) == ("anna", "ben", 1)
    assert said(operators, "anna", 50, 51) == 1


def test_who_is_silent_for_two_seconds_has_it_no_longer():
    operators = Operators()
    said(operators, "anna", 0, 0)
    assert said(operators, "ben", 2000, 2000) is None
    assert said(operators, "ben", 2001, 2001) == 0
    assert operators.holder == "ben"
    assert operators.refused is None


def test_a_repeated_or_older_input_does_not_count():
    operators = Operators()
    assert said(operators, "anna", 100, 100) == 0
    assert said(operators, "anna", 100, 120) is None
    assert said(operators, "anna", 90, 130) is None
    assert operators.repeated_inputs == 2
    assert said(operators, "anna", 140, 140) == 0


def test_where_clocks_agree_the_whole_way_counts_as_age():
    operators = Operators()
    assert said(operators, "anna", 0, 40) == 40
    assert said(operators, "anna", 100, 200) == 100
    assert said(operators, "anna", 200, 460) is None
    assert operators.late_inputs == 1


@pytest.mark.parametrize("ahead_ms", [-7_200_000, -250, 150, 3_600_000])
def test_where_clocks_differ_the_age_counts_from_the_quickest_message(ahead_ms):
    operators = Operators()
    assert said(operators, "anna", 1000 - ahead_ms, 1010) == 0
    assert said(operators, "anna", 1100 - ahead_ms, 1105) == 0
    assert said(operators, "anna", 1200 - ahead_ms, 1225) == pytest.approx(20, abs=0.1)
    assert said(operators, "anna", 1300 - ahead_ms, 1600) is None


def test_a_burst_after_a_lost_link_does_not_count():
    operators = Operators()
    for t in range(0, 1000, 50):
        assert said(operators, "anna", t - 5000, t + 3) is not None
    # For 0.6 s nothing arrives; then everything that was sent meanwhile arrives at once.
    counted = [said(operators, "anna", t - 5000, 1603) for t in range(1000, 1600, 50)]
    assert counted[:6] == [None] * 6
    assert operators.late_inputs >= 6


def test_a_link_that_stays_slow_does_not_become_normal():
    operators = Operators()
    for t in range(0, 1000, 50):
        said(operators, "anna", t - 5000, t + 3)
    late = [said(operators, "anna", t - 5000, t + 503) for t in range(1000, 61_000, 100)]
    assert late == [None] * len(late)


def test_a_clock_that_drifts_is_followed():
    operators = Operators()
    ages = [said(operators, "anna", t * (1 - 1e-4) - 9000, t + 2) for t in range(0, 1_800_000, 100)]
    assert max(ages) < 50


def test_after_a_long_silence_an_operator_may_have_another_clock():
    operators = Operators()
    said(operators, "anna", 10_000_000, 0)
    assert said(operators, "anna", 500, 500) is None
    assert said(operators, "anna", 3000, 3000) == 0


def test_what_is_no_number_does_not_count():
    operators = Operators()
    assert said(operators, "anna", 0, 0, speed=float("nan")) is None
    assert said(operators, "anna", 1, 1, speed=float("inf")) is None
    assert operators.impossible_inputs == 2
    assert operators.holder is None


def test_a_flood_of_operators_is_forgotten():
    operators = Operators()
    said(operators, "anna", 0, 0)
    for i in range(1000):
        said(operators, f"x{i}", i, 1)
    assert len(operators._known) <= 17
    assert operators.holder == "anna"
    assert said(operators, "anna", 50, 50) == 0
