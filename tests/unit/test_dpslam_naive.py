"""The shared store and the ancestry tree give, bit for bit, what P whole maps and P whole paths give."""

import numpy as np
import pytest

from drivers.world import Sick, room, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.motion import Motion
from processing.scan import Scan
from tests.lasers import beams_of_laser
from tests.unit import naive_dpslam as naive

COVARIANCE = np.diag((0.03**2, 0.03**2, 0.01**2))


def drive(scans, seed):
    """Scans of a small laser in a furnished room, with motions that err by a few centimetres a step."""
    laser = Sick(beams=24, angle_increment_rad=np.pi / 24, range_max_m=8.0)
    beams = beams_of_laser(laser)
    rng = np.random.default_rng(seed)
    odom, before = np.zeros(3), None
    course = simulate_scans(room(), laser=laser, speed_mps=0.8, max_scans=scans, rest_s=0.0, seed=seed)
    for stamp_ns, ranges_m, world_t_laser in course:
        if before is not None:
            error = rng.normal(size=3) * (0.02, 0.02, 0.006)
            odom = se2.snap_yaw(se2.compose(odom, se2.between(before, world_t_laser) + error))
        before = world_t_laser
        motion = Motion(stamp_ns, odom, COVARIANCE, np.array((0.5, 0.0, 0.1)))
        yield Scan(stamp_ns, ranges_m.copy(), beams), motion


def maps_of(slam):
    """Dense maps of all particles, cut to the extent of the naive ones."""
    side = 2 * naive.HALF
    for particle in range(slam.config.particles):
        cells, (row, col) = slam.population.store.dense(particle)
        dense = np.zeros((side, side, 4), dtype=np.uint16)
        dense[row + naive.HALF :, col + naive.HALF :][: cells.shape[0], : cells.shape[1]] = cells
        yield dense


def compare(slam, twin):
    assert np.array_equal(slam.population.poses, twin.poses)
    assert np.array_equal(slam.population.log_weights, twin.log_weights)
    assert slam.population.best == twin.best
    for particle, dense in enumerate(maps_of(slam)):
        assert np.array_equal(slam.population.ancestry.path(particle), np.array(twin.paths[particle]))
        assert np.array_equal(dense, twin.maps[particle].cells)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_filter_equals_one_that_copies_whole_maps(seed):
    # Many selections: a strong tempering on few particles.
    config = DpSlamConfig(
        particles=5, points=20, rays=12, key_distance_m=0.15, tempering=1.0, memory=8, close_loops=False
    )
    slam, twin = DpSlam(config, seed), naive.NaiveDpSlam(config, seed)
    slam._on_old_ground = lambda: twin.old_ground
    for number, (scan, motion) in enumerate(drive(46, seed)):
        twin.old_ground = not 6 <= number < 18
        assert slam.step(scan, motion).updated == twin.step(scan, motion)
        if number == 24:
            # A bent past, as closing a loop gives it: both live through it again.
            bend = np.linspace(0.0, 0.06, twin.keys)[:, None] * np.array((0.5, -0.3, 0.1))
            path = se2.compose(slam.population.path, bend)
            slam.relive(path)
            twin.relive(path)
            compare(slam, twin)
    assert twin.selections >= 5
    assert twin.keys >= 15
    compare(slam, twin)


def test_particles_share_most_of_their_tiles():
    config = DpSlamConfig(particles=30, points=20, rays=12, key_distance_m=0.15, close_loops=False)
    slam = DpSlam(config, 3)
    for scan, motion in drive(60, 3):
        slam.step(scan, motion)
    store = slam.population.store
    assert store.tiles_used < 0.8 * int((store.table >= 0).sum())
