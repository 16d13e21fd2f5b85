"""The whole pipeline on simulated drives: deterministic, a pose for every scan, stored and taken up again."""

import numpy as np
import pytest

from drivers.world import Building, Urg04lx, outline, pillar_hall, room, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.motion import Motion
from processing.odometry import Tracking
from processing.scan import Beams, Scan
from processing.slam import Slam, SlamConfig
from tests.lasers import beams_of_laser

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)
CONFIG = SlamConfig(mapping=DpSlamConfig(particles=10))


@pytest.fixture(scope="module")
def course():
    """(scan, true pose seen from the first) of a drive between pillars."""
    out, start = [], None
    for stamp_ns, ranges_m, world_t_laser in simulate_scans(
        pillar_hall(9.0, 7.0), laser=LASER, speed_mps=0.5, max_scans=260, seed=3
    ):
        start = world_t_laser if start is None else start
        out.append((Scan(stamp_ns, ranges_m.copy(), BEAMS), se2.between(start, world_t_laser)))
    return out


@pytest.fixture(scope="module")
def run(course):
    slam = Slam(CONFIG, seed=4)
    steps = [slam.step(scan) for scan, _ in course]
    return slam, steps


def test_the_path_is_the_true_one_within_centimetres(run, course):
    slam, _ = run
    _, path = slam.trajectory()
    error = se2.between(np.array([pose for _, pose in course]), path)
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.08
    assert np.abs(error[:, 2]).max() < 0.03


def test_every_scan_has_a_pose_under_its_own_stamp_in_the_order_of_arrival(run, course):
    slam, steps = run
    stamps_ns, path = slam.trajectory()
    assert stamps_ns.tolist() == [scan.stamp_ns for scan, _ in course]
    assert path.shape == (len(course), 3)
    assert 0 < sum(step.mapping.updated for step in steps) < len(course) / 2
    for step in steps:
        assert step.mapping.particles.shape == (10, 3)
        assert step.mapping.weights.sum() == pytest.approx(1.0)
        assert 1.0 <= step.mapping.n_eff <= 10.0 + 1e-9


@pytest.mark.parametrize("most", [1, 7, 50, 10_000])
def test_a_part_of_the_way_is_the_whole_one_with_gaps_and_ends_where_it_ends(run, most):
    slam, _ = run
    stamps_ns, path = slam.trajectory()
    some_ns, part = slam.mapping.trajectory(most)
    assert 0 < len(part) <= most
    assert some_ns[-1] == stamps_ns[-1]
    assert len(np.unique(np.diff(np.searchsorted(stamps_ns, some_ns)))) <= 1
    np.testing.assert_array_equal(part, path[np.searchsorted(stamps_ns, some_ns)])


def test_the_same_scans_and_seed_give_the_same_bits_and_another_seed_others(run, course):
    slam, _ = run
    again, other = Slam(CONFIG, seed=4), Slam(CONFIG, seed=5)
    for scan, _ in course[:120]:
        again.step(scan)
        other.step(scan)
    first = slam.mapping.population.ancestry.path(slam.mapping.population.best)
    keys = again.mapping.population.keys
    assert not np.array_equal(again.mapping.population.poses, other.mapping.population.poses)
    for scan, _ in course[120:]:
        again.step(scan)
    assert keys < again.mapping.population.keys
    assert np.array_equal(again.mapping.population.path, first)
    assert np.array_equal(again.occupancy().probability, slam.occupancy().probability, equal_nan=True)


def test_pillars_are_occupied_the_way_is_free_and_what_lies_outside_is_unknown(run, course):
    slam, _ = run
    grid = slam.occupancy()

    def at(x, y):
        col, row = ((np.array((x, y)) - grid.origin_m) / grid.resolution_m).astype(int)
        return grid.probability[row - 1 : row + 2, col - 1 : col + 2]

    for _, pose in course[::20]:
        # Ahead nothing answers from so far away: between two key scans no ray need have crossed a cell.
        around = at(pose[0], pose[1])
        assert np.isfinite(around).mean() > 0.5
        assert np.nanmax(around) < 0.25
    assert np.isnan(grid.probability).mean() > 0.05
    occupied = (grid.probability > 0.65).sum()
    assert 200 < occupied < 3000


def test_in_a_plain_corridor_the_mapper_goes_on_where_the_odometry_does():
    # Two niches to begin with, and then nothing but two walls.
    free = [(0.0, 0.0, 40.0, 2.0), (1.5, 2.0, 2.5, 2.8), (4.0, -0.8, 5.0, 0.0)]
    plain = Building(outline(free), route=np.array(((1.0, 1.0), (39.0, 1.0))))
    slam, steps, blind = Slam(CONFIG, seed=1), [], []
    course = simulate_scans(plain, laser=LASER, speed_mps=0.5, max_scans=180, rest_s=0.0, seed=1)
    for stamp_ns, ranges_m, world_t_laser in course:
        step = slam.step(Scan(stamp_ns, ranges_m.copy(), BEAMS))
        steps.append((step.match.motion.odom_t_laser, step.mapping.map_t_laser, world_t_laser))
        blind.append(step.match.state is Tracking.DEGENERATE)
    odometry, mapped, true = (np.hypot(*(way[-1] - way[100])[:2]) for way in zip(*steps, strict=True))
    assert all(blind[100:])
    assert true > 3.5
    assert mapped == pytest.approx(odometry, rel=0.15)
    assert odometry == pytest.approx(true, rel=0.15)


def test_taken_up_again_the_run_goes_on_bit_for_bit(run, course):
    motions = [step.match.motion for step in run[1]]
    whole = DpSlam(CONFIG.mapping, seed=4)
    for (scan, _), motion in zip(course[:100], motions[:100], strict=True):
        whole.step(scan, motion)
    # Through a file's worth of plain arrays, in the middle between two key scans.
    state = {name: np.frombuffer(v.tobytes(), v.dtype).reshape(v.shape) for name, v in whole.state().items()}
    resumed = DpSlam.from_state(state, CONFIG.mapping)
    for (scan, _), motion in zip(course[100:], motions[100:], strict=True):
        one, other = whole.step(scan, motion), resumed.step(scan, motion)
        assert np.array_equal(one.map_t_laser, other.map_t_laser)
        assert np.array_equal(one.particles, other.particles)
        assert np.array_equal(one.weights, other.weights)
    whole.finish()
    resumed.finish()
    assert np.array_equal(whole.trajectory()[1], resumed.trajectory()[1])
    one, other = whole.state(), resumed.state()
    assert one.keys() == other.keys()
    for name in one:
        assert np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f"), name


def test_a_state_of_other_particles_is_refused():
    state = DpSlam(DpSlamConfig(particles=3)).state()
    with pytest.raises(ValueError, match=r"4 particles, must be 3 as when the state was taken"):
        DpSlam.from_state(state, DpSlamConfig(particles=4))
    with pytest.raises(ValueError, match=r"close_loops = False, must be as when the state was taken"):
        DpSlam.from_state(state, DpSlamConfig(particles=3, close_loops=False))


def test_another_scanner_in_mid_run_is_refused_and_leaves_no_trace(run, course):
    motions = [step.match.motion for step in run[1]]
    slam, clean = DpSlam(CONFIG.mapping, 1), DpSlam(CONFIG.mapping, 1)
    other = Beams(count=181, angle_min_rad=-1.5, angle_increment_rad=0.0174)
    for number in range(30):
        scan, motion = course[number][0], motions[number]
        if number == 15:
            strange = Scan(motion.stamp_ns, np.ones(181, np.float32), other)
            with pytest.raises(ValueError, match=r"scan of 181 beams, must be 682 as the first scan"):
                slam.step(strange, motion)
        slam.step(scan, motion)
        clean.step(scan, motion)
    assert np.array_equal(slam.trajectory()[1], clean.trajectory()[1])


def test_a_motion_of_another_scan_is_refused(course):
    with pytest.raises(ValueError, match=r"motion of scan 7, must be of scan"):
        DpSlam(CONFIG.mapping).step(course[0][0], Motion(7, np.zeros(3), np.eye(3), np.zeros(3)))


def test_scans_without_a_single_return_are_carried_by_the_motion(run, course):
    motions = [step.match.motion for step in run[1]]
    slam = DpSlam(CONFIG.mapping, 2)
    for number in range(80):
        scan = course[number][0]
        if 40 <= number < 60:
            scan = Scan(scan.stamp_ns, np.full(BEAMS.count, np.nan, np.float32), BEAMS)
        step = slam.step(scan, motions[number])
        assert np.isfinite(step.map_t_laser).all()
    error = se2.between(course[79][1], step.map_t_laser)
    assert np.hypot(error[0], error[1]) < 0.15


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_a_first_scan_of_nothing_is_no_map_and_no_error(value):
    slam = Slam(CONFIG)
    step = slam.step(Scan(1, np.full(BEAMS.count, value, np.float32), BEAMS))
    assert step.mapping.map_t_laser.tolist() == [0.0, 0.0, 0.0]
    assert np.isnan(slam.occupancy().probability).all()


def test_a_person_walking_through_the_room_is_not_left_in_the_map():
    """Somebody walks across the room, between the furniture, while the robot drives around."""
    still = room()
    slam = Slam(SlamConfig(mapping=DpSlamConfig(particles=10)), 0)
    rng = np.random.default_rng(0)
    start, met = None, 0
    for number, (stamp_ns, ranges_m, pose) in enumerate(
        simulate_scans(still, laser=LASER, speed_mps=0.4, max_scans=420, seed=0)
    ):
        start = pose if start is None else start
        person = np.array((1.5 + 0.012 * number, 1.6 + 0.004 * number, 0.2))
        if 20 <= number < 270 and np.hypot(*(person[:2] - pose[:2])) > 0.5:
            pillars = np.vstack((still.pillars, person))
            crowded = Building(still.walls, pillars, still.dark, still.route, closed=True)
            ranges_m = LASER.measure(crowded, np.tile(pose, (LASER.beams, 1)), rng)
            met += 1
        slam.step(Scan(stamp_ns, ranges_m.copy(), BEAMS))
    assert met > 150
    error = se2.between(se2.between(start, pose), slam.trajectory()[1][-1])
    assert np.hypot(error[0], error[1]) < 0.1
    grid = slam.occupancy()
    rows, cols = np.nonzero(grid.probability > 0.65)
    laser_frame = np.column_stack((cols + 0.5, rows + 0.5)) * grid.resolution_m + grid.origin_m
    world = se2.transform(start, laser_frame)
    from_wall = np.array([still.nearest(point)[0] for point in world])
    assert len(world) > 200
    assert (from_wall > 0.2).sum() <= 3
