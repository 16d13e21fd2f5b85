"""A laser that turns slowly all around, on a robot that turns fast: its bent sweeps are set straight."""

import numpy as np
import pytest

from drivers.world import Spinning, corridor, demo_building, pillar_hall, simulate_scans, square_of_corridors
from processing import se2, straightening
from processing.evaluation import absolute_errors
from processing.matching import MatchingConfig
from processing.ndt import Ndt, NdtConfig
from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.prediction import ConstantVelocity, PredictionConfig, exponential
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Scan
from processing.straightening import Straightener
from tests.lasers import beams_of_laser

LASER = Spinning()
BEAMS = beams_of_laser(LASER)
MIDDLE_S = 0.5 * BEAMS.sweep_s


def scan_of(ranges_m, stamp_ns=1):
    return Scan(stamp_ns, ranges_m, BEAMS)


def seen_while(twist, start, seed=0):
    """What the laser sees in one revolution that begins at `start` (3,), at a velocity (3,)."""
    times_s = BEAMS.time_increment_s * np.arange(BEAMS.count)
    poses = np.array([se2.compose(start, exponential(np.asarray(twist) * t)) for t in times_s])
    return LASER.measure(demo_building(), poses, np.random.default_rng(seed))


@pytest.fixture
def at_rest():
    """A reference seen at rest, a filter that expects rest there, and where that is."""
    start = np.array((3.0, 2.0, 0.3))
    resampler = Resampler(ResamplingConfig(), BEAMS)
    reference = Ndt(NdtConfig())
    reference.build(resampler.points(scan_of(seen_while((0.0, 0.0, 0.0), start)), np.zeros(3)).copy())
    filter_ = ConstantVelocity(PredictionConfig())
    filter_.advance(BEAMS.period_s)
    return start, resampler, reference, filter_


def score_of(scan, resampler, reference, filter_):
    """Score where the filter has the laser, at the velocity that it has."""
    resampler.points(scan, filter_.twist, MIDDLE_S)
    means = resampler.oriented_means()
    return reference.score(means, filter_.pose).value / len(means)


@pytest.mark.parametrize("rate", [0.9, -0.7])
def test_the_turn_rate_of_a_turn_that_has_just_begun_is_found(at_rest, rate):
    start, resampler, reference, filter_ = at_rest
    scan = scan_of(seen_while((0.0, 0.0, rate), start, seed=1))
    least = 1.5 * score_of(scan, resampler, reference, filter_)
    assert Straightener(MatchingConfig(), walls=True).straighten(
        scan, resampler, filter_, MIDDLE_S, reference, least
    )
    assert filter_.twist[2] == pytest.approx(rate, abs=0.2)
    # The points that are left in the resampler are the straight ones.
    left, _ = resampler.filled(0.0)
    np.testing.assert_array_equal(left, resampler.points(scan, filter_.twist, MIDDLE_S))


@pytest.mark.parametrize("what", ["straight", "noise"])
def test_a_sweep_that_no_turn_explains_changes_nothing(at_rest, what):
    start, resampler, reference, filter_ = at_rest
    ranges_m = seen_while((0.0, 0.0, 0.0), start, seed=1)
    if what == "noise":
        ranges_m = np.random.default_rng(3).uniform(0.3, 8.0, BEAMS.count).astype(np.float32)
    scan = scan_of(ranges_m)
    pose, twist, covariance = filter_.pose.copy(), filter_.twist.copy(), filter_.covariance.copy()
    left = resampler.points(scan, twist, MIDDLE_S).copy()
    least = max(score_of(scan, resampler, reference, filter_), 0.4)
    assert not Straightener(MatchingConfig(), walls=True).straighten(
        scan, resampler, filter_, MIDDLE_S, reference, least
    )
    np.testing.assert_array_equal(filter_.pose, pose)
    np.testing.assert_array_equal(filter_.twist, twist)
    np.testing.assert_array_equal(filter_.covariance, covariance)
    filled, _ = resampler.filled(0.0)
    np.testing.assert_array_equal(filled, left)


def test_a_quick_sweep_is_straight_enough(at_rest):
    start, resampler, reference, filter_ = at_rest
    scan = scan_of(seen_while((0.0, 0.0, 0.9), start))
    assert not Straightener(MatchingConfig(), walls=True).straighten(
        scan, resampler, filter_, 0.01, reference, 0.0
    )


@pytest.mark.parametrize("building", [demo_building, pillar_hall])
def test_the_velocity_of_slow_sweeps_does_not_swing(building):
    how = {"speed_mps": 0.6, "rest_s": 0.0, "seed": 1, "max_scans": 250}
    drive = list(simulate_scans(building(), laser=LASER, **how))
    odometry = LaserOdometry(OdometryConfig(), 1)
    matches = [odometry.step(scan_of(ranges_m, stamp_ns)) for stamp_ns, ranges_m, _ in drive]
    found = np.array([match.motion.twist[0] for match in matches[1:]])
    places = np.array([pose[:2] for *_, pose in drive])
    true = np.linalg.norm(np.diff(places, axis=0), axis=1) / LASER.period_s
    # Between the middles of two sweeps it may have changed by a tenth of a metre a second.
    assert np.abs(found - true).max() < 0.15


def test_through_a_noisy_laser_a_bare_corridor_is_not_seen_along_either():
    laser = Spinning(range_max_m=6.0, noise_m=0.03)
    beams, odometry = beams_of_laser(laser), LaserOdometry(OdometryConfig(), 1)
    how = {"speed_mps": 0.5, "rest_s": 0.0, "seed": 1, "max_scans": 160}
    drive = simulate_scans(corridor(40.0), laser=laser, **how)
    states = [odometry.step(Scan(stamp_ns, ranges_m, beams)).state for stamp_ns, ranges_m, _ in drive]
    assert np.mean([state is Tracking.DEGENERATE for state in states[100:]]) > 0.7


@pytest.mark.parametrize("straightened", [True, False])
def test_who_turns_fast_is_followed_only_with_straight_sweeps(monkeypatch, straightened):
    if not straightened:
        monkeypatch.setattr(straightening, "LEAST_BEND_RAD", np.inf)
    building = square_of_corridors(10.0)
    how = {"speed_mps": 0.5, "turn_rate_radps": 1.5, "rest_s": 0.0, "seed": 3}
    drive = list(simulate_scans(building, laser=LASER, max_scans=330, **how))
    odometry = LaserOdometry(OdometryConfig(), 1)
    matches = [odometry.step(scan_of(ranges_m, stamp_ns)) for stamp_ns, ranges_m, _ in drive]
    truth = np.array([pose for _, _, pose in drive])
    errors = absolute_errors(truth, np.array([match.motion.odom_t_laser for match in matches]))
    lost = sum(match.state is Tracking.LOST for match in matches)
    assert (lost == 0) == straightened
    assert (errors.translation_m.max() < 0.15) == straightened
