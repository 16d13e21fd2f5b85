"""With which velocity a laser goes on where its way is not seen."""

import numpy as np
import pytest

from processing.cruise import Cruise
from processing.habits import SHARP_SCANS, SURE_M
from processing.prediction import exponential


def test_a_steady_velocity_is_the_mean_of_the_longest_time_that_agrees_with_the_present_one():
    rng = np.random.default_rng(3)
    cruise, twist = Cruise(0.1), np.array((0.35, 0.0, 0.0))
    for _ in range(80):
        cruise.see(exponential(0.1 * np.array((0.3 + rng.normal(0.0, 0.05), 0.0, 0.05))), 0.1)
    held = cruise.velocity(twist, 0.1)
    # A half second of it would be off by 0.02.
    assert held[0] == pytest.approx(0.3, abs=0.01)
    assert cruise.steady_s == pytest.approx(8.0, abs=0.2)
    # It stays until everything is seen again, whatever the filter makes of it.
    assert cruise.velocity(np.array((0.0, 0.0, 0.0)), 0.1) is held


def test_two_last_scans_that_hardly_see_do_not_change_the_velocity_of_seconds():
    cruise = Cruise(0.1)
    for speed in (0.3,) * 78 + (0.2, 0.1):
        cruise.see(exponential(0.1 * np.array((speed, 0.0, 0.0))), 0.1)
    # A filter that knows its velocity is believed, and one that does not is not.
    assert cruise.velocity(np.array((0.1, 0.0, 0.0)), 0.3)[0] == pytest.approx(0.3, abs=0.01)
    cruise.see(exponential(0.1 * np.array((0.1, 0.0, 0.0))), 0.1)
    assert cruise.velocity(np.array((0.1, 0.0, 0.0)), 0.05)[0] < 0.15


def test_after_a_stop_the_way_before_it_does_not_count():
    cruise = Cruise(0.1)
    for speed in (0.6,) * 15 + (0.0,) * 5:
        cruise.see(exponential(np.array((0.1 * speed, 0.0, 0.0))), 0.1)
    assert cruise.velocity(np.zeros(3), 0.1)[0] == pytest.approx(0.0, abs=1e-9)
    cruise.forget()
    assert cruise.velocity(np.array((0.2, 0.1, 0.0)), 0.1) == pytest.approx((0.2, 0.1))


def test_who_comes_out_of_a_turn_goes_on_as_straight_on_and_not_as_in_the_turn():
    cruise = Cruise(0.1)
    for speed, turn_rate in ((0.28, 0.8),) * 30 + ((0.3, 0.0),) * 15:
        cruise.see(exponential(0.1 * np.array((speed, 0.0, turn_rate))), 0.1)
    assert cruise.velocity(np.array((0.3, 0.0, 0.0)), 0.1)[0] == pytest.approx(0.3, abs=1e-3)
    # Still turning, there is nothing better than the newest moment.
    for _ in range(10):
        cruise.see(exponential(0.1 * np.array((0.28, 0.0, 0.8))), 0.1)
    assert cruise.velocity(np.array((0.28, 0.0, 0.8)), 0.1)[0] == pytest.approx(0.28, abs=1e-3)
    assert cruise.steady_s <= 0.5


@pytest.mark.parametrize(
    ("out_of_the_turn", "goes_on_with"),
    [
        ((0.1, 0.2, 0.3, 0.4), 0.8),  # speeds up: to what it had
        ((0.4, 0.3, 0.2, 0.1), 0.2),  # slows down
        ((0.4, 0.4, 0.4, 0.4), 0.4),  # is slow and stays it
        ((0.7, 0.9, 1.1, 1.3), 0.9),  # is faster than it was
        ((-0.1, -0.2, -0.3, -0.4), -0.2),  # backs off
    ],
)
def test_who_speeds_up_again_after_a_turn_goes_on_as_fast_as_before_it(out_of_the_turn, goes_on_with):
    cruise = Cruise(0.2)
    for speed, turn_rate in ((0.8, 0.0),) * 20 + ((0.1, 1.0),) * 10:
        cruise.see(exponential(0.2 * np.array((speed, 0.0, turn_rate))), 0.2)
    for speed in out_of_the_turn:
        cruise.see(exponential(0.2 * np.array((speed, 0.0, 0.5))), 0.2)
    # The middle one of the last five, which is what the laser is sure of.
    present = np.array((np.median((0.1, *out_of_the_turn)), 0.0, 0.5))
    assert cruise.velocity(present, 0.01)[0] == pytest.approx(goes_on_with, abs=0.05)
    # Nobody has seen that it goes so fast.
    assert cruise.steady_s <= 0.5


def test_one_that_has_hardly_stood_still_has_no_velocity_to_go_on_with():
    cruise = Cruise(0.2)
    for turn_rate in (0.5,) * 10 + (0.0,) * 5:
        cruise.see(exponential(0.2 * np.array((0.01, 0.0, turn_rate))), 0.2)
    assert cruise.velocity(np.zeros(3), 0.01) == pytest.approx((0.0, 0.0), abs=0.02)
    assert cruise.steady_s == 0.0
    for _ in range(6):
        cruise.see(np.zeros(3), 0.2)
    assert cruise.velocity(np.zeros(3), 0.01) == pytest.approx((0.0, 0.0), abs=0.02)
    assert cruise.steady_s >= 2.0


def test_a_velocity_that_grows_is_that_of_the_last_moments():
    cruise = Cruise(0.1)
    for speed in np.linspace(0.0, 0.4, 80):
        cruise.see(exponential(np.array((0.1 * speed, 0.0, 0.0))), 0.1)
    # Half of eight seconds of it would be 0.2.
    assert cruise.velocity(np.array((0.4, 0.0, 0.0)), 0.1)[0] == pytest.approx(0.4, abs=0.05)
    assert cruise.steady_s <= 1.0
    # Faster than a velocity can be called steady in any time.
    hasty = Cruise(0.1)
    for speed in (0.0, 0.2, 0.4, 0.6):
        hasty.see(exponential(np.array((0.1 * speed, 0.0, 0.0))), 0.1)
    assert hasty.velocity(np.array((0.8, 0.0, 0.0)), 0.1)[0] == pytest.approx(0.8)
    assert hasty.steady_s == 0.0


@pytest.mark.parametrize("vague_m", [0.05, 0.1])
def test_motions_that_hardly_see_weigh_as_little_as_they_know(vague_m):
    cruise, weight = Cruise(0.2), (SURE_M / vague_m) ** 2
    for speed, deviation_m in ((0.8, 0.005),) * 20 + ((0.7, vague_m),) * 4:
        cruise.see(exponential(0.2 * np.array((speed, 0.0, 0.0))), 0.2, deviation_m)
    held = cruise.velocity(np.array((0.8, 0.0, 0.0)), 0.01)[0]
    # The present velocity counts as one more.
    expected = np.average((0.8, 0.7), weights=(21.0, 4.0 * weight))
    assert held == pytest.approx(expected, abs=1e-6)
    assert held > np.average((0.8, 0.7), weights=(21.0, 4.0))


@pytest.mark.parametrize(
    ("seen_m_s", "goes_on_m_s"),
    [
        (0.29, 0.3),  # a second tells a velocity no better than this: it drives as always
        (0.31, 0.3),
        (0.25, 0.25),  # it drives slower here
        (0.36, 0.36),
    ],
)
def test_behind_a_corner_a_glimpse_tells_whether_it_drives_as_always_and_not_how_fast(seen_m_s, goes_on_m_s):
    cruise = Cruise(0.1)
    turning(cruise, 0.3, 0.0, 60)
    turning(cruise, 0.1, 0.9, 20)
    turning(cruise, seen_m_s, 0.0, 12)
    held = cruise.velocity(np.array((seen_m_s, 0.0, 0.0)), 0.01)
    assert held[0] == pytest.approx(goes_on_m_s, abs=0.004)
    # That it goes on so is as sure as the glimpse was long.
    assert cruise.steady_s == pytest.approx(1.3, abs=0.3)


def test_the_seconds_in_which_it_sped_up_do_not_count():
    cruise = Cruise(0.1)
    for speed in (0.15, 0.2, 0.25) + (0.3,) * 27:
        turning(cruise, speed, 0.0, 1)
    assert cruise.velocity(np.array((0.3, 0.0, 0.0)), 0.01)[0] == pytest.approx(0.3, abs=0.006)
    assert cruise.steady_s == pytest.approx(3.0, abs=0.2)


def test_the_usual_velocity_is_the_one_that_was_steady_for_longest_until_another_one_was():
    cruise = Cruise(0.1)
    turning(cruise, 0.3, 0.0, 80)
    turning(cruise, 0.1, 0.9, 20)
    turning(cruise, 0.306, 0.0, 25)
    turning(cruise, 0.1, -0.9, 20)
    turning(cruise, 0.309, 0.0, 12)
    present = np.array((0.309, 0.0, 0.0))
    assert cruise.velocity(present, 0.01)[0] == pytest.approx(0.3, abs=0.002)
    turning(cruise, 0.4, 0.0, 25)  # a moment of it is not another habit
    turning(cruise, 0.1, 0.9, 20)
    turning(cruise, 0.309, 0.0, 12)
    assert cruise.velocity(present, 0.01)[0] == pytest.approx(0.3, abs=0.002)
    turning(cruise, 0.4, 0.0, 45)
    turning(cruise, 0.1, 0.9, 20)
    turning(cruise, 0.309, 0.0, 12)
    assert cruise.velocity(present, 0.01)[0] == pytest.approx(0.309, abs=0.002)


def test_who_is_faster_than_ever_all_of_a_sudden_was_drawn_along_by_somebody():
    cruise = Cruise(0.1)
    turning(cruise, 0.4, 0.0, 60)
    for speed in (0.8, 1.0, 1.15, 0.95):
        turning(cruise, speed, 0.0, 1)
    assert cruise.velocity(np.array((0.97, 0.0, 0.0)), 0.4)[0] == pytest.approx(0.4, abs=0.01)
    assert cruise.steady_s == 0.0
    # Unless the filter knows.
    cruise.see(exponential(np.array((0.095, 0.0, 0.0))), 0.1)
    assert cruise.velocity(np.array((0.97, 0.0, 0.0)), 0.1)[0] > 0.9


@pytest.mark.parametrize(
    ("seen_m_s", "goes_on_m_s"), [((0.1, -0.3, 0.2, -0.4, 0.1), 0.4), ((0.34, 0.28, 0.2, 0.1, 0.0), 0.0)]
)
def test_who_was_drawn_to_and_fro_drives_as_usual_and_who_slows_down_does_not(seen_m_s, goes_on_m_s):
    cruise = Cruise(0.1)
    turning(cruise, 0.4, 0.0, 60)
    for speed in seen_m_s:
        turning(cruise, speed, 0.0, 1)
    assert cruise.velocity(np.array((-0.05, 0.0, 0.0)), 0.4)[0] == pytest.approx(goes_on_m_s, abs=0.06)
    assert cruise.steady_s == 0.0


def test_who_speeds_up_behind_a_sharp_turn_drives_on_as_before_it():
    cruise = Cruise(0.1)
    turning(cruise, 0.4, 0.0, 60)
    for speed in (0.37, 0.3, 0.22, 0.23, 0.22, 0.21, 0.17, 0.31, 0.3, 0.37):
        turning(cruise, speed, 1.0, 1)
    assert cruise.velocity(np.array((0.3, 0.0, 1.0)), 0.4)[0] == pytest.approx(0.4, abs=0.01)


def turning(cruise, speed, turn_rate, scans):
    for _ in range(scans):
        cruise.see(exponential(0.1 * np.array((speed, 0.0, turn_rate))), 0.1)


def test_who_turns_unseen_goes_on_as_it_was_seen_to_turn_and_nothing_of_that_is_steady():
    cruise, present = Cruise(0.1), np.array((0.4, 0.0, 0.0))
    turning(cruise, 0.2, 0.5, SHARP_SCANS)
    turning(cruise, 0.02, -1.2, SHARP_SCANS - 1)
    turning(cruise, 0.4, 0.0, 80)
    assert cruise.velocity(present, 0.1, 0.2)[0] == pytest.approx(0.4, abs=0.01)
    assert cruise.steady_s > 2.0
    # Of turns as sharp as the second not enough were seen yet: then it is that of the others.
    assert cruise.velocity(present, 0.1, -0.5)[0] == pytest.approx(0.2)
    assert cruise.velocity(present, 0.1, 1.0)[0] == pytest.approx(0.2)
    assert cruise.steady_s == 0.0
    turning(cruise, 0.02, 0.9, 1)
    turning(cruise, 0.4, 0.0, 80)
    assert cruise.velocity(present, 0.1, 1.0)[0] == pytest.approx(0.02)
    # Out of the turn it drives on as before, and nobody knows whether it does.
    assert cruise.velocity(present, 0.1, 0.0)[0] == pytest.approx(0.4, abs=0.01)
    assert cruise.steady_s == 0.0


def test_who_was_never_seen_to_turn_is_taken_to_drive_on():
    cruise = Cruise(0.1)
    turning(cruise, 0.4, 0.0, 80)
    assert cruise.velocity(np.array((0.4, 0.0, 0.0)), 0.1, 1.0)[0] == pytest.approx(0.4, abs=0.01)
    assert cruise.steady_s == 0.0


def held_at(cruise, speed, deviation_m=0.005):
    """Make a velocity the one that goes on."""
    for _ in range(10):
        cruise.see(exponential(0.2 * np.array((speed, 0.0, 0.0))), 0.2, deviation_m)
    return cruise.velocity(np.array((speed, 0.0, 0.0)), 0.01)


def test_what_was_hardly_seen_was_not_steady():
    cruise = Cruise(0.2)
    held_at(cruise, 0.4, 0.1)
    assert cruise.steady_s == 0.0
    held_at(cruise, 0.4, 0.005)
    assert cruise.steady_s >= 2.0
