"""Buildings, rays, laser models and the wheeled robot of the simulated world."""

import time

import numpy as np
import pytest

from drivers.world import (
    Building,
    Sick,
    Urg04lx,
    WheeledRobot,
    bearings,
    cast,
    corridor,
    demo_building,
    hallway_with_doors,
    loop_corridor,
    outline,
    pillar_hall,
    room,
    simulate_scans,
    square_of_corridors,
)
from drivers.world.robot import BUMP_LEFT, BUMP_RIGHT

SECOND = 1_000_000_000
EVERY_BUILDING = (
    demo_building,
    room,
    pillar_hall,
    square_of_corridors,
    hallway_with_doors,
    corridor,
    loop_corridor,
)


def plainly_cast(building, origin, bearing):
    """Meet one ray with every wall and pillar, in the words of a school book."""
    best = np.inf
    d = np.array((np.cos(bearing), np.sin(bearing)))
    for x0, y0, x1, y1 in building.walls:
        matrix = np.array(((d[0], x0 - x1), (d[1], y0 - y1)))
        if abs(np.linalg.det(matrix)) > 1e-12:
            t, u = np.linalg.solve(matrix, np.array((x0, y0)) - origin)
            if t > 0 and 0 <= u <= 1:
                best = min(best, t)
    for x, y, radius in building.pillars:
        to = np.array((x, y)) - origin
        root = (to @ d) ** 2 - to @ to + radius**2
        if root > 0 and (t := to @ d - np.sqrt(root)) > 0:
            best = min(best, t)
    return best


@pytest.mark.parametrize("make", EVERY_BUILDING)
def test_rays_end_where_the_school_book_says(make):
    building, rng = make(), np.random.default_rng(3)
    for place in building.route[:6]:
        origin = place + rng.uniform(-0.2, 0.2, 2)
        directions = rng.uniform(-np.pi, np.pi, 40)
        expected = [plainly_cast(building, origin, b) for b in directions]
        np.testing.assert_allclose(cast(building, origin, directions).ranges_m, expected, rtol=1e-9)


def test_a_ray_of_its_own_origin_is_cast_from_there():
    walls = room(6.0, 5.0, furniture=False)
    origins = np.array(((1.0, 2.0), (2.5, 2.0), (4.0, 1.0)))
    hits = cast(walls, origins, np.array((0.0, 0.0, np.pi / 2)))
    np.testing.assert_allclose(hits.ranges_m, (5.0, 3.5, 4.0))
    np.testing.assert_allclose(hits.incidence_cos, 1.0)


def test_what_is_out_of_reach_is_not_hit():
    hits = cast(room(6.0, 5.0, furniture=False), (1.0, 2.5), np.array((0.0, np.pi)), reach_m=4.0)
    np.testing.assert_array_equal(hits.ranges_m, (np.inf, 1.0))
    np.testing.assert_array_equal(hits.incidence_cos, (0.0, 1.0))


def test_leaving_out_far_walls_changes_nothing_in_reach():
    building = demo_building()
    directions = np.linspace(-np.pi, np.pi, 400)
    for place in building.route:
        near, all_of_it = cast(building, place, directions, 5.6), cast(building, place, directions)
        expected = np.where(all_of_it.ranges_m <= 5.6, all_of_it.ranges_m, np.inf)
        np.testing.assert_array_equal(near.ranges_m, expected)


def test_no_ray_leaves_a_building_through_a_corner():
    for make in EVERY_BUILDING:
        building = make()
        corners = building.walls.reshape(-1, 2)
        for place in building.route:
            at_corners = np.arctan2(*(corners - place).T[::-1])
            assert np.isfinite(cast(building, place, at_corners).ranges_m).all(), building.name


def test_the_outline_of_touching_rectangles_has_no_wall_between_them():
    walls = outline([(0, 0, 2, 1), (2, 0, 3, 1), (1, 1, 2, 3)])
    length = np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]).sum()
    assert length == pytest.approx(3 + 1 + 1 + 2 + 1 + 2 + 1 + 1)
    assert len(walls) == 8


def test_a_rectangle_with_its_edges_swapped_is_refused():
    with pytest.raises(ValueError, match=r"\(2\.0, 0\.0, 1\.0, 1\.0\), must be x_min < x_max"):
        outline([(2, 0, 1, 1)])


@pytest.mark.parametrize("make", EVERY_BUILDING)
def test_the_route_of_a_building_keeps_clear_of_walls(make):
    building = make()
    scans = simulate_scans(building, laser=Sick(beams=1, period_s=0.2))
    gaps = [building.nearest(truth[:2])[0] for _, _, truth in scans]
    assert len(gaps) > 50
    assert min(gaps) > 0.3


def test_every_place_of_the_demo_has_a_wall_within_four_metres():
    building = demo_building()
    for place in building.route:
        assert cast(building, place, np.linspace(-np.pi, np.pi, 90)).ranges_m.min() < 4.0


def test_an_urg_on_its_way_through_the_demo_always_sees_enough():
    shares = [np.isfinite(r).mean() for _, r, _ in simulate_scans(demo_building(), max_scans=800)]
    assert min(shares) > 0.4
    assert max(shares) < 1.0


def test_the_noise_of_the_urg_is_what_the_specification_says():
    laser, building = Urg04lx(), room(4.0, 4.0, furniture=False)
    poses = np.tile((2.0, 2.0, 0.1), (laser.beams, 1))
    rng = np.random.default_rng(5)
    true_m = cast(building, poses[:, :2], poses[:, 2] + bearings(laser)).ranges_m
    errors = np.stack([laser.measure(building, poses, rng) for _ in range(200)]) - true_m
    away_from_edges = np.abs(np.gradient(true_m)) < 0.02
    spread = np.nanstd(errors, axis=0)[away_from_edges]
    assert np.median(spread) == pytest.approx(0.004, rel=0.15)
    bias = np.abs(np.nanmean(errors, axis=0))[away_from_edges]
    assert (bias < np.maximum(0.010, 0.01 * true_m[away_from_edges])).all()
    assert bias.max() > 0.003


def test_what_the_urg_cannot_see_is_an_error_code_and_no_range():
    laser, building = Urg04lx(), corridor(30.0, 2.0)
    poses = np.tile((15.0, 1.0, 0.0), (laser.beams, 1))
    reported_mm = laser.measure_mm(building, poses, np.random.default_rng(1))
    assert reported_mm[384 - 44] == 0  # straight down the corridor
    assert set(np.unique(reported_mm[reported_mm < 20])) <= {0, 7, 9}
    assert reported_mm[reported_mm >= 20].min() >= 20
    assert reported_mm.max() <= 5600
    ranges = laser.measure(building, poses, np.random.default_rng(1))
    np.testing.assert_array_equal(np.isnan(ranges), reported_mm < 20)


def test_a_dark_wall_is_seen_only_from_near():
    wall = Building(np.array(((3.0, -5.0, 3.0, 5.0), (-1.0, -5.0, -1.0, 5.0))), dark=np.array((True, False)))
    laser, rng = Urg04lx(), np.random.default_rng(2)
    ahead, share = slice(300, 380), {}
    for x in (0.0, 2.2):
        poses = np.tile((x, 0.0, 0.0), (laser.beams, 1))
        share[x] = np.isfinite(laser.measure(wall, poses, rng)[ahead]).mean()
    assert share[0.0] == 0.0
    assert share[2.2] > 0.9


def test_a_sick_reports_infinity_where_nothing_returns():
    wall = Building(np.array(((3.0, -50.0, 3.0, 50.0),)))
    laser = Sick()
    ranges = laser.measure(wall, np.zeros((180, 3)), np.random.default_rng(0))
    assert ranges[90] == pytest.approx(3.0, abs=0.05)
    assert ranges[0] == np.inf  # along the wall
    np.testing.assert_allclose(ranges[1:] * 100, np.rint(ranges[1:] * 100), atol=1e-3)


def test_the_same_seed_gives_the_same_scans():
    first = list(simulate_scans(room(), max_scans=30, seed=7))
    again = list(simulate_scans(room(), max_scans=30, seed=7))
    other = list(simulate_scans(room(), max_scans=30, seed=8))
    for (stamp_a, ranges_a, truth_a), (stamp_b, ranges_b, truth_b) in zip(first, again, strict=True):
        assert stamp_a == stamp_b
        np.testing.assert_array_equal(ranges_a, ranges_b)
        np.testing.assert_array_equal(truth_a, truth_b)
    assert any(not np.array_equal(a[1], b[1], equal_nan=True) for a, b in zip(first, other, strict=True))


def test_each_ray_of_a_moving_laser_is_cast_from_its_own_place():
    laser = Sick(noise_m=0.0, time_increment_s=0.001)
    building = corridor(40.0, 2.0)
    scans = list(simulate_scans(building, laser=laser, speed_mps=1.0, rest_s=0.0, max_scans=40))
    _, ranges, truth = scans[-1]
    # The ray straight ahead is taken 90 ms after the stamp: the robot is 9 cm further by then.
    assert 40.0 - truth[0] - ranges[90] == pytest.approx(0.09, abs=0.006)


def test_a_lap_ends_where_it_began():
    truths = [truth for _, _, truth in simulate_scans(room(), laser=Sick(beams=1))]
    assert np.hypot(*(truths[-1] - truths[0])[:2]) < 0.3


def test_an_unsteady_hand_keeps_a_speed_for_seconds_and_then_another_one():
    laser, hall = Sick(beams=1), corridor(60.0, 2.0)
    drive = {"laser": laser, "speed_mps": 0.5, "rest_s": 0.0, "max_scans": 350, "seed": 4}
    poses = np.array([truth for *_, truth in simulate_scans(hall, unsteady=0.4, **drive)])
    speeds = np.diff(poses[10:, 0]) / laser.period_s
    assert 0.29 < speeds.min() < 0.4
    assert 0.42 < speeds.max() < 0.51
    changes = np.flatnonzero(np.abs(np.diff(speeds)) > 0.01)
    held = np.diff(changes[np.diff(changes, prepend=-10) > 5]) * laser.period_s
    assert len(held) >= 3
    assert held.min() >= 4.5
    with pytest.raises(ValueError, match=r"unsteady = 1.0, must be in \[0, 1\)"):
        next(simulate_scans(hall, unsteady=1.0))


def test_a_robot_drives_the_arc_of_its_wheels():
    robot = WheeledRobot(Building(np.empty((0, 4))), (0.0, 0.0, 0.0))
    speed, turn = 0.2, 0.4
    robot.drive(speed - turn * 0.129, speed + turn * 0.129)
    for now_ms in range(10, 2010, 10):
        robot.advance(now_ms * 1_000_000)
    yaw = turn * 2.0
    expected = (speed / turn * np.sin(yaw), speed / turn * (1 - np.cos(yaw)), yaw)
    np.testing.assert_allclose(robot.pose, expected, atol=1e-9)


def test_the_past_of_a_robot_can_be_asked_for_and_a_little_of_its_future():
    robot = WheeledRobot(Building(np.empty((0, 4))), (0.0, 0.0, 0.0))
    robot.drive(0.1, 0.1)
    for now_ms in range(15, 1515, 15):
        robot.advance(now_ms * 1_000_000)
    asked = np.array((0.2, 0.777, 1.5, 1.52))
    np.testing.assert_allclose(
        robot.poses_at((asked * SECOND).astype(np.int64))[:, 0], 0.1 * asked, atol=1e-9
    )


def test_a_wall_stops_the_robot_and_presses_the_bumper():
    robot = WheeledRobot(room(6.0, 5.0, furniture=False), (5.0, 2.5, 0.0))
    robot.drive(0.3, 0.3)
    for now_ms in range(15, 5000, 15):
        robot.advance(now_ms * 1_000_000)
    assert robot.pose[0] == pytest.approx(6.0 - 0.165, abs=1e-3)
    assert robot.bumps == BUMP_LEFT | BUMP_RIGHT
    assert robot.twist[0] == 0.0
    robot.drive(-0.1, -0.1)
    robot.advance(6 * SECOND)
    assert robot.bumps == 0
    assert robot.pose[0] < 5.8


@pytest.mark.parametrize(("yaw", "side"), [(0.9, BUMP_RIGHT), (-0.9, BUMP_LEFT)])
def test_a_slanted_wall_presses_one_side_of_the_bumper(yaw, side):
    robot = WheeledRobot(room(6.0, 5.0, furniture=False), (5.0, 2.5, yaw))
    robot.drive(0.3, 0.3)
    for now_ms in range(15, 5000, 15):
        robot.advance(now_ms * 1_000_000)
    assert robot.bumps == side


def test_a_robot_that_backs_into_a_wall_stops_without_a_bump():
    robot = WheeledRobot(room(6.0, 5.0, furniture=False), (1.0, 2.5, 0.0))
    robot.drive(-0.3, -0.3)
    for now_ms in range(15, 5000, 15):
        robot.advance(now_ms * 1_000_000)
    assert robot.pose[0] == pytest.approx(0.165, abs=1e-3)
    assert robot.bumps == 0


def test_thousands_of_scans_take_seconds():
    began = time.process_time()
    count = sum(1 for _ in simulate_scans(demo_building(), max_scans=500))
    assert count == 500
    assert time.process_time() - began < 10.0  # about 0.5 s; the bound only guards against a lost fast path
