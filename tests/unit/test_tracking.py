"""The watch over the scores: what is usual, what does not fit, and when the track counts as lost."""

import numpy as np
import pytest

from processing.local_map import KeyScan
from processing.matching import Matcher, Matching, MatchingConfig
from processing.motion import Motion, anew_covariance, doubted_covariance, following, lost_covariance
from processing.ndt import Ndt, NdtConfig
from processing.prediction import ConstantVelocity, PredictionConfig, Prior
from processing.recovery import Recovery, covered
from processing.se2 import invert, transform
from processing.sightlines import judge
from processing.tracking import DOUBT_S, FIT, SURE, Watch

URG_S, SICK_S, FAST_S = 0.0999, 0.1975, 1.0 / 75.0


def ring(radius_m, count=300):
    bearing = np.linspace(-2.0, 2.0, count)
    return radius_m * np.column_stack((np.cos(bearing), np.sin(bearing)))


def matching(score):
    return Matching(np.zeros(3), score, -np.eye(3), 1e4 * np.eye(3), 1, 1, 1)


def accepted(watch, found, off_m=0.0):
    """Whether a scan of a ring of 2 m is accepted on a ring of 4 m, so far from where it was expected."""
    prior = Prior(np.array((off_m, 0.0, 0.0)), np.diag((400.0, 400.0, 400.0)))
    return watch.accept(ring(2.0), found, prior, [KeyScan(np.zeros(3), ring(4.0), -ring(1.0))])


def watch_of(period_s, usual=0.6):
    watch = Watch(period_s, NdtConfig())
    watch.take(matching(usual))
    return watch


@pytest.mark.parametrize("period_s", [URG_S, SICK_S, FAST_S])
def test_the_track_is_lost_within_half_a_second_but_not_within_a_quarter(period_s):
    watch, filter_ = watch_of(period_s), ConstantVelocity(PredictionConfig())
    lost_s, time_s = None, 0.0
    for _ in range(100):
        # The laser was taken away just after the last good scan.
        watch.expect(filter_, period_s)
        time_s += period_s
        watch.miss(filter_, 0)
        if watch.lost:
            lost_s = time_s
            break
    assert lost_s is not None
    assert 0.25 < lost_s <= 0.5


def test_scans_that_never_came_count_as_time_without_a_good_one():
    watch, filter_ = watch_of(URG_S), ConstantVelocity(PredictionConfig())
    watch.expect(filter_, 4 * URG_S)
    watch.miss(filter_, missed=3)
    assert watch.lost
    assert watch.since_s == pytest.approx(4 * URG_S)


@pytest.mark.parametrize("usual", [0.3, 0.6, 0.9])
def test_a_score_is_judged_by_what_is_usual_in_this_scene(usual):
    watch = watch_of(URG_S, usual)
    assert accepted(watch, matching(1.01 * FIT * usual))
    assert not accepted(watch, matching(0.98 * FIT * usual))


def watched(watch, score, yaw_rad=0.0):
    """A scan of a ring of 2 m at a heading, where one has looked at a ring of 4 m before."""
    found = Matching(np.array((0.0, 0.0, yaw_rad)), score, -np.eye(3), 1e4 * np.eye(3), 1, 1, 1)
    prior = Prior(found.pose, np.diag((400.0, 400.0, 400.0)))
    return watch.accept(ring(2.0), found, prior, [KeyScan(np.zeros(3), ring(4.0), -ring(1.0))])


def test_a_scan_that_fits_badly_is_doubted_on_known_ground_only():
    watch = watch_of(URG_S)
    assert watched(watch, 0.7 * 0.6)
    assert watch.doubtful
    assert watched(watch, 0.95 * 0.6)
    assert not watch.doubtful
    # Turned by a radian a quarter of its rays go where nobody has looked.
    assert watched(watch, 0.7 * 0.6, yaw_rad=1.0)
    assert not watch.doubtful


def test_what_contradicts_the_map_for_long_is_believed_and_shakes_the_track_until_long_after():
    watch = watch_of(URG_S)
    assert not watch.shaken
    doubted = []
    for _ in range(round(2.0 * DOUBT_S / URG_S)):
        # What is usual stays, or else such scores would soon be.
        watch._usual = 0.6
        watched(watch, 0.6 * 0.6)
        doubted.append(watch.doubtful)
        assert watch.shaken
    believed = doubted.index(False)
    assert believed * URG_S == pytest.approx(DOUBT_S, abs=URG_S)
    assert not any(doubted[believed:])
    calm_s = 0.0
    while watch.shaken:
        watched(watch, 0.6)
        calm_s += URG_S
    assert calm_s == pytest.approx(DOUBT_S, abs=URG_S)


def test_what_is_usual_follows_the_scene_in_seconds_and_a_bad_scan_does_not_move_it():
    watch = watch_of(URG_S, 0.8)
    for _ in range(round(20.0 / URG_S)):
        assert accepted(watch, matching(0.45))
    assert accepted(watch, matching(0.25))
    other = watch_of(URG_S, 0.8)
    for _ in range(50):
        assert not accepted(other, matching(0.25))


def test_after_a_bad_scan_the_next_must_fit_better():
    watch, filter_ = watch_of(URG_S), ConstantVelocity(PredictionConfig())
    middling = matching(0.5 * (FIT + SURE) * 0.6)
    assert accepted(watch, middling)
    watch.expect(filter_, URG_S)
    watch.miss(filter_, 0)
    assert not accepted(watch, middling)
    assert accepted(watch, matching(0.6))
    assert accepted(watch, middling)


def test_after_a_hole_a_scan_must_fit_better():
    watch, filter_ = watch_of(URG_S), ConstantVelocity(PredictionConfig())
    middling = matching(0.5 * (FIT + SURE) * 0.6)
    watch.expect(filter_, 3 * URG_S)
    assert accepted(watch, middling)
    watch.expect(filter_, 1.0)
    assert not accepted(watch, middling)
    assert accepted(watch, matching(0.6))


def test_a_scan_that_fits_worse_far_from_where_it_was_expected_must_be_possible_there():
    middling = matching(0.5 * (FIT + SURE) * 0.6)
    assert accepted(watch_of(URG_S), middling, off_m=0.1)
    assert not accepted(watch_of(URG_S), middling, off_m=0.3)
    assert accepted(watch_of(URG_S), matching(0.6), off_m=0.3)


def test_the_papers_chain_takes_every_match():
    watch = watch_of(URG_S)
    assert not accepted(watch, matching(0.01))
    watch.take(matching(0.01))
    assert accepted(watch, matching(0.5))


def corner(count=150):
    along = np.linspace(0.0, 3.0, count)
    return np.vstack(
        (np.column_stack((along, np.full(count, 2.0))), np.column_stack((np.full(count, 3.0), 2 - along)))
    )


def test_a_scan_that_fits_the_last_one_is_followed_where_the_local_map_is_poor():
    watch, matcher = watch_of(URG_S), Matcher(MatchingConfig(), 1)
    watch.remember(corner())
    elsewhere = Ndt(NdtConfig())
    elsewhere.build(corner() + 20.0)
    truth = np.array((0.04, -0.03, 0.02))
    prior = Prior(np.zeros(3), np.diag((100.0, 100.0, 400.0)))
    seen = np.ascontiguousarray(transform(invert(truth), corner())[::3])
    found = watch.follow(seen, prior, matcher, elsewhere)
    assert found is not None
    assert np.abs(found.pose - truth).max() < 0.01
    assert watch.follow(seen + 5.0, prior, matcher, elsewhere) is None


def test_a_lost_laser_is_known_the_worse_the_longer_nobody_saw_it():
    filter_ = ConstantVelocity(PredictionConfig())
    filter_.advance(0.1)
    recovery = Recovery(filter_, 0.1)
    spread = []
    for since_s in (0.5, 1.0, 2.0):
        recovery.since_s = since_s
        prior = recovery.stand(filter_)
        spread.append(np.sqrt(np.diag(np.linalg.inv(prior.information))))
        assert filter_.twist.tolist() == [0.0, 0.0, 0.0]
    assert (np.diff(spread, axis=0) > 0.0).all()
    assert spread[-1][0] == pytest.approx(2.0 * PredictionConfig().speed_m_s, rel=0.1)


def beside(walls, truth):
    """A map of walls seen from its origin, a scan of the corner from elsewhere, how well it fits there."""
    matcher, reference = Matcher(MatchingConfig(), 1), Ndt(NdtConfig())
    reference.build(walls)
    keys = [KeyScan(np.zeros(3), walls, np.zeros_like(walls))]
    points = np.ascontiguousarray(transform(invert(np.array(truth)), corner()))
    usual = matcher.match(points, reference, Prior(np.array(truth), np.diag((1e4, 1e4, 1e4)))).score
    return matcher, reference, keys, points, usual


@pytest.mark.parametrize(("hole_s", "found"), [(1.3, True), (0.1, False)])
def test_where_the_motion_may_have_led_in_a_hole_a_scan_is_found_that_the_map_has_walls_before(hole_s, found):
    truth = np.array((0.3, -0.2, 0.5))
    matcher, reference, keys, points, usual = beside(np.vstack((corner(), ring(1.0))), truth)
    filter_ = ConstantVelocity(PredictionConfig())
    near = matcher.match(points, reference, filter_.advance(hole_s), np.array((0.02, 0.02, 0.02)))
    place = Recovery(filter_, hole_s).look(points, near, matcher, reference, keys, usual, URG_S)
    if not found:
        assert place is None
        return
    assert place is not None
    assert np.abs(place.pose - truth).max() < 0.02


@pytest.mark.parametrize(
    ("hole_s", "truth", "found"),
    [
        (1.3, (0.3, -0.2, 0.5), True),  # where the motion may have led in a hole: nothing to try
        (0.1, (0.1, 0.0, 0.0), False),  # no hole: why did it not fit?
        (0.5, (1.0, 0.0, 0.0), False),  # farther than it could get
    ],
)
def test_who_is_found_after_a_hole_where_the_motion_led_is_not_lost(hole_s, truth, found):
    matcher, reference, keys, points, usual = beside(corner(), truth)
    watch, filter_ = watch_of(URG_S, usual), ConstantVelocity(PredictionConfig())
    near = matcher.match(points, reference, watch.expect(filter_, hole_s), np.array((0.02, 0.02, 0.02)))
    place, fits = watch.find(points, near, filter_, matcher, reference, keys)
    assert np.abs(place.pose - truth).max() < 0.02
    assert fits == found
    assert watch.trying != found


@pytest.mark.parametrize(
    ("truth", "lost", "share", "confirmed"),
    [
        ((0.2, 0.1, 0.1), False, 0.8, True),  # a scan that fitted badly, where it was expected
        ((0.2, 0.1, 0.1), False, 0.7, False),  # the next one does so, too
        ((0.2, 0.1, 0.1), True, 0.8, False),  # after a loss nobody knows where to expect it
        ((0.7, 0.0, 0.1), False, 0.8, False),  # elsewhere
    ],
)
def test_one_scan_that_fits_confirms_a_place_where_the_laser_was_expected(truth, lost, share, confirmed):
    matcher, reference, keys, points, usual = beside(corner(), truth)
    filter_ = ConstantVelocity(PredictionConfig())
    near = matcher.match(points, reference, filter_.advance(URG_S), np.array((0.02, 0.02, 0.02)))
    recovery = Recovery(filter_, URG_S)
    place = recovery.look(points, near, matcher, reference, keys, usual, URG_S)
    assert place is not None
    assert np.abs(place.pose - truth).max() < 0.02
    assert recovery.judge(share, URG_S, lost) is (True if confirmed else None)
    assert recovery.trying != confirmed


def test_a_hand_before_the_laser_and_a_few_points_are_no_view():
    ring = 0.08 * np.column_stack((np.cos(np.arange(100.0)), np.sin(np.arange(100.0))))
    assert covered(ring)
    assert covered(corner()[:10])
    assert not covered(corner())


def sight(points, place, walls, earlier):
    """What one earlier scan, or none, says of a scan at a place."""
    ends, poses = ([], np.zeros((0, 3))) if earlier is None else ([len(walls)], earlier[None])
    return judge(points, place, walls, np.array(ends, dtype=np.int64), poses)


def test_a_place_behind_a_wall_is_none():
    here, wall = np.zeros(3), ring(2.0)
    assert sight(ring(2.0, 150), here, wall, here).possible
    assert not sight(ring(4.0, 150), here, wall, here).possible


def test_thin_things_before_a_wall_do_not_hide_it():
    here, wall = np.zeros(3), ring(4.0)
    legs = ring(2.0, 77)  # three degrees apart
    among_legs = sight(ring(4.0, 150), here, np.vstack((wall, legs)), None)
    assert among_legs.possible
    assert not among_legs.free
    assert not sight(ring(4.0, 150), here, np.vstack((wall, ring(2.0))), None).possible


def test_a_place_whose_walls_stand_where_an_earlier_scan_looked_through_is_none():
    here, far = np.zeros(3), ring(4.0)
    # The walls of the map do not tell, as nothing of them is hidden; the earlier rays do.
    assert not sight(ring(2.0, 150), here, far, here).possible
    assert sight(ring(2.0, 150), here, far, None).possible


def test_what_no_scan_has_looked_at_is_not_known():
    here, wall = np.zeros(3), ring(2.0)
    turned = np.array((0.0, 0.0, 1.0))
    seen = sight(ring(2.0, 150), turned, wall, here)
    assert seen.possible
    assert seen.known == pytest.approx(0.75, abs=0.02)


def motion(x, covariance):
    return Motion(7, np.array((x, 0.0, 0.0)), covariance, np.zeros(3))


def test_a_lost_motion_left_out_takes_nothing_away_and_a_new_beginning_stays_one():
    known = np.diag((1e-4, 1e-4, 1e-5))
    lost, anew = motion(1.0, lost_covariance()), motion(1.0, anew_covariance())
    doubted = motion(1.0, doubted_covariance())
    assert lost.lost
    assert doubted.lost
    assert [m.doubted for m in (lost, doubted, anew)] == [False, True, False]
    assert not lost.anew
    assert not doubted.anew
    np.testing.assert_array_equal(following(doubted, motion(2.0, known)).covariance, known)
    assert anew.anew
    assert not anew.lost
    np.testing.assert_array_equal(following(lost, motion(2.0, known)).covariance, known)
    assert following(motion(0.0, known), anew).anew
    after = following(anew, motion(2.0, known))
    assert after.anew
    np.testing.assert_array_equal(after.odom_t_laser, (2.0, 0.0, 0.0))
