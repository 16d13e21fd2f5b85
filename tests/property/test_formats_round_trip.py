"""What one format holds comes back from it, and what it cannot hold is told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from runtime.formats import tinyslam
from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserGeometry, LaserLog
from runtime.formats.logs import open_log
from runtime.formats.write_bags import scan_messages, write_mcap, write_ros1, write_ros2
from runtime.formats.write_text import write_carmen, write_tinyslam

few = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
known = st.floats(0.0625, 5.0, width=32)  # every format's sensor reaches so far
readings = known | st.sampled_from([np.nan, np.inf])


def log_of(geometry, stamps_ns, ranges):
    return LaserLog(
        path=Path("made.up"),
        kind="test",
        topic=None,
        geometry=geometry,
        stamps_ns=np.array(stamps_ns, dtype=np.int64),
        notices=(),
        read=lambda: iter(ranges),
    )


@st.composite
def logs(draw, stamp_step_ns=1, beams=None, geometry=None):
    count = draw(st.integers(1, 6))
    stamps = draw(st.lists(st.integers(0, 2**60 // stamp_step_ns), min_size=count, max_size=count))
    beams = draw(st.integers(2, 30)) if beams is None else beams
    ranges = draw(hnp.arrays(np.float32, (count, beams), elements=readings))
    if geometry is None:
        geometry = LaserGeometry(
            count=beams,
            angle_min_rad=float(np.float32(draw(st.floats(-3, 0)))),
            angle_increment_rad=float(np.float32(draw(st.floats(0.001, 0.2)))),
            time_increment_s=float(np.float32(draw(st.sampled_from([0.0, 1e-4])))),
            period_s=float(np.float32(0.1)),
            range_min_m=float(np.float32(0.02)),
            range_max_m=6.0,
        )
    return log_of(geometry, [stamp * stamp_step_ns % 2**61 for stamp in stamps], ranges)


def table(log):
    return np.stack([record.ranges_m for record in log])


def check_same(got, log):
    assert got.stamps_ns.tolist() == log.stamps_ns.tolist()
    np.testing.assert_array_equal(table(got), table(log))


@few
@given(logs())
def test_mcap_holds_a_log_bit_by_bit(tmp_path_factory, log):
    path = tmp_path_factory.mktemp("x") / "a.mcap"
    assert write_mcap(path, scan_messages(log)) == len(log)
    got = open_log(path)
    check_same(got, log)
    assert got.geometry == log.geometry


@few
@given(logs())
def test_bags_of_both_generations_hold_a_log_bit_by_bit(tmp_path_factory, log):
    folder = tmp_path_factory.mktemp("x")
    if log.stamps_ns.max() < 2**31 * 10**9:  # seconds of a ROS 1 stamp
        assert write_ros1(folder / "a.bag", scan_messages(log)) == (len(log), {})
        got = open_log(folder / "a.bag")
        check_same(got, log)
        assert got.geometry == log.geometry
    write_ros2(folder / "bag", scan_messages(log))
    check_same(open_log(folder / "bag"), log)


@few
@given(logs())
def test_carmen_holds_stamps_readings_and_the_fan_of_any_laser(tmp_path_factory, log):
    path = tmp_path_factory.mktemp("x") / "a.clf"
    lost = write_carmen(path, log)
    got = open_log(path)
    check_same(got, log)
    for name in ("count", "angle_min_rad", "angle_increment_rad", "range_max_m"):
        assert getattr(got.geometry, name) == getattr(log.geometry, name)
    assert any("time_increment" in one for one in lost) == bool(log.geometry.time_increment_s)


@pytest.mark.parametrize(("beams", "steps"), [(180, 180), (181, 180), (361, 360)])
def test_a_half_circle_is_written_as_flaser(tmp_path, beams, steps):
    geometry = LaserGeometry(
        count=beams, angle_min_rad=-np.pi / 2, angle_increment_rad=np.pi / steps, time_increment_s=0.0,
        period_s=0.1, range_min_m=0.02, range_max_m=80.0,
    )  # fmt: skip
    ranges = np.full((1, beams), 1.07, dtype=np.float32)
    ranges[0, :3] = np.inf, np.nan, 60.0
    lost = write_carmen(tmp_path / "a.log", log_of(geometry, [123456789012345678], ranges))
    text = (tmp_path / "a.log").read_text()
    assert f"\nFLASER {beams} 81.83 0.0 60.0 1.07 1.07 " in text
    assert " 123456789.012345678 hallway 0.000000\n" in text
    assert "1 readings of 50 m or more, which mean no echo there" in lost
    got = open_log(tmp_path / "a.log").geometry
    assert got.angle_increment_rad == pytest.approx(np.pi / steps)
    # The time from ray to ray is read as a SICK's, and only another one is told as lost.
    assert any(f"time_increment = 0 s, which is read as {got.time_increment_s:g} s" in one for one in lost)
    sick = log_of(replace(geometry, time_increment_s=got.time_increment_s), [1], ranges)
    assert not any("time_increment" in one for one in write_carmen(tmp_path / "b.log", sick))


URG = LaserGeometry(
    count=682, angle_min_rad=-340 * tinyslam.STEP_RAD, angle_increment_rad=tinyslam.STEP_RAD,
    time_increment_s=tinyslam.TIME_INCREMENT_S, period_s=0.1, range_min_m=0.02, range_max_m=5.6,
)  # fmt: skip


@few
@given(st.integers(1, 5), st.integers(0, 10**15), st.integers(0, 2**32 - 1))
def test_tinyslam_holds_whole_millimetres_and_microseconds(tmp_path_factory, count, stamp_us, seed):
    rng = np.random.default_rng(seed)
    mm = rng.integers(20, 5600, (count, 682))
    mm[rng.random(mm.shape) < 0.5] = 0
    ranges = (mm / 1000).astype(np.float32)
    ranges[mm == 0] = np.nan
    log = log_of(URG, [(stamp_us + i) * 1000 for i in range(count)], ranges)
    path = tmp_path_factory.mktemp("x") / "a.dat"
    assert write_tinyslam(path, log) == ["the period, which is estimated again from the stamps"]
    got = open_log(path)
    check_same(got, log)
    assert got.kind == "tinySLAM"


def test_what_tinyslam_cannot_hold_is_told(tmp_path):
    ranges = np.full((2, 682), 1.0, dtype=np.float32)
    ranges[0, :4] = np.inf, 1.0004, 0.019, 5.6
    lost = write_tinyslam(tmp_path / "a.dat", log_of(URG, [1, 2000], ranges))
    assert lost[1:] == [
        "the nanoseconds of 1 stamps",
        "fractions of a millimetre of 1 readings",
        "1 readings of no return, which are no information there",
        "2 readings outside 20 .. 5599 mm",
    ]


def test_another_laser_does_not_fit_into_tinyslam(tmp_path):
    geometry = LaserGeometry(
        count=180, angle_min_rad=-1.5, angle_increment_rad=0.01, time_increment_s=0.0, period_s=0.1,
        range_min_m=0.02, range_max_m=5.0,
    )  # fmt: skip
    with pytest.raises(FormatError, match=r"made\.up: 180 beams from -1\.5000 rad .* tinySLAM holds 682"):
        write_tinyslam(tmp_path / "a.dat", log_of(geometry, [1], np.ones((1, 180), dtype=np.float32)))


@few
@given(st.binary(max_size=300))
def test_any_bytes_are_a_log_or_one_line(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("x") / "a.log"
    path.write_bytes(data)
    check_log_or_one_line(path)


def check_log_or_one_line(path):
    told = ""
    try:
        log = open_log(path)
    except FormatError as error:
        told = str(error)
    else:
        assert len(list(log)) == len(log) > 0
    assert "\n" not in told
    assert not told or told.startswith(str(path))


@few
@given(st.data())
def test_a_damaged_text_log_is_a_log_or_one_line(tmp_path_factory, data):
    rng = np.random.default_rng(1)
    readings = [" ".join(map(str, rng.uniform(1, 5, 4).round(2))) for _ in range(5)]
    lines = [f"FLASER 4 {text} 0 0 0 0 0 0 {i}.5 h 0.1\n" for i, text in enumerate(readings)]
    text = bytearray("".join(lines).encode())
    for _ in range(data.draw(st.integers(1, 5))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("x") / "a.log"
    path.write_bytes(text[: data.draw(st.integers(0, len(text)))])
    check_log_or_one_line(path)
