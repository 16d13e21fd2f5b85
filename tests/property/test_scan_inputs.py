"""Whatever a laser sends, the front end goes on, and what it says is finite."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.recovery import COVER_M
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Beams, Scan, end_points

STILL = np.zeros(3)
odd = st.sampled_from((np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-30, 0.02, 5.6, 5.61, 1e30))
ranges_m = st.one_of(odd, st.floats(width=32), st.floats(0.0, 6.0, width=32))
twists = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
slow = settings(max_examples=60, deadline=None)


def beams_of(count, time_increment_s=1e-4):
    return Beams(
        count=count,
        angle_min_rad=-2.1,
        angle_increment_rad=4.2 / count,
        time_increment_s=time_increment_s,
        range_max_m=5.6,
    )


@st.composite
def scans(draw, count=None):
    count = draw(st.integers(1, 1500)) if count is None else count
    # A few drawn values, repeated in an order of their own: 1500 drawn ones would cost more than they find.
    values = np.array(draw(st.lists(ranges_m, min_size=1, max_size=12)), np.float32)
    pick = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mixed = values[pick.integers(len(values), size=count)]
    if draw(st.booleans()):
        begin = draw(st.integers(0, count - 1))
        mixed[begin:] = 1.0 + pick.random(count - begin, np.float32)
    return Scan(draw(st.integers(0, 2**62)), mixed, beams_of(count))


def valid(scan):
    r = scan.ranges_m.astype(np.float64)
    return np.flatnonzero((r > 0.0) & (r >= scan.beams.range_min_m) & (r <= scan.beams.range_max_m))


@slow
@given(scans(), twists)
def test_end_points_are_those_of_the_valid_ranges(scan, twist):
    points, rays = end_points(scan, twist, 0.5 * scan.beams.sweep_s)
    np.testing.assert_array_equal(rays, valid(scan))
    assert points.shape == (len(rays), 2)
    assert np.isfinite(points).all()
    still, _ = end_points(scan, STILL)
    np.testing.assert_allclose(np.linalg.norm(still, axis=1), scan.ranges_m[rays], rtol=1e-6)


@slow
@given(scans(), twists)
def test_the_compiled_end_points_are_the_plain_ones(scan, twist):
    middle_s = 0.5 * scan.beams.sweep_s
    compiled = Resampler(ResamplingConfig(), scan.beams).points(scan, twist, middle_s)
    np.testing.assert_allclose(compiled, end_points(scan, twist, middle_s)[0], atol=1e-9)


@slow
@given(scans(), st.sampled_from((0, 10, 134)))
def test_the_resampled_points_lie_among_the_points(scan, wanted):
    resampler = Resampler(ResamplingConfig(points=wanted), scan.beams)
    points = resampler.points(scan, STILL).copy()
    means = resampler.means()
    assert np.isfinite(means).all()
    assert (len(means) > 0) == (len(points) > 0)
    assert len(means) <= len(points)
    if len(points) > 0:
        assert np.all((points.min(axis=0) - 1e-12 <= means) & (means <= points.max(axis=0) + 1e-12))


def assert_sane(match):
    for numbers in (match.motion.odom_t_laser, match.motion.twist, match.motion.covariance):
        assert np.isfinite(numbers).all()
    assert np.isfinite(match.points_laser).all()
    assert 0.0 <= match.score <= 1.0
    assert np.linalg.eigvalsh(match.motion.covariance).min() > -1e-9


@slow
@given(st.integers(1, 1500).flatmap(lambda count: st.lists(scans(count), min_size=1, max_size=5)))
def test_the_odometry_goes_on_with_whatever_comes(sequence):
    odometry = LaserOdometry(OdometryConfig(), 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        begun = False
        for scan in sequence:
            match = odometry.step(scan)
            assert_sane(match)
            near = scan.ranges_m[valid(scan)] < COVER_M
            seen = len(near) > 0
            if seen and near.mean() > 0.6:
                # Whether it counts as covered is for the resampled points to tell.
                seen = match.motion.anew or (begun and not match.motion.lost)
            # The frame of the odometry is where the first points are seen.
            assert match.motion.anew == (seen and not begun)
            assert match.motion.lost or seen
            begun = begun or seen
            assert begun or match.state is Tracking.LOST


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 681), st.floats(0.125, 5.5, width=32))
def test_one_point_is_enough_to_go_on(ray, range_m):
    odometry = LaserOdometry(OdometryConfig(), 1)
    ranges = np.full(682, np.nan, np.float32)
    ranges[ray] = range_m
    for k in range(4):
        match = odometry.step(Scan(k, ranges, beams_of(682)))
        assert_sane(match)
        assert len(match.points_laser) == 1


def test_after_scans_without_a_point_the_track_is_taken_up_again():
    odometry = LaserOdometry(OdometryConfig(), 1)
    nothing = Scan(0, np.full(400, np.nan, np.float32), beams_of(400))
    bearings = beams_of(400).bearings()
    # Seen from the middle of a square room of 3 m.
    wall = Scan(
        0, (1.5 / np.maximum(abs(np.cos(bearings)), abs(np.sin(bearings)))).astype(np.float32), nothing.beams
    )
    matches = [odometry.step(scan) for scan in (nothing, wall, wall, *(nothing,) * 4, *(wall,) * 12)]
    assert [match.motion.lost for match in matches[:7]] == [True, False, False, *(True,) * 4]
    assert [match.state is Tracking.LOST for match in matches[3:7]] == [False, False, False, True]
    assert not matches[-1].motion.lost
    assert matches[-1].state is Tracking.TRACKING
    assert not any(match.motion.anew for match in matches[2:])
    np.testing.assert_allclose(odometry.step(wall).motion.odom_t_laser, 0.0, atol=0.02)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 1500), st.integers(1, 1500))
def test_another_number_of_beams_in_mid_run_is_an_error_with_both_numbers(first, second):
    odometry = LaserOdometry(OdometryConfig(), 1)
    odometry.step(Scan(0, np.ones(first, np.float32), beams_of(first)))
    other = Scan(1, np.ones(second, np.float32), beams_of(second))
    if first == second:
        assert_sane(odometry.step(other))
        return
    with pytest.raises(ValueError, match=rf"\b{second}\b.*\b{first}\b"):
        odometry.step(other)
    assert_sane(odometry.step(Scan(2, np.ones(first, np.float32), beams_of(first))))


def test_a_scan_with_more_or_fewer_ranges_than_beams_is_refused():
    with pytest.raises(ValueError, match=r"\(5,\) ranges, must be \(4,\)"):
        Scan(0, np.ones(5, np.float32), beams_of(4))


@pytest.mark.parametrize("order", [slice(None), slice(None, None, 2)])
def test_ranges_of_a_message_are_taken_though_they_are_read_only_or_strided(order):
    ranges = np.frombuffer(np.ones(100, np.float32).tobytes(), np.float32)[order]
    scan = Scan(0, ranges, beams_of(len(ranges)))
    assert len(LaserOdometry(OdometryConfig(), 1).step(scan).points_laser) > 0
