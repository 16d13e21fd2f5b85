"""The watch over a stream: when which remedy is due, and how much damage is too much."""

import pytest

from drivers.urg04lx.watch import Remedy, Watch

S = 1_000_000_000


def remedies(watch, from_s, to_s):
    """Ask every 50 ms; return what was due when."""
    found = {}
    for tick in range(round(from_s * 20), round(to_s * 20)):
        if (remedy := watch.due(tick * S // 20)) is not None:
            found[remedy] = tick / 20
    return found


def test_the_ladder_is_climbed_step_by_step_after_the_last_good_scan():
    watch = Watch(0, 0.1)
    watch.good(10 * S)
    assert remedies(watch, 10, 16) == {
        Remedy.REPORT: pytest.approx(10.3, abs=0.051),
        Remedy.RESTART: pytest.approx(11.0, abs=0.051),
        Remedy.RESET: pytest.approx(13.0, abs=0.051),
        Remedy.REOPEN: pytest.approx(15.0, abs=0.051),
    }


def test_the_first_scan_has_two_seconds():
    assert remedies(Watch(0, 0.1), 0, 3) == {Remedy.RESTART: pytest.approx(2.0, abs=0.051)}


def test_a_slower_stream_is_given_its_own_period():
    watch = Watch(0, 0.5)
    watch.good(10 * S)
    assert remedies(watch, 10, 10.65) == {}
    assert watch.due(round(10.75 * S)) is Remedy.REPORT


def test_only_the_first_good_scan_after_an_illness_is_a_recovery():
    watch = Watch(0, 0.1)
    assert watch.good(1 * S)
    assert not watch.good(round(1.1 * S))
    assert watch.due(2 * S) is Remedy.REPORT
    assert watch.good(round(2.1 * S))


def test_a_sensor_that_asks_for_time_is_given_it():
    watch = Watch(0, 0.1)
    watch.good(10 * S)
    watch.wait(10 * S)
    assert remedies(watch, 10, 14) == {}
    assert Remedy.RESTART in remedies(watch, 14, 16)


def test_a_stream_that_is_acknowledged_again_has_time_to_prove_it():
    watch = Watch(0, 0.1)
    watch.good(0)
    assert Remedy.RESTART in remedies(watch, 0, 2.9)
    watch.restarted(round(2.9 * S))
    assert remedies(watch, 2.9, 4) == {Remedy.RESET: pytest.approx(3.5, abs=0.051)}


def test_ten_damaged_scans_in_a_row_are_too_many_and_nine_are_not():
    watch = Watch(0, 0.1)
    watch.good(0)
    assert not any(watch.damaged(1, n * S // 10) for n in range(9))
    assert watch.damaged(1, S)
    assert not watch.damaged(1, S)  # counted anew after the restart


def test_a_good_scan_in_between_ends_the_row():
    watch = Watch(0, 0.1)
    for n in range(9):
        watch.damaged(1, n)
    watch.good(10)
    assert not watch.damaged(5, 11)


@pytest.mark.parametrize(("every", "too_bad"), [(20, False), (6, False), (4, True), (2, True)])
def test_more_than_a_fifth_within_five_seconds_is_too_many(every, too_bad):
    watch = Watch(0, 0.1)
    found = False
    for n in range(200):
        at_ns = n * S // 10
        if n % every == 0:
            found |= watch.damaged(1, at_ns)
        else:
            watch.good(at_ns)
            found |= watch.damaged(0, at_ns)
    assert found == too_bad
