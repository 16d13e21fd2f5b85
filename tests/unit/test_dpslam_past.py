"""A past is enough to go on from: the same map, one frame, and never a guess between two places."""

import numpy as np
import pytest

from drivers.world import Building, Urg04lx, demo_building, outline, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.dpslam.joining import joined
from processing.dpslam.layer import Layer, Paint
from processing.dpslam.memory import MOST_SCANS
from processing.dpslam.past import Past, past_of
from processing.dpslam.redrawing import rebuild
from processing.dpslam.resume import Returning
from processing.motion import Motion
from processing.scan import Beams, Scan
from tests.lasers import beams_of_laser

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)
KNOWN = np.diag((0.01**2, 0.01**2, 0.003**2))
CONFIG = DpSlamConfig(particles=8)
TWINS = Building(
    outline([(0.0, 0.0, 4.0, 3.0), (10.0, 0.0, 14.0, 3.0), (4.0, 1.3, 10.0, 1.7)]),
    route=np.array(((1.0, 1.5), (13.0, 1.5), (1.0, 1.5), (3.0, 1.5))),
    name="twins",
)


def course(building, first, last, seed=0, route=None):
    """Scans `first` to `last` of a drive, with a good odometry that begins at `first`, and the true poses.

    The poses are seen from where the drive would have begun.
    """
    made = simulate_scans(building, route, laser=LASER, speed_mps=0.6, max_scans=last, rest_s=0.0, seed=seed)
    origin = before = start = None
    steps = []
    for number, (stamp_ns, ranges_m, world_t_laser) in enumerate(made):
        origin = world_t_laser if origin is None else origin
        pose = se2.between(origin, world_t_laser)
        if number >= first:
            start = pose if start is None else start
            twist = np.zeros(3) if before is None else se2.between(before, pose) / LASER.period_s
            odom = se2.snap_yaw(se2.between(start, pose))
            steps.append((Scan(stamp_ns, ranges_m.copy(), BEAMS), Motion(stamp_ns, odom, KNOWN, twist), pose))
        before = pose
    return steps


@pytest.fixture(scope="module")
def mapped():
    """A map of the first rooms of the demo building."""
    slam = DpSlam(CONFIG, 1)
    for scan, motion, _ in course(demo_building(), 0, 420):
        slam.step(scan, motion)
    slam.finish()
    return slam


@pytest.fixture(scope="module")
def past(mapped):
    return past_of(mapped)


def off(pose, truth):
    error = se2.between(truth, pose)
    return float(np.hypot(error[0], error[1])), abs(float(error[2]))


def drive(robot, steps):
    return [robot.step(scan, motion) for scan, motion, _ in steps]


def test_a_rebuilt_map_is_the_map(mapped, past):
    again = rebuild(past, CONFIG)
    seen, drawn = mapped.occupancy(), again.occupancy()
    assert seen.origin_m == drawn.origin_m
    assert np.array_equal(seen.probability, drawn.probability, equal_nan=True)
    for one, other in zip(mapped.trajectory(), again.trajectory(), strict=True):
        assert np.array_equal(one, other)
    assert [len(points) for points in mapped.loops.way.points] == [
        len(points) for points in again.loops.way.points
    ]


def test_what_is_held_is_told_with_the_points_by_which_places_are_found_again(mapped, past):
    points = sum(one.nbytes for one in mapped.loops.way.points)
    assert mapped.loops.way.bytes_used == rebuild(past, CONFIG).loops.way.bytes_used == points > 0
    without = mapped.population.store.bytes_held + mapped._scans.bytes_used
    assert mapped.bytes_held == without + points


def test_a_rebuilt_past_is_the_past(past):
    again = past_of(rebuild(past, CONFIG)).arrays()
    for name, array in past.arrays().items():
        assert np.array_equal(array, again[name]), name


def test_the_number_of_particles_may_change_from_day_to_day(past):
    more = rebuild(past, DpSlamConfig(particles=20))
    few = rebuild(past, DpSlamConfig(particles=2, close_loops=False))
    assert np.array_equal(more.occupancy().probability, few.occupancy().probability, equal_nan=True)


def test_a_past_that_does_not_fit_together_is_refused(past):
    arrays = past.arrays()
    for name, wrong in {
        "twists": past.twists[1:],
        "counts": past.counts + 1,
        "keys": past.keys[::-1].copy(),
        "relation_ends": past.relation_ends + len(past.keys),
        "places": past.places + len(past.keys),
        "numbers": past.numbers + np.uint16(LASER.beams),
    }.items():
        if len(wrong) == 0:
            continue
        with pytest.raises(ValueError, match=r"must|shape"):
            Past(**(arrays | {name: wrong}))


def test_a_drive_from_an_unknown_start_is_mapped_into_the_saved_frame(past):
    robot = Returning(past, CONFIG, seed=2)
    steps = course(demo_building(), 200, 420, seed=5)
    answers = drive(robot, steps)
    found = [number for number, answer in enumerate(answers) if not answer.lost]
    assert robot.found
    assert found[0] < 30
    assert found == list(range(found[0], len(steps)))
    assert off(answers[-1].map_t_laser, steps[-1][2])[0] < 0.15
    robot.finish()
    stamps_ns, path = robot.trajectory()
    assert robot.first_scan == 420
    assert len(stamps_ns) == 420 + len(steps)
    # What was driven before it was found lies in the same frame.
    for pose, (_, _, truth) in zip(path[420:], steps, strict=True):
        assert off(pose, truth)[0] < 0.2
    both = robot.past()
    assert both.drives.tolist() == [0, 420]
    assert len(both.keys) > len(past.keys) + 10


def test_it_goes_on_a_third_day_and_memory_is_bounded(past):
    steps = course(demo_building(), 0, 150, seed=6)
    own = DpSlam(CONFIG, 3)
    drive(own, steps)
    second = past_of(own)
    third = joined(past, second, len(second.keys) - 1, steps[-1][2])
    for _ in range(3):
        third = joined(third, second, len(second.keys) - 1, steps[-1][2])
    places, counts = np.unique(third.places[:, :3], axis=0, return_counts=True)
    assert counts.max() <= MOST_SCANS
    assert len(places) < len(third.places)
    assert third.counts.sum() == len(third.ranges_m)
    assert rebuild(third, CONFIG).occupancy().probability.size > 1


def test_on_a_fixed_map_nothing_is_written(past):
    robot = Returning(past, CONFIG, seed=2, fixed=True)
    before = robot.saved.occupancy()
    steps = course(demo_building(), 200, 420, seed=5)
    answers = drive(robot, steps)
    assert robot.found
    assert np.array_equal(before.probability, robot.occupancy().probability, equal_nan=True)
    for answer, (_, _, truth) in list(zip(answers, steps, strict=True))[60:]:
        distance, turn = off(answer.map_t_laser, truth)
        assert distance < 0.15
        assert turn < 0.05


def test_elsewhere_it_is_not_found_and_has_a_map_of_its_own(past):
    hall = outline([(0.0, 0.0, 3.1, 3.1), (3.1, 1.0, 12.0, 1.7)])
    elsewhere = Building(hall, route=np.array(((1.6, 1.6), (11.0, 1.35))), name="elsewhere")
    robot = Returning(past, CONFIG, seed=2)
    answers = drive(robot, course(elsewhere, 0, 120))
    assert all(answer.lost for answer in answers)
    assert not robot.found
    assert robot.first_scan == 0
    assert len(robot.trajectory()[0]) == 120
    assert robot.past().drives.tolist() == [0]


# Within a room nothing tells which it is; the corridor leads out on one side only.
AROUND = np.array(((11.0, 1.1), (12.6, 1.1), (12.6, 2.0), (11.2, 1.9), (11.0, 1.5), (3.0, 1.5)))
BEGIN = np.array((1.0, 1.5, 0.0))


def follow(building, last):
    """Map a building; then begin in its second room: the answers, and how far each is from the truth."""
    slam = DpSlam(CONFIG, 1)
    drive(slam, course(building, 0, 330))
    robot = Returning(past_of(slam), CONFIG, seed=2)
    answers, errors = [], []
    for scan, motion, pose in course(building, 0, last, seed=4, route=AROUND):
        answers.append(robot.step(scan, motion))
        world = se2.compose((*AROUND[0], 0.0), pose)
        errors.append(off(se2.compose(BEGIN, answers[-1].map_t_laser), world)[0])
    return answers, errors


def test_where_half_the_building_is_as_the_other_both_places_are_named_and_neither_is_believed():
    answers, _ = follow(TWINS, 110)
    assert all(answer.lost for answer in answers)
    named = [answer.places for answer in answers if len(answer.places) > 1]
    assert len(named) > 50
    assert max(abs(se2.between(named[-1][0], place)[2]) for place in named[-1]) > 3.0


def test_what_the_way_shows_decides_between_two_rooms():
    rooms = [(0.0, 0.0, 4.0, 3.0), (10.0, 0.0, 14.0, 3.0), (4.0, 1.2, 10.0, 1.8), (4.6, 1.8, 5.8, 2.6)]
    told = Building(outline(rooms), route=TWINS.route, name="told")
    answers, errors = follow(told, 250)
    assert max(len(answer.places) for answer in answers[:60]) > 1
    found = [number for number, answer in enumerate(answers) if not answer.lost]
    assert found
    # The rooms are ten metres apart; the bare corridor between them may be mapped a little short.
    assert max(errors[number] for number in found) < 1.0


def test_a_scanner_with_other_beams_is_refused(past):
    robot = Returning(past, CONFIG)
    other = Beams(count=360, angle_min_rad=-1.5, angle_increment_rad=0.01)
    scan = Scan(1, np.ones(360, dtype=np.float32), other)
    with pytest.raises(ValueError, match="360 beams, must be 682"):
        robot.step(scan, Motion(1, np.zeros(3), KNOWN, np.zeros(3)))


def test_the_same_drive_is_the_same_to_the_bit(past):
    steps = course(demo_building(), 200, 260, seed=5)
    one, other = Returning(past, CONFIG, seed=2), Returning(past, CONFIG, seed=2)
    for first, second in zip(drive(one, steps), drive(other, steps), strict=True):
        assert np.array_equal(first.particles, second.particles)
    assert np.array_equal(one.occupancy().probability, other.occupancy().probability, equal_nan=True)


def cells_where(grid, chosen):
    rows, cols = np.nonzero(chosen)
    corner = np.round(np.array(grid.origin_m)[::-1] / grid.resolution_m).astype(int)
    return np.column_stack((rows, cols)) + corner


def test_paint_stands_over_the_map_and_the_newer_stroke_wins(past):
    path = past.map_t_laser
    grid = rebuild(past, CONFIG).occupancy()
    walls = cells_where(grid, grid.probability > 0.65)[:40]
    layer = Layer.none().painted(walls, Paint.ERASED, path)
    layer = layer.painted(walls[:10], Paint.WALL, path).painted(walls[:5], Paint.KEEP_OUT, path)
    assert [layer.count(paint) for paint in Paint] == [30, 10, 5]
    assert np.array_equal(
        np.sort(layer.cells(path), axis=0)[:3], np.sort(np.vstack((walls, walls[:5])), axis=0)[:3]
    )
    shown = layer.over(grid, path)
    changed = cells_where(grid, (shown.probability != grid.probability) & ~np.isnan(grid.probability))
    assert {tuple(cell) for cell in changed} <= {tuple(cell) for cell in walls}
    free = cells_where(grid, shown.probability == 0.0)
    assert {tuple(cell) for cell in walls[10:]} <= {tuple(cell) for cell in free}
    kept_out = cells_where(grid, layer.keep_out(grid, path))
    assert {tuple(cell) for cell in kept_out} == {tuple(cell) for cell in walls[:5]}
    assert len(layer.without(Paint.KEEP_OUT)) == 40


def test_paint_moves_with_the_path_that_it_is_tied_to(past):
    path = past.map_t_laser
    layer = Layer.none().painted(np.array(((3, 4), (10, -7))), Paint.WALL, path)
    moved = se2.compose((1.0, -0.5, 0.0), path)
    assert (layer.cells(moved) - layer.cells(path)).tolist() == [[-10, 20]] * 2


def test_the_laser_is_followed_on_the_map_as_painted(past):
    path = past.map_t_laser
    grid = rebuild(past, CONFIG).occupancy()
    walls = cells_where(grid, grid.probability > 0.65)
    unknown = np.array(((900, 900), (901, 900)))
    layer = Layer.none().painted(walls, Paint.ERASED, path).painted(unknown, Paint.WALL, path)
    robot = Returning(past, CONFIG, fixed=True, layer=layer)
    shown = robot.saved.occupancy()
    assert len(cells_where(shown, shown.probability > 0.65)) == len(unknown)
    # With every wall erased there is nothing left on which it could be found.
    assert not any(not answer.lost for answer in drive(robot, course(demo_building(), 200, 240, seed=5)))


def test_an_empty_layer_and_a_wrong_one():
    assert len(Layer.none()) == 0
    with pytest.raises(ValueError, match="no known kind"):
        Layer(paints=np.array([9], np.uint8), keys=np.zeros(1, np.int64), spots=np.zeros((1, 2)))
    with pytest.raises(ValueError, match="must be as many"):
        Layer(paints=np.array([1], np.uint8), keys=np.zeros(2, np.int64), spots=np.zeros((1, 2)))
