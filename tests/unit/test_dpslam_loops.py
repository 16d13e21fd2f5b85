"""Coming back is noticed, the path is bent so that it has, and a look-alike is not taken for home."""

import itertools

import numpy as np
import pytest

from drivers.world import Building, outline
from drivers.world.drive import simulate_scans
from drivers.world.generators import corridor, square_of_corridors
from drivers.world.laser import Sick, Urg04lx, bearings
from processing.dpslam import loops as loops_module
from processing.dpslam import old_ground
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.loops import Loops
from processing.dpslam.old_ground import PASSED_M, PASSED_MOST_M, PASSED_SHORT_M, OldGround
from processing.dpslam.way import Way
from processing.se2 import between, compose, invert, transform

KEY_M, KEY_RAD = 0.3, 0.25


def key_scans(building, route=None, laps=1, max_scans=None, seed=1, laser=None):
    """Points of every key scan (every other ray), and its true pose."""
    laser = Sick() if laser is None else laser
    directions = bearings(laser)[::2]
    last, keys = None, []
    drive = simulate_scans(
        building,
        route,
        laser=laser,
        speed_mps=0.8,
        turn_rate_radps=0.7,
        laps=laps,
        max_scans=max_scans,
        seed=seed,
    )
    for _, ranges, truth in drive:
        if last is not None:
            moved = between(last, truth)
            if np.hypot(moved[0], moved[1]) < KEY_M and abs(moved[2]) < KEY_RAD:
                continue
        last = truth
        reach = ranges[::2].astype(np.float64)
        seen = np.isfinite(reach) & (reach < 30.0)
        points = reach[seen, None] * np.column_stack((np.cos(directions), np.sin(directions)))[seen]
        keys.append((points, truth))
    return keys


def drifting(keys, turn_rad_per_m, stretch):
    """The motions between key scans as a matcher with a bias would report them."""
    motions = [np.zeros(3)]
    for (_, a), (_, b) in itertools.pairwise(keys):
        moved = between(a, b)
        step_m = np.hypot(moved[0], moved[1])
        motions.append(moved * (1 + stretch, 1 + stretch, 1.0) + (0.0, 0.0, turn_rad_per_m * step_m))
    return motions


def follow(keys, motions, covariance=None):
    """Run the loops over a single lineage; the path as it was without them, and as they left it."""
    loops, alone = Loops(LoopConfig()), np.zeros((1, 3))
    for k, (points, _) in enumerate(keys):
        path = loops.way.path
        new = np.zeros(3) if k == 0 else compose(path[-1], motions[k])
        if k:
            alone = np.vstack((alone, compose(alone[-1], motions[k])))
        cov = np.zeros((3, 3)) if covariance is None else covariance
        loops.step(motions[k], cov, points, np.vstack((path, new)))
    return loops, alone


@pytest.fixture(scope="module")
def round_the_block():
    return key_scans(square_of_corridors(20.0), laps=2, max_scans=620)


def worst(path, keys):
    """Largest distance to the truth, both seen from the first pose."""
    truth = np.array([pose for _, pose in keys])
    return np.hypot(*between(np.tile(truth[0], (len(truth), 1)), truth)[:, :2].T - path[:, :2].T).max()


def test_a_loop_takes_the_drift_out_of_the_whole_path(round_the_block):
    motions = drifting(round_the_block, 0.001, 0.004)
    loops, alone = follow(round_the_block, motions)
    assert worst(alone, round_the_block) > 1.0
    assert loops.closures >= 1
    assert loops.linked
    smoothed = loops.way.smoothed()
    assert len(smoothed) == len(round_the_block)
    assert worst(smoothed, round_the_block) < 0.4


def test_ground_is_old_only_when_something_lies_behind_and_the_laser_is_on_it(round_the_block):
    loops = Loops(LoopConfig())
    motions = drifting(round_the_block, 0.0, 0.0)
    assert not loops.on_settled_map
    old = []
    for k, (points, _) in enumerate(round_the_block):
        new = np.zeros(3) if k == 0 else compose(loops.way.path[-1], motions[k])
        loops.step(motions[k], np.zeros((3, 3)), points, np.vstack((loops.way.path, new)))
        old.append(loops.on_settled_map)
    behind = np.array(loops.way.lengths_m) > LoopConfig().reach_m
    assert not any(np.array(old)[~behind])
    # On the second way round the laser is where it was, once it has been found there.
    assert not all(old)
    assert all(old[-10:])


def test_a_path_without_drift_is_not_bent(round_the_block):
    loops, _ = follow(round_the_block, drifting(round_the_block, 0.0, 0.0))
    assert worst(loops.way.smoothed(), round_the_block) < 0.06


def test_the_same_steps_give_the_same_bits(round_the_block):
    motions = drifting(round_the_block, -0.001, 0.003)
    first, second = (follow(round_the_block, motions)[0].way.smoothed() for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("cut", [1, 40, 250, 330])
def test_restored_goes_on_as_if_never_interrupted(round_the_block, cut):
    motions = drifting(round_the_block, 0.001, 0.004)
    whole, _ = follow(round_the_block, motions)
    part, _ = follow(round_the_block[:cut], motions[:cut])
    again = Loops(LoopConfig())
    again.restore(part.state())
    for k in range(cut, len(round_the_block)):
        path = np.vstack((again.way.path, compose(again.way.path[-1], motions[k])))
        again.step(motions[k], np.zeros((3, 3)), round_the_block[k][0], path)
    np.testing.assert_array_equal(again.way.path, whole.way.path)
    assert again.closures == whole.closures


@pytest.fixture(scope="module")
def lanes():
    """Key scans of a laser that sees four metres, there and back along screens seen from both lanes."""
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.uniform(1.0, 2.6, 13))
    low_m, slant_m = rng.uniform(3.7, 4.0, 13), rng.uniform(-0.5, 0.5, 13)
    screens = np.column_stack((x, low_m, x + slant_m, rng.uniform(6.5, 6.8, 13)))
    hall = Building(np.vstack((outline([(0.0, 0.0, 26.0, 10.5)]), screens)))
    route = np.array(((3.0, 3.0), (20.0, 3.0), (20.0, 7.5), (3.0, 7.5)))
    keys = key_scans(hall, route, seed=2, laser=Urg04lx())
    return [(points[np.hypot(*points.T) < 4.0], truth) for points, truth in keys]


@pytest.mark.parametrize("partly", [True, False])
def test_a_drift_is_found_where_only_a_part_of_the_ground_is_known(lanes, monkeypatch, partly):
    if not partly:
        monkeypatch.setattr(loops_module, "LEAST_PART", 1.0)
    loops, alone = follow(lanes, drifting(lanes, 0.004, 0.005))
    assert worst(alone, lanes) > 1.5
    assert loops.closures == partly
    # Only where nearly all is known does the next scan lie on the settled map.
    assert not loops.linked
    if partly:
        assert worst(loops.way.settled(), lanes) < 0.75


def test_at_the_end_of_a_drive_the_second_search_is_brought_to_its_end_too(lanes):
    motions = drifting(lanes, 0.004, 0.005)
    begun = 0
    for last in range(90, len(lanes), 3):
        loops, _ = follow(lanes[:last], motions[:last])
        if "closing.cloud" in loops.state() and not len(loops.state()["closing.passed"]):
            begun += 1
            loops.conclude()
            assert "closing.cloud" not in loops.state()
    assert begun > 0


def test_where_no_ray_is_known_to_have_passed_there_is_no_second_search(lanes, monkeypatch):
    monkeypatch.setattr(OldGround, "passed", lambda *_: np.zeros((0, 2)))
    loops, alone = follow(lanes, drifting(lanes, 0.004, 0.005))
    assert loops.closures == 0
    np.testing.assert_array_equal(loops.way.path, alone)


def test_a_path_that_is_right_stays_where_a_part_of_the_ground_is_known(lanes):
    loops, alone = follow(lanes, drifting(lanes, 0.0, 0.0))
    assert worst(alone, lanes) < 0.1
    assert worst(loops.way.path, lanes) < 0.1


@pytest.mark.parametrize("course", ["round_the_block", "lanes"])
def test_restored_amid_a_search_goes_on_with_it(course, request):
    keys = request.getfixturevalue(course)
    motions = drifting(keys, *((0.001, 0.004) if course == "round_the_block" else (0.004, 0.005)))
    whole, _ = follow(keys, motions)
    again, amid = Loops(LoopConfig()), 0
    for k, (points, _) in enumerate(keys):
        new = np.zeros(3) if k == 0 else compose(again.way.path[-1], motions[k])
        again.step(motions[k], np.zeros((3, 3)), points, np.vstack((again.way.path, new)))
        written = again.state()
        if "closing.cloud" in written:
            amid += 1
            again = Loops(LoopConfig())
            again.restore(written)
    assert amid > 10
    assert again.closures == whole.closures
    assert again.closures > 0
    np.testing.assert_array_equal(again.way.path, whole.way.path)


def test_a_search_that_is_under_way_when_the_drive_ends_is_brought_to_its_end(round_the_block):
    motions = drifting(round_the_block, 0.001, 0.004)
    loops = Loops(LoopConfig())
    for k, (points, _) in enumerate(round_the_block):
        new = np.zeros(3) if k == 0 else compose(loops.way.path[-1], motions[k])
        before = loops.closures
        loops.step(motions[k], np.zeros((3, 3)), points, np.vstack((loops.way.path, new)))
        if loops.closures > before:
            break
        written = loops.state()
    # A key scan before the closure the search was on its way; nothing but time was missing.
    loops = Loops(LoopConfig())
    loops.restore(written)
    assert loops.conclude() is not None
    assert loops.closures == before + 1
    assert loops.conclude() is None
    assert loops.closures == before + 1


@pytest.mark.parametrize("sides_count", [True, False])
def test_the_room_next_door_is_not_home_though_their_wall_is_one(monkeypatch, sides_count):
    if not sides_count:
        monkeypatch.setattr(old_ground, "MOST_BEHIND", 1.0)
    corridor_m, doors = (0.0, 0.0, 12.0, 2.0), ((3.5, 2.0, 4.5, 2.2), (7.5, 2.0, 8.5, 2.2))
    rooms = (2.0, 2.2, 5.9, 12.2), (6.1, 2.2, 10.0, 12.2)
    building = Building(outline([corridor_m, *doors, *rooms]))
    route = np.array(((1.0, 1.0), (4.0, 1.0), (4.0, 11.2), (4.0, 1.0), (8.0, 1.0), (8.0, 11.2)))
    keys = key_scans(building, route, seed=2)
    loops, _ = follow(keys, drifting(keys, 0.0, 0.0))
    assert loops.closures > 0
    # Else it is off by the thickness of the wall.
    assert (worst(loops.way.smoothed(), keys) < 0.1) == sides_count


def test_a_plain_corridor_is_nobodys_place():
    # There and back in a corridor that looks alike everywhere, with a matcher that cannot see along it.
    building = corridor(80.0, 2.0)
    route = np.array(((25.0, 1.0), (50.0, 1.0), (25.0, 1.0)))
    keys = [(points[np.abs(points[:, 0]) < 8.0], truth) for points, truth in key_scans(building, route)]
    blind = np.diag((0.05**2, 1e-4, 1e-6))
    loops, alone = follow(keys, drifting(keys, 0.0, 0.02), blind)
    assert loops.closures == 0
    np.testing.assert_array_equal(loops.way.path, alone)


@pytest.mark.parametrize(("along_m", "held"), [(0.1, False), (0.01, True)])
def test_in_a_corridor_old_ground_holds_along_only_what_the_odometry_saw(along_m, held):
    building = corridor(80.0, 2.0)
    route = np.array(((25.0, 1.0), (50.0, 1.0), (25.0, 1.0)))
    keys = [(points[np.abs(points[:, 0]) < 8.0], truth) for points, truth in key_scans(building, route)]
    motions, covariance = drifting(keys, 0.0, 0.0), np.diag((along_m**2, 1e-4, 1e-6))
    back = next(k for k, (_, truth) in enumerate(keys) if k > 60 and truth[0] < 38.0)
    loops, _ = follow(keys[:back], motions[:back], covariance)
    # Somebody has told it that it is on old ground; itself it cannot know.
    state = loops.state()
    state["flags"][[0, 3]] = True, 0
    loops.restore(state)
    for k in range(back, len(keys)):
        path = np.vstack((loops.way.path, compose(loops.way.path[-1], motions[k])))
        loops.step(motions[k], covariance, keys[k][0], path)
    known = loops.way.places.informations.rows
    deviations = 1.0 / np.sqrt(np.diagonal(known, axis1=1, axis2=2))
    assert len(deviations) > 20
    assert (np.median(deviations[:, 0]) < 0.5) == held
    assert (deviations[:, 1] < 0.03).all()


def test_a_square_is_passed_where_two_rays_went_through():
    way = Way()
    ground = OldGround(way, LoopConfig())
    rng = np.random.default_rng(3)
    for k in range(6):
        at = (0.4 * k - 1.0, 0.1 * k, 0.3 * k)
        way.go_on(np.array((0.4, 0.0, 0.0)), np.eye(3), rng.uniform(-9.0, 9.0, (31, 2)))
        way.path = np.vstack((way.path, at))
    ground.keys = 5
    here, reach_m = np.array((0.5, 0.0, 0.0)), 1.0
    counts = {}
    for k in range(5):
        for end in transform(way.path[k], way.points[k][::2]):
            ray = end - way.path[k, :2]
            length_m = float(np.hypot(*ray))
            for step in range(int((min(length_m, PASSED_MOST_M) - PASSED_SHORT_M) / PASSED_M)):
                at = way.path[k, :2] + step * PASSED_M / length_m * ray
                square = tuple(np.floor(at / PASSED_M).astype(int).tolist())
                counts[square] = counts.get(square, 0) + 1
    expected = sorted(square for square, count in counts.items() if count >= 2)
    passed = np.floor(ground.passed(here, reach_m) / PASSED_M).astype(int)
    assert len(expected) > 100
    assert sorted(map(tuple, passed.tolist())) == expected


@pytest.mark.parametrize(("name", "value"), [("reach_m", 0.0), ("least_score", 1.5), ("rival_ratio", 0.0)])
def test_a_setting_out_of_its_range_is_refused(name, value):
    with pytest.raises(ValueError, match=name):
        LoopConfig(**{name: value})


def test_a_place_is_tied_to_who_saw_its_walls_and_not_to_who_stood_nearest():
    wall = np.column_stack((np.full(60, 12.0), np.linspace(-3.0, 3.0, 60)))
    elsewhere = np.column_stack((np.linspace(-8.0, -2.0, 60), np.full(60, -6.0)))
    way = Way()
    ground = OldGround(way, LoopConfig())
    for k in range(40):
        # Two stretches of way: one sees the wall from afar, the other stands before it and does not.
        at = (0.1 * k, 0.0, 0.0) if k < 20 else (9.0 + 0.05 * k, 0.0, np.pi)
        points = between_points(at, wall if k < 20 else elsewhere)
        step_m = 0.1 if k != 20 else 100.0
        way.go_on(np.array((step_m, 0.0, 0.0)), np.eye(3), points)
        way.path = np.vstack((way.path, at))
        ground.map.add(points, np.array(at))
        ground.keys = k + 1
    here = np.array((10.0, 0.0, 0.0))
    assert ground.witness(between_points(here, wall), here) == 19
    assert ground.witness(between_points(here, elsewhere), here) == 20
    assert ground.witness(between_points(here, wall + 50.0), here) is None


def test_past_the_last_relation_the_path_keeps_the_shape_that_the_particles_gave_it():
    way = Way()
    for k in range(10):
        way.go_on(np.array((1.0, 0.0, 0.0)), np.diag((1e-2, 1e-2, 1e-3)), np.zeros((0, 2)))
        # The particles have the second half turned; the motions say straight on.
        here = (1.0 * k, 0.0, 0.0) if k <= 5 else (5.0, 1.0 * (k - 5), np.pi / 2)
        way.path = np.vstack((way.path, here))
        if k == 5:
            way.relate(0, np.array((4.8, 0.3, 0.0)), 1e4 * np.eye(3), 0.0)
    before, settled = way.path, way.settled()
    assert np.abs(settled[5] - (4.8, 0.3, 0.0)).max() < 0.01
    np.testing.assert_allclose(settled[:6], way.smoothed()[:6])
    np.testing.assert_allclose(between(settled[5], settled[5:]), between(before[5], before[5:]), atol=1e-12)


def between_points(map_t_laser, points_map):
    return np.ascontiguousarray(transform(invert(np.asarray(map_t_laser)), points_map))
