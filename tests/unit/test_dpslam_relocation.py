"""Lost and found: on a saved map, after a loss, and carried away."""

import itertools

import numpy as np
import pytest

from drivers.world import Urg04lx, demo_building, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.motion import Motion, anew_covariance, lost_covariance
from processing.scan import Scan
from tests.lasers import beams_of_laser

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)
KNOWN = np.diag((0.01**2, 0.01**2, 0.003**2))
# The motions of these drives are nearly true: no doubt is laid on them.
CONFIG = DpSlamConfig(particles=8, close_loops=False, motion_doubt=1.0)


def drive(building, scans, seed=0, first_ns=0, every=1):
    """Scans, with motions as a good odometry gives them, and the true poses seen from the first."""
    start, before = None, None
    course = simulate_scans(building, laser=LASER, speed_mps=0.6, max_scans=scans, rest_s=0.0, seed=seed)
    for stamp_ns, ranges_m, world_t_laser in itertools.islice(course, 0, None, every):
        start = world_t_laser if start is None else start
        pose = se2.between(start, world_t_laser)
        twist = np.zeros(3)
        if before is not None:
            step = se2.between(before, pose)
            twist = step / (every * LASER.period_s)
        before = pose
        motion = Motion(stamp_ns + first_ns, se2.snap_yaw(pose), KNOWN, twist)
        yield Scan(stamp_ns + first_ns, ranges_m.copy(), BEAMS), motion, pose


@pytest.fixture(scope="module")
def mapped():
    """A map of the first rooms of the demo building, and the poses on it."""
    slam, poses = DpSlam(CONFIG, 1), []
    for scan, motion, pose in drive(demo_building(), 420):
        slam.step(scan, motion)
        poses.append(pose)
    return slam, np.array(poses)


def moved(motion, odom_t_laser, covariance=None):
    return Motion(
        motion.stamp_ns,
        se2.snap_yaw(odom_t_laser),
        motion.covariance if covariance is None else covariance,
        motion.twist,
    )


def off(pose, truth):
    error = se2.between(truth, pose)
    return float(np.hypot(error[0], error[1])), abs(float(error[2]))


def test_a_new_session_finds_itself_on_the_saved_map_and_goes_on(mapped):
    slam, poses = mapped
    later = DpSlam.from_state(slam.state(), CONFIG)
    keys = later.population.keys
    later.find_itself()
    steps = []
    for number, (scan, motion, _) in enumerate(drive(demo_building(), 420, seed=5, first_ns=10**12)):
        if number < 200:
            continue
        # Its odometry starts at zero, wherever the laser is.
        odom = se2.between(poses[200], poses[number])
        steps.append((number, later.step(scan, moved(motion, odom))))
    found = [number for number, step in steps if not step.lost]
    assert found
    assert found[0] < 260
    assert found == list(range(found[0], 420))  # and it is not lost again
    distance, turn = off(steps[-1][1].map_t_laser, poses[419])
    assert distance < 0.15
    assert turn < 0.05
    assert later.population.keys > keys
    stamps, path = later.trajectory()
    assert len(stamps) == 420 + 220
    # The scans before it was found are laid backwards from there.
    assert np.hypot(*(path[420:, :2] - poses[200:, :2]).T).max() < 0.3


def test_carried_away_blind_it_is_found_where_it_was_put_down(mapped):
    slam, poses = mapped
    robot = DpSlam.from_state(slam.state(), CONFIG)
    course = list(drive(demo_building(), 420, seed=7, first_ns=10**12))
    odom = np.array(poses[-1])
    states = []
    for number in range(150, 260):
        scan, motion, _ = course[number]
        covariance = lost_covariance() if number < 155 else anew_covariance() if number == 155 else KNOWN
        if number > 155:
            odom = se2.compose(odom, se2.between(poses[number - 1], poses[number]))
        states.append(robot.step(scan, moved(motion, odom, covariance)))
    assert states[0].lost
    assert not any(state.updated for state in states[:5])
    assert not states[-1].lost
    distance, _ = off(states[-1].map_t_laser, poses[259])
    assert distance < 0.2


def test_a_map_that_contradicts_what_is_seen_is_not_written_on(mapped):
    slam, poses = mapped
    robot = DpSlam.from_state(slam.state(), CONFIG)
    course = list(drive(demo_building(), 420, seed=8, first_ns=10**12))
    odom = np.array(poses[-1])
    lost_at = found_at = None
    for number in range(100, 330):
        # Put down elsewhere without a word: the odometry takes the new place for the old one.
        scan, motion, _ = course[number]
        if number > 100:
            odom = se2.compose(odom, se2.between(poses[number - 1], poses[number]))
        step = robot.step(scan, moved(motion, odom))
        lost_at = number if step.lost and lost_at is None else lost_at
        if lost_at is not None and not step.lost:
            found_at = number
            break
    assert lost_at is not None
    assert lost_at < 140
    assert found_at is not None
    distance, _ = off(step.map_t_laser, poses[found_at])
    assert distance < 0.2


def test_a_drift_that_the_map_contradicts_is_no_loss(mapped):
    slam, poses = mapped
    robot = DpSlam.from_state(slam.state(), CONFIG)
    robot._is_located = lambda: False
    odom = np.array(poses[-1])
    course = list(drive(demo_building(), 200, seed=8, first_ns=10**12))
    for number in range(100, 200):
        scan, motion, _ = course[number]
        if number > 100:
            odom = se2.compose(odom, se2.between(poses[number - 1], poses[number]))
        assert not robot.step(scan, moved(motion, odom)).lost
    # It goes on by its motions.
    assert off(robot.population.poses[robot.population.best], odom)[0] < 0.3


def test_the_map_may_be_contradicted_where_the_path_is_known_only():
    slam = DpSlam(DpSlamConfig(particles=2))
    assert slam._is_located()
    slam.loops.linked = False
    assert slam._is_located()
    slam.loops.way.drift.go_on(np.zeros((3, 3)), np.zeros(3))
    slam.loops.way.drift.errors.rows[-1] = np.diag((0.01, 1.0, 0.001))
    assert not slam._is_located()
    # Old ground is where something has settled, and the laser is on it.
    slam.loops.linked = True
    assert not slam._is_located()
    slam.loops._old.keys = 1
    assert slam._is_located()


def test_a_search_survives_a_restart(mapped):
    slam, poses = mapped
    robot = DpSlam.from_state(slam.state(), CONFIG)
    robot.find_itself()
    course = list(drive(demo_building(), 420, seed=5, first_ns=10**12))
    steps = [
        (scan, moved(motion, se2.between(poses[200], poses[k]))) for k, (scan, motion, _) in enumerate(course)
    ]
    blind = [
        (Scan(scan.stamp_ns, np.full(LASER.beams, np.nan, np.float32), BEAMS), motion)
        for scan, motion in steps
    ]
    for scan, motion in blind[200:203]:
        assert robot.step(scan, motion).lost
    twin = DpSlam.from_state(robot.state(), CONFIG)
    for scan, motion in steps[203:260]:
        one, other = robot.step(scan, motion), twin.step(scan, motion)
        assert np.array_equal(one.particles, other.particles)
        assert one.lost == other.lost
    assert not one.lost


@pytest.fixture(scope="module")
def on_its_way():
    """A map of 300 scans, where the way goes on to new ground, and the pose at its end."""
    slam = DpSlam(CONFIG, 1)
    course = list(drive(demo_building(), 300))
    for scan, motion, _ in course:
        slam.step(scan, motion)
    return slam, course[-1][2]


@pytest.mark.parametrize(("turned_rad", "found"), [(0.0, True), (1.0, False)])
def test_on_the_way_to_new_ground_a_guess_is_believed_unless_what_is_known_contradicts_it(
    on_its_way, turned_rad, found
):
    slam, end = on_its_way
    robot = DpSlam.from_state(slam.state(), CONFIG)
    written = robot.population.keys
    # Some seconds of nothing, and then the place from which the odometry goes on.
    gap = list(itertools.islice(drive(demo_building(), 335), 300, None))
    for scan, motion, pose in gap:
        covariance = anew_covariance() if scan is gap[-1][0] else lost_covariance()
        odom = se2.compose(end, se2.compose((0.0, 0.0, turned_rad), se2.between(end, pose)))
        step = robot.step(scan, moved(motion, odom, covariance))
    assert step.lost is not found
    assert robot.population.keys == written + found
    if found:
        distance, turn = off(step.map_t_laser, pose)
        assert distance < 0.15
        assert turn < 0.05
