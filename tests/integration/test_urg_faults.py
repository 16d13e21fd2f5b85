"""Twenty-five things that go wrong with this sensor, each done to a real line, and what the scans become."""

import dataclasses

import numpy as np
import pytest

from drivers.urg04lx import faults
from drivers.urg04lx.emulator import PERIOD_NS, Emulator
from drivers.urg04lx.model import URG_04LX, Mode
from drivers.urg04lx.pair import Session, attach
from drivers.urg04lx.protocol import encode_scan

SPEED = 4.0
IDLE = {"mode": Mode.IDLE, "speed": SPEED}


def run(emulator, **wanted):
    return Session(attach(emulator, speed=SPEED, **wanted), emulator)


def true_stamps(emulator):
    """The true time of the first ray of every scan, by the sensor's stamp."""
    return {stamp_ms: step_0_ns + 44 * PERIOD_NS // 1024 for stamp_ms, step_0_ns in emulator.sweeps}


def only_one_lost(damage, kind):
    """Spoil one scan in a running stream; everything else must arrive, without a restart."""
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.spoil(damage)
        assert session.more_scans(6)
        sent = [stamp for stamp, _ in emulator.sweeps]
        requests = list(emulator.requests)
    got = [scan.sensor_ms for scan in session.scans]
    lost = [stamp for stamp in sent if sent[0] <= stamp <= got[-1] and stamp not in got]
    assert len(lost) == 1
    assert session.device.decoder.damaged == {kind: 1}
    # What the line had no room for, on a busy machine, is missing too.
    assert 1 <= session.device.sequence.missed <= 1 + emulator.dropped
    assert requests.count(b"MD0044072501000") == 1
    assert session.device.counts["restarts"] == 0


def test_hook_1_a_flipped_data_byte_costs_one_scan():
    only_one_lost(faults.flip(700), "sum")


def test_hook_1_a_flip_that_the_sum_cannot_see_costs_one_scan():
    only_one_lost(faults.flip(700, 0x80), "character")


def test_hook_2_a_lost_byte_costs_one_scan():
    only_one_lost(faults.delete(700), "length")


def test_hook_3_a_lost_line_end_costs_one_scan():
    only_one_lost(faults.delete_line_end(9), "length")


def test_hook_4_a_lost_end_costs_one_scan_and_not_the_next():
    only_one_lost(faults.delete_end, "no end")


@pytest.mark.parametrize("garbage", [b"\x00", b"\xff", b"\x00\xff" * 10_000])
def test_hook_5_garbage_inside_costs_one_scan(garbage):
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.spoil(faults.insert(300, garbage))
        assert session.more_scans(10)
    assert session.device.sequence.missed >= 1
    assert session.device.counts["restarts"] == 0
    assert session.device.decoder.skipped_bytes >= len(garbage)


def test_hook_6_a_scan_cut_short_costs_itself_and_not_the_next():
    only_one_lost(faults.truncate(900), "no end")


@pytest.mark.parametrize(("pause_s", "restarts"), [(0.2, 0), (1.5, 1), (4.0, 2)])
def test_hook_7_a_pause_is_waited_for_reported_and_treated_as_long_as_it_lasts(pause_s, restarts):
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.silence(pause_s)
        assert session.more_scans(5, 15.0)
        assert session.until(lambda: session.notices[-1].level == "ok", 3.0)
    assert session.said("no scan for") or pause_s < 0.3
    assert session.device.counts["restarts"] <= restarts
    assert (session.device.counts["restarts"] > 0) == (restarts > 0)
    assert session.device.counts["failures"] == 0


def test_hook_7_a_pause_of_more_than_five_seconds_leads_to_opening_the_port_again():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.silence(6.0)
        assert session.more_scans(5, 25.0)
        assert emulator.requests.count(b"VV") == 1  # the same plugging: not asked twice
    assert session.said("opening the port again")
    assert len(session.connections) == 2


@pytest.mark.parametrize(
    ("wake_on", "times", "resets", "connections"),
    [(b"QT", 1, 0, 1), (b"RS", 1, 1, 1), (b"RS", 2, 1, 2)],
)
def test_hook_8_silence_is_cured_by_the_weakest_remedy_that_helps(wake_on, times, resets, connections):
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.silence(wake_on=wake_on, times=times)
        assert session.more_scans(3, 40.0)
    assert session.device.counts["resets"] == resets
    assert len(session.connections) == connections


def test_hook_8_silence_for_ever_is_an_error_that_stays_and_says_what_to_do():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.silence()
        assert session.until(lambda: session.device.counts["failures"] >= 2, 30.0)
        assert session.until(lambda: session.said("plug it in again"), 10.0)
        assert session.notices[-1].level == "error"
        assert len(session.connections) == 1


def test_hook_9_a_sensor_that_stops_to_verify_an_error_is_left_in_peace():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.fault(b"21")
        assert session.until(lambda: session.said("verify an error (status 21)"), 3.0)
        assert not session.more_scans(1, 2.5)
        emulator.fault(b"98")
        assert session.more_scans(3)
        assert emulator.requests.count(b"QT") == 1
    assert session.device.counts["restarts"] == 0


def test_hook_9_one_that_never_comes_back_from_verifying_is_started_again():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.fault(b"21")
        assert session.more_scans(3, 15.0)
    assert session.device.counts["restarts"] == 1


def test_hook_9_hardware_trouble_is_told_word_for_word_and_the_sensor_reset():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.fault(b"55")
        assert session.more_scans(3, 15.0)
        sent = list(emulator.requests)
    assert sent[sent.index(b"RS") - 1] == b"QT"
    assert session.said("status 55")
    assert session.said("cut its power")
    assert session.device.counts["faults"] == 1
    assert len(session.connections) == 2
    # A good scan, and nothing less, makes the next trouble the first one again.
    assert session.device._faults == session.device._failures == 0


def test_hook_9_trouble_that_does_not_end_is_tried_again_every_thirty_seconds():
    with Emulator(mode=Mode.IDLE, speed=20.0) as emulator:
        # Every scan is trouble: there is never a good one that would clear the count.
        emulator.spoil(faults.status(b"55"), 10_000)
        with Session(attach(emulator, speed=20.0), emulator) as session:
            assert session.until(lambda: session.device.counts["faults"] >= 5, 120.0)
            before_ns = emulator.now_ns()
            assert session.until(lambda: session.device.counts["faults"] >= 6, 60.0)
            assert (emulator.now_ns() - before_ns) / 1e9 > 29.0


def test_hook_10_a_scan_that_comes_twice_is_taken_once():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        emulator.spoil(faults.duplicate, 3, every=2)
        assert session.more_scans(10)
    stamps = [scan.sensor_ms for scan in session.scans]
    assert len(stamps) == len(set(stamps))
    assert session.device.sequence.duplicates == 3


def test_hook_11_a_scan_that_does_not_come_is_counted_as_missed():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(2)
        emulator.spoil(faults.skip, 2, every=3)
        assert session.more_scans(8)
    assert 2 <= session.device.sequence.missed <= 2 + emulator.dropped
    assert session.device.decoder.damaged.total() == 0


def test_hook_12_the_wrap_of_the_counter_is_not_seen_in_the_stamps():
    with Emulator(**IDLE, start_ms=(1 << 24) - 1500) as emulator, run(emulator) as session:
        assert session.more_scans(20)
        truth = true_stamps(emulator)
    raw = [scan.sensor_ms for scan in session.scans]
    assert max(raw) > 16_776_000
    assert min(raw) < 2000
    for scan in session.scans:
        assert scan.stamp_ns == pytest.approx(truth[scan.sensor_ms], abs=60_000_000)
    assert session.device.clock.jumps == 0
    assert session.device.sequence.missed <= emulator.dropped


def test_hook_13_a_counter_back_at_zero_gives_no_wrong_stamp():
    with Emulator(**IDLE, start_ms=1_000_000) as emulator, run(emulator) as session:
        assert session.more_scans(6)
        emulator.reset_timer()
        assert session.more_scans(10)
        truth = true_stamps(emulator)
    assert session.device.clock.jumps == 1
    assert min(scan.sensor_ms for scan in session.scans) < 10_000
    for scan in session.scans:
        assert scan.stamp_ns == pytest.approx(truth[scan.sensor_ms], abs=60_000_000)
    stamps = [scan.stamp_ns for scan in session.scans]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize(("hook", "mode"), [(14, Mode.STREAMING), (15, Mode.TIME), (16, Mode.SCIP1)])
def test_hooks_14_to_16_the_state_it_was_left_in_does_not_matter(hook, mode):
    with Emulator(mode=mode, speed=SPEED) as emulator, run(emulator) as session:
        assert session.more_scans(3)
    assert len(session.connections) == 1


def test_hook_17_the_switch_answered_with_an_error_of_scip_2_is_a_success():
    class Hasty(Emulator):
        """Answers E to the first QT, though it is in SCIP 2.0 already."""

        def _answer(self, line, at_ns):
            if line == b"QT" and b"SCIP2.0" not in self.requests:
                self._emit(b"QT\nE\n\n", at_ns)
            else:
                super()._answer(line, at_ns)

    with Hasty(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        assert emulator.requests[1] == b"SCIP2.0"


def test_hook_18_a_sensor_without_a_sensitive_mode_measures_without():
    with Emulator(**IDLE) as emulator, run(emulator, sensitive=True) as session:
        assert session.more_scans(3)
        assert b"HS1" in emulator.requests
    assert session.said("no sensitive mode")


def test_hook_19_a_version_with_a_wrong_sum_and_a_line_too_many_is_a_version():
    odd = dataclasses.replace(URG_04LX, odd_version=True)
    with Emulator(model=odd, **IDLE) as emulator, run(emulator, serial="H0706400") as session:
        assert session.more_scans(3)
    assert session.connections[0].identity.version.serial == "H0706400"
    assert session.said("wrong sum")


def test_hook_20_unplugged_and_back_under_another_name_in_scip_1(tmp_path):
    with Emulator(mode=Mode.IDLE, speed=SPEED, link=tmp_path / "ttyACM0") as emulator:
        with run(emulator) as session:
            assert session.more_scans(3)
            emulator.unplug()
            assert session.until(lambda: session.said("unplugged"), 5.0)
            emulator.plug(tmp_path / "ttyACM1")
            assert session.more_scans(3, 20.0)
            sent = list(emulator.requests)
        assert [c.path for c in session.connections] == [str(tmp_path / "ttyACM0"), str(tmp_path / "ttyACM1")]
    assert sent.count(b"VV") == 2  # another plugging: perhaps another unit
    assert b"SCIP2.0" in sent
    stamps = [scan.stamp_ns for scan in session.scans]
    assert stamps == sorted(stamps)


def test_hook_20_power_lost_without_losing_the_port_is_recovered_from():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.power_cycle()
        assert session.more_scans(3, 15.0)
        assert b"SCIP2.0" in emulator.requests
    assert len(session.connections) == 1


def test_hook_21_a_wrong_rate_gives_garbage_and_the_right_one_is_found():
    with Emulator(mode=Mode.STREAMING, rs232=True, speed=SPEED) as emulator:
        emulator.sensor.baud = emulator.sensor.next_baud = 115_200
        with run(emulator, baud=500_000) as session:
            assert session.more_scans(3, 30.0)
            assert b"SS500000" in emulator.requests


def test_hook_22_bytes_one_by_one_are_scans_all_the_same():
    with Emulator(mode=Mode.IDLE, speed=1.0, chunk_bytes=1) as emulator:
        with Session(attach(emulator), emulator) as session:
            assert session.more_scans(4)
        assert session.device.decoder.damaged.total() == 0


def test_hook_23_sums_that_look_like_separators_are_sums():
    def sums(ray_times_ns):
        """Lines whose sums are every character in turn, among them ; and backslash."""
        return np.arange(len(ray_times_ns), dtype=np.int32) * 7 % 5581 + 20

    with Emulator(sums, **IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(3)
    values = np.rint(session.scans[0].ranges_m * 1000).astype(int)
    assert values.tolist() == sums(np.zeros(682)).tolist()
    ends = {line[-1:] for line in encode_scan(b"M" * 15, b"99", 0, values, 3).split(b"\n") if len(line) == 65}
    assert len(ends) > 15

    def both(ray_times_ns):
        seen = np.full(len(ray_times_ns), 64, dtype=np.int32)
        # The last line carries the last twenty values and two thirds of the one before.
        seen[-1] = 64 + next(n for n in range(64) if tail(seen, 64 + n) == b";")
        seen[0] = 64 + next(n for n in range(64) if first(seen, 64 + n) == b"\\")
        return seen

    def lines(seen):
        return encode_scan(b"M" * 15, b"99", 0, seen, 3).split(b"\n")

    def tail(seen, value):
        return lines(np.append(seen[:-1], value))[-3][-1:]

    def first(seen, value):
        return lines(np.append(value, seen[1:]))[3][-1:]

    with Emulator(both, **IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(2)
    assert session.device.decoder.damaged.total() == 0


def test_hook_24_a_sensor_that_takes_a_second_version_amiss_is_not_asked_twice():
    touchy = dataclasses.replace(URG_04LX, mute_after_versions=2)
    with Emulator(model=touchy, speed=SPEED) as emulator, run(emulator) as session:
        assert session.more_scans(3)
        emulator.silence(6.0)  # long enough to open the port again
        assert session.more_scans(3, 25.0)
        assert emulator.requests.count(b"VV") == 1
        assert not [line for line in emulator.requests if line[:2] in (b"ME", b"GE", b"HD")]


@pytest.mark.parametrize("step_s", [1.0, -1.0])
def test_hook_25_a_step_of_the_host_clock_gives_no_wrong_stamp(step_s):
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(8)
        emulator.step_host_clock(step_s)
        assert session.more_scans(12, 20.0)
        truth = true_stamps(emulator)
    # The clock of the device steps with the host: a scan under way belongs to either side of the step.
    steps = [scan.stamp_ns - truth[scan.sensor_ms] for scan in session.scans]
    assert all(abs(error) < 60e6 or abs(error - step_s * 1e9) < 60e6 for error in steps)
    assert sum(abs(error) > 60e6 for error in steps) <= 3
    assert session.device.clock.jumps <= 1


def test_five_per_cent_of_damaged_scans_cost_themselves_and_no_reconnection():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        emulator.spoil(faults.delete(500), 6, every=20)
        assert session.more_scans(110, 30.0)
    assert session.device.decoder.damaged.total() == 5
    assert session.device.counts["restarts"] == 0
    assert len(session.connections) == 1


def test_ten_damaged_scans_in_a_row_start_the_stream_again():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(2)
        emulator.spoil(faults.flip(300), 11)
        assert session.more_scans(3, 10.0)
        assert emulator.requests.count(b"MD0044072501000") >= 2
    # Ten scans are a second, after which the silence of good ones says the same.
    assert session.said("many damaged scans") or session.said("starting the stream again")
    assert len(session.connections) == 1


def test_a_third_of_damaged_scans_starts_the_stream_again():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        assert session.more_scans(2)
        emulator.spoil(faults.flip(300), 20, every=3)
        assert session.until(lambda: session.said("many damaged scans"), 15.0)
        assert session.more_scans(3, 10.0)


def test_a_connection_without_scans_is_no_success():
    with Emulator(**IDLE) as emulator:
        emulator.spoil(faults.skip, 100_000)
        with run(emulator) as session:
            assert session.until(lambda: session.device.counts["failures"] >= 2, 60.0)
            waits = session.device._back_off_s()
    assert session.scans == []
    assert waits == 1.0  # the second failure in a row: acknowledged streams did not clear the count


def test_every_scan_lost_between_two_others_is_accounted_for():
    with Emulator(**IDLE) as emulator, run(emulator) as session:
        emulator.spoil(faults.skip, 2, every=4)
        emulator.spoil(faults.flip(200), 2, every=4)
        emulator.spoil(faults.duplicate, 2, every=4)
        assert session.more_scans(24)
        sent = [stamp for stamp, _ in emulator.sweeps]
    got = [scan.sensor_ms for scan in session.scans]
    within = sent[sent.index(got[0]) : sent.index(got[-1]) + 1]
    # Stamps of the last scans may have come after the session was asked: count up to what the device saw.
    assert len(within) - len(got) == 4
    assert 4 <= session.device.sequence.missed <= 4 + emulator.dropped
