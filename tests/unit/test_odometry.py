"""The laser is covered, carried away, turned too fast: said at once, found again, and never guessed."""

import pickle

import numpy as np
import pytest

from drivers.world import Building, Urg04lx, corridor, demo_building, outline, room, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.scan import Scan
from processing.slam import Slam, SlamConfig
from runtime.nodes.convert import motion_from_message, motion_to_message
from tests.lasers import beams_of_laser
from tests.people import Peopled, Person

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)
NOTHING = np.full(LASER.beams, np.nan, np.float32)
HAND = np.full(LASER.beams, 0.06, np.float32)
HALF_A_SECOND = 5


def drive(scans, seed=0, building=None, **how):
    """Ranges and true poses of a drive, seen from its first."""
    building = building or demo_building()
    course = list(
        simulate_scans(building, laser=LASER, speed_mps=0.5, max_scans=scans, rest_s=0.0, seed=seed, **how)
    )
    poses = np.array([pose for _, _, pose in course])
    return [ranges_m.copy() for _, ranges_m, _ in course], se2.between(poses[0], poses)


def standing(building, poses, seed=0):
    """What the laser sees standing at each pose (x, y, yaw)."""
    rng = np.random.default_rng(seed)
    return [LASER.measure(building, np.tile(pose, (LASER.beams, 1)), rng) for pose in poses]


def follow(ranges, seed=1):
    odometry = LaserOdometry(OdometryConfig(), seed)
    return [
        odometry.step(Scan(1_000_000_000 + k * 99_889_000, ranges_m, BEAMS))
        for k, ranges_m in enumerate(ranges)
    ]


def first_lost(matches, begin):
    """How many scans after `begin` the track counts as lost."""
    return next(k - begin + 1 for k in range(begin, len(matches)) if matches[k].state is Tracking.LOST)


def found_again(matches, begin):
    """Number of the first scan after `begin` whose motion is known."""
    return next(k for k in range(begin, len(matches)) if not matches[k].motion.lost)


def off(match, before, truth):
    """How far the way between two matches is from the true one: m, rad."""
    way = se2.between(before.motion.odom_t_laser, match.motion.odom_t_laser)
    error = se2.between(truth, way)
    return float(np.hypot(error[0], error[1])), abs(float(error[2]))


@pytest.fixture(scope="module")
def course():
    return drive(300)


@pytest.fixture(scope="module")
def in_a_room():
    return drive(160, building=room())


@pytest.mark.parametrize("seed", [1, 2])
def test_a_plain_drive_is_never_lost(course, seed):
    ranges, truth = course
    matches = follow(ranges, seed)
    assert [k for k, match in enumerate(matches) if match.state is Tracking.LOST] == []
    assert [k for k, match in enumerate(matches) if match.motion.lost] == []
    assert [k for k, match in enumerate(matches) if match.motion.anew] == [0]
    assert off(matches[-1], matches[0], truth[-1])[0] < 0.15


@pytest.mark.parametrize("cover", [NOTHING, HAND], ids=["nothing", "hand"])
def test_two_covered_scans_are_no_loss_and_the_next_motion_vouches_for_the_way_over_them(course, cover):
    ranges, truth = course
    covered = [cover if k in (150, 151) else seen for k, seen in enumerate(ranges[:170])]
    matches = follow(covered)
    assert Tracking.LOST not in [match.state for match in matches]
    assert [k for k, match in enumerate(matches) if match.motion.lost] == [150, 151]
    assert off(matches[152], matches[149], se2.between(truth[149], truth[152]))[0] < 0.03


@pytest.mark.parametrize("cover", [NOTHING, HAND], ids=["nothing", "hand"])
def test_a_covered_laser_is_lost_in_half_a_second_and_found_where_it_then_is(in_a_room, cover):
    ranges, truth = in_a_room
    # It drives on for two seconds under the hand: about a metre.
    matches = follow([*ranges[:90], *[cover] * 20, *ranges[110:150]])
    assert first_lost(matches, 90) <= HALF_A_SECOND
    assert all(match.motion.lost for match in matches[90:110])
    again = found_again(matches, 90)
    assert again < 110 + 25
    assert not any(match.motion.anew for match in matches[1:])
    distance, turn = off(matches[again], matches[89], se2.between(truth[89], truth[again]))
    assert distance < 0.1
    assert turn < 0.03


def test_a_scan_that_contradicts_known_ground_is_doubted_and_no_part_of_the_map(in_a_room):
    ranges, truth = in_a_room
    someone, place = slice(LASER.beams * 3 // 10, LASER.beams * 7 // 10), range(40, 48)
    rng = np.random.default_rng(0)
    seen = [ranges_m.copy() for ranges_m in ranges[:60]]
    for k in place:
        # Somebody comes round the corner and covers more than a third of the sight.
        near_m = 1.4 + rng.normal(0.0, 0.01, LASER.beams)
        seen[k][someone] = np.fmin(seen[k], near_m)[someone]
    free, matches = follow(ranges[:60]), follow(seen)
    assert any(free[k].key for k in place)
    assert not any(matches[k].key for k in place)
    assert [k for k, match in enumerate(matches) if match.motion.lost] == list(place)
    assert all(matches[k].motion.doubted for k in place)
    assert Tracking.LOST not in [match.state for match in matches]
    # What moved may have drawn the matches with it, and the motions that follow say so.
    assert matches[48].motion.covariance[0, 0] > 100.0 * free[48].motion.covariance[0, 0]
    for after in (48, 59):
        distance, turn = off(matches[after], matches[39], se2.between(truth[39], truth[after]))
        assert distance < 0.03
        assert turn < 0.01


def test_covered_for_a_moment_in_a_plain_corridor_it_goes_on_and_does_not_know_how_far():
    ranges, truth = drive(140, building=corridor(30.0))
    matches = follow([*ranges[:100], *[NOTHING] * 8, *ranges[108:140]])
    again = found_again(matches, 100)
    assert again < 108 + 15
    assert not matches[again].motion.anew
    covariance = matches[again].motion.covariance
    assert np.sqrt(covariance[0, 0]) > 0.2
    assert np.sqrt(covariance[1, 1]) < 0.1
    assert abs(off(matches[again], matches[99], se2.between(truth[99], truth[again]))[1]) < 0.03


def out_of_sight(x):
    """Poses of a laser that turns away from the end of a corridor, drives off to x, and turns back to it."""
    turn = np.linspace(0.0, np.pi, 26)
    at = np.concatenate((np.full(38, 3.0), np.linspace(3.0, x, 9)[1:], np.full(31, x)))
    yaw = np.concatenate((np.zeros(8), turn, np.full(12, np.pi), np.pi + turn, np.full(5, 2.0 * np.pi)))
    return np.column_stack((at, np.ones_like(at), np.pi + yaw))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_who_sets_out_unseen_after_a_turn_on_the_spot_is_found_when_something_comes_into_sight(seed):
    poses = out_of_sight(3.3)
    matches = follow(standing(corridor(30.0), poses, seed), seed)
    assert [match.state for match in matches[36:40]] == [Tracking.DEGENERATE] * 4
    assert matches[-1].state is Tracking.TRACKING
    assert off(matches[-1], matches[0], se2.between(poses[0], poses[-1]))[0] < 0.05


def sweeping(building, poses, seed=0):
    """What the laser sees on its way from each pose (x, y, yaw) to the next."""
    rng = np.random.default_rng(seed)
    share = (LASER.time_increment_s / LASER.period_s * np.arange(LASER.beams))[:, None]
    ways = zip(poses, np.vstack((poses[1:], poses[-1:])), strict=True)
    return [LASER.measure(building, a + share * (b - a), rng) for a, b in ways]


@pytest.mark.parametrize("seed", [0, 1])
def test_who_stops_to_turn_where_nothing_is_seen_is_not_taken_to_drive_on(seed):
    # Once around in a room, out of it and along a corridor, and a quarter turn on the spot in its middle.
    building = Building(outline([(-4.0, -2.0, 0.0, 2.0), (-0.01, -0.8, 40.0, 0.8)]))
    yaw = np.concatenate((np.linspace(0.0, 2.0 * np.pi, 63), np.full(350, 2.0 * np.pi)))
    yaw = np.concatenate((yaw, yaw[-1] + np.linspace(0.1, 1.5, 15)))
    x = np.full(len(yaw), -2.0)
    x[63:] += np.minimum(0.04 * np.arange(1, len(yaw) - 62), 0.04 * 350)
    poses = np.column_stack((x, np.zeros_like(x), yaw))
    matches = follow(sweeping(building, poses, seed), seed)
    before, after = 410, len(poses) - 1
    assert {match.state for match in matches[before:]} == {Tracking.DEGENERATE}
    assert off(matches[after], matches[before], se2.between(poses[before], poses[after]))[0] < 0.25


def along_a_corridor(person, **how):
    """True poses and matches of a drive out of a room along a plain corridor in which somebody walks."""
    start, end, speed_mps = person
    building = Building(
        outline([(0.0, -2.0, 6.0, 3.0), (6.0, 0.0, 60.0, 2.0)]), route=np.array(((2.0, 1.0), (59.0, 1.0)))
    )
    people = [Person(start=np.array(start), end=np.array(end), speed_mps=speed_mps)]
    course = list(
        simulate_scans(
            building, laser=Peopled(LASER, people), speed_mps=0.4, max_scans=300, rest_s=0.0, seed=3
        )
    )
    poses = np.array([pose for _, _, pose in course])
    odometry = LaserOdometry(OdometryConfig(**how), 1)
    matches = [odometry.step(Scan(ns, ranges_m.copy(), BEAMS)) for ns, ranges_m, _ in course]
    return se2.between(poses[0], poses), matches


@pytest.mark.parametrize("person", [((28.0, 0.6), (1.0, 0.6), 0.8), ((30.0, 0.7), (1.0, 0.7), 1.2)])
def test_who_walks_through_a_plain_corridor_does_not_take_the_laser_with_him(person):
    truth, matches = along_a_corridor(person)
    trusting = along_a_corridor(person, walkers_left_out=False)[1]
    way = truth[-1, 0]
    assert way > 10.0
    off_m, trusting_off_m = (abs(seen[-1].motion.odom_t_laser[0] - way) for seen in (matches, trusting))
    assert off_m < 0.3
    assert trusting_off_m > 3.0 * off_m
    # And nobody claims that it is known.
    assert {match.state for match in matches[150:]} <= {Tracking.DEGENERATE, Tracking.TRACKING}
    assert [match.state for match in matches[150:]].count(Tracking.DEGENERATE) > 100


def test_lifted_and_put_down_within_the_local_map_it_is_found_there(course):
    ranges, truth = course
    # Back by five seconds of way, without a scan between.
    matches = follow([*ranges[:250], *ranges[200:250]])
    assert first_lost(matches, 250) <= HALF_A_SECOND
    again = found_again(matches, 250)
    assert again < 250 + 35
    # Likely, but for the whole map to confirm.
    assert [k for k, match in enumerate(matches) if match.motion.anew] == [0, again]
    distance, turn = off(matches[again], matches[249], se2.between(truth[249], truth[again - 50]))
    assert distance < 0.15
    assert turn < 0.05
    assert all(match.state is Tracking.TRACKING for match in matches[again:])


def test_carried_to_a_place_never_seen_it_claims_nothing_and_begins_anew(course):
    ranges, _ = course
    elsewhere, truth = drive(80, building=room(5.0, 4.0))
    matches = follow([*ranges[:150], *elsewhere])
    assert first_lost(matches, 150) <= HALF_A_SECOND
    anew = next(k for k in range(150, len(matches)) if matches[k].motion.anew)
    assert all(match.motion.lost for match in matches[150:anew])
    assert 25 <= anew - 150 <= 45
    # Its own motion is known again from there on.
    distance, turn = off(matches[-1], matches[anew], se2.between(truth[anew - 150], truth[-1]))
    assert distance < 0.05
    assert turn < 0.03


def test_turned_by_sixty_degrees_between_two_scans_it_is_found_turned():
    furnished = room()
    before, after = np.array((1.5, 1.2, 0.3)), np.array((1.5, 1.2, 0.3 + np.pi / 3))
    matches = follow(standing(furnished, [before] * 20 + [after] * 30))
    again = found_again(matches, 20)
    assert again <= 20 + 15
    distance, turn = off(matches[again], matches[19], np.array((0.0, 0.0, np.pi / 3)))
    assert distance < 0.05
    assert turn < 0.03


def test_a_room_that_looks_the_same_four_ways_is_not_guessed():
    square = Building(outline([(0.0, 0.0, 4.0, 4.0)]), route=np.array(((1.0, 1.0), (3.0, 3.0))))
    turned = [np.array((2.0, 2.0, yaw)) for yaw in [0.0] * 20 + [np.pi / 4] * 60]
    matches = follow(standing(square, turned))
    assert first_lost(matches, 20) <= HALF_A_SECOND
    anew = found_again(matches, 20)
    assert matches[anew].motion.anew


def test_what_a_motion_is_survives_its_message(course):
    ranges, _ = course
    matches = follow([*ranges[:30], NOTHING, *ranges[31:33]])
    for match in matches:
        back = motion_from_message(motion_to_message(match.motion))
        assert (back.lost, back.anew) == (match.motion.lost, match.motion.anew)
        np.testing.assert_array_equal(back.covariance, match.motion.covariance)
        np.testing.assert_array_equal(back.odom_t_laser, match.motion.odom_t_laser)
    assert matches[30].motion.lost


@pytest.fixture(scope="module")
def mapped():
    """A whole pipeline that has mapped the first rooms of a building, and the true poses."""
    ranges, truth = drive(420)
    slam = Slam(SlamConfig(mapping=DpSlamConfig(particles=10)), 1)
    for k, ranges_m in enumerate(ranges):
        step = slam.step(Scan(1_000_000_000 + k * 99_889_000, ranges_m, BEAMS))
    assert not step.mapping.lost
    return slam, truth


def go_on(slam, ranges):
    """Steps of further scans, without a hint that the laser is elsewhere."""
    return [slam.step(Scan(10**12 + k * 99_889_000, ranges_m, BEAMS)) for k, ranges_m in enumerate(ranges)]


def test_kidnapped_to_another_room_of_the_map_it_is_found_there_and_the_map_waits(mapped):
    import copy

    slam, truth = copy.deepcopy(mapped[0]), mapped[1]
    keys = slam.mapping.population.keys
    again, _ = drive(420, seed=5)
    steps = go_on(slam, again[60:280])
    lost = [k for k, step in enumerate(steps) if step.mapping.lost]
    assert lost[0] <= 1
    found = lost[-1] + 1
    assert lost == list(range(lost[0], found))
    assert 35 < found < 160
    assert slam.mapping.population.keys > keys
    assert not any(step.mapping.updated for step in steps[lost[0] : found])
    for step, pose in zip(steps[found:], truth[60 + found : 280], strict=True):
        error = se2.between(pose, step.mapping.map_t_laser)
        assert np.hypot(error[0], error[1]) < 0.25
        assert abs(error[2]) < 0.1


def test_carried_off_the_map_it_writes_no_walls_and_is_lost_until_it_comes_back(mapped):
    import copy

    slam = copy.deepcopy(mapped[0])
    before = slam.occupancy().probability
    elsewhere, _ = drive(100, building=room(4.5, 3.2))
    steps = go_on(slam, elsewhere)
    assert all(step.mapping.lost for step in steps[1:])
    assert not any(step.mapping.updated for step in steps)
    np.testing.assert_array_equal(slam.occupancy().probability, before)


def test_a_scan_that_contradicts_known_ground_is_doubted_and_the_track_goes_on():
    ranges, truth = drive(90)
    person = ranges[60].copy()
    person[200:480] = 0.9
    ranges[60] = person
    steps = follow(ranges)
    assert {step.state for step in steps} == {Tracking.TRACKING}
    assert [k for k, step in enumerate(steps) if step.motion.lost] == [60]
    assert steps[60].motion.doubted
    assert not steps[60].key
    # What moved may have drawn the next matches with it; two seconds later that is over.
    sigma_m = [np.sqrt(step.motion.covariance[0, 0]) for step in steps]
    assert max(sigma_m[50:60]) < 0.03
    assert min(sigma_m[61:79]) > 0.04
    assert max(sigma_m[82:]) < 0.03
    off = se2.between(truth[-1], steps[-1].motion.odom_t_laser)
    assert np.hypot(off[0], off[1]) < 0.05


def test_what_is_kept_of_the_odometry_is_small_and_goes_on_bit_for_bit():
    ranges, _ = drive(60)
    whole = LaserOdometry(OdometryConfig(), 1)
    for k, ranges_m in enumerate(ranges[:40]):
        whole.step(Scan(10**9 + k * 99_889_000, ranges_m, BEAMS))
    kept = pickle.dumps(whole)
    # The cells of the reference alone would be many megabytes; the key scans that they come from are not.
    assert len(kept) < 1_000_000
    after = pickle.loads(kept)
    for k, ranges_m in enumerate(ranges[40:], 40):
        one, other = (o.step(Scan(10**9 + k * 99_889_000, ranges_m, BEAMS)) for o in (whole, after))
        np.testing.assert_array_equal(one.motion.odom_t_laser, other.motion.odom_t_laser)
        np.testing.assert_array_equal(one.motion.covariance, other.motion.covariance)
