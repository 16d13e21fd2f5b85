"""Text logs: what each format means, and one clear line for each way in which it can be wrong."""

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from runtime.formats.errors import FormatError
from runtime.formats.logs import open_log

FLASER_TAIL = "0.1 0.2 0.3 0.4 0.5 0.6"


def flaser(ranges, stamp="976052857.337530", tail=FLASER_TAIL):
    return f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {tail} {stamp} nohost 0.000246\n"


def robotlaser(ranges, stamp="10.5", start=-1.0, field=2.0, step=0.5, maximum=20.0, remissions=()):
    head = f"ROBOTLASER1 0 {start} {field} {step} {maximum} 0.01 0 {len(ranges)}"
    intensities = "".join(f" {one}" for one in remissions)
    body = f"{head} {' '.join(map(str, ranges))} {len(remissions)}{intensities}"
    return f"{body} 1 2 3 4 5 6 0 0 0 0 0 {stamp} host 0.1\n"


def tinyslam(ranges, stamp_us=212387282, header=24):
    return f"{stamp_us} {' '.join(['0'] * (header - 1))}  {' '.join(map(str, ranges))} \n"


def wean(ranges, stamp="25.466000"):
    return f"L -94.2 -139.9 -1.3 -88.5 -164.3 -1.3 {' '.join(map(str, ranges))} {stamp}\n"


def written(tmp_path: Path, text: str | bytes, name: str = "some.log") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def only_first(log, count):
    return [(record.stamp_ns, record.ranges_m.tobytes()) for record in list(log)[:count]]


def only(log):
    (record,) = log
    return record


# ---- CARMEN ----


def test_the_ipc_time_of_a_flaser_line_is_kept_digit_by_digit(tmp_path):
    log = open_log(written(tmp_path, flaser([1.0, 2.0], stamp="976052857.337530")))
    assert log.stamps_ns.tolist() == [976052857337530000]
    assert log.kind == "CARMEN FLASER"
    assert log.topic is None


@pytest.mark.parametrize(("count", "steps"), [(180, 180), (360, 360), (181, 180), (361, 360)])
def test_flaser_fans_of_even_counts_end_one_step_early(tmp_path, count, steps):
    g = open_log(written(tmp_path, flaser([1.0] * count))).geometry
    assert g.count == count
    assert g.angle_min_rad == pytest.approx(-math.pi / 2)
    assert g.angle_increment_rad == pytest.approx(math.pi / steps)
    # A SICK's mirror turns 75 times a second; every ray of a half circle comes in half a turn.
    assert g.time_increment_s * steps == pytest.approx(1.0 / 150.0)


def test_readings_become_distances_no_return_or_no_information(tmp_path):
    log = open_log(written(tmp_path, flaser([1.07, 81.83, 50.0, 0.0, -1.0, "nan"])))
    np.testing.assert_array_equal(
        only(log).ranges_m, np.array([1.07, np.inf, np.inf, np.nan, np.nan, np.nan], dtype=np.float32)
    )
    (notice,) = log.notices
    assert notice.endswith("3 readings are no distance (first at line 1, beam 3: 0); taken as no information")


def test_odometry_parameters_and_other_lasers_are_passed_over(tmp_path):
    lines = "# CARMEN Logfile\nPARAM x 1 0 h 0\nODOM 0 0 0 0 0 0 1.0 h 0\nRLASER 1 5 0 0 0 0 0 0 1.0 h 0\n"
    log = open_log(written(tmp_path, lines + flaser([3.0])))
    assert only(log).ranges_m.tolist() == [3.0]


def test_robotlaser_tells_its_own_fan_and_its_own_maximum(tmp_path):
    log = open_log(written(tmp_path, robotlaser([1.0, 19.9, 20.0, 81.0], remissions=(7, 8, 9, 10))))
    g = log.geometry
    assert (g.angle_min_rad, g.angle_increment_rad, g.range_max_m) == (-1.0, 0.5, 20.0)
    # Of a fan that is no half circle nobody knows how long it takes.
    assert g.time_increment_s == 0.0
    np.testing.assert_array_equal(only(log).ranges_m, np.array([1.0, 19.9, np.inf, np.inf], dtype=np.float32))
    assert log.stamps_ns.tolist() == [10_500_000_000]


@pytest.mark.parametrize("count", [180, 181])
def test_a_robotlaser_of_a_half_circle_has_the_time_of_a_sick_as_a_flaser_has(tmp_path, count):
    step = math.pi / 180
    line = robotlaser([1.0] * count, start=-math.pi / 2, field=math.pi, step=step)
    assert open_log(written(tmp_path, line)).geometry.time_increment_s == pytest.approx(1.0 / 75.0 / 360)


def test_a_robotlaser_without_resolution_spreads_its_rays_over_its_field_of_view(tmp_path):
    log = open_log(written(tmp_path, robotlaser([1.0] * 5, step=0.0)))
    assert log.geometry.angle_increment_rad == 0.5


def test_of_two_kinds_of_messages_the_same_scans_are_taken_once(tmp_path):
    both = flaser([1.0, 2.0]) + robotlaser([5.0, 6.0, 7.0])
    assert len(open_log(written(tmp_path, both))) == 1
    assert open_log(written(tmp_path, both + flaser([3.0, 4.0]))).kind == "CARMEN FLASER"


@pytest.mark.parametrize(
    ("compress", "name"), [(bz2.compress, "a.clf.bz2"), (gzip.compress, "a.log.gz"), (bz2.compress, "a.dat")]
)
def test_compression_is_found_by_content_whatever_the_name_says(tmp_path, compress, name):
    assert len(open_log(written(tmp_path, compress(flaser([1.0]).encode()), name))) == 1


# ---- tinySLAM ----


@pytest.mark.parametrize("header", [24, 25])
def test_the_last_682_columns_of_a_tinyslam_line_are_millimetres(tmp_path, header):
    ranges = [0, 19, 20, 2229, *[1000] * 677, 5601]
    log = open_log(written(tmp_path, tinyslam(ranges, header=header)))
    record = only(log)
    assert record.stamp_ns == 212387282000
    np.testing.assert_array_equal(
        record.ranges_m[:5], np.array([np.nan, np.nan, 0.02, 2.229, 1.0], dtype=np.float32)
    )
    assert np.isposinf(record.ranges_m[-1])
    assert log.notices == ()  # error codes are part of the format


def test_the_front_of_a_tinyslam_scan_is_beam_340(tmp_path):
    g = open_log(written(tmp_path, tinyslam([1000] * 682))).geometry
    assert g.angle_min_rad + 340 * g.angle_increment_rad == pytest.approx(0.0, abs=1e-12)
    assert math.degrees(g.angle_min_rad) == pytest.approx(-119.53, abs=0.005)
    assert g.time_increment_s == 1 / 10240


# ---- Wean ----


def test_a_wean_line_is_centimetres_from_the_right(tmp_path):
    log = open_log(written(tmp_path, "O 1 2 3 4.5\n" + wean([66, 8183, *[250] * 178])))
    assert only(log).ranges_m[:3].tolist() == [np.float32(0.66), np.inf, 2.5]
    assert log.stamps_ns.tolist() == [25_466_000_000]
    assert log.geometry.angle_min_rad == pytest.approx(-math.pi / 2)
    assert log.geometry.angle_increment_rad == pytest.approx(math.radians(1))
    assert log.geometry.time_increment_s == pytest.approx(1.0 / 75.0 / 360)


# ---- stamps and rate ----


def test_stamps_that_go_backwards_are_kept_in_file_order_and_told_once(tmp_path):
    stamps = ["1.0", "1.2", "1.1", "1.4", "1.3"]
    log = open_log(written(tmp_path, "".join(flaser([1.0 + i], s) for i, s in enumerate(stamps))))
    assert [record.ranges_m[0] for record in log] == [1, 2, 3, 4, 5]
    assert log.stamps_ns.tolist() == [int(float(s) * 10) * 100_000_000 for s in stamps]
    (notice,) = log.notices
    assert "stamps go backwards 2 times (first at scan 3: 1.200000 -> 1.100000 s)" in notice


def test_the_period_is_the_rate_of_the_log_and_not_of_its_bursts(tmp_path):
    rng = np.random.default_rng(1)
    true_s = 0.0987 * np.arange(600)
    true_s[300:] += 40.0  # a pause
    arrival_s = 5.0 + true_s + rng.choice([0.0, 0.06, 0.15], 600)
    text = "".join(flaser([1.0], f"{s:.6f}") for s in arrival_s)
    assert open_log(written(tmp_path, text)).geometry.period_s == pytest.approx(0.0987, rel=0.005)


@pytest.mark.parametrize("stamps", [["5.0"], ["5.0", "5.0", "5.0"], ["5.0", "500.0"]])
def test_stamps_that_tell_no_rate_leave_ten_scans_a_second(tmp_path, stamps):
    log = open_log(written(tmp_path, "".join(flaser([1.0], s) for s in stamps)))
    assert log.geometry.period_s == 0.1


# ---- what is wrong, said once ----


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ("\n\n  \n", "only blank lines"),
        ("hello world\n", r":1: not a laser log: it begins with 'hello world'; known: tinySLAM"),
        (b"\x00\x01\x02\x03" * 50, ":1: not text: binary bytes"),
        (b"FLASER \xff\n", ":1: not text: byte 0xff"),
        ("# CARMEN Logfile\nODOM 0 0 0 0 0 0 1.0 h 0\n", "0 scans found, a CARMEN log must hold FLASER"),
        ("1" * 2_000_000, ":1: a line of more than 1048576 bytes"),
        ("O 1 2 3 4.5\n", "0 scans found, a Wean log must hold at least 1"),
        (flaser([1, 2]) + flaser([1, 2, 3]), r":2: scan of 3 beams, must be 2 as in line 1"),
        (flaser([1, 2]) + flaser([1, 2])[:30] + "\n", r":2: FLASER with \d+ fields, must be 12: the"),
        ("FLASER\n", ":1: FLASER readings = '', must be a whole number"),
        ("FLASER -3 1 2 3\n", ":1: FLASER readings = '-3', must be a whole number of at least 1"),
        (flaser(["1.0", "x7"]), r":1: range 1 = 'x7', must be a number"),
        (flaser([1.0], stamp="noon"), r":1: stamp = 'noon', must be a number"),
        (flaser([1.0], stamp="-1"), r":1: stamp = -1, must be at least 0"),
        (flaser([1.0], stamp="nan"), r":1: stamp = 'nan', must be a number"),
        (robotlaser([1.0]) + robotlaser([1.0], step=0.6), r":2: laser parameters .* must stay"),
        (robotlaser([1.0], step=0.0, field=0.0), ":1: start angle -1.0, resolution 0.0 rad"),
        (robotlaser([1.0, 2.0])[:60], ":1: ROBOTLASER1"),
        (tinyslam([1000] * 681), r":1: 705 columns, must be 24 or 25 and 682 ranges: the line is cut"),
        (tinyslam([1000] * 682) + tinyslam([1000] * 682)[:900] + "\n", r":2: \d+ columns, must be 24 and"),
        (tinyslam([1000] * 682, header=25) + tinyslam([1000] * 682), r":2: 706 columns, must be 25 and 682"),
        (wean([66] * 179), ":1: L with 187 fields, must be 188"),
        (wean([66] * 180) + "X 1 2\n", ":2: line begins with 'X', must be L or O"),
    ],
)  # fmt: skip
def test_a_bad_log_is_one_line_of_place_rule_and_value(tmp_path, text, said):
    with pytest.raises(FormatError, match=said) as caught:
        open_log(written(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "some.log"))
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
def test_a_compressed_log_that_is_cut_off_is_read_up_to_its_last_whole_line(tmp_path, compress):
    rng = np.random.default_rng(2)
    text = "".join(flaser(rng.uniform(1, 5, 60).round(3)) for _ in range(6000))
    data = compress(text.encode())
    log = open_log(written(tmp_path, data[: len(data) * 7 // 10], "a.clf.gz"))
    assert 0 < len(log) < 6000
    (loss,) = log.losses
    assert loss.endswith(f"a.clf.gz:{len(log) + 1}: the last line is cut off, and left out")
    whole = open_log(written(tmp_path, data, "b.clf.gz"))
    assert whole.losses == ()
    assert only_first(log, len(log)) == only_first(whole, len(log))
    with pytest.raises(FormatError, match=r"compressed data is cut off after line 0"):
        open_log(written(tmp_path, data[:50], "c.clf.gz"))


def test_compressed_data_that_is_damaged_is_an_error(tmp_path):
    data = bytearray(gzip.compress("".join(flaser([k, 2.0]) for k in range(1, 500)).encode()))
    data[-6] ^= 0xFF  # of the sum at its end
    with pytest.raises(FormatError, match=r"compressed data is damaged after line \d+ \(CRC"):
        open_log(written(tmp_path, bytes(data), "a.clf.gz"))


LINES = {
    "FLASER": flaser([1.0, 2.0]),
    "ROBOTLASER1": robotlaser([1.0, 2.0]),
    "tinySLAM": tinyslam([1000] * 682),
    "Wean": wean([66] * 180),
}


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("left", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("tail", ["", "\0" * 5000], ids=["cut", "zeros"])
def test_a_log_whose_last_line_is_cut_off_is_read_up_to_there(tmp_path, name, left, tail):
    line = LINES[name]
    part = line[: max(1, int(left * len(line)))]
    log = open_log(written(tmp_path, 3 * line + part + tail))
    assert len(log) == 3
    assert log.losses == (f"{tmp_path / 'some.log'}:4: the last line is cut off, and left out",)
    assert only_first(log, 3) == only_first(open_log(written(tmp_path, 3 * line, "whole.log")), 3)


@pytest.mark.parametrize("name", LINES)
def test_a_line_that_is_broken_in_the_middle_or_has_an_end_is_no_cut(tmp_path, name):
    line, part = LINES[name], LINES[name][: len(LINES[name]) // 2]
    for text in (line + part + "\n" + line, line + part + "\n", line + part + "\0\n" + line):
        with pytest.raises(FormatError, match=r"some\.log:2: "):
            open_log(written(tmp_path, text))


@pytest.mark.parametrize("name", LINES)
def test_a_last_line_that_lacks_its_end_alone_is_whole(tmp_path, name):
    log = open_log(written(tmp_path, (2 * LINES[name]).rstrip()))
    assert (len(log), log.losses) == (2, ())


def test_a_topic_of_a_text_log_is_refused(tmp_path):
    with pytest.raises(FormatError, match="topic '/scan' was asked for, but a text log has no topics"):
        open_log(written(tmp_path, flaser([1.0])), "/scan")


def test_a_folder_that_is_no_bag_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"a folder without metadata\.yaml"):
        open_log(tmp_path)


def test_a_missing_file_stays_an_error_of_the_system(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_log(tmp_path / "nowhere.log")
